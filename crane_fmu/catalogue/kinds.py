"""The FMUs there are: what each computes, carries and must do when nothing is connected."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product

from crane_fmu.catalogue import variables
from crane_fmu.catalogue.choices import FORMULATIONS, MODELS
from crane_fmu.slave.interface import REST, Interface, components
from crane_fmu.slave.lines import PROFILES

Route = tuple[str, str]
"""Names of a model and a formulation."""


@dataclass(frozen=True)
class Kind:
    """One of the FMUs.

    Attributes
    ----------
    name : str
        Of the file and of the model.
    module : str
        Module in `crane_fmu.slave` with the class `Slave`.
    interface : callable
        Makes the table of variables.
    page : str
        The user page in the documentation; its template has the same name and ``.j2``.
    runs : tuple of dict
        Start values for the runs of the check.
    rest : dict
        What the outputs have to be at the end of each.
    routes : tuple of (str, str)
        Models and formulations whose compiled functions it carries.
    to_machine_code : tuple of (str, str)
        Those of them whose steps are compiled further.
    has_plant : bool
        Whether it carries the compiled forward dynamics.
    """

    name: str
    module: str
    interface: Callable[[], Interface]
    page: str
    runs: tuple[dict[str, float | str], ...]
    rest: dict[str, float]
    routes: tuple[Route, ...] = ()
    to_machine_code: tuple[Route, ...] = ()
    has_plant: bool = False

    @property
    def file_name(self) -> str:
        """Name of the file."""
        return f"{self.name}.fmu"


_LOAD_AT_REST = dict(zip(components("load.position"), REST, strict=True))
_CRANE_AT_REST = {"phi": 0.0, "s": REST[0], "l": -REST[2], "tension": 981.0}
_ROUTES = tuple(product(MODELS, FORMULATIONS))

LOAD_TRAJECTORY = Kind(
    name="LoadTrajectory",
    module="trajectory",
    interface=variables.load_trajectory,
    page="fmu-load-trajectory.md",
    runs=tuple({"start_time": 1.0, "profile": name} for name in PROFILES),
    rest=_LOAD_AT_REST,
)

ROTARY_CRANE = Kind(
    name="RotaryCrane",
    module="crane",
    interface=variables.rotary_crane,
    page="fmu.md",
    runs=tuple({"model": model, "formulation": formulation} for model, formulation in _ROUTES),
    rest={**_CRANE_AT_REST, "M_b": 0.0, "F": 0.0, "M_w": -98.1, "swing": 0.0},
    routes=_ROUTES,
    # a compiler takes a second for each of these, and longer than for all of them for one of the model of bodies
    to_machine_code=(*product(["points"], FORMULATIONS), ("generalized", "reduced")),
    has_plant=True,
)

CRANE_PLANT = Kind(
    name="CranePlant",
    module="plant",
    interface=variables.crane_plant,
    page="fmu-crane-plant.md",
    runs=({}, {"M_w": -98.1}, {"M_w": -98.1, "hold": "zero_order", "brakes": "none"}),
    rest={**_CRANE_AT_REST, **_LOAD_AT_REST},
    has_plant=True,
)

KINDS: Mapping[str, Kind] = {each.name: each for each in (LOAD_TRAJECTORY, ROTARY_CRANE, CRANE_PLANT)}
"""All FMUs by name, in the order in which signals pass through them."""
