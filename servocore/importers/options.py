"""Choices beside a file: elastic, locked and passive joints, point masses and ropes, inputs and outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from servocore.errors import InvalidModel, InvalidSetting, require_kind, require_positive, require_real
from servocore.importers.tree import Tree


@dataclass(frozen=True)
class Elastic:
    """An elastic joint: a spring between the motor behind its gear and the link (Spong).

    Parameters
    ----------
    stiffness : float
        K, N m/rad or N/m, positive.
    motor_inertia : float, optional
        Inertia B of the motor behind its gear, kg m2 or kg; the armature of the file when not given.
    damping : float
        Viscous damping beside the spring, N m s/rad or N s/m.

    Raises
    ------
    InvalidSetting
        If a value is negative or not finite, or the stiffness is zero.

    References
    ----------
    M. W. Spong: Modeling and control of elastic joint robots. Journal of Dynamic Systems, Measurement, and Control 109
    (1987) 310-319.
    """

    stiffness: float
    motor_inertia: float | None = None
    damping: float = 0.0

    def __post_init__(self) -> None:
        for name in ("stiffness", "motor_inertia", "damping"):
            value = getattr(self, name)
            if name != "motor_inertia" or value is not None:
                require_positive(value, f"the {name} of an elastic joint", "a number", or_zero=name != "stiffness")


def driven_joints(tree: Tree, options: Options) -> list[str]:
    """Return the joints that have a drive, in the order of the file.

    In files without drives all hinges and slides have one but those of free bodies.
    """
    on = [actuator.on for actuator in tree.actuators if actuator.kind == "joint"]
    if not tree.actuators:
        tied = [body for body in tree.bodies if all(joint.kind != "ball" for joint in body.joints)]
        on = [joint.name for body in tied for joint in body.joints if not joint.mimic]
    return [name for name in tree.joints if name in on and name not in (*options.passive, *options.locked)]


@dataclass(frozen=True)
class Options:
    """Arguments of `servocore.scenes.from_file`, which describes them."""

    outputs: Sequence[str] = ()
    inputs: Sequence[str] | None = None
    elastic: Mapping[str, Elastic] = field(default_factory=dict)
    passive: Sequence[str] = ()
    locked: Sequence[str] = ()
    points: Sequence[str] = ()
    ropes: Sequence[str] = ()
    taut: Sequence[str] = ()
    posture: Mapping[str, float] = field(default_factory=dict)
    payload: Mapping[str, float] = field(default_factory=dict)
    gravity: Sequence[float] | None = None
    limits: bool = True

    @classmethod
    def of(cls, settings: Mapping[str, Any], tree: Tree, source: str) -> Options:
        """Return options from the settings of a TOML file, or of a command line.

        Parameters
        ----------
        settings : mapping of str to object
            The arguments of `servocore.scenes.from_file` by name. An elastic joint is a stiffness, or a table of
            ``stiffness``, ``motor_inertia``, ``damping``; one stiffness is that of all driven joints. A setting
            ``motor_inertia`` holds for all that state none.
        tree : Tree
            The mechanism.
        source : str
            Name of the settings in messages.

        Raises
        ------
        InvalidSetting
            If a name is unknown, or a value is of the wrong kind.
        """
        values = dict(settings)
        motor, elastic = values.pop("motor_inertia", None), values.pop("elastic", {})
        if unknown := [name for name in values if name not in cls.__dataclass_fields__]:
            known = ", ".join([*cls.__dataclass_fields__, "motor_inertia"])
            raise InvalidSetting(f"{source}: there is no setting {unknown[0]}; there are {known}")
        if motor is not None and not elastic:
            raise InvalidSetting(f"{source}: motor_inertia is that of elastic joints, and there are none: set elastic")
        cls(**values)._require_kinds()
        if not isinstance(elastic, Mapping):
            elastic = dict.fromkeys(driven_joints(tree, cls(**values)), elastic)
        joints = dict[str, Elastic]()
        for name, value in elastic.items():
            table = dict(value) if isinstance(value, Mapping) else {"stiffness": value}
            if wrong := [key for key in table if key not in Elastic.__dataclass_fields__] or "stiffness" not in table:
                what = "no stiffness" if wrong is True else f"an unknown value {wrong[0]}"
                raise InvalidSetting(f"{source}: the elastic joint {name} has {what}")
            joints[name] = Elastic(**{"motor_inertia": motor, **table})
        return cls(elastic=joints, **values)

    def require_known(self, tree: Tree) -> None:
        """Raise `InvalidSetting` for a wrong kind of a value, or a name that the file does not have."""
        joints = dict.fromkeys([*tree.joints, *(name for each in tree.joints.values() for name in each.coordinates)])
        listed = (
            ("joint", joints, ("elastic", "passive", "locked", "posture")),
            ("body", tree.body, ("points", "ropes")),
            ("tendon", tree.tendons, ("taut",)),
        )
        self._require_kinds()
        for kind, known, options in listed:
            for option in options:
                for name in getattr(self, option):
                    if name not in known:
                        there_are = ", ".join(known) or "none"
                        raise InvalidSetting(f"{option}: {tree.source} has no {kind} {name}; there are {there_are}")
                    if option in ("locked", "posture") and name in tree.joints and (mimic := tree.joints[name].mimic):
                        raise InvalidSetting(f"{option}: {name} follows {mimic[0]}: name that one")
        self._require_consistent(tree)

    def _require_kinds(self) -> None:
        for option in ("outputs", "inputs", "passive", "locked", "points", "ropes", "taut"):
            value = getattr(self, option)
            listed = isinstance(value, Sequence) and all(isinstance(name, str) for name in value)
            if isinstance(value, str) or not (listed or value is None):
                raise InvalidSetting(f"{option} must be a list of names, not {value!r}")
        for option in ("elastic", "posture", "payload"):
            require_kind(getattr(self, option), Mapping, option, "values by name", InvalidSetting)
        for option in ("posture", "payload"):
            for name, value in getattr(self, option).items():
                require_real(value, f"the {option} of {name}", "a number", InvalidSetting)
        require_kind(self.limits, bool, "limits", "true or false", InvalidSetting)
        numbers = self.gravity if isinstance(self.gravity, Sequence) else (self.gravity,)
        if self.gravity is not None and not (len(numbers) == 3 and all(isinstance(x, int | float) for x in numbers)):
            raise InvalidSetting(f"gravity must be three numbers in m/s2, not {self.gravity!r}")

    def _require_consistent(self, tree: Tree) -> None:
        """Refuse options that exclude each other."""
        for name, elastic in self.elastic.items():
            require_kind(
                elastic, Elastic, f"elastic: {name}", "an Elastic(stiffness, motor_inertia=...)", InvalidSetting
            )
            joint = tree.joints[name]
            if joint.kind == "ball" or joint.mimic or name in self.locked or name in self.passive:
                why = "a ball" if joint.kind == "ball" else "a mimic" if joint.mimic else "locked or passive"
                raise InvalidSetting(f"elastic: {name} is {why}; only driven hinges and slides have a motor")
            if elastic.motor_inertia is None and not joint.armature > 0.0:
                raise InvalidSetting(
                    f"elastic: {name} needs a motor inertia, for {tree.source} states no armature:"
                    f" Elastic({elastic.stiffness:g}, motor_inertia=...)"
                )
        for body in {*self.points, *self.ropes}:
            if body in self.points and body in self.ropes:
                raise InvalidSetting(f"{body} is either one of points or one of ropes")
            if not tree.body[body].mass > 0.0:
                raise InvalidModel(f"{tree.source}: the body {body} has no mass, so that it cannot be a point mass")
