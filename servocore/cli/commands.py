"""The command ``servocore``: which scenes there are, what kind of problem each is, and what its models cost."""

from __future__ import annotations

import inspect
import re
import shlex
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import rich.box
import rich.table
import typer
from rich.markup import escape

from servocore.analysis import analyse
from servocore.cli.cache import EXAMPLES as CACHE_EXAMPLES
from servocore.cli.cache import show_cache
from servocore.cli.chosen_scene import chosen
from servocore.cli.console import SETTINGS, PatientProgress, SentenceGroup, Version, table_console
from servocore.cli.effects import EXAMPLES as EFFECTS_EXAMPLES
from servocore.cli.effects import show_effects
from servocore.cli.export import EXAMPLES as EXPORT_EXAMPLES
from servocore.cli.export import export_scene
from servocore.cli.feedforward import EXAMPLES as FEEDFORWARD_EXAMPLES
from servocore.cli.feedforward import feed_forward
from servocore.cli.level_costs import Level
from servocore.cli.level_measurement import measure_levels
from servocore.cli.level_tables import HEADINGS, csv_text, markdown_page, remarks, rows
from servocore.cli.options import Model, Parameters, PointsCommand
from servocore.cli.plan import EXAMPLES as PLAN_EXAMPLES
from servocore.cli.plan import plan_scene
from servocore.cli.sensitivities import EXAMPLES as SENSITIVITIES_EXAMPLES
from servocore.cli.sensitivities import show_sensitivities
from servocore.cli.sweep import EXAMPLES as SWEEP_EXAMPLES
from servocore.cli.sweep import sweep_command
from servocore.cli.view import EXAMPLES as VIEW_EXAMPLES
from servocore.cli.view import view_scene
from servocore.errors import InvalidSetting
from servocore.files import require_places, write_together
from servocore.model.scene import Scene
from servocore.planning.sweep import sweep
from servocore.scenes import REGISTRY

NAME = "servocore"
_INDENT = 22  # where the second column of a printed analysis begins
_REPEATS = 15

app = typer.Typer(
    name=NAME,
    cls=SentenceGroup,
    help="""Servo constraint problems: the inputs that make a mechanical system's output follow a path.

These commands look at scenes, those of the library and your own, compute their
inputs along a path, plan their fastest motions, and export them for other tools.""",
    **SETTINGS,
)

_SCENE = typer.Argument(
    metavar="SCENE", help=f"One of {', '.join(REGISTRY)}, or module:function of your own.", show_default=False
)
SceneName = Annotated[str, _SCENE]


@app.callback()
def _commands(_version: Version = False) -> None:
    """Keep the commands named even if there is one only; the text of the help is that of `app`."""


@app.command("scenes")
def list_scenes() -> None:
    """List all scenes: what each is, its models (smallest first), its inputs and the outputs that follow the path."""
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 1, 0))
    table.add_column("scene", no_wrap=True)
    for heading in ("models", "inputs", "outputs"):
        table.add_column(heading)
    table.add_column("what it is and needs", ratio=1)
    for name, factory in REGISTRY.items():
        scene = factory()
        model = scene.model()
        ends = ["\n".join(f"{e.name} ({e.unit})" for e in group) for group in (model.inputs, model.outputs)]
        summary, needs = described(factory)
        table.add_row(
            name,
            "\n".join(scene.models),
            *ends,
            f"{escape(summary)}\n[dim]{escape(needs)}[/dim]" if needs else escape(summary),
        )
    table_console().print(table)


def described(factory: Callable[[], Scene]) -> tuple[str, str]:
    """First line of the file of a scene, and its sentence "What the scene needs: ..."; empty where there is none."""
    text = inspect.getdoc(inspect.getmodule(factory)) or ""
    summary = text.partition("\n")[0]
    needs = re.search(r"What the scene (needs: .*?(?<!\.)\.)(?:\s|$)", text, re.DOTALL)
    return summary, " ".join(needs[1].replace("``", "").split()) if needs else ""


_ANALYSE_EXAMPLES = """[bold]Examples[/bold]

[cyan]servocore analyse rotary_crane[/cyan]

[cyan]servocore analyse mass_on_car --model points --parameters heavy.toml[/cyan]
"""


@app.command("analyse", epilog=_ANALYSE_EXAMPLES)
def analyse_scene(scene: SceneName, model: Model = None, parameters: Parameters = None) -> None:
    """Say what kind of problem a scene is, before anything is solved.

    Prints index, internal dynamics with their eigenvalues, classification, what
    was done to the equations, the condition of the system Jacobian along the
    default path, how often which equation is differentiated, and what to do.
    A problem that is singular somewhere is an answer as well (exit code 0): the
    reason is printed, with the time.
    """
    report = str(analyse(chosen(scene, parameters), model=model))
    console = table_console()
    if console.is_terminal:
        report = "\n".join(hanging(line, console.width) for line in report.splitlines())
    console.print(report, markup=False, highlight=False, soft_wrap=True)


