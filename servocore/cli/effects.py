"""The command ``servocore effects``: which physical effects a scene may leave out, as table, page and verdict."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import rich.box
import rich.table
import typer

from servocore.cli.chosen_scene import GivenPath, chosen
from servocore.cli.console import PatientProgress, table_console
from servocore.cli.options import Parameters, ReferenceFile, SceneName, Waypoints
from servocore.effects.drives import Drives
from servocore.effects.report import HEADINGS, EffectsReport
from servocore.effects.study import effects
from servocore.errors import InvalidSetting
from servocore.files import require_places, write_together
from servocore.model.parameter_files import read_parameters
from servocore.model.units import in_unit

EXAMPLES = """[bold]Examples[/bold]

[cyan]servocore effects rotary_crane[/cyan]

[cyan]servocore effects overhead_crane --tolerance 20mm --bandwidth 3 --parameters crane.toml[/cyan]

[cyan]servocore effects gantry_crane --open-loop --simulate --markdown effects.md[/cyan]
"""
_LEFT = 1  # columns of text before those of numbers

Tolerance = Annotated[
    str, typer.Option("--tolerance", metavar="LENGTH", help="How far the load may be off its path, with its unit.")
]
Bandwidth = Annotated[
    float | None,
    typer.Option("--bandwidth", metavar="W", help="Bandwidth of the drives' position loops (rad/s).", show_default="6"),
]
OpenLoop = Annotated[bool, typer.Option("--open-loop", help="Inputs alone drive the plant, without position loops.")]
Simulate = Annotated[bool, typer.Option("--simulate", help="Simulate every plant, instead of those hard to estimate.")]
Markdown = Annotated[Path | None, typer.Option("--markdown", metavar="FILE.md", help="Write the table as a page too.")]


def show_effects(
    scene: SceneName,
    tolerance: Tolerance = "5mm",
    bandwidth: Bandwidth = None,
    open_loop: OpenLoop = False,
    simulate: Simulate = False,
    parameters: Parameters = None,
    reference: ReferenceFile = None,
    waypoints: Waypoints = None,
    markdown: Markdown = None,
) -> None:
    """Say which physical effects a scene may leave out, and what that costs.

    Each row is an effect that the scene lacks, or has and may do without: how
    far off its path the load goes where the inputs of the model without it drive
    a plant with it. Errors are estimated from the inputs of both models, or
    simulated where that is weak. The file of parameters may hold those of
    effects too.
    """
    subject = chosen(scene, None)
    require_places({"--markdown": markdown}, [parameters, reference, waypoints])
    declared = subject.effects.parameters
    given = {} if parameters is None else read_parameters(parameters, subject, declared.values())
    own = subject.model().parameters.names
    subject = subject.with_parameters(**{name: each for name, each in given.items() if name in own})
    subject = GivenPath(reference, waypoints).along(subject)
    allowed = _allowed(tolerance, subject.model().outputs[0].unit)
    if open_loop and bandwidth is not None:
        raise InvalidSetting("--open-loop has no drives whose bandwidth could be chosen")
    with PatientProgress("estimating"):
        found = effects(
            subject,
            drives=None if open_loop else Drives() if bandwidth is None else Drives(bandwidth),
            tolerance=allowed,
            parameters={name: each for name, each in given.items() if name not in own},
            simulate=simulate,
        )
    if markdown is not None:
        write_together({markdown: f"# What {subject.name} may leave out\n\n{found.markdown()}"})
    table_console().print(_table(found), *found.remarks, sep="\n", soft_wrap=False)


def _allowed(text: str, unit: str) -> float:
    """Return a tolerance in a unit; a bare number is refused, since few who write 5 mean metres."""
    try:
        float(text)
    except ValueError:
        return in_unit(text, unit, "the tolerance")
    raise InvalidSetting(f"the tolerance is given as {text!r} without its unit, such as '5mm'")


def _table(report: EffectsReport) -> rich.table.Table:
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for k, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="left" if k < _LEFT else "right")
    for row, cells in zip(report.rows, report.cells(), strict=True):
        table.add_row(*cells, style="bold" if row.needed else None)
    return table
