"""The study as files: what the page and the figures are made of, so that they can be made again without measuring.

`results.csv` holds the rows, `times.csv` what they have no columns for, `facts.json` what is no row: machine, versions,
the paper's step, the cost beside C. Everything else on the page is computed from these three.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.chart import own
from benchmarks.chart.orders import Fit, fit_order, round_off_constant
from benchmarks.chart.rows import Row, read_rows, write_rows
from benchmarks.chart.timing import Timed

ORDER_SCENE = "rotary_crane_degree13"
RESULTS, TIMES, FACTS = "results.csv", "times.csv", "facts.json"

Key = tuple[str, ...]


@dataclass(frozen=True)
class Spent:
    """Spread and preparation of one row, in s; `lower` and `upper` are quartiles, None if it gave no answer."""

    repeats: int
    lower: float | None
    upper: float | None
    preparation: float
    errors: str


@dataclass(frozen=True)
class OrderLine:
    """Errors of one method with falling step, and the order fitted to them."""

    method: str
    nominal: int
    steps: tuple[float, ...]
    errors: tuple[float, ...]
    fit: Fit


@dataclass(frozen=True, eq=False)
class Record:
    """What was measured.

    Attributes
    ----------
    rows : list of Row
        All points, those of the study of orders included.
    spent : dict
        `Spent` by row.
    facts : dict
        What is no row.
    """

    rows: list[Row]
    spent: dict[Key, Spent] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def scenes(self) -> list[str]:
        """Names of the scenes of the chart, in their order."""
        return [name for name in dict.fromkeys(row.scene for row in self.rows) if name != ORDER_SCENE]

    def of(self, scene: str) -> list[Row]:
        """Return the rows of a scene."""
        return [row for row in self.rows if row.scene == scene]

    def spread(self, row: Row) -> tuple[float, float]:
        """Return the quartiles of a row's times."""
        spent, median = self.spent.get(key(row)), row.seconds or 0.0
        if spent is None or spent.lower is None or spent.upper is None:
            return median, median
        return spent.lower, spent.upper

    @cached_property
    def order_study(self) -> tuple[list[OrderLine], float]:
        """Fitted orders, and the constant c of the round-off c/h^2 that all methods share, in s^2."""
        return order_lines(self.of(ORDER_SCENE))


def key(row: Row) -> Key:
    """Return what identifies a row."""
    return (*row.series, row.setting)


def order_lines(rows: Sequence[Row]) -> tuple[list[OrderLine], float]:
    """Fit orders to the rows of `ORDER_SCENE`."""
    methods = {each.name: each for each in own.METHODS}
    lines: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        if row.error is not None:
            lines.setdefault(row.method, []).append((own.ORDER_DURATION / int(row.setting.split()[0]), row.error))
    damped = [name for name in lines if methods[name].orders(3).forces > 0]
    found = [round_off_constant(*zip(*lines[name], strict=True)) for name in damped]
    constants = [c for c in found if 0.0 < c < own.LARGEST_ROUND_OFF]
    constant = float(np.median(constants)) if constants else 0.0
    result = []
    for name, points in lines.items():
        steps, errors = zip(*points, strict=True)
        nominal = methods[name].orders(3).forces
        result.append(OrderLine(name, nominal, steps, errors, fit_order(steps, errors, constant)))
    return result, constant


def write_record(folder: Path, timed: Sequence[Timed], facts: dict[str, Any]) -> None:
    """Write the three files."""
    folder.mkdir(parents=True, exist_ok=True)
    write_rows(folder / RESULTS, [each.row for each in timed])
    with (folder / TIMES).open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("scene", "solver", "model", "formulation", "method", "setting", *Spent.__dataclass_fields__))
        for each in timed:
            spent = asdict(_spent(each))
            writer.writerow((*key(each.row), *("" if value is None else value for value in spent.values())))
    (folder / FACTS).write_text(json.dumps(facts, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _spent(each: Timed) -> Spent:
    lower, upper = (
        (float(f"{value:.6e}") for value in np.percentile(each.seconds, (25, 75))) if each.seconds else (None, None)
    )
    errors = "; ".join(f"{name} {error:.3e}" for name, error in each.errors.items())
    return Spent(len(each.seconds), lower, upper, round(each.preparation, 3), errors)


def read_record(folder: Path) -> Record:
    """Undo `write_record`."""
    spent = {}
    with (folder / TIMES).open(newline="") as stream:
        for line in csv.DictReader(stream):
            values = list(line.values())
            repeats, lower, upper, preparation, errors = values[-5:]
            quartiles: tuple[float | None, float | None] = (
                (float(lower), float(upper)) if lower and upper else (None, None)
            )
            spent[tuple(values[:-5])] = Spent(int(repeats), *quartiles, float(preparation), errors)
    facts = json.loads((folder / FACTS).read_text(encoding="utf-8"))
    return Record(read_rows(folder / RESULTS), spent, facts)
