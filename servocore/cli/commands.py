"""The command ``servocore``: which scenes there are, what kind of problem each is, and all that is done with one."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable
from typing import Annotated

import rich.box
import rich.table
import typer
from rich.markup import escape

from servocore.analysis import analyse
from servocore.cli.cache import EXAMPLES as CACHE_EXAMPLES
from servocore.cli.cache import show_cache
from servocore.cli.chosen_scene import chosen
from servocore.cli.console import SETTINGS, SentenceGroup, Version, table_console
from servocore.cli.effects import EXAMPLES as EFFECTS_EXAMPLES
from servocore.cli.effects import show_effects
from servocore.cli.export import EXAMPLES as EXPORT_EXAMPLES
from servocore.cli.export import export_scene
from servocore.cli.feedforward import EXAMPLES as FEEDFORWARD_EXAMPLES
from servocore.cli.feedforward import feed_forward
from servocore.cli.options import Model, Parameters, PointsCommand
from servocore.cli.plan import EXAMPLES as PLAN_EXAMPLES
from servocore.cli.plan import plan_scene
from servocore.cli.sensitivities import EXAMPLES as SENSITIVITIES_EXAMPLES
from servocore.cli.sensitivities import show_sensitivities
from servocore.cli.sweep import EXAMPLES as SWEEP_EXAMPLES
from servocore.cli.sweep import sweep_command
from servocore.cli.view import EXAMPLES as VIEW_EXAMPLES
from servocore.cli.view import view_scene
from servocore.model.scene import Scene
from servocore.planning.sweep import sweep
from servocore.scenes import REGISTRY

NAME = "servocore"
_INDENT = 22  # where the second column of a printed analysis begins

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


app.command("feedforward", cls=PointsCommand, epilog=FEEDFORWARD_EXAMPLES)(feed_forward)
app.command("plan", cls=PointsCommand, epilog=PLAN_EXAMPLES)(plan_scene)
app.command("sensitivities", epilog=SENSITIVITIES_EXAMPLES)(show_sensitivities)
app.command("sweep", epilog=SWEEP_EXAMPLES)(sweep_command(sweep))
app.command("effects", epilog=EFFECTS_EXAMPLES)(show_effects)
app.command("view", epilog=VIEW_EXAMPLES)(view_scene)
app.command("export", epilog=EXPORT_EXAMPLES)(export_scene)
app.command("cache", epilog=CACHE_EXAMPLES)(show_cache)
