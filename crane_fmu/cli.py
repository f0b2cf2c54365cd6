"""The command ``crane-fmu``: parsing, progress and sentences; what it computes is in the other modules.

Exit codes: 0 when everything asked for was done; 2 when it was not, with one sentence on the standard error
stream. Whatever else is raised is a defect and ends with its traceback.
"""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, NoReturn

import rich.box
import rich.table
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from typer.core import TyperGroup

import servocore as sc
from crane_fmu import feedforward as ff
from crane_fmu.parameters_file import read_parameters
from crane_fmu.writing import require_place, write_together

if TYPE_CHECKING:
    from crane_fmu.report.page import Table

# What draws, builds or runs FMUs is imported by the commands that need it: the others start in half the time.

NAME = "crane-fmu"
REFUSED = 2
WIDE = 120
"""Columns of text for tables that do not go to a terminal."""

UsageError: Any = typer.BadParameter.__mro__[1]
"""What the command line's own complaints have in common; Typer gives it no public name."""


class SentenceGroup(TyperGroup):
    """A command group that ends refusals with one plain sentence and exit code 2."""

    def main(self, *args: Any, **options: Any) -> Any:
        """Run the command line and end the process; the arguments are Typer's own."""
        try:
            with _notes_on_the_error_stream():
                code = super().main(*args, **{**options, "standalone_mode": False})
        except sc.ServocoreError as error:
            _refuse(str(error))
        except typer.Abort:
            _refuse("stopped")
        except UsageError as error:
            message = error.format_message().rstrip(".")
            _refuse(f"{message[:1].lower()}{message[1:]}; see {NAME} --help")
        sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def _notes_on_the_error_stream() -> Iterator[None]:
    """Print the library's warnings as plain lines; those of others stay as they are."""
    with warnings.catch_warnings():
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, sc.ServocoreWarning):
                print(f"{NAME}: note: {message}", file=sys.stderr)
            else:
                others(message, category, *place, **more)

        warnings.showwarning = show
        warnings.simplefilter("always", sc.ServocoreWarning)
        yield


def _refuse(sentence: str) -> NoReturn:
    print(f"{NAME}: {' '.join(sentence.split())}", file=sys.stderr)
    sys.exit(REFUSED)


app = typer.Typer(
    name=NAME,
    cls=SentenceGroup,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Inputs that make the load of a rotary crane follow its path, and that crane as an FMU.",
    epilog="Exit code 0: done. Exit code 2: refused, with one sentence on the error stream and no file.",
)


@app.callback()
def _commands() -> None:
    """Keep the commands named even if there is one only; the text of the help is that of `app`."""


