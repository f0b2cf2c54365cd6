"""`Scene`: models of one system of different size, limits, a default reference and a closed form."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from servocore.errors import InvalidModel, InvalidReference, InvalidSetting, described, require_kind
from servocore.model.drawing import Drawing
from servocore.model.effects import NO_EFFECTS, Effects
from servocore.model.limits import RATE, Bounds, Limit, limit_named, quantity_named
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.references.base import Reference
from servocore.references.consistency import require_consistent

if TYPE_CHECKING:
    from servocore.model.drives import Drive

ModelFactory = Callable[[], MechanicalSystem]
"""Factory of a model. Equal factories share one model; one without a hash makes a new one every time."""

ClosedForm = Callable[[Array, Mapping[str, float]], dict[str, Array]]
"""(reference jets (N, orders, m), parameter values) -> arrays (N,) by name."""

IndependentSolution = Callable[[Array, Reference, Mapping[str, float]], dict[str, Array]]
"""(times (N,), reference, parameter values) -> arrays (N,) by name, computed without this library's solvers."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A servo constraint problem: models, path, parameter values, limits and, if known, its exact solution.

    Parameters
    ----------
    name : str
        Identifier, such as ``rotary_crane``.
    models : mapping of str to callable
        Factories of its models, smallest first: the first is the default. Each is called once for all
        scenes; a factory with settings should be a frozen dataclass with `__call__`, so that equal settings compare
        equal.
    reference : Reference
        The path of the servo outputs.
    closed_form : callable, optional
        Exact solution by name, for reference jets with `closed_form_order` derivatives.
    closed_form_order : int
        Highest derivative of the path in the closed form.
    independent_solution : callable, optional
        For scenes with internal dynamics, which have no closed form: their differential equation, derived by hand and
        integrated to near round-off by SciPy.
    limits : tuple of Limit
        Limits of the scene.
    parameters : mapping of str to float
        Values that differ from the defaults.
    follow_branch : bool
        Whether every instant of the exact inversion starts from the extrapolated previous one instead of the model's
        guess: where several configurations belong to one output, a run then stays on the branch on which it started,
        and continues smoothly where two branches meet.
    tracked : str
        Name of the body whose position the outputs are: ``load``. Tables of variables then have
        vectors ``load.position``, ``load.velocity``.
    effects : Effects
        Physical effects that the scene neglects, or may neglect, see `with_effects`.
    drawing : callable, optional
        Symbols of reported quantities and of parameters, by name -> the parts that pages draw, see `Part`; bodies and
        points by the names of coordinates when not given.
    hint : str
        A sentence about other choices of coordinates or inputs, which `analyse` adds where the problem is singular or
        its internal dynamics are not damped.
    drives : mapping of str to Drive
        Motors and transmissions by the names of their inputs, see `with_drives`.
    """

    name: str
    models: Mapping[str, ModelFactory]
    reference: Reference
    closed_form: ClosedForm | None = None
    closed_form_order: int = 4
    independent_solution: IndependentSolution | None = None
    limits: tuple[Limit, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    follow_branch: bool = False
    tracked: str = ""
    effects: Effects = NO_EFFECTS
    drawing: Drawing | None = None
    hint: str = ""
    drives: Mapping[str, Drive] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_kind(self.name, str, "the name of a scene", "a text", InvalidModel)
        if not self.name.strip():
            raise InvalidModel("a scene needs a name, for messages, tables and files")
        require_kind(
            self.models, Mapping, f"{self.name}: models", "factories by name, such as {'only': make}", InvalidModel
        )
        if not self.models:
            raise InvalidModel(f"{self.name}: a scene needs a model")
        for name, factory in self.models.items():
            if not isinstance(name, str) or isinstance(factory, MechanicalSystem) or not callable(factory):
                raise InvalidModel(
                    f"{self.name}: the model {name} is {described(factory)}; models are functions that make a system:"
                    f" models={{{name!r}: lambda: system}}"
                )
        require_kind(self.reference, Reference, f"{self.name}: the reference", "a Reference", InvalidReference)
        if not type(self.reference).__module__.startswith(f"{__package__.partition('.')[0]}."):
            require_consistent(self.reference)
        require_kind(self.parameters, Mapping, f"{self.name}: parameters", "values by name", InvalidModel)
        if not (isinstance(self.limits, Sequence) and all(isinstance(limit, Limit) for limit in self.limits)):
            raise InvalidModel(f"{self.name}: limits must be a tuple of Limit, not {described(self.limits)}")

        for attribute in ("closed_form", "independent_solution", "drawing"):
            value = getattr(self, attribute)
            if not (value is None or callable(value)):
                raise InvalidModel(f"{self.name}: {attribute} must be a function, not {described(value)}")

    @property
    def default_model(self) -> str:
        """Name of the smallest model."""
        return next(iter(self.models))

    @property
    def independent_model(self) -> str | None:
        """Name of the first model without holonomic constraints: its coordinates are a minimal state."""
        return next((name for name in self.models if not self.model(name).lam.numel()), None)

    def model(self, name: str | None = None) -> MechanicalSystem:
        """Return the model called `name`, or the default one, the same object every time.

        Parameters
        ----------
        name : str, optional
            One of `models`.

        Returns
        -------
        MechanicalSystem
            Made at the first call.

        Raises
        ------
        InvalidModel
            If there is no such model.
        """
        name = name or self.default_model
        if not isinstance(name, Hashable) or name not in self.models:
            raise InvalidModel(f"{self.name} has no model {name}; it has {', '.join(self.models)}")
        factory = self.models[name]
        try:
            system: object = _made(factory) if isinstance(factory, Hashable) else factory()
        except TypeError as error:
            if "required positional argument" not in str(error):
                raise
            raise InvalidModel(f"{self.name}: the factory of {name} is called without arguments: {error}") from None
        if not isinstance(system, MechanicalSystem):
            raise InvalidModel(
                f"{self.name}: the factory of {name} returned {described(system)}, not a MechanicalSystem"
            )
        if not self.drives:
            return system
        from servocore.model.drives import driven  # noqa: PLC0415 - few scenes have them

        return driven(system, tuple(self.drives.items()))

    def with_reference(self, reference: Reference) -> Scene:
        """Return the scene with another path; raises `InvalidReference` if it does not fit.

        A path needs the scene's dimension. One from a file whose header declares no units is also refused where its
        times or positions are out of proportion to the scene, as milliseconds and millimetres would be.

        Parameters
        ----------
        reference : Reference
            With as many components as the scene has outputs.

        Returns
        -------
        Scene
            A new scene; this one is unchanged.
        """
        from servocore.references.likely_units import require_likely_units  # noqa: PLC0415 - a scene has a path already

        changed = replace(self, reference=reference)
        system = changed.model()
        changed.require_path(system)
        require_likely_units(reference, self.reference, system.home, [output.unit for output in system.outputs])
        return changed

    def require_path(self, system: MechanicalSystem) -> None:
        """Raise `InvalidReference` if the reference has not one component for each output of a model.

        Parameters
        ----------
        system : MechanicalSystem
            One of the scene's models.
        """
        outputs = [quantity.name for quantity in system.outputs]
        if self.reference.dimension != len(outputs):
            raise InvalidReference(
                f"{self.name} needs a path with {len(outputs)} components, this one has {self.reference.dimension}; the"
                f" outputs are {', '.join(outputs)}"
            )

    def with_parameters(self, **values: float) -> Scene:
        """Return the scene with other parameter values; raises `InvalidModel` for bad names or values.

        Parameters
        ----------
        **values : float
            By the name of a parameter, in its unit.

        Returns
        -------
        Scene
            A new scene; this one is unchanged.
        """
        merged = {**self.parameters, **values}
        self.model().parameters.values(merged)
        return replace(self, parameters=merged)

    def with_effects(self, *names: str, without: Iterable[str] = ()) -> Scene:
        """Return the scene with effects added or left out, and a single model with these effects.

        Parameters
        ----------
        *names : str
            Effects to add; those that the scene declares are in ``scene.effects.declared``. Their parameters become
            parameters of the scene.
        without : sequence of str
            Effects that the scene has and that are left out.

        Returns
        -------
        Scene
            A new scene; this one is unchanged.

        Raises
        ------
        InvalidModel
            If the scene declares no such effect, or cannot have them together.

        Examples
        --------
        >>> import servocore as sc
        >>> crane = sc.scenes.rotary_crane().with_effects("friction", "flexible bridge")
        >>> crane = crane.with_parameters(bridge_frequency=2.0)
        >>> sc.analyse(crane).index
        7
        """
        if not self.effects.declared:
            raise InvalidModel(f"{self.name} declares no effects that could be added or left out")
        effects = self.effects.with_(names, (without,) if isinstance(without, str) else without)
        return self._with_models(models={"with effects": effects}, effects=effects)

    def with_drives(self, **drives: Drive | None) -> Scene:
        """Return the scene with motors and transmissions at its inputs, and all its models with them.

        Reflected inertia and friction join the equations; inputs keep name, place and unit, and are the motor's torque
        times its transmission. Observables ``NAME.motor_torque``, ``.motor_speed``, ``.power``, ``.current`` and
        ``.torque_reserve`` are reported beside them, and ``.energy`` and ``.rms_torque`` of the run up to each instant;
        the data of the drives are parameters, ``NAME.motor_inertia``.
        The scene has no closed form then.

        Parameters
        ----------
        **drives : Drive or None
            By the name of an input; they replace those of the same inputs, and None removes one.

        Returns
        -------
        Scene
            A new scene; this one is unchanged.

        Raises
        ------
        InvalidModel
            If there is no such input, its unit is neither N nor N.m, or the drive's radius is missing or superfluous.

        Examples
        --------
        >>> import servocore as sc
        >>> slewing = sc.Drive(ratio=120, motor_inertia=0.012, rated_torque=12)
        >>> crane = sc.scenes.rotary_crane().with_drives(M_b=slewing).with_limits(**{"M_b.motor_torque": 20})
        >>> sc.solve(crane).unit("M_b.motor_torque")
        'N.m'
        """
        from servocore.model.drives import Drive, place_of_input  # noqa: PLC0415 - few scenes have them

        for name, drive in drives.items():
            require_kind(drive, (Drive, type(None)), f"the drive of {name}", "a Drive", InvalidModel)
            place_of_input(self.model(), name)
        merged = {name: drive for name, drive in {**self.drives, **drives}.items() if drive is not None}
        return self._with_models(drives=merged)

    def _with_models(self, **changes: Any) -> Scene:
        """Return the scene with models of which no solution is known, and those of its parameters that they have."""
        changed = replace(self, closed_form=None, independent_solution=None, **changes)
        known = changed.model().parameters.names
        return replace(changed, parameters={name: x for name, x in self.parameters.items() if name in known})

    def with_limits(self, **bounds: Bounds | None) -> Scene:
        """Return the scene with limits of reported quantities by name, which replace those of the same name.

        `solve` and `ExactInversion` refuse a path that violates one, with the time.

        Parameters
        ----------
        **bounds : float, str or pair
            By the name of an input, an observable, an output or a coordinate, or that name and ``.rate``. One number is
            the largest magnitude, an upper bound if the quantity is never negative; a pair is a lower and an upper
            bound, None for none. A text has its unit, ``5 deg``. None removes the limit. Those of ``M_b.energy`` and
            ``M_b.rms_torque``, of drives, are on their values at the end of a run.

        Returns
        -------
        Scene
            A new scene; this one is unchanged.

        Raises
        ------
        InvalidSetting
            If no quantity has a name, or its bounds are invalid.

        Examples
        --------
        >>> import servocore as sc
        >>> crane = sc.scenes.rotary_crane()
        >>> crane = crane.with_limits(F=60, M_w=(-104, -92), swing="5 deg", **{"s.rate": 1.2, "F.rate": 200})
        >>> sc.solve(crane, step=0.1).margins["F"].slack > 0
        True
        """
        model, names = self.model(), [each.reported + RATE * each.rate for each in self.limits]
        for name in bounds:
            if name not in names:  # one that is removed may be of a model that the scene has no more
                quantity_named(model, name)
        new_limits = tuple(limit_named(model, name, bound) for name, bound in bounds.items() if bound is not None)
        kept = (each for each, name in zip(self.limits, names, strict=True) if not each.reported or name not in bounds)
        return replace(self, limits=(*kept, *new_limits))

    def parameter_values(self) -> dict[str, float]:
        """All parameters by name.

        Returns
        -------
        dict of str to float
            In the units of the parameters.
        """
        parameters = self.model().parameters
        return dict(zip(parameters.names, map(float, parameters.values(self.parameters)), strict=True))

    def exact(self, t: Array) -> dict[str, Array]:
        """Evaluate the exact solution at the times `t`; raises `InvalidModel` if the scene has none.

        Parameters
        ----------
        t : ndarray, shape (N,)
            Times in s.

        Returns
        -------
        dict of str to ndarray, shape (N,)
            Inputs, and further quantities of the solution, by name and in their units.
        """
        if self.independent_solution is not None:
            return self.independent_solution(t, self.reference, self.parameter_values())
        if self.closed_form is None:
            raise InvalidModel(f"{self.name} has no closed form")
        return self.closed_form(self.reference.jet(t, self.closed_form_order), self.parameter_values())


def require_scene(subject: object, who: str) -> None:
    """Raise `InvalidModel`, with the correct form, if the argument of `who` is not a `Scene`."""
    if isinstance(subject, MechanicalSystem):
        raise InvalidModel(
            f"{who} takes a Scene, not the system {subject.name}: Scene(name, models={{'only': lambda: system}},"
            " reference=path) says which path its outputs follow"
        )
    require_kind(subject, Scene, f"the first argument of {who}", "a Scene", InvalidModel)


def within_limits(scene: Scene, limits: Mapping[str, Bounds | None] | None) -> Scene:
    """Return a scene with limits that are given as one argument; raises `InvalidSetting` if they are no mapping."""
    require_kind(limits, (Mapping, type(None)), "limits", "bounds by name, as {'F': 60}", InvalidSetting)
    return scene.with_limits(**limits) if limits else scene


# Resolved problems and compiled functions are memoized by the system object: scenes made twice, by `with_reference` or
# by calling `cars(3)` again, must have the same one. The bound of the memo limits memory where many factories are made.
@made_once
def _made(factory: ModelFactory) -> MechanicalSystem:
    return factory()
