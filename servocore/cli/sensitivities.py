"""The command ``servocore sensitivities``: how inputs and load change with the parameters, as table and figure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import rich.box
import rich.table
import typer

from servocore.cli.choice import along, chosen
from servocore.cli.console import PatientProgress, table_console
from servocore.cli.options import Model, Parameters, ReferenceFile, SceneName, Step
from servocore.files import PICTURES, require_picture, require_places, write_together
from servocore.planning.sensitivities import Sensitivities, sensitivities

EXAMPLES = """[bold]Examples[/bold]

[cyan]servocore sensitivities rotary_crane[/cyan]

[cyan]servocore sensitivities overhead_crane --wrt load_mass --output by_mass.csv --plot by_mass.png[/cyan]
"""

ByParameters = Annotated[
    list[str] | None, typer.Option("--wrt", metavar="NAME", help="A parameter, any number of times. Default: all.")
]
Output = Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE.csv", help="All derivatives over time.")]
Plot = Annotated[
    Path | None,
    typer.Option("--plot", metavar="FILE.png", help=f"Draw effects of one per cent; {', '.join(PICTURES)} are known."),
]


def show_sensitivities(
    scene: SceneName,
    wrt: ByParameters = None,
    reference: ReferenceFile = None,
    parameters: Parameters = None,
    model: Model = None,
    step: Step = None,
    output: Output = None,
    plot: Plot = None,
) -> None:
    """Say how inputs and load change with the parameters.

    The derivatives are exact. The table tells the largest effect of one per cent
    more of each parameter: on the inputs that the path asks for, and on where
    the load goes (drift) if the inputs stay as they were.
    """
    subject = chosen(scene, parameters)
    require_places({"--output": output, "--plot": plot}, [parameters, reference])
    require_picture(plot)
    subject = along(subject, reference, model)
    with PatientProgress("differentiating"):
        found = sensitivities(subject, wrt or None, step=step, model=model)
        contents: dict[Path, str | bytes] = {}
        if output is not None:
            contents[output] = found.table()
        if plot is not None:
            from servocore.cli.plan_figure import sensitivities_figure  # noqa: PLC0415 - slow to import

            contents[plot] = sensitivities_figure(found, plot.suffix[1:].lower())
    write_together(contents)
    table_console().print(_table(found), "Largest effect of one per cent more of a parameter.")


def _table(found: Sensitivities) -> rich.table.Table:
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("of")
    for name in found.parameters:
        table.add_column(f"by {name}", justify="right")
    for quantity in found.quantities:
        effects = [
            found[quantity.name, name] * size / 100.0 for name, size in zip(found.parameters, found.sizes, strict=True)
        ]
        shown = [f"{effect[np.abs(effect).argmax()]:.3g} {quantity.unit}" for effect in effects]
        table.add_row(quantity.name, *shown)
    return table
