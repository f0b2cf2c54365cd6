"""The command ``servocore sensitivities``: how inputs and load change with the parameters, as table and figure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import rich.box
import rich.table
import typer

from servocore.cli.chosen_scene import GivenPath, chosen
from servocore.cli.console import PatientProgress, table_console
from servocore.cli.options import Model, Parameters, ReferenceFile, SceneName, Step, Tolerance, Waypoints
from servocore.files import PICTURES, require_picture, require_places, write_together
from servocore.planning.sensitivities import Sensitivities, sensitivities

EXAMPLES = """[bold]Examples[/bold]

[cyan]servocore sensitivities rotary_crane[/cyan]

[cyan]servocore sensitivities overhead_crane --wrt load_mass --output by_mass.csv --plot by_mass.png[/cyan]
"""

ByParameters = Annotated[
    list[str] | None,
    typer.Option("--wrt", metavar="NAME", help="Differentiate by this parameter; may be repeated. Default: all."),
]
Output = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="FILE.csv", help="Write all derivatives over time to this file."),
]
Plot = Annotated[
    Path | None,
    typer.Option("--plot", metavar="FILE.png", help=f"Draw effects of one per cent; {', '.join(PICTURES)} are known."),
]


def show_sensitivities(
    scene: SceneName,
    wrt: ByParameters = None,
    reference: ReferenceFile = None,
    tolerance: Tolerance = None,
    waypoints: Waypoints = None,
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
    require_places({"--output": output, "--plot": plot}, [parameters, reference, waypoints])
    require_picture(plot)
    subject = GivenPath(reference, waypoints, tolerance).along(subject, model)
    with PatientProgress("differentiating"):
        found = sensitivities(subject, tuple(dict.fromkeys(wrt or ())) or None, step=step, model=model)
        contents: dict[Path, str | bytes] = {}
        if output is not None:
            contents[output] = found.table()
        if plot is not None:
            contents[plot] = _figure(found, plot.suffix[1:].lower())
    write_together(contents)
    table_console().print(_table(found), "Largest effect of one per cent more of a parameter.")


def _table(result: Sensitivities) -> rich.table.Table:
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("of")
    for name in result.parameters:
        table.add_column(f"by {name}", justify="right")
    for quantity in result.quantities:
        effects = [
            result[quantity.name, name] * size / 100.0
            for name, size in zip(result.parameters, result.sizes, strict=True)
        ]
        shown = [f"{effect[np.abs(effect).argmax()]:.3g} {quantity.unit}" for effect in effects]
        table.add_row(quantity.name, *shown)
    return table


def _figure(result: Sensitivities, kind: str) -> bytes:
    """Return a picture of the effects of one per cent more of each parameter, one panel a quantity."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import

    from servocore.cli.plan_figure import saved_figure  # noqa: PLC0415

    rows = -(-len(result.quantities) // 2)
    figure = Figure(figsize=(11.0, 0.8 + 1.9 * rows), layout="constrained", dpi=120)
    panels = figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()
    for axes, quantity in zip(panels, result.quantities, strict=False):
        for k, (name, size) in enumerate(zip(result.parameters, result.sizes, strict=True)):
            look = ("-", "--", "-.", ":")[k % 4]
            axes.plot(
                result.t,
                result[quantity.name, name] * size / 100.0,
                linewidth=1.5,
                linestyle=look,
                label=name,
            )
        axes.set_title(f"{quantity.name} ({quantity.unit})", fontsize="medium", loc="left")
        axes.margins(x=0.01)
    for axes in panels[len(result.quantities) :]:
        axes.set_visible(False)
    for axes in panels[max(len(result.quantities) - 2, 0) : len(result.quantities)]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("time (s)")
    handles, labels = panels[0].get_legend_handles_labels()
    title = "effect of one per cent more of"
    figure.legend(handles, labels, loc="outside upper center", ncols=6, frameon=False, title=title)
    return saved_figure(figure, kind)