def hanging(line: str, width: int) -> str:
    """Break a line of a printed analysis so that its second column stays one."""
    return textwrap.fill(line, max(width, 2 * _INDENT), subsequent_indent=" " * _INDENT, break_on_hyphens=False) or line


_LEVELS_EXAMPLES = """[bold]Examples[/bold]

[cyan]servocore levels rotary_crane[/cyan]

[cyan]servocore levels overhead_crane --parameters crane.toml --csv levels.csv[/cyan]

All scenes, as the page of the documentation:

[cyan]servocore levels --all --markdown docs/model-levels.md[/cyan]
"""
OptionalScene = Annotated[str | None, _SCENE]
AllScenes = Annotated[bool, typer.Option("--all", help="Measure every scene, instead of one.")]
Instants = Annotated[
    int, typer.Option("--instants", metavar="N", help="Steps of a run; the error of the projected route depends on it.")
]
CsvFile = Annotated[
    Path | None, typer.Option("--csv", metavar="FILE.csv", help="Write the figures for machines as well.")
]
MarkdownFile = Annotated[
    Path | None, typer.Option("--markdown", metavar="FILE.md", help="Write the figures as a page as well.")
]


@app.command("levels", epilog=_LEVELS_EXAMPLES)
def show_levels(
    scene: OptionalScene = None,
    every: AllScenes = False,
    parameters: Parameters = None,
    instants: Instants = 1000,
    csv: CsvFile = None,
    markdown: MarkdownFile = None,
) -> None:
    """Measure what the models of a scene cost, how exact they are, and say which one the scene needs.

    Each model runs along the default path by exact inversion (the derivative
    array, solved instant by instant) and by projected backward Euler. Times are
    microseconds of the processor an instant: median and quartiles of warm runs.
    Errors are the largest of any input, as a fraction of its largest value.
    Other work on the machine shows in the times a little; trust the ratios.
    """
    scenes = _asked_for(scene, every, parameters)
    require_places({"--csv": csv, "--markdown": markdown}, [parameters])
    levels: list[Level] = []
    with PatientProgress("measuring") as progress:
        for scene_ in scenes:
            levels += measure_levels(scene_, instants=instants, repeats=_REPEATS, describe=progress.describe)
    contents = {}
    if csv is not None:
        contents[csv] = csv_text(levels)
    if markdown is not None:
        command = _as_typed(scene, every, parameters, instants, markdown)
        contents[markdown] = markdown_page(
            levels, command=command, instants=instants, repeats=_REPEATS, introduced=every
        )
    write_together(contents)
    console = table_console()
    for scene_ in scenes:
        own = [level for level in levels if level.scene == scene_.name]
        table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
        for heading in HEADINGS:
            table.add_column(heading, justify="left" if heading in ("model", "route") else "right")
        for level in own:
            for row in rows(level):
                table.add_row(*row, style="bold" if level.needed else None)
        console.print(f"[bold]{scene_.name}[/bold]", table, *remarks(own), "", sep="\n")


def _asked_for(scene: str | None, every: bool, parameters: Path | None) -> list[Scene]:
    if every == (scene is not None):
        raise InvalidSetting("name one scene, or use --all for every scene")
    if scene is not None:
        return [chosen(scene, parameters)]
    if parameters is not None:
        raise InvalidSetting("--parameters belongs to one scene, not to --all")
    return [factory() for factory in REGISTRY.values()]


def _as_typed(scene: str | None, every: bool, parameters: Path | None, instants: int, markdown: Path) -> str:
    """Return the command line that writes a page again."""
    words = [NAME, "levels", "--all" if every else str(scene)]
    if parameters is not None:
        words += ["--parameters", str(parameters)]
    if instants != 1000:
        words += ["--instants", str(instants)]
    return shlex.join([*words, "--markdown", str(markdown)])


app.command("feedforward", cls=PointsCommand, epilog=FEEDFORWARD_EXAMPLES)(feed_forward)
app.command("plan", cls=PointsCommand, epilog=PLAN_EXAMPLES)(plan_scene)
app.command("sensitivities", epilog=SENSITIVITIES_EXAMPLES)(show_sensitivities)
app.command("sweep", epilog=SWEEP_EXAMPLES)(sweep_command(sweep))
app.command("effects", epilog=EFFECTS_EXAMPLES)(show_effects)
app.command("view", epilog=VIEW_EXAMPLES)(view_scene)
app.command("export", epilog=EXPORT_EXAMPLES)(export_scene)
app.command("cache", epilog=CACHE_EXAMPLES)(show_cache)
