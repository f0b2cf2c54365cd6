"""The command ``crane-fmu``: commands of ``servocore`` bound to the rotary crane, and those of its FMUs."""

from __future__ import annotations

import io
import sys
from dataclasses import dataclass
from pathlib import Path

import rich.box
import rich.table

import servocore as sc
from crane_fmu.catalogue import KINDS, ROTARY_CRANE, FmuKind
from servocore.cli import feedforward, plan, view
from servocore.cli.command import Command, option
from servocore.cli.console import CommandLine, PatientProgress, table_console
from servocore.cli.kinds import FILE, FILE_READ, FOLDER, NAMES, VALUE, choice
from servocore.cli.options import Certified, GivenLimits, GivenPath, Platforms, Rows, Subject, Table, output
from servocore.files import write_together

# Modules that draw, build or run FMUs are imported by the commands that need them: the others start in half the time.

NAME = "crane-fmu"

CRANE: dict[str, object] = {
    "scene": "rotary_crane",
    "servo_output": (),
    "elastic": (),
    "motor_inertia": None,
    "import_settings": None,
}
FMUS: dict[str, object] = {**CRANE, "model": None}
"""Fixed options of commands of the crane, and of its FMUs."""


@dataclass(frozen=True)
class Place:
    """Folder and language of FMUs."""

    title = "Results"

    output: Path | None = output(
        "DIR", "Write into this folder, made if missing. Default of build: here; of ssp: system; of demo: out.", FOLDER
    )
    native: bool = option("--native", help="FMUs in C, which run without Python.")


@dataclass(frozen=True)
class Which:
    """One of the FMUs, or its page."""

    title = "FMU"

    fmu: FmuKind = option(
        "--fmu", kind=choice("FMU", KINDS), metavar="NAME", default=ROTARY_CRANE.name,
        help=f"{', '.join(KINDS)}. Default: {ROTARY_CRANE.name}.",
    )  # fmt: skip
    page: Path | None = option("--page", kind=FILE, metavar="FILE.md", help="Write the user page instead, in Markdown.")


def build(subject: Subject, which: Which, place: Place, platforms: Platforms) -> None:
    """Build RotaryCrane.fmu, validate and run it with FMPy, and write it into a folder.

    With --parameters and --drives the default crane of the FMU is that of the files. Without --targets the FMU has
    libraries for this machine and 64-bit Windows. python build_fmu.py does the same. With --fmu it is another one of
    the system's FMUs.
    """
    from crane_fmu.build import build_fmu, user_page  # noqa: PLC0415

    crane = subject.driven()
    changed = subject.changes(crane)
    if which.page is not None:
        if place.output or platforms.targets:
            raise sc.InvalidSetting("--page writes no FMU: not with --output or --targets")
        write_together({which.page: user_page(which.fmu).encode()})
        return
    with PatientProgress("building the FMU") as progress:
        file = build_fmu(
            place.output or Path(), progress.describe, which.fmu, None, changed, platforms.targets, crane.drives
        )
    print(file)


def ssp(subject: Subject, path: GivenPath, place: Place, platforms: Platforms, certified: Certified) -> None:
    """Build trajectory, inverse model and plant as FMUs, and Crane.ssp, which connects them.

    The folder then holds LoadTrajectory.fmu, RotaryCrane.fmu, CranePlant.fmu with their cross-check files, and
    Crane.ssp. Run it with a communication step of 0.01 s. The load follows the given path, with --profile alone the
    default line by that time law; with --parameters and --drives the crane is that of the files. Nothing has to be set
    in the tool. With --native the FMUs are in C. Without --targets they have libraries for this machine and 64-bit
    Windows, with --native for all platforms if the package ziglang is installed, else for this machine. The verdict of
    the certificate, a proof that the inputs hold at all times of the path, is printed on the error stream.
    """
    crane = subject.driven()
    law = path.profile if path.options() == ["--profile"] else None
    line = path.path(crane) if law is None else None
    from crane_fmu.build import SystemOptions, build_ssp  # noqa: PLC0415

    profile = next((name for name, known in sc.TIME_LAWS.items() if known == law), None)
    options = SystemOptions(line, profile, subject.changes(crane), crane.drives, place.native, platforms.targets)
    with PatientProgress("building the system") as progress:
        usual = crane.reference
        if law is not None:
            start, end = usual.jet([usual.start_time, usual.end_time], 0)[:, 0]
            usual = sc.rest_to_rest(start, end, usual.duration, profile=law)
        told = certified.line(crane.with_parameters(**options.parameters).with_reference(line or usual))
        files = build_ssp(place.output or Path("system"), progress.describe, options)
    print(*files, sep="\n")
    print(*told, sep="\n", end="\n" * len(told), file=sys.stderr)


