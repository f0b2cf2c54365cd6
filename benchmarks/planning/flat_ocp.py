"""One manoeuvre within limits by python-control's flat planners, by CasADi by hand and by `sc.fastest`.

Run it by `python -m benchmarks.planning.flat_ocp`.

The job: the default line of the rotary crane with |M_b| <= 1000 N m and |F| <= 60 N, as fast as possible.

`point_to_point` and `solve_flat_ocp` plan for a given time: the shortest time for which they succeed is searched by
bisection between the time of `sc.fastest` and that of the polynomial of degree 9. Whatever a planner returns is looked
at on a fine grid, by the exact inversion of its own path. Times are those of the processor.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import control
import control.flatsys as fs
import numpy as np
import rich.box
from rich.table import Table

import servocore as sc
from benchmarks.planning.by_hand import by_hand
from servocore.cli.console import table_console
from servocore.planning.report import PlanReport

START, END = (5.0, 0.0, -5.0), (-2.0, 2.0, -2.0)
LIMITS = {"M_b": 1000.0, "F": 60.0}
FUNCTIONS = 14
"""Of the basis of each output: polynomials, as python-control's own examples use."""

INSTANTS = 25
"""Where python-control looks at the constraints; more take minutes."""

FINE = 2001
HALVINGS = 5
GUESS = 20.0
"""Duration that CasADi starts from, s: the demo's."""


@dataclass(frozen=True)
class Row:
    """What one planner reached: the load's miss at the end in m, the violation as a share of the limit."""

    planner: str
    duration: float
    violation: float
    miss: float
    seconds: float


def by_fastest() -> tuple[Row, PlanReport]:
    """Plan with `sc.fastest`."""
    begin = time.process_time()
    _, report = sc.fastest(sc.scenes.rotary_crane(), [START, END], LIMITS)
    return Row("sc.fastest", report.duration, report.violation, 0.0, time.process_time() - begin), report


def by_control(planner: str, shortest: float, longest: float) -> Row:
    """Plan with one of python-control's, for the shortest time that it can do."""
    crane = sc.to_control(sc.scenes.rotary_crane())
    ends = [crane.reverse([[each, 0, 0, 0, 0] for each in place]) for place in (START, END)]
    begin, best = time.process_time(), None
    for _ in range(HALVINGS):
        duration = 0.5 * (shortest + longest)
        found = _attempt(PLANNERS[planner], crane, ends, duration)
        if found is None:
            shortest = duration
        else:
            longest, best = duration, found
    seconds = time.process_time() - begin
    if best is None:
        return Row(planner, np.nan, np.nan, np.nan, seconds)
    t = np.linspace(0.0, longest, FINE)
    state, inputs = best.eval(t)
    miss = float(np.linalg.norm(crane.output(longest, state[:, -1], inputs[:, -1]) - END))
    return Row(planner, longest, _violation(inputs), miss, seconds)


def by_casadi(planner: str, *, straight: bool) -> Row:
    """Plan by hand; what IPOPT says of a failure is told beside the planner's name."""
    begin = time.process_time()
    plan = by_hand(START, END, LIMITS, GUESS, straight=straight)
    seconds = time.process_time() - begin
    if plan.status != "Solve_Succeeded":
        return Row(f"{planner}: {plan.status}", np.nan, np.nan, np.nan, seconds)
    crane, jets = sc.to_control(sc.scenes.rotary_crane()), plan.jets(FINE)
    inputs = np.array([crane.reverse(list(each.T))[1] for each in jets]).T
    return Row(planner, plan.duration, _violation(inputs), float(np.linalg.norm(jets[-1, 0] - END)), seconds)


def _violation(inputs: np.ndarray) -> float:
    """Return by what share of a limit the inputs (3, N) are beyond it."""
    bounds = np.array([*LIMITS.values(), np.inf])
    return max(float(np.max(np.abs(inputs) / bounds[:, None])) - 1.0, 0.0)


def _attempt(plan: Callable[..., Any], crane: Any, ends: list[Any], duration: float) -> Any:
    """Return a trajectory that keeps the limits where its planner looked, or None."""
    instants = np.linspace(0.0, duration, INSTANTS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = plan(crane, ends, instants, fs.PolyFamily(FUNCTIONS, T=duration))
            _, inputs = found.eval(instants)
        except (sc.ServocoreError, ValueError, np.linalg.LinAlgError):
            return None
    kept = all(np.abs(inputs[k]).max() <= 1.001 * bound for k, bound in enumerate(LIMITS.values()))
    return found if kept else None


def _bounds(crane: Any) -> Any:
    upper = np.array([*LIMITS.values(), 1e6])
    return control.optimal.input_range_constraint(crane, -upper, upper)


def _effort(crane: Any, end: Any) -> Any:
    weights = np.diag([*(1.0 / bound**2 for bound in LIMITS.values()), 1e-6])
    return control.optimal.quadratic_cost(crane, None, weights, x0=end[0], u0=end[1])


def _point_to_point(crane: Any, ends: list[Any], instants: Any, basis: Any) -> Any:
    effort = _effort(crane, ends[1])
    return fs.point_to_point(
        crane, instants, *ends[0], *ends[1], cost=effort, trajectory_constraints=_bounds(crane), basis=basis
    )


def _flat_ocp(crane: Any, ends: list[Any], instants: Any, basis: Any) -> Any:
    at_the_end = control.optimal.quadratic_cost(crane, 1e3 * np.eye(crane.nstates), None, x0=ends[1][0])
    line = np.linspace(START, END, len(instants)).T
    return fs.solve_flat_ocp(
        crane, instants, *ends[0], _effort(crane, ends[1]), terminal_cost=at_the_end,
        trajectory_constraints=_bounds(crane), basis=basis, initial_guess=line,
    )  # fmt: skip


PLANNERS = {"control.flatsys.point_to_point": _point_to_point, "control.flatsys.solve_flat_ocp": _flat_ocp}


def main() -> None:
    """Run the job and print a table."""
    row, report = by_fastest()
    rows = [row, by_casadi("CasADi by hand, on the line", straight=True)]
    rows.append(by_casadi("CasADi by hand, its own way", straight=False))
    rows += [by_control(each, report.duration, 1.5 * report.degree9) for each in PLANNERS]
    table = Table(box=rich.box.SIMPLE_HEAD)
    for heading in ("planner", "duration, s", "violation, %", "miss at the end, mm", "time to plan, s"):
        table.add_column(heading, justify="left" if heading == "planner" else "right", no_wrap=True)
    for each in rows:
        table.add_row(
            each.planner, f"{each.duration:.2f}", f"{100 * each.violation:.2g}", f"{1e3 * each.miss:.2g}",
            f"{each.seconds:.1f}",
        )  # fmt: skip
    table_console().print(table)


if __name__ == "__main__":
    main()