class PatientProgress:
    """A progress bar on the error stream, for terminals only, that appears after a second."""

    def __init__(self, label: str) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        self._progress = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task(label, total=None)
        self._begin = monotonic()
        self._started = False

    def __enter__(self) -> PatientProgress:
        return self

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` steps are done."""
        self._show()
        self._progress.update(self._task, completed=done, total=total)

    def describe(self, label: str) -> None:
        """Change what is said to be going on."""
        self._show()
        self._progress.update(self._task, description=label)

    def _show(self) -> None:
        if not self._started and self._progress.console.is_terminal and monotonic() - self._begin > 1.0:
            self._progress.start()
            self._started = True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._started:
            self._progress.stop()


def _option(panel: str, *names: str, metavar: str, text: str) -> Any:
    return typer.Option(*names, metavar=metavar, help=text, rich_help_panel=panel)


Point = tuple[float, float, float]
_FILE, _LINE, _CRANE, _RESULTS = "Path: a file", "Path: a straight line", "Crane and computation", "Results"
_PARAMETERS = ", ".join(sc.scenes.rotary_crane().parameter_values())

ReferenceFile = Annotated[
    Path | None,
    _option(_FILE, "--reference", metavar="FILE.csv",
            text="Positions of the load over time: header time,x,y,z, optionally followed by vx,vy,vz, then"
            " ax,ay,az, then jx,jy,jz, then sx,sy,sz (s, m, m/s, ...)."),
]  # fmt: skip
Tolerance = Annotated[
    float | None,
    _option(_FILE, "--tolerance", metavar="METRES",
            text="How far the path may stay away from the positions in the file, for rounded or noisy ones."),
]  # fmt: skip
Start = Annotated[Point | None, _option(_LINE, "--from", metavar="X Y Z", text="Start (m); z < 0 is below the girder.")]
End = Annotated[Point | None, _option(_LINE, "--to", metavar="X Y Z", text="End (m).")]
Duration = Annotated[float | None, _option(_LINE, "--duration", metavar="T", text="Time of the motion (s).")]
ProfileName = Annotated[
    str | None,
    _option(_LINE, "--profile", metavar="NAME",
            text=f"Time law: {', '.join(ff.PROFILES)}. Default: {next(iter(ff.PROFILES))}."),
]  # fmt: skip
Ramp = Annotated[
    float | None,
    _option(_LINE, "--ramp", metavar="TAU0",
            text=f"Time to accelerate (s), only for {ff.THREE_PHASE}. Default: duration/4."),
]  # fmt: skip
ParametersFile = Annotated[
    Path | None,
    _option(_CRANE, "--parameters", metavar="FILE.toml", text=f"Any of {_PARAMETERS} (SI units)."),
]
ModelName = Annotated[str, _option(_CRANE, "--model", metavar="NAME", text=f"One of {', '.join(ff.MODELS)}.")]
FormulationName = Annotated[
    str, _option(_CRANE, "--formulation", metavar="NAME", text=f"One of {', '.join(ff.FORMULATIONS)}.")
]
MethodName = Annotated[str, _option(_CRANE, "--method", metavar="NAME", text=f"One of {', '.join(ff.METHODS)}.")]
Step = Annotated[
    float | None,
    _option(_CRANE, "--step", metavar="H", text="Step (s); divides the duration. Default: duration/200."),
]
RelativeTolerance = Annotated[
    float | None,
    _option(_CRANE, "--rtol", metavar="R", text="In place of a step: error of the inputs relative to their peaks."),
]
AbsoluteTolerance = Annotated[
    float | None,
    _option(_CRANE, "--atol", metavar="A", text="In place of a step: error of the inputs in their own units."),
]
OutputStep = Annotated[
    float | None,
    _option(_CRANE, "--output-step", metavar="H",
            text="With --rtol or --atol: time between rows (s); divides the duration. Default: duration/200."),
]  # fmt: skip
OutputFile = Annotated[
    Path | None,
    _option(_RESULTS, "--output", "-o", metavar="FILE.csv",
            text="Where the table goes. Default: the standard output stream."),
]  # fmt: skip
PlotFile = Annotated[
    Path | None,
    _option(_RESULTS, "--plot", metavar="FILE.png",
            text=f"Draw inputs and motion; {', '.join(ff.PICTURES)} are known."),
]  # fmt: skip

_FEEDFORWARD_EXAMPLES = """[bold]Examples[/bold]

The manoeuvre of the demo, as a table on the standard output stream:

[cyan]crane-fmu feedforward --from 5 0 -5 --to -2 2 -2 --duration 20[/cyan]

A path and a crane from files; the table goes into a file:

[cyan]crane-fmu feedforward --reference path.csv --parameters crane.toml --output inputs.csv[/cyan]
"""


@app.command("feedforward", epilog=_FEEDFORWARD_EXAMPLES)
def feedforward(
    reference: ReferenceFile = None,
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
    output: OutputFile = None,
    plot: PlotFile = None,
) -> None:
    """Compute the inputs that move the load along a path, as a table.

    The path is either a file (--reference) or a straight line from rest to rest (--from, --to, --duration).
    The table has the columns time,M_b,F,M_w,phi,s,l,x,y,z,tension in SI units and one row a step.
    """
    line = LineOptions(start, end, duration, profile, ramp)
    path = path_request(reference, tolerance, line)
    results = [each for each in (output, plot) if each is not None]
    _require_places(results, {each for each in (reference, parameters) if each is not None})
    if plot is not None and plot.suffix.lower() not in ff.PICTURES:
        raise sc.InvalidSetting(f"cannot draw {plot}: the name must end in {', '.join(ff.PICTURES)}")
    changed = {} if parameters is None else read_parameters(parameters, sc.scenes.rotary_crane())
    contents = {}
    with PatientProgress("computing the inputs") as progress:
        solution = ff.feedforward(
            path, changed, ff.Route(model, formulation, method, step, rtol, atol, output_step), progress
        )
        table = ff.csv_text(solution)
        if plot is not None:
            contents[plot] = _drawn(solution, plot.suffix.lower())
    if output is not None:
        contents[output] = table.encode()
    write_together(contents)
    if output is None:
        _print(table)


def _drawn(solution: sc.Solution, suffix: str) -> bytes:
    from crane_fmu.report.style import picture  # noqa: PLC0415
    from crane_fmu.report.trajectories import inputs_and_motion  # noqa: PLC0415

    return picture(inputs_and_motion(solution), suffix)


OutputFolder = Annotated[
    Path, typer.Option("--output", "-o", metavar="DIR", help="Folder; made if it is not there.", show_default=True)
]


@app.command("build", epilog="The same as [cyan]python build_fmu.py[/cyan].")
def build(output: OutputFolder = Path()) -> None:
    """Build RotaryCrane.fmu, check it in a process of its own and put it into a folder."""
    from crane_fmu.build import build_fmu  # noqa: PLC0415

    with PatientProgress("building the FMU") as progress:
        file = build_fmu(output, progress.describe)
    print(file)


PathToCarry = Annotated[
    Path | None,
    typer.Option("--reference", metavar="FILE.csv", help="A path that LoadTrajectory.fmu carries (profile = file)."),
]


@app.command("ssp", epilog="[bold]Example[/bold]\n\n[cyan]crane-fmu ssp -o system[/cyan]")
def ssp(output: OutputFolder = Path("system"), reference: PathToCarry = None) -> None:
    """Build trajectory, inverse model and plant as FMUs, and Crane.ssp, which connects them.

    The folder then holds LoadTrajectory.fmu, RotaryCrane.fmu, CranePlant.fmu with their cross-check files, and
    Crane.ssp. Run it with a communication step of 0.01 s.
    """
    from crane_fmu.ssp import build_ssp  # noqa: PLC0415

    with PatientProgress("building the system") as progress:
        files = build_ssp(output, progress.describe, reference)
    print(*files, sep="\n")


@app.command("demo", epilog="[bold]Example[/bold]\n\n[cyan]crane-fmu demo -o out[/cyan]")
def run_demo(output: OutputFolder = Path("out")) -> None:
    """Build the FMU, run it, compare it with the closed form and with a forward simulation, and write a report.

    The folder then holds RotaryCrane.fmu, inputs.csv, report.html and a folder of figures. Takes half a minute.
    """
    from crane_fmu.demo import REPORT, demo  # noqa: PLC0415

    with PatientProgress("demo") as progress:
        done = demo(output, progress.describe)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a stream that knows no Greek gets question marks
    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, WIDE)
    for each in done.tables:
        console.print(f"[bold]{each.title}[/bold]", _terminal_table(each), sep="\n")
        console.print(each.note, "", sep="\n" if each.note else "")
    for note in done.notes:
        console.print(note)
    console.print(f"{len(done.files)} files in {done.folder}; the report is {done.folder / REPORT}", soft_wrap=True)


def _terminal_table(table: Table) -> rich.table.Table:
    shown = rich.table.Table(*table.headings, box=rich.box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    for row in table.rows:
        shown.add_row(*row)
    return shown


def _print(text: str) -> None:
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        raise  # whoever reads has seen enough: Typer ends quietly
    except OSError as error:
        raise sc.InvalidSetting(f"cannot write to the standard output stream: {error.strerror or error}") from error


class LineOptions(NamedTuple):
    """The options of a straight line as they were given."""

    start: Point | None
    end: Point | None
    duration: float | None
    profile: str | None
    ramp: float | None


def path_request(reference: Path | None, tolerance: float | None, line: LineOptions) -> ff.PathRequest:
    """Turn the options that describe a path into one description.

    Raises
    ------
    InvalidSetting
        If they describe no path, two, or half of one.
    """
    names = ("--from", "--to", "--duration", "--profile", "--ramp")
    given = [name for name, value in zip(names, line, strict=True) if value is not None]
    if reference is not None:
        if given:
            raise sc.InvalidSetting(f"a path is given either by --reference or by {given[0]}, not by both")
        return ff.FileRequest(reference, tolerance)
    if tolerance is not None:
        raise sc.InvalidSetting("--tolerance belongs to --reference")
    if line.start is None or line.end is None or line.duration is None:
        if not given:
            raise sc.InvalidSetting("no path is given: use --reference, or --from, --to and --duration")
        missing = [name for name in names[:3] if name not in given]
        raise sc.InvalidSetting(f"a straight line also needs {' and '.join(missing)}")
    profile = next(iter(ff.PROFILES)) if line.profile is None else line.profile
    return ff.LineRequest(line.start, line.end, line.duration, profile, line.ramp)


def _require_places(results: Sequence[Path], sources: set[Path]) -> None:
    places = [each.resolve() for each in results]
    if len(set(places)) < len(places):
        raise sc.InvalidSetting(f"--output and --plot both name {results[0]}")
    for result in results:
        if result.resolve() in {each.resolve() for each in sources}:
            raise sc.InvalidSetting(f"cannot write {result}: it is read as well")
        require_place(result)


def main() -> None:
    """Run the command line; the entry point of the package."""
    app(prog_name=NAME)
