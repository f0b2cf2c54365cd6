"""The command ``servocore sensitivities``: sensitivities of inputs and load to the parameters, as table and figure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rich.box
import rich.table

from servocore.cli.command import option
from servocore.cli.console import PatientProgress, table_console
from servocore.cli.kinds import text
from servocore.cli.options import GivenPath, Rows, Subject, Table
from servocore.files import write_together
from servocore.planning.sensitivities import Sensitivities, sensitivities

EXAMPLES = ("rotary_crane", "overhead_crane --wrt load_mass --output by_mass.csv --plot by_mass.png")

FIXED: dict[str, object] = {"columns": None, "verbose": False}


@dataclass(frozen=True)
class ByParameters:
    """Parameters to differentiate by."""

    title = "Sensitivities"

    wrt: tuple[str, ...] = option(
        "--wrt", kind=text("load_mass"), metavar="NAME", default=(),
        help="Differentiate by this parameter. Default: all.",
    )  # fmt: skip


def show_sensitivities(subject: Subject, path: GivenPath, by: ByParameters, rows: Rows, results: Table) -> None:
    """Compute the sensitivities of inputs and load to the parameters.

    The derivatives are exact. The table shows the largest effect of one per cent more of each parameter: on the inputs
    for the prescribed path, and on the position of the load (drift) under unchanged inputs. With --output all
    derivatives over time are written to a file.
    """
    moved = path.along(subject.chosen(), subject.model)
    rows.require(moved.reference.duration)
    with PatientProgress("differentiating"):
        found = sensitivities(moved, tuple(dict.fromkeys(by.wrt)) or None, step=rows.step, model=subject.model)
        contents = results.picture(lambda pictures: pictures.sensitivities_figure(found))
    write_together(contents if results.output is None else {**contents, results.output: found.table()})
    table_console().print(_table(found), "Largest effect of one per cent more of a parameter.")


def _table(result: Sensitivities) -> rich.table.Table:
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("parameter")
    for quantity in result.quantities:
        table.add_column(quantity.name, justify="right")
    for name, size in zip(result.parameters, result.sizes, strict=True):
        effects = [result[quantity.name, name] * size / 100.0 for quantity in result.quantities]
        largest = [effect[np.abs(effect).argmax()] for effect in effects]
        shown = [f"{each:.3g} {of.unit}" for each, of in zip(largest, result.quantities, strict=True)]
        table.add_row(name, *shown)
    return table
