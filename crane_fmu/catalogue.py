"""Tables by name: formulations, methods, time laws, models of the crane, and the FMUs.

The command line, the FMUs, their pages and their checks read the same tables. The first name of each is the default.
The variables of each FMU are in its model description.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

import servocore as sc
from servocore.cli import choices

FORMULATIONS, METHODS = choices.FORMULATIONS, choices.METHODS
"""Formulations and methods by their names on the command line."""

MODELS = tuple(sc.scenes.rotary_crane().models)
"""Models of the crane; the first, and smallest, is the default."""


# Names that the variables of several FMUs have in common --------------------------------------------------------------

ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")
"""Names of the load path's derivatives of order 0, 1, ..."""

DIMENSION = 3
"""Components of the load path."""


def components(*vectors: str) -> tuple[str, ...]:
    """Return the names of the components of vectors, one vector after the other.

    Parameters
    ----------
    *vectors : str
        Names without an index.

    Returns
    -------
    tuple of str
        With indices from 1 on.
    """
    return tuple(f"{name}[{k}]" for name in vectors for k in range(1, DIMENSION + 1))


PATH_INPUTS = components(*(f"load.{order}" for order in ORDERS))
"""Inputs of the inverse model: the load path and its derivatives, order by order."""

FEEDBACK_INPUTS = (
    *(f"measured.{name}" for name in ("phi", "s", "l", "phi_dot", "s_dot", "l_dot")),
    *components("measured.position", "measured.velocity"),
)
"""Inputs of the feedback: the measured motion of the crane, in the order of the law's arguments."""


# The FMUs ------------------------------------------------------------------------------------------------------------

Starts = Mapping[str, float | str]
"""Start values by the names of variables, in place of defaults."""

NO_STARTS: Starts = MappingProxyType({})

FROM_FILE = "file"
"""Item of a trajectory's `profile`: the path that the FMU contains, in place of a time law."""

_MOVING = (*components(*(f"{of}.{order}" for of in ("load", "start") for order in ORDERS[1:])), "M_b", "F", "M_w")


@dataclass(frozen=True)
class FmuKind:
    """One of the FMUs.

    Attributes
    ----------
    name : str
        Of the file and of the model.
    page : str
        The user page in the documentation; its template has the same name and ``.j2``.
    runs : tuple of dict
        Start values for the runs of the check.
    """

    name: str
    page: str
    runs: tuple[dict[str, float | str], ...]

    @property
    def file_name(self) -> str:
        """Name of the file."""
        return f"{self.name}.fmu"

    def runs_with(self, starts: Starts) -> tuple[dict[str, float | str], ...]:
        """Return the runs of the check; an FMU with a path of its own has one run, with its start values.

        Parameters
        ----------
        starts : mapping
            Start values by the name of the variable.

        Returns
        -------
        tuple of dict
            Start values of each run, among them variables that only some of the FMUs have.
        """
        if self is LOAD_TRAJECTORY and starts.get("profile") == FROM_FILE:
            return ({},)
        still: dict[str, float | str] = {name: 0.0 for name in _MOVING if name in starts}
        known = crane_with(starts).parameter_values()
        hold: dict[str, float | str] = {"M_w": -known["load_mass"] * known["gravity"] * known["winch_radius"]}
        return tuple(still | run | (hold if "M_w" in run else {}) for run in self.runs)


def crane_with(starts: Starts, drives: Mapping[str, sc.Drive] | None = None) -> sc.Scene:
    """Return the rotary crane with those of some start values that are its parameters.

    Parameters
    ----------
    starts : mapping
        Start values by the name of the variable.
    drives : mapping of str to Drive, optional
        By the names of inputs.

    Returns
    -------
    Scene
        The crane; other start values have no effect.
    """
    crane = sc.scenes.rotary_crane().with_drives(**(drives or {}))
    return crane.with_parameters(**{name: float(starts[name]) for name in crane.parameter_values() if name in starts})


LOAD_TRAJECTORY = FmuKind(
    name="LoadTrajectory",
    page="fmu-load-trajectory.md",
    runs=tuple({"start_time": 1.0, "profile": name} for name in sc.TIME_LAWS),
)

ROTARY_CRANE = FmuKind(
    name="RotaryCrane",
    page="fmu.md",
    runs=tuple({"model": model, "formulation": name} for model, name in product(MODELS, FORMULATIONS)),
)

CRANE_PLANT = FmuKind(
    name="CranePlant",
    page="fmu-crane-plant.md",
    runs=({}, {"M_w": -98.1}, {"M_w": -98.1, "hold": "zero_order", "brakes": "none"}),
)

KINDS: Mapping[str, FmuKind] = {kind.name: kind for kind in (LOAD_TRAJECTORY, ROTARY_CRANE, CRANE_PLANT)}
"""All FMUs by name, in the order in which signals pass through them."""