@dataclass(frozen=True)
class Plant:
    """A crane as an FMU of the user."""

    title = "Plant"

    plant: Path = option(kind=FILE_READ, metavar="PLANT.fmu", default=..., help="FMU of a crane.")
    mapped: tuple[dict[str, str], ...] = option(
        "--map", kind=NAMES, metavar="OURS=THEIRS", default=(),
        help="Name in the FMU of M_b, F, M_w or of the load's x, y, z; or a TOML file with such names.",
    )  # fmt: skip
    settings: tuple[dict[str, float], ...] = option(
        "--set", kind=VALUE, metavar="NAME=NUMBER", default=(),
        help="A start value of the FMU, in the unit of the variable.",
    )  # fmt: skip


def drive(plant: Plant, subject: Subject, path: GivenPath, limits: GivenLimits, rows: Rows, table: Table) -> None:
    """Simulate your own crane, an FMU, under the feedforward inputs, and print the tracking error of its load.

    There is no feedback: the error shows how well the FMU and the model agree. Path and crane are given as for
    feedforward. --step is the communication step; its default is 0.01 s, reduced if need be to divide the duration.
    With --output the motion is written as a table.
    """
    from crane_fmu import drive as driving  # noqa: PLC0415

    names = {ours: theirs for each in plant.mapped for ours, theirs in each.items()}
    starts = {name: value for each in plant.settings for name, value in each.items()}
    moved = path.along(subject.chosen().with_limits(**limits.bounds()))
    rows.require(moved.reference.duration)
    with PatientProgress("driving the plant"):
        found = driving.drive(plant.plant, moved, names, starts, rows.step)
    if table.output is not None:
        write_together({table.output: driving.table(found)})
    print(*driving.sentences(found), sep="\n")


def run_demo(place: Place, certified: Certified) -> None:
    """Build the FMU, run it, compare it with the closed form and a forward simulation, and write a report.

    The folder then holds RotaryCrane.fmu, the folder system of the command ssp, inputs.csv, report.html and a folder
    of figures. The inputs are those of exact inversion; the scheme of the paper is shown for comparison. Takes half a
    minute.
    """
    from crane_fmu.demo import REPORT, demo  # noqa: PLC0415

    with PatientProgress("demo") as progress:
        done = demo(place.output or Path("out"), progress.describe, certify=not certified.no_certify)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a stream without Greek letters gets question marks
    console = table_console()
    console.print(*done.summary, "", sep="\n")
    for table in done.tables:
        shown = rich.table.Table(*table.headings, box=rich.box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
        for row in table.rows:
            shown.add_row(*row)
        console.print(f"[bold]{table.title}[/bold]", f"[dim]{table.by}[/dim]", shown, sep="\n")
        console.print(table.note, "", sep="\n" if table.note else "")
    console.print(f"{len(done.files)} files in {done.folder}; the report is {done.folder / REPORT}", soft_wrap=True)


_LINE = "--from 5 0 -5 --to -2 2 -2"

app = CommandLine(
    NAME,
    "Feedforward inputs (inverse dynamics) of a rotary crane for a prescribed load path, and the crane as an FMU.",
    [
        Command(
            "feedforward", feedforward.feed_forward,
            (f"{_LINE} --duration 20", "--reference path.csv --parameters crane.toml --output inputs.csv"),
            CRANE,
        ),
        Command(
            "plan", plan.plan_motion,
            (f"{_LINE} --limit M_b=1000 --limit F=60 --limit swing=5deg -o plan.csv",
             f"{_LINE} --limit F=60 -o plan.csv --write-path way.csv"),
            {**CRANE, **plan.FIXED},
        ),
        Command(
            "view", view.view_scene, ("", f"{_LINE} --duration 20 --limit F=60 -o mine.html"),
            CRANE,
        ),
        Command("build", build, ("-o fmus",), {**FMUS, "native": False}),
        Command("ssp", ssp, ("-o system", "--reference way.csv -o system"), FMUS),
        Command(
            "drive", drive,
            ("mine.fmu --map F=trolley.f --map M_b=slew.tau --map M_w=hoist.tau --map x=load.r[1] --map y=load.r[2]"
             f" --map z=load.r[3] {_LINE} --duration 20",),
            {**CRANE, "model": None, "columns": None, "plot": None, "verbose": False},
        ),
        Command("demo", run_demo, ("-o out",), {"native": False}),
    ],
)  # fmt: skip
