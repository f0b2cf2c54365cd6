"""The command ``crane-fmu``: its options and what they say; what it computes is in the other modules."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import rich.box
import rich.table
import typer

import servocore as sc
from crane_fmu import feedforward as ff
from crane_fmu.cli import plan
from crane_fmu.cli.options import (
    AbsoluteTolerance,
    DriveStep,
    Duration,
    End,
    FormulationName,
    Limits,
    LimitsFile,
    MethodName,
    ModelName,
    OutputFile,
    OutputStep,
    ParametersFile,
    PlotFile,
    ProfileName,
    Ramp,
    ReferenceFile,
    RelativeTolerance,
    Start,
    Step,
    Tolerance,
    WaypointsFile,
)
from crane_fmu.files import path_in_file
from servocore.cli.console import (
    SETTINGS,
    PatientProgress,
    SentenceGroup,
    Version,
    deliver,
    end_as_of_no_use,
    held_notes,
    table_console,
)
from servocore.cli.run_summary import Columns, Verbose, chosen_columns, details, summary, tell, timed
from servocore.files import require_picture, require_places, write_together

# What draws, builds or runs FMUs is imported by the commands that need it: the others start in half the time.

NAME = "crane-fmu"
app = typer.Typer(
    name=NAME,
    cls=SentenceGroup,
    help="Inputs that make the load of a rotary crane follow its path, and that crane as an FMU.",
    **SETTINGS,
)


@app.callback()
def _commands(_version: Version = False) -> None:
    """Take options that belong to no command; the text of the help is that of `app`."""


_FEEDFORWARD_EXAMPLES = """[bold]Examples[/bold]

The manoeuvre of the demo, as a table on the standard output stream:

[cyan]crane-fmu feedforward --from 5 0 -5 --to -2 2 -2 --duration 20[/cyan]

A path and a crane from files; the table goes into a file:

[cyan]crane-fmu feedforward --reference path.csv --parameters crane.toml --output inputs.csv[/cyan]
"""


@app.command(epilog=_FEEDFORWARD_EXAMPLES)
def feedforward(
    reference: ReferenceFile = None,
    waypoints: WaypointsFile = None,
    tolerance: Tolerance = None,
    start: Start = None,
    end: End = None,
    duration: Duration = None,
    profile: ProfileName = None,
    ramp: Ramp = None,
    parameters: ParametersFile = None,
    model: ModelName = ff.Route.model,
    formulation: FormulationName = ff.Route.formulation,
    method: MethodName = ff.Route.method,
    step: Step = None,
    rtol: RelativeTolerance = None,
    atol: AbsoluteTolerance = None,
    output_step: OutputStep = None,
    limit: Limits = None,
    limits: LimitsFile = None,
    columns: Columns = None,
    output: OutputFile = None,
    plot: PlotFile = None,
    verbose: Verbose = False,
) -> None:
    """Compute the inputs that move the load along a path, as a table.

    The path is a file of samples (--reference) or of waypoints (--waypoints), or a straight line from rest to rest
    (--from, --to, --duration). The table has the columns time,M_b,F,M_w,phi,s,l,x,y,z,tension in SI units, or those of
    --columns, and one row a step. Peaks, rest, and how far the inputs are from right are told on the error stream.
    Where an input is off by half of its peak or more, which can happen if the formulation is not the default one, the
    exit code is 1.
    """
    line = {"--from": start, "--to": end, "--duration": duration, "--profile": profile, "--ramp": ramp}
    path = path_request(reference, tolerance, line, waypoints)
    require_places({"--output": output, "--plot": plot}, [reference, waypoints, parameters, limits])
    require_picture(plot)
    changed = {} if parameters is None else sc.read_parameters(parameters, sc.scenes.rotary_crane())
    contents: dict[Path, str | bytes] = {}
    route = ff.Route(model, formulation, method, step, rtol, atol, output_step)
    with held_notes() as notes, PatientProgress("computing the inputs") as progress:
        names = chosen_columns(columns, sc.scenes.rotary_crane().model(model), ff.COLUMNS)
        with timed() as seconds:
            solution = ff.feedforward(path, changed, route, progress, sc.limits_given(limit, limits))
        table, far_off = ff.table_pieces(solution, names), ff.far_off(solution, path, changed, route)
        told = [] if far_off else summary(solution) + (details(solution, seconds) if verbose else [])
        if far_off:
            notes.clear()  # one sentence says it all
        if plot is not None:
            from crane_fmu.report.style import picture  # noqa: PLC0415
            from crane_fmu.report.trajectories import inputs_and_motion  # noqa: PLC0415

            contents[plot] = picture(inputs_and_motion(solution), plot.suffix.lower(), solution.route)
    deliver(table, output, contents)
    if far_off:
        end_as_of_no_use(NAME, far_off)
    tell(told)


app.command("plan", epilog=plan.EXAMPLES)(plan.plan_motion)

OutputFolder = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="DIR", help="Write into this folder, which is made if it does not exist."),
]


@app.command(epilog="The same as [cyan]python build_fmu.py[/cyan].")
def build(output: OutputFolder = Path(), parameters: ParametersFile = None) -> None:
    """Build RotaryCrane.fmu, check it in a process of its own and put it into a folder.

    With --parameters the crane of the file is the FMU's default.
    """
    from crane_fmu.build import build_fmu  # noqa: PLC0415

    changed = {} if parameters is None else sc.read_parameters(parameters, sc.scenes.rotary_crane())
    with PatientProgress("building the FMU") as progress:
        file = build_fmu(output, progress.describe, starts=changed)
    print(file)


PathToCarry = Annotated[
    Path | None,
    typer.Option("--reference", metavar="FILE.csv", help="A path for the load; LoadTrajectory.fmu carries it."),
]


@app.command(epilog="[bold]Example[/bold]\n\n[cyan]crane-fmu ssp -o system[/cyan]")
def ssp(
    output: OutputFolder = Path("system"),
    reference: PathToCarry = None,
    waypoints: WaypointsFile = None,
    tolerance: Tolerance = None,
    profile: ProfileName = None,
    parameters: ParametersFile = None,
    native: Annotated[bool, typer.Option("--native", help="FMUs in C, which need no Python where they run.")] = False,
    targets: Annotated[
        str | None,
        typer.Option(
            "--targets", metavar="LIST", help="Platforms for which --native compiles, as in servocore export."
        ),
    ] = None,
) -> None:
    """Build trajectory, inverse model and plant as FMUs, and Crane.ssp, which connects them.

    The folder then holds LoadTrajectory.fmu, RotaryCrane.fmu, CranePlant.fmu with their cross-check files, and
    Crane.ssp. Run it with a communication step of 0.01 s. With --reference, --waypoints or --profile the load goes
    that way, with --parameters the crane is that of the file, without anything to set in the tool. With --native they
    are in C.
    """
    if targets is not None and not native:
        raise sc.InvalidSetting("--targets belongs to --native")
    from crane_fmu.build import Wishes, build_ssp  # noqa: PLC0415

    changed = {} if parameters is None else sc.read_parameters(parameters, sc.scenes.rotary_crane())
    with PatientProgress("building the system") as progress:
        wishes = Wishes(reference, waypoints, tolerance, profile, changed, native, targets)
        files = build_ssp(output, progress.describe, wishes)
    print(*files, sep="\n")


Signals = Annotated[
    list[str] | None,
    typer.Option("--map", metavar="OURS=THEIRS",
                 help="What M_b, F, M_w and the load's x, y, z are called in the FMU, or a TOML file that says so."),
]  # fmt: skip
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=NUMBER", help="A start value of the FMU, in its own unit.")
]

_DRIVE_EXAMPLE = """[bold]Example[/bold]

