"""What there is, by name: formulations, methods, time laws, models of the crane, and the FMUs.

The command line, the FMUs, their pages and their checks read the same tables. The first name of each is the default.
What each FMU has says its model description.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import TypeVar

import servocore as sc
from servocore.cli import choices

FORMULATIONS, METHODS = choices.FORMULATIONS, choices.METHODS
"""Formulations and methods by their names on the command line."""

MODELS = tuple(sc.scenes.rotary_crane().models)
"""Models of the crane; the first, and smallest, is the default."""

PROFILES = sc.TIME_LAWS
"""Time laws of a straight line; the first is the default."""

Choice = TypeVar("Choice")


def chosen(table: Mapping[str, Choice], name: str, kind: str) -> Choice:
    """Look a name up; raises `InvalidSetting` with the names there are.

    Parameters
    ----------
    table : mapping of str to Choice
        What there is to choose from.
    name : str
        The name that a user gave.
    kind : str
        What messages call its kind.

    Returns
    -------
    Choice
        Its entry.
    """
    if name not in table:
        raise sc.InvalidSetting(f"there is no {kind} {name!r}; there are {', '.join(table)}")
    return table[name]


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
"""What the inverse model has to be told of the load path, order by order."""

FEEDBACK_INPUTS = (
    *(f"measured.{name}" for name in ("phi", "s", "l", "phi_dot", "s_dot", "l_dot")),
    *components("measured.position", "measured.velocity"),
)
"""What the feedback has to be told of the crane, in the order in which the law takes it."""


# The FMUs ------------------------------------------------------------------------------------------------------------

Starts = Mapping[str, float | str]
"""Start values by the names of variables, in place of defaults."""

NO_STARTS: Starts = MappingProxyType({})

FROM_FILE = "file"
"""What a trajectory is told in place of a time law to follow the table that it carries."""

_LOAD, _CRANE = components("load.position"), ("phi", "s", "l", "tension")
_STARTS = components(*(f"start.{order}" for order in ORDERS))
_MOVING = (*components(*(f"load.{order}" for order in ORDERS[1:])), *_STARTS[3:], "M_b", "F", "M_w")


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
    resting : tuple of str
        Outputs that have to be those of a crane at rest at the end of each.
    """

    name: str
    page: str
    runs: tuple[dict[str, float | str], ...]
    resting: tuple[str, ...]

    @property
    def file_name(self) -> str:
        """Name of the file."""
        return f"{self.name}.fmu"

    def runs_with(self, starts: Starts) -> tuple[dict[str, float | str], ...]:
        """Return the runs of the check for an FMU with other start values: with a path of its own only as it is.

        Parameters
        ----------
        starts : mapping
            Start values by the name of the variable.

        Returns
        -------
        tuple of dict
            Start values of each run; the FMU does not have all of those that let the load rest.
        """
        if self is LOAD_TRAJECTORY and starts.get("profile") == FROM_FILE:
            return ({},)
        hold, still = at_rest(starts)["M_w"], {name: 0.0 for name in _MOVING if name in starts}
        return tuple(still | run | ({"M_w": hold} if "M_w" in run else {}) for run in self.runs)

    def rest(self, starts: Starts) -> dict[str, float]:
        """Return what outputs have to be at the end of each run.

        Parameters
        ----------
        starts : mapping
            Start values by the name of the variable.

        Returns
        -------
        dict of str to float
            By the name of the output, in its unit.
        """
        if self is LOAD_TRAJECTORY and starts:
            return {}
        values = at_rest(starts)
        return {name: values[name] for name in self.resting}


def at_rest(starts: Starts) -> dict[str, float]:
    """Return what a crane's outputs are while its load hangs where it starts.

    Parameters
    ----------
    starts : mapping
        Start values by the name of the variable.

    Returns
    -------
    dict of str to float
        By the name of the output, in its unit.
    """
    crane = sc.scenes.rotary_crane()
    path = crane.reference
    home = zip(_STARTS, path.jet(path.start_time, 0)[0].tolist(), strict=False)
    known = {name: float(starts.get(name, value)) for name, value in (*crane.parameter_values().items(), *home)}
    place = [known[name] for name in _STARTS[:3]]
    tension = known["load_mass"] * known["gravity"]
    values = {"phi": math.atan2(place[1], place[0]), "s": math.hypot(*place[:2]), "l": -place[2], "tension": tension}
    values |= {"M_b": 0.0, "F": 0.0, "M_w": -tension * known["winch_radius"], "swing": 0.0}
    return values | dict(zip(_LOAD, place, strict=True))


LOAD_TRAJECTORY = FmuKind(
    name="LoadTrajectory",
    page="fmu-load-trajectory.md",
    runs=tuple({"start_time": 1.0, "profile": name} for name in sc.TIME_LAWS),
    resting=_LOAD,
)

ROTARY_CRANE = FmuKind(
    name="RotaryCrane",
    page="fmu.md",
    runs=tuple({"model": model, "formulation": name} for model, name in product(MODELS, FORMULATIONS)),
    resting=(*_CRANE, "M_b", "F", "M_w", "swing"),
)

CRANE_PLANT = FmuKind(
    name="CranePlant",
    page="fmu-crane-plant.md",
    runs=({}, {"M_w": -98.1}, {"M_w": -98.1, "hold": "zero_order", "brakes": "none"}),
    resting=(*_CRANE, *_LOAD),
)

KINDS: Mapping[str, FmuKind] = {kind.name: kind for kind in (LOAD_TRAJECTORY, ROTARY_CRANE, CRANE_PLANT)}
"""All FMUs by name, in the order in which signals pass through them."""
