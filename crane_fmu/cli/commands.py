"""The command ``crane-fmu``: commands of ``servocore`` bound to the rotary crane, and those of its FMUs."""

from __future__ import annotations

import io
import sys
from dataclasses import dataclass
from pathlib import Path

import rich.box
import rich.table

import servocore as sc
from servocore.cli import feedforward, plan, view
from servocore.cli.command import Command, option
from servocore.cli.console import CommandLine, PatientProgress, table_console
from servocore.cli.kinds import FILE_READ, FOLDER, NAMES, VALUE
from servocore.cli.options import NO_POINTS_BETWEEN, GivenLimits, GivenPath, Platforms, Rows, Subject, Table, output
from servocore.files import write_together

# What draws, builds or runs FMUs is imported by the commands that need it: the others start in half the time.

NAME = "crane-fmu"

CRANE: dict[str, object] = {"scene": "rotary_crane"}
FMUS: dict[str, object] = {**CRANE, **NO_POINTS_BETWEEN, "model": None}
"""Options that are fixed: for commands of the crane, and for those of its FMUs."""


@dataclass(frozen=True)
class Place:
    """Where FMUs go, and in what language they are."""

    title = "Results"

    output: Path | None = output(
        "DIR", "Write into this folder, which is made if need be. Default: here, system of ssp, out of demo.", FOLDER
    )
    native: bool = option("--native", help="FMUs in C, which need no Python where they run.")


def build(subject: Subject, place: Place, platforms: Platforms) -> None:
    """Build RotaryCrane.fmu, check it in a process of its own and put it into a folder.

    With --parameters the crane of the file is the FMU's default. It is the same as python build_fmu.py.
    """
    from crane_fmu.build import build_fmu  # noqa: PLC0415

    changed = subject.changes(sc.scenes.rotary_crane())
    with PatientProgress("building the FMU") as progress:
        file = build_fmu(place.output or Path(), progress.describe, starts=changed, targets=platforms.targets)
    print(file)


def ssp(subject: Subject, path: GivenPath, place: Place, platforms: Platforms) -> None:
    """Build trajectory, inverse model and plant as FMUs, and Crane.ssp, which connects them.

    The folder then holds LoadTrajectory.fmu, RotaryCrane.fmu, CranePlant.fmu with their cross-check files, and
    Crane.ssp. Run it with a communication step of 0.01 s. With a path the load goes that way, with --profile alone
    along the default line by that law, with --parameters the crane is that of the file, without anything to set in the
    tool. With --native they are in C. All have libraries for the platforms of --targets.
    """
    crane = sc.scenes.rotary_crane()
    law = path.profile if path.options() == ["--profile"] else None
    line = path.path(crane) if law is None else None
    from crane_fmu.build import SystemOptions, build_ssp  # noqa: PLC0415

    profile = next((name for name, known in sc.TIME_LAWS.items() if known == law), None)
    options = SystemOptions(line, profile, subject.changes(crane), place.native, platforms.targets)
    with PatientProgress("building the system") as progress:
        files = build_ssp(place.output or Path("system"), progress.describe, options)
    print(*files, sep="\n")


@dataclass(frozen=True)
class Plant:
    """A crane of the user's own, as an FMU."""

    title = "Plant"

    plant: Path = option(kind=FILE_READ, metavar="PLANT.fmu", default=..., help="An FMU of a crane, your own say.")
    mapped: tuple[dict[str, str], ...] = option(
        "--map", kind=NAMES, metavar="OURS=THEIRS", default=(),
        help="What M_b, F, M_w and the load's x, y, z are called in the FMU, or a TOML file that says so.",
    )  # fmt: skip
    settings: tuple[dict[str, float], ...] = option(
        "--set", kind=VALUE, metavar="NAME=NUMBER", default=(),
        help="A start value of the FMU, in its own unit.",
    )  # fmt: skip


def drive(plant: Plant, subject: Subject, path: GivenPath, limits: GivenLimits, rows: Rows, table: Table) -> None:
    """Drive a crane of your own, an FMU, by our inputs, and say how far its load leaves the path.

    There is no feedback: what is seen is how well your crane and ours agree. Path and crane are given as for
    feedforward. The --step is the one of communication; without it, it is 0.01 s or a little less to divide the
    duration. With --output the motion goes into a table.
    """
    from crane_fmu import drive as driving  # noqa: PLC0415

    names = {ours: theirs for each in plant.mapped for ours, theirs in each.items()}
    starts = {name: value for each in plant.settings for name, value in each.items()}
    moved = path.along(subject.chosen().with_limits(**limits.bounds()))
    rows.require(moved.reference.duration)
    with PatientProgress("driving the plant"):
        found = driving.drive(plant.plant, moved, names, starts, rows.step)
    if table.output is not None:
        write_together({table.output: found.table()})
    print(*found.sentences(), sep="\n")


def run_demo(place: Place) -> None:
    """Build the FMU, run it, compare it with the closed form and with a forward simulation, and write a report.

    The folder then holds RotaryCrane.fmu, the folder system of the command ssp, inputs.csv, report.html and a folder
    of figures. Inputs are those of the default, exact inversion; the scheme of the paper is shown beside it. Takes
    half a minute.
    """
    from crane_fmu.demo import REPORT, demo  # noqa: PLC0415

    with PatientProgress("demo") as progress:
        done = demo(place.output or Path("out"), progress.describe)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a stream that knows no Greek gets question marks
    console = table_console()
    console.print(*done.summary, "", sep="\n")
    for table in done.tables:
        shown = rich.table.Table(*table.headings, box=rich.box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
        for row in table.rows:
            shown.add_row(*row)
        console.print(f"[bold]{table.title}[/bold]", f"[dim]{table.by}[/dim]", shown, sep="\n")
        console.print(table.note, "", sep="\n" if table.note else "")
    for note in done.notes:
        console.print(note)
    console.print(f"{len(done.files)} files in {done.folder}; the report is {done.folder / REPORT}", soft_wrap=True)


_LINE = "--from 5 0 -5 --to -2 2 -2"

app = CommandLine(
    NAME,
    "Inputs that make the load of a rotary crane follow its path, and that crane as an FMU.",
    [
        Command(
            "feedforward", feedforward.feed_forward,
            (f"{_LINE} --duration 20", "--reference path.csv --parameters crane.toml --output inputs.csv"),
            {**CRANE, **NO_POINTS_BETWEEN},
        ),
        Command(
            "plan", plan.plan_motion,
            (f"{_LINE} --limit M_b=1000 --limit F=60 --limit swing=5deg -o plan.csv",
             f"{_LINE} --limit F=60 -o plan.csv --write-path way.csv"),
            {**CRANE, **plan.FIXED},
        ),
        Command(
            "view", view.view_scene, ("", f"{_LINE} --duration 20 --limit F=60 -o mine.html"),
            {**CRANE, **NO_POINTS_BETWEEN},
        ),
        Command("build", build, ("-o fmus",), {**FMUS, "native": False}),
        Command("ssp", ssp, ("-o system", "--reference way.csv -o system"), FMUS),
        Command(
            "drive", drive,
            ("mine.fmu --map F=trolley.f --map M_b=slew.tau --map M_w=hoist.tau --map x=load.r[1] --map y=load.r[2]"
             f" --map z=load.r[3] {_LINE} --duration 20",),
            {**FMUS, "columns": None, "plot": None, "verbose": False},
        ),
        Command("demo", run_demo, ("-o out",), {"native": False}),
    ],
)  # fmt: skip