[cyan]crane-fmu drive mine.fmu --map F=trolley.f --map M_b=slew.tau --map M_w=hoist.tau --map x=load.r[1]
--map y=load.r[2] --map z=load.r[3] --from 5 0 -5 --to -2 2 -2 --duration 20[/cyan]
"""


@app.command(epilog=_DRIVE_EXAMPLE)
def drive(
    plant: Annotated[
        Path, typer.Argument(metavar="PLANT.fmu", help="Drive this FMU of a crane, your own for instance.")
    ],
    mapped: Signals = None,
    settings: Settings = None,
    reference: ReferenceFile = None,
    waypoints: WaypointsFile = None,
    tolerance: Tolerance = None,
    start: Start = None,
    end: End = None,
    duration: Duration = None,
    profile: ProfileName = None,
    ramp: Ramp = None,
    parameters: ParametersFile = None,
    step: DriveStep = None,
    limit: Limits = None,
    limits: LimitsFile = None,
    output: OutputFile = None,
) -> None:
    """Drive a crane of your own, an FMU, by our inputs, and say how far its load leaves the path.

    There is no feedback: what is seen is how well your crane and ours agree. The path is given as for feedforward.
    With --output the motion goes into a table.
    """
    from crane_fmu import drive as driving  # noqa: PLC0415

    line = {"--from": start, "--to": end, "--duration": duration, "--profile": profile, "--ramp": ramp}
    path = path_request(reference, tolerance, line, waypoints)
    require_places({"--output": output}, [reference, waypoints, parameters, plant, limits])
    changed = {} if parameters is None else sc.read_parameters(parameters, sc.scenes.rotary_crane())
    names, starts = driving.signals(mapped or ()), driving.settings(settings or ())
    with PatientProgress("driving the plant"):
        found = driving.drive(plant, path, names, changed, starts, step, sc.limits_given(limit, limits))
    if output is not None:
        write_together({output: found.table()})
    print(*found.sentences(), sep="\n")


@app.command("demo", epilog="[bold]Example[/bold]\n\n[cyan]crane-fmu demo -o out[/cyan]")
def run_demo(output: OutputFolder = Path("out")) -> None:
    """Build the FMU, run it, compare it with the closed form and with a forward simulation, and write a report.

    The folder then holds RotaryCrane.fmu, the folder system of the command ssp, inputs.csv, report.html and a folder of
    figures. Inputs are those of the
    default, exact inversion; the scheme of the paper is shown beside it. Takes half a minute.
    """
    from crane_fmu.demo import REPORT, demo  # noqa: PLC0415

    with PatientProgress("demo") as progress:
        done = demo(output, progress.describe)
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


def path_request(
    reference: Path | None, tolerance: float | None, line: Mapping[str, Any], waypoints: Path | None = None
) -> Callable[[], sc.Reference]:
    """Turn the options that describe a path, a straight line by their names, into a function that makes it.

    Raises
    ------
    InvalidSetting
        If they describe no path, two, or half of one.
    """
    given = [name for name, value in line.items() if value is not None]
    read = path_in_file(reference, waypoints, tolerance, given)
    if read is not None:
        return read
    if not given:
        raise sc.InvalidSetting("no path is given: use --reference or --waypoints, or --from, --to and --duration")
    missing = [name for name in ("--from", "--to", "--duration") if name not in given]
    if missing:
        raise sc.InvalidSetting(f"a straight line also needs {' and '.join(missing)}")
    return partial(ff.line, *line.values())
