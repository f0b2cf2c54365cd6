"""The fastest law as a nonlinear program: lifted chains in physical time, the duration free.

Unknowns are the states of the chains at the knots and the snaps, each divided by its peak in a polynomial law, and
theta = T/T0. The duration enters the steps from knot to knot only; limits are local. Limits are kept at a
few points of every interval; `fastest` looks between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array, mapped
from servocore.planning.integrator_chains import Law, advanced
from servocore.planning.limit_rows import Inner

_OPTIONS = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.mu_strategy": "adaptive",
    "ipopt.tol": 1e-6,
    "ipopt.max_iter": 300,
}
_SHORTEST, _LONGEST = 0.02, 50.0  # theta
_SAMPLES = 12  # intervals of a law that says how large inner unknowns are
_NOTHING = 1e-9  # an unknown that stays smaller has no size
SOLVED = "Solve_Succeeded"

CHECKS = 3
"""Points of an interval at which the program keeps the limits."""


@dataclass(frozen=True, eq=False)
class Task:
    """Requirements on a law, independent of the grid.

    Attributes
    ----------
    inner : Inner
        (jets of the chains (C, orders), unknowns) -> rows, between their bounds, equations, integrands.
    lower, upper : ndarray, shape (rows,)
        Bounds.
    start, end : ndarray, shape (C,)
        Where the chains rest.
    length : int
        K, of the chains.
    peaks : ndarray, shape (K + 1, C)
        Largest derivatives of a polynomial law of duration one.
    forward : bool
        Whether no chain turns back.
    most : ndarray, shape (integrands,)
        Upper bounds of the integrals of the integrands over the time.
    """

    inner: Inner
    lower: Array
    upper: Array
    start: Array
    end: Array
    length: int
    peaks: Array
    forward: bool
    most: Array

    @property
    def orders(self) -> int:
        """How many columns the jets have that the rows take."""
        return int(self.inner.local.size2_in(0))

    def unknowns(self, jets: Array) -> Array:
        """Return the unknowns (size, n) of the motion for jets (C, orders, n)."""
        return _at_each(self.inner.start, jets)[0]

    def values(self, jets: Array) -> tuple[Array, Array]:
        """Return the rows (rows, n) of jets (C, K + 2, n), and the integrands."""
        rows, _, integrands = _at_each(self.inner.solved, jets[:, : self.orders])
        return rows, integrands

    def scales(self, jets: Array) -> tuple[Array, Array]:
        """Return the scales of unknowns and equations: their sizes along jets (C, orders, n)."""
        local, rows = self.inner.local, self.unknowns(jets)
        sizes = np.nanmax(np.abs(rows), axis=1, initial=0.0)
        sizes = np.where(sizes > _NOTHING, sizes, 1.0)
        jet, unknowns = ca.SX.sym("jet", *local.size_in(0)), ca.SX.sym("unknowns", self.inner.size)
        slopes = ca.Function("sc_slopes", [jet, unknowns], [ca.jacobian(local(jet, unknowns)[1], unknowns)])
        magnitudes = [np.abs(np.asarray(slopes(jets[:, :, k], rows[:, k]))) @ sizes for k in range(rows.shape[1])]
        largest = np.nanmax(np.array(magnitudes), axis=0, initial=0.0)
        return sizes, np.where(largest > 0.0, largest, 1.0)

    def over_all(self, integrands: Array, duration: float) -> Array:
        """Return by how much integrals are beyond their bounds, from integrands (integrals, intervals, points).

        All intervals are equally long, and points are evenly from start to end of each.
        """
        means = np.trapezoid(integrands, dx=1.0 / (integrands.shape[2] - 1)).mean(axis=1)
        over = duration * means - self.most
        return np.where(np.isfinite(over), over, np.inf)

    def excess(self, values: Array) -> Array:
        """Return by how much rows (rows, intervals, points) are beyond their bounds; infinite where undefined."""
        over: Array = np.maximum(values - self.upper[:, None, None], self.lower[:, None, None] - values)
        return np.where(np.isfinite(values), over, np.inf)


def _at_each(function: ca.Function, jets: Array) -> list[Array]:
    """Return the results (rows, n) of a function of jets (C, orders, n)."""
    columns = jets.transpose(0, 2, 1)
    count = columns.shape[1]
    results = mapped(function, count)(columns.reshape(len(columns), -1))
    return [result.reshape(-1, count, order="F") for result in results]


@dataclass(frozen=True)
class Outcome:
    """The results of the solver: a law, its status, its iterations, and how often bounds were narrowed."""

    law: Law
    status: str
    iterations: int
    rounds: int = 0


class Transcription:
    """A task on a grid, as a program for the solver.

    Parameters
    ----------
    task : Task
        Boundary conditions and limits of the law.
    intervals : int
        N; the rows are kept at `CHECKS` points of each.
    scale : float
        T0, in s.
    """

    def __init__(self, task: Task, intervals: int, scale: float) -> None:
        self.task, self.intervals, self.scale = task, intervals, scale
        self._scales = task.peaks / scale ** np.arange(task.length + 1)[:, None]  # of states and snaps, (K + 1, C)
        typical = Law(scale, task.start, task.end, np.zeros((_SAMPLES + 1, len(task.start))), task.length)
        self._sizes, of_equations = task.scales(_looked_at(task, typical.resting(), _SAMPLES))
        program = _program(task, intervals, scale, self._scales, self._sizes, of_equations)
        self._solver = ca.nlpsol("sc_plan", "ipopt", program, _OPTIONS)

    def solve(self, start: Law, tightened: Array, less: Array, progress: Callable[[str], None]) -> Outcome:
        """Solve from a law.

        Parameters
        ----------
        start : Law
            On this grid.
        tightened : ndarray, shape (rows, N * CHECKS)
            By how much bounds are narrowed.
        less : ndarray, shape (integrands,)
            By how much those of integrals are.
        progress : callable
            Called with a text on the progress.
        """
        progress(f"solving on {self.intervals} intervals")
        lower, upper = self._bounds()
        defects = np.zeros(self.intervals * (self.task.length * len(self.task.start) + CHECKS * self.task.inner.size))
        most = self.task.most - less
        low = np.append((self.task.lower[:, None] + tightened).ravel(order="F"), np.full(len(most), -np.inf))
        high = np.append((self.task.upper[:, None] - tightened).ravel(order="F"), most)
        result = self._solver(
            x0=np.clip(self._packed(start), lower, upper),
            lbx=lower,
            ubx=upper,
            lbg=np.append(defects, low),
            ubg=np.append(defects, high),
        )
        statistics = self._solver.stats()
        law = self._unpacked(np.asarray(result["x"]).ravel())
        return Outcome(law, str(statistics["return_status"]), int(statistics["iter_count"]))

    def _packed(self, law: Law) -> Array:
        states = np.concatenate([law.states(), law.snaps[None]])  # (K + 1, N + 1, C)
        path = np.append((states / self._scales[:, None]).transpose(1, 2, 0).ravel(), law.duration / self.scale)
        inner = self.task.unknowns(_looked_at(self.task, law, CHECKS)) / self._sizes[:, None]
        return np.append(path, np.nan_to_num(inner).ravel(order="F"))

    def _unpacked(self, unknowns: Array) -> Law:
        task = self.task
        size = (self.intervals + 1) * len(task.start) * (task.length + 1)
        table = unknowns[:size].reshape(self.intervals + 1, len(task.start), task.length + 1)
        snaps = table[:, :, -1] * self._scales[-1]
        return Law(float(unknowns[size]) * self.scale, task.start, task.end, snaps, task.length).resting()

    def _bounds(self) -> tuple[Array, Array]:
        task = self.task
        low = np.full((self.intervals + 1, len(task.start), task.length + 1), -np.inf)
        if task.forward and task.length > 1:
            low[1:-1, :, 1] = 0.0  # at the ends it is zero already: a bound there would have no inside
        high = np.full_like(low, np.inf)
        for knot, place in ((0, task.start), (-1, task.end)):
            low[knot] = high[knot] = 0.0
            low[knot, :, 0] = high[knot, :, 0] = place / self._scales[0]
        inner = np.full(self.intervals * CHECKS * task.inner.size, np.inf)
        return np.concatenate([low.ravel(), [_SHORTEST], -inner]), np.concatenate([high.ravel(), [_LONGEST], inner])


def _looked_at(task: Task, law: Law, checks: int) -> Array:
    """Return the jets (C, orders, N * CHECKS) of a law at the points of its grid where rows are kept."""
    return law.jets(np.arange(checks) / checks)[:, : task.orders]


def _program(
    task: Task, intervals: int, scale: float, scales: Array, of_unknowns: Array, of_equations: Array
) -> dict[str, ca.MX]:
    """Return x, f, g of the program for CasADi's solvers; sizes divide inner unknowns and their equations."""
    C, K = len(task.start), task.length
    left, right, h = ca.SX.sym("here", C * (K + 1)), ca.SX.sym("there", C * (K + 1)), ca.SX.sym("h")
    begin, end = (ca.reshape(knot * scales.T.ravel(), K + 1, C).T for knot in (left, right))  # (C, K + 1)
    states, u, change = [begin[:, d] for d in range(K)], begin[:, K], end[:, K] - begin[:, K]
    arrived = ca.horzcat(*advanced(states, u, change, 1.0, h)[:K])
    defect = (end[:, :K] - arrived) / ca.SX(scales[:K].T)
    step = ca.Function("sc_step", [left, right, h], [ca.vec(defect.T)])
    rows, equations, size, added = [], [], task.inner.size, ca.SX.zeros(len(task.most))
    inner = ca.SX.sym("inner", size * CHECKS)
    unknown_sizes, equation_sizes = (ca.DM(each[:, None]) for each in (of_unknowns, of_equations))
    for k in range(CHECKS):
        jets = ca.horzcat(*advanced(states, u, change, k / CHECKS, h)[: task.orders])
        limited, residual, integrands = task.inner.local(jets, inner[k * size : (k + 1) * size] * unknown_sizes)
        rows.append(limited)
        added += integrands / CHECKS
        equations.append(residual / equation_sizes)
    results = [ca.vertcat(*equations), ca.vertcat(*rows), added]
    local = ca.Function("sc_local", [left, right, h, inner], results, {"cse": True})
    knots, theta = ca.MX.sym("knots", C * (K + 1), intervals + 1), ca.MX.sym("theta")
    inside = ca.MX.sym("inside", size * CHECKS, intervals)
    length = ca.repmat(theta * (scale / intervals), 1, intervals)
    arguments = knots[:, :-1], knots[:, 1:], length
    steps = step.map(intervals)(*arguments)
    held, local_rows, parts = local.map(intervals)(*arguments, inside)
    # By the trapezoidal rule: the last instant rests, and so does the first.
    integrals = ca.sum2(parts) * (theta * (scale / intervals))
    return {
        "x": ca.vertcat(ca.vec(knots), theta, ca.vec(inside)),
        "f": ca.log(theta),
        "g": ca.vertcat(ca.vec(steps), ca.vec(held), ca.vec(local_rows), integrals),
    }
