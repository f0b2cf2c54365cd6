"""The demo: build the FMU, run it, compare it with the closed form, and write a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

import servocore as sc
from crane_fmu.build import STEP, SystemOptions, build_ssp
from crane_fmu.catalogue import ROTARY_CRANE, components
from crane_fmu.files import filled_folder, put
from crane_fmu.report import contents
from crane_fmu.report.page import Illustration, Part, Table, page
from crane_fmu.report.study import STEPS, Announce, Cycle, LoadRun, Study, study, working_cycle
from crane_fmu.run import run_fmu, run_ssp
from servocore.cli.run_summary import COLUMNS, table_pieces

REPORT, INPUTS_FILE, FIGURES, SYSTEM = "report.html", "inputs.csv", "figures", "system"

LOOPS: dict[str, dict[str, float]] = {
    "feedforward alone": {"crane.feedback": 0.0},
    "with feedback": {},
    "with feedback, 5 % more mass, gust of 20 N": {
        "plant.mass_error": 0.05,
        "plant.gust[2]": 20.0,
        "plant.gust_start": 8.0,
        "plant.gust_duration": 2.0,
    },
}
"""Runs of the connected FMUs: parameters that differ from their defaults, by label."""


@dataclass(frozen=True)
class Demo:
    """Results of the demo.

    Attributes
    ----------
    folder : Path
        Folder of the files.
    files : tuple of str
        The files, relative to `folder`.
    summary : tuple of str
        Sentences on the results of the default, then of the scheme of the paper.
    tables : tuple of Table
        The results as tables of texts.
    """

    folder: Path
    files: tuple[str, ...]
    summary: tuple[str, ...]
    tables: tuple[Table, ...]


def demo(
    target: Path, announce: Announce = lambda _: None, steps: Sequence[float] = STEPS, *, certify: bool = True
) -> Demo:
    """Run the demo.

    Parameters
    ----------
    target : Path
        Folder for FMU, table of inputs, figures and report; made if it is not there.
    announce : callable
        Called with a description of each stage.
    steps : sequence of float
        Step sizes in s of the scheme of the paper, largest first; rows of tables and the FMU's steps are the first.
    certify : bool
        Whether to prove the inputs for all times; the report states the verdict.

    Returns
    -------
    Demo
        Files, sentences and tables.

    Raises
    ------
    ServocoreError
        If the folder cannot be made or filled, or a part of the demo does not run to its end.
    """
    with filled_folder(target) as draft:
        scene = sc.scenes.rotary_crane()
        system = build_system(draft, announce)
        fmu = draft / ROTARY_CRANE.file_name
        found = study(scene, announce, steps)
        if certify:
            announce("proving the inputs")
            found = replace(found, certificate=sc.certify(found.base).summary)
        announce("running the FMU")
        outputs = run_fmu(fmu, scene.reference, steps[0])
        loop = closed_loops(scene, system, announce)
        announce("working cycle")
        cycle = example_cycle(scene)
        put(draft, {INPUTS_FILE: "".join(table_pieces(found.base, COLUMNS["rotary_crane"]))})
        announce("drawing figures")
        write_report(draft, found, contents.sections(found, outputs, loop, cycle))
        files = tuple(sorted(file.relative_to(draft).as_posix() for file in draft.rglob("*") if file.is_file()))
    tables = (
        contents.error_table(found),
        contents.fmu_table(found, outputs),
        contents.tracking_table(found.tracking),
        contents.loop_table(loop),
        contents.cycle_table(cycle),
        contents.paper_table(found, factors=False),
        contents.difference_table(found),
    )
    told = (*contents.summary(found), *([f"Certificate: {found.certificate}."] if certify else []))
    return Demo(target, files, told, tables)


def build_system(folder: Path, announce: Announce) -> Path:
    """Build the FMUs and the system that connects them; the inverse model lies beside the report too.

    Parameters
    ----------
    folder : Path
        The folder of the demo.
    announce : callable
        Called with a description of each stage.

    Returns
    -------
    Path
        The file of the system.
    """
    own = SystemOptions(targets="host")  # it runs here
    files = build_ssp(folder / SYSTEM, lambda stage: announce(f"building the FMUs: {stage}"), own)
    put(folder, {ROTARY_CRANE.file_name: (folder / SYSTEM / ROTARY_CRANE.file_name).read_bytes()})
    return files[-1]


def closed_loops(scene: sc.Scene, system: Path, announce: Announce) -> list[LoadRun]:
    """Run the connected FMUs along the default manoeuvre, undisturbed and disturbed.

    Parameters
    ----------
    scene : Scene
        The rotary crane.
    system : Path
        The file of the system.
    announce : callable
        Called with a description of each stage.

    Returns
    -------
    list of LoadRun
        Times in s, and positions of the load in m as prescribed and as the plant had them.
    """
    runs = []
    for label, parameters in LOOPS.items():
        announce(f"running the connected FMUs, {label}")
        found = run_ssp(system, scene.reference.duration, STEP, parameters)
        prescribed, driven = (
            np.column_stack([found[name] for name in components(f"{component}.load.position")])
            for component in ("trajectory", "plant")
        )
        begin = parameters.get("plant.gust_start")
        gust = None if begin is None else (begin, begin + parameters["plant.gust_duration"])
        runs.append(LoadRun(label, found["time"], prescribed, driven, gust))
    return runs


def write_report(folder: Path, found: Study, sections: Mapping[str, Sequence[Part]]) -> None:
    """Write the page and, in a folder of their own, its pictures.

    Parameters
    ----------
    folder : Path
        The folder of the demo.
    found : Study
        All results.
    sections : mapping of str to sequence
        Tables, figures and facts by the heading above them.
    """
    drawings: dict[str, bytes] = {}
    for part in chain(*sections.values()):
        if isinstance(part, Illustration):
            drawings |= part.files()
    put(folder / FIGURES, drawings)
    live = sc.live_part(found.base)
    put(folder, {REPORT: page(contents.TITLE, contents.facts(found), live, sections, drawings)})


def example_cycle(scene: sc.Scene) -> Cycle:
    """Compute the working cycle of the examples.

    Parameters
    ----------
    scene : Scene
        The rotary crane.

    Returns
    -------
    Cycle
        Its motion and inputs.
    """
    here = Path(__file__).resolve().parent  # examples are in the installed package, or beside it in a clone
    folder = next(each for each in (here / "examples", here.parent / "examples") if each.is_dir())
    file = folder / "working_cycle_waypoints.csv"
    through, samples = sc.waypoints_from_csv(file), sc.from_csv(folder / "working_cycle_sampled.csv")
    return working_cycle(scene, through, samples, np.loadtxt(file, delimiter=",", skiprows=1))
