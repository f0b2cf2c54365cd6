"""The FMUs there are: what each computes, carries and must do when nothing is connected."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product

import servocore as sc
from crane_fmu.catalogue import variables as tables
from crane_fmu.slave.crane import PLANT_FILE, program_file
from crane_fmu.slave.interface import REST, Interface

FORMULATIONS: Mapping[str, sc.Formulation] = {
    "reduced": sc.Reduced(),
    "projected": sc.Projected(),
    "original": sc.Original(),
}
"""Formulations that the inverse model offers; the first is the default."""

Progress = Callable[[str], None]
"""Called with what is being done."""

_ERRORS = "from servocore.errors import {}\n"
_TABLE_SOURCES = ("__init__", "interface", "base", "checks", "guard")
_PLANT_MODEL = "generalized"


@dataclass(frozen=True)
class Kind:
    """One of the FMUs.

    Attributes
    ----------
    name : str
        Of the file and of the model.
    module, slave : str
        Where the slave's class is, and its name.
    own_sources, servocore_sources : tuple of str
        Modules that travel with it; of servocore also packages.
    face : str
        The small edition of ``servocore/__init__.py``.
    interface : callable
        Makes the table of variables.
    compiled : callable
        Makes the texts of compiled functions by file name.
    to_machine_code : tuple of str
        Names of those files that hold programs whose steps are compiled further.
    template, page : str
        Template of the user page, and the page in the documentation.
    runs : tuple of dict
        Start values for the runs of the check.
    rest : dict
        What the outputs have to be at the end of each.
    """

    name: str
    module: str
    slave: str
    own_sources: tuple[str, ...]
    servocore_sources: tuple[str, ...]
    face: str
    interface: Callable[[], Interface]
    compiled: Callable[[Progress], dict[str, str]]
    template: str
    page: str
    runs: tuple[dict[str, float | str], ...]
    rest: dict[str, float]
    to_machine_code: tuple[str, ...] = ()

    @property
    def file_name(self) -> str:
        """Name of the file."""
        return f"{self.name}.fmu"


def _programs(tell: Progress) -> dict[str, str]:
    files = {}
    for model, formulation in product(_models(), FORMULATIONS):
        tell(f"compiling {model}, {formulation}")
        files[program_file(model, formulation)] = _program(model, formulation)
    return {**files, **_plant(tell)}


@cache
def _program(model: str, formulation: str) -> str:
    crane = sc.scenes.rotary_crane()
    return sc.Stepper(crane, FORMULATIONS[formulation], sc.BackwardEuler(), 0.1, model).program.to_json()


def _plant(tell: Progress) -> dict[str, str]:
    tell("compiling the forward dynamics")
    return {PLANT_FILE: _plant_text()}


@cache
def _plant_text() -> str:
    return sc.compile_plant(sc.scenes.rotary_crane().model(_PLANT_MODEL)).to_json()


def _models() -> tuple[str, ...]:
    return tuple(sc.scenes.rotary_crane().models)


def _face(errors: str, *imports: str) -> str:
    return '"""The part of servocore that an FMU needs."""\n\n' + _ERRORS.format(errors) + "\n".join([*imports, ""])


_AT_REST = {"phi": 0.0, "s": REST[0], "l": -REST[2], "tension": 981.0}

ROTARY_CRANE = Kind(
    name="RotaryCrane",
    module="slave.crane",
    slave="CraneSlave",
    own_sources=(
        *_TABLE_SOURCES, "crane", "estimate", "feedback", "motion", "paths", "quick",
    ),
    servocore_sources=("calls", "errors", "plant", "program"),
    face=_face(
        "InconsistentStart, IntegrationFailed, InvalidReference, InvalidSetting, ServocoreError",
        "from servocore.plant import Plant",
        "from servocore.program import Program",
    ),
    interface=lambda: tables.crane_interface(_models(), tuple(FORMULATIONS)),
    compiled=_programs,
    template="fmu.md.j2",
    page="fmu.md",
    runs=tuple({"model": model, "formulation": name} for model, name in product(_models(), FORMULATIONS)),
    rest={**_AT_REST, "M_b": 0.0, "F": 0.0, "M_w": -98.1, "swing": 0.0},
    # a compiler takes a second for each of these, and longer than for all of them for one of the model of bodies
    to_machine_code=(
        *(program_file("points", formulation) for formulation in FORMULATIONS),
        program_file("generalized", "reduced"),
    ),
)  # fmt: skip

LOAD_TRAJECTORY = Kind(
    name="LoadTrajectory",
    module="slave.trajectory",
    slave="TrajectorySlave",
    own_sources=(*_TABLE_SOURCES, "trajectory"),
    servocore_sources=("errors", "references"),
    face=_face(
        "InvalidReference, InvalidSetting, ServocoreError",
        "from servocore.references import DEGREE9, DEGREE13, Profile, Reference, from_csv, rest_to_rest, three_phase",
    ),
    interface=tables.trajectory_interface,
    compiled=lambda _: {},
    template="load_trajectory.md.j2",
    page="fmu-load-trajectory.md",
    runs=tuple({"start_time": 1.0, "profile": name} for name in ("degree9", "degree13", "three-phase")),
    rest={f"load.position[{k + 1}]": REST[k] for k in range(3)},
)

CRANE_PLANT = Kind(
    name="CranePlant",
    module="slave.plant",
    slave="PlantSlave",
    own_sources=(*_TABLE_SOURCES, "paths", "plant"),
    servocore_sources=("calls", "errors", "plant", "program"),
    face=_face(
        "IntegrationFailed, InvalidReference, InvalidSetting, ServocoreError", "from servocore.plant import Plant"
    ),
    interface=tables.plant_interface,
    compiled=_plant,
    template="crane_plant.md.j2",
    page="fmu-crane-plant.md",
    runs=({}, {"M_w": -98.1}, {"M_w": -98.1, "hold": "zero_order", "brakes": "none"}),
    rest={**_AT_REST, **{f"load.position[{k + 1}]": REST[k] for k in range(3)}},
)

KINDS: Mapping[str, Kind] = {each.name: each for each in (LOAD_TRAJECTORY, ROTARY_CRANE, CRANE_PLANT)}
"""All FMUs by name, in the order in which signals pass through them."""
