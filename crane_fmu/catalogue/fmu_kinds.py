"""The FMUs there are: what each computes, carries and must do when nothing is connected."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

from crane_fmu.catalogue import variables
from crane_fmu.catalogue.choices import FORMULATIONS, MODELS
from crane_fmu.slave.interface import CRANE_PARAMETERS, FROM_FILE, ORDERS, START_ORDERS, Interface, components
from crane_fmu.slave.straight_lines import PROFILES

Starts = Mapping[str, float | str]
"""Start values by the names of variables, in place of defaults."""

NO_STARTS: Starts = MappingProxyType({})


@dataclass(frozen=True)
class FmuKind:
    """One of the FMUs.

    Attributes
    ----------
    name : str
        Of the file and of the model.
    interface : callable
        Makes the table of variables.
    page : str
        The user page in the documentation; its template has the same name and ``.j2``.
    runs : tuple of dict
        Start values for the runs of the check.
    resting : tuple of str
        Outputs that have to be those of a crane at rest at the end of each.
    """

    name: str
    interface: Callable[[], Interface]
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
            Start values of each run.
        """
        if self is LOAD_TRAJECTORY and starts.get("profile") == FROM_FILE:
            return ({},)
        hold = at_rest(starts)["M_w"]
        own = [each.name for each in self.interface().variables if each.causality != "output"]
        still = {name: 0.0 for name in own if name in _MOVING and name in starts}
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


_LOAD = components("load.position")


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
    defaults = {
        variable.name: variable.start
        for variable in variables.crane_plant().variables
        if variable.causality == "parameter"
    }
    known = {name: float(starts.get(name, defaults[name] or 0.0)) for name in (*CRANE_PARAMETERS, *_START)}
    place = [known[name] for name in _START]
    tension = known["load_mass"] * known["gravity"]
    values = {"phi": math.atan2(place[1], place[0]), "s": math.hypot(*place[:2]), "l": -place[2], "tension": tension}
    values |= {"M_b": 0.0, "F": 0.0, "M_w": -tension * known["winch_radius"], "swing": 0.0}
    return values | dict(zip(_LOAD, place, strict=True))


_START = components("start.position")
_MOVING = frozenset(
    (
        *(each.name for each in variables.crane_plant().of("input")),
        *components(*(f"load.{order}" for order in ORDERS[1:]), *(f"start.{order}" for order in START_ORDERS[1:])),
    )
)
"""What is zero while the load rests."""
_CRANE = ("phi", "s", "l", "tension")
_ROUTES = tuple(product(MODELS, FORMULATIONS))

LOAD_TRAJECTORY = FmuKind(
    name="LoadTrajectory",
    interface=variables.load_trajectory,
    page="fmu-load-trajectory.md",
    runs=tuple({"start_time": 1.0, "profile": name} for name in PROFILES),
    resting=_LOAD,
)

ROTARY_CRANE = FmuKind(
    name="RotaryCrane",
    interface=variables.rotary_crane,
    page="fmu.md",
    runs=tuple({"model": model, "formulation": formulation} for model, formulation in _ROUTES),
    resting=(*_CRANE, "M_b", "F", "M_w", "swing"),
)

CRANE_PLANT = FmuKind(
    name="CranePlant",
    interface=variables.crane_plant,
    page="fmu-crane-plant.md",
    runs=({}, {"M_w": -98.1}, {"M_w": -98.1, "hold": "zero_order", "brakes": "none"}),
    resting=(*_CRANE, *_LOAD),
)

KINDS: Mapping[str, FmuKind] = {kind.name: kind for kind in (LOAD_TRAJECTORY, ROTARY_CRANE, CRANE_PLANT)}
"""All FMUs by name, in the order in which signals pass through them."""
