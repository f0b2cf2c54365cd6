"""The study as a whole: what is measured, and what came out."""

from __future__ import annotations

import csv
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import servocore as sc
from benchmarks.chart import own
from benchmarks.chart.candidate import Candidate, Problem
from benchmarks.chart.orders import Fit, fit_order, round_off_constant
from benchmarks.chart.rows import Row
from benchmarks.chart.timing import Timed, measure, one_line

PEERS = (
    "plain_python", "casadi_integrators", "sundials_ida", "scipy_dae", "gekko_dynamic", "pyomo_dae", "exudyn_solver",
)  # fmt: skip
"""Modules of `benchmarks.peers`."""

ORDER_SCENE = "rotary_crane_degree13"

Say = Callable[[str], None]


def problems() -> list[Problem]:
    """Return the scenes of the study, under their names."""
    scenes = {
        "rotary_crane": sc.scenes.rotary_crane(),
        "overhead_crane": sc.scenes.overhead_crane(),
        "three_cars": sc.scenes.cars(3),
        "mass_on_car": sc.scenes.mass_on_car(),
        "arm": sc.scenes.passive_joint_arm(),
    }
    return [Problem(name, scene) for name, scene in scenes.items()]


def order_problem() -> Problem:
    """Return the rotary crane on the smoother path, on which orders can be seen."""
    crane = sc.scenes.rotary_crane()
    path = crane.reference
    smooth = sc.rest_to_rest(path.start, path.end, path.duration, sc.DEGREE13)
    return Problem(ORDER_SCENE, crane.with_reference(smooth))


@dataclass(frozen=True)
class Effort:
    """How much is measured: everything, or two settings of each solver on one scene."""

    smoke: bool = False
    peers: Sequence[str] = PEERS
    only: Sequence[str] = ()
    budget: float = 0.25


@dataclass(frozen=True)
class OrderLine:
    """Errors of one method with falling step, and the order fitted to them."""

    method: str
    nominal: int
    steps: tuple[float, ...]
    errors: tuple[float, ...]
    fit: Fit


@dataclass(eq=False)
class Study:
    """Everything measured.

    Attributes
    ----------
    timed : list of Timed
        Rows of the chart, with spreads and preparation.
    order_lines : list of OrderLine
        Of `ORDER_SCENE`.
    round_off : float
        c of the round-off c/h^2, in s^2.
    """

    timed: list[Timed]
    scenes: list[str]
    order_lines: list[OrderLine] = field(default_factory=list)
    round_off: float = 0.0

    @property
    def rows(self) -> list[Row]:
        """All rows."""
        return [each.row for each in self.timed]

    def spread(self, row: Row) -> tuple[float, float]:
        """Return the quartiles of a row's times."""
        for each in self.timed:
            if each.row is row and each.seconds:
                lower, upper = np.percentile(each.seconds, (25, 75))
                return float(lower), float(upper)
        return row.seconds or 0.0, row.seconds or 0.0


def carry_out(effort: Effort, say: Say) -> Study:
    """Measure everything."""
    chosen = [each for each in problems() if not effort.only or each.name in effort.only]
    timed: list[Timed] = []
    for problem in chosen[:1] if effort.smoke else chosen:
        candidates = [*own.closed_form(problem), *own.candidates(problem, effort.smoke)]
        refused: list[Timed] = []
        for peer in effort.peers:
            found = peer_candidates(peer, problem, effort)
            candidates += found if isinstance(found, list) else []
            refused += [found] if isinstance(found, Timed) else []
        timed += [*measure(candidates, say, effort.budget), *refused]
    study = Study(timed, list(dict.fromkeys(each.row.scene for each in timed)))
    if not effort.only or ORDER_SCENE in effort.only:
        measured = measure(own.order_candidates(order_problem(), effort.smoke), say, effort.budget / 4)
        study.order_lines, study.round_off = order_lines(measured)
        study.timed += measured
    return study


def peer_candidates(module: str, problem: Problem, effort: Effort) -> list[Candidate] | Timed:
    """Return what a peer is to do, or the row that says why it cannot."""
    peer = importlib.import_module(f"benchmarks.peers.{module}")
    try:
        found: list[Candidate] = peer.candidates(problem, effort)
    except Exception as error:  # a peer that is not installed, or does not load, is listed with its message
        return Timed(Row(problem.name, peer.NAME, "", "", "", "", message=one_line(error)))
    return found


def order_lines(measured: Sequence[Timed]) -> tuple[list[OrderLine], float]:
    """Fit orders; all methods share one estimate of the round-off."""
    methods = {each.name: each for each in own.METHODS}
    lines: dict[str, list[tuple[float, float]]] = {}
    for each in measured:
        if each.row.error is not None:
            steps = int(each.row.setting.split()[0])
            lines.setdefault(each.row.method, []).append((20.0 / steps, each.row.error))
    found = [round_off_constant(*zip(*points, strict=True)) for name, points in lines.items() if name != "trapezoidal"]
    constants = [c for c in found if 0.0 < c < 1e-9]
    constant = float(np.median(constants)) if constants else 0.0
    result = []
    for name, points in lines.items():
        steps, errors = zip(*points, strict=True)
        result.append(
            OrderLine(name, methods[name].orders(3).forces, steps, errors, fit_order(steps, errors, constant))
        )
    return result, constant


def write_times(path: Path, timed: Sequence[Timed]) -> None:
    """Write what `results.csv` has no columns for: spread, repeats, preparation, error of each input."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("scene", "solver", "model", "formulation", "method", "setting", "repeats", "lower_quartile",
                         "upper_quartile", "preparation", "errors"))  # fmt: skip
        for each in timed:
            row = each.row
            quartiles = np.percentile(each.seconds, (25, 75)) if each.seconds else ("", "")
            writer.writerow((
                *row.series, row.setting, len(each.seconds),
                *(f"{value:.6e}" if value != "" else "" for value in quartiles), f"{each.preparation:.3f}",
                "; ".join(f"{name} {error:.3e}" for name, error in each.errors.items()),
            ))  # fmt: skip
