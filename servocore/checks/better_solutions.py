"""How far a solution is from better answers to the same problem, and whether its motion is one.

Without internal dynamics the exact answer at every instant is known, on the branch that the run began on. With them
the same initial value problem is solved again by a method of high order, at steps halved until the difference to the
run is much larger than what half the step changes. Both cost more than a step of backward Euler. So a run is checked
first by its inputs alone, or against a run at a much larger step, and closely only if that leaves a doubt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from servocore.checks.findings import ROUND_OFF
from servocore.checks.wrong_inputs import (
    LARGEST_UNWARNED,
    NOTICED,
    Comparison,
    steps_that_stand_out,
    warn_of_wrong_inputs,
)
from servocore.errors import ServocoreError
from servocore.formulations.base import Formulation
from servocore.methods.base import Method
from servocore.methods.collocation import RadauIIA
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import subdivided
from servocore.solution import ErrorEstimate, Solution

STEPWISE = "one: no step of the motion stands out from its neighbours"

Run = Callable[[Problem, Array], Solution]
"""(problem, instants) -> its solution."""

_MOST_HALVINGS = 3
_SURE = 2.0  # times the change of the better values at half the step: a larger difference is the error of the run
_COMPARED = 40, 400  # instants at which a run with internal dynamics is compared, at first and where it is doubtful


@dataclass(frozen=True, eq=False)
class BetterSolver:
    """The more accurate solver that solutions are compared with.

    Attributes
    ----------
    run : callable or None
        Solves the same problem better; None where nothing is known to.
    exact : bool
        Whether its results do not depend on its steps.
    basis : str
        Its name in messages; the reason where there is none.
    """

    run: Run | None
    exact: bool
    basis: str

    def compared(self, problem: Problem, solution: Solution) -> Comparison:
        """Compare a solution with better values at its instants.

        Raises
        ------
        ServocoreError
            If there are none.
        """
        if self.run is None:
            raise ServocoreError(self.basis)
        t, inputs = solution.t, problem.system.inputs
        if self.exact:
            return compared_with(inputs, solution, _on_the_grid(self.run(problem, t), solution), self.basis)
        last: Array | None = None
        comparison, failed = None, ServocoreError("no step was small enough")
        for halvings in range(_MOST_HALVINGS + 1):
            parts = 2**halvings
            try:
                better = self.run(problem, subdivided(t, parts)).values[::parts]
            except ServocoreError as error:
                failed = error
                continue
            if last is not None:
                doubt, off = (np.abs(better - each).max(axis=0) for each in (last, solution.values))
                known = (off >= _SURE * doubt) | (np.maximum(off, doubt) <= ROUND_OFF * np.abs(better).max(axis=0))
                comparison = Comparison(inputs, t, solution.values, better, known, self.basis)
                if known[: len(inputs)].all():
                    return comparison
            last = better
        if comparison is None:
            raise failed
        return comparison

    def estimate(self, problem: Problem, solution: Solution) -> ErrorEstimate:
        """Return how far the inputs of a solution are from better ones."""
        try:
            return self.compared(problem, solution).estimate
        except ServocoreError as error:
            names = [quantity.name for quantity in problem.system.inputs]
            peaks = dict(zip(names, np.abs(solution.values[:, : len(names)]).max(axis=0).tolist(), strict=True))
            return ErrorEstimate(dict.fromkeys(names), peaks, f"unknown: {error}")


def _on_the_grid(better: Solution, solution: Solution) -> Array:
    """Return values at the instants of a solution; its own where the better one, evenly spaced, has none."""
    if np.array_equal(better.t, solution.t):
        return better.values
    step = (better.t[-1] - better.t[0]) / (len(better.t) - 1)
    rows = np.round((solution.t - better.t[0]) / step).astype(np.intp)
    inside = (rows >= 0) & (rows < len(better.t))
    return np.where(inside[:, None], better.values[np.clip(rows, 0, len(better.t) - 1)], solution.values)


def compared_with(inputs: tuple[Quantity, ...], solution: Solution, better: Array, basis: str) -> Comparison:
    """Compare a solution with exact values (N, channels) at its instants."""
    return Comparison(inputs, solution.t, solution.values, better, np.ones(better.shape[1], dtype=bool), basis)


def stated_branch(
    problem: Problem, solution: Solution, how: tuple[Formulation, Method | None], comparison: Comparison | None
) -> str:
    """Warn if inputs are far from better ones, and return on which branch the motion of a solution is.

    Parameters
    ----------
    problem, solution : Problem, Solution
        The problem, and the result.
    how : tuple of Formulation and Method or None
        Form and method, on which the advice depends.
    comparison : Comparison or None
        With better values; None where none are known.
    """
    places = {name: k for k, name in enumerate(solution.names)}
    columns = [places[name] for name in problem.system.coordinates.names]
    if comparison is not None:
        warn_of_wrong_inputs(problem, *how, solution, comparison)
        far = comparison.far_from_better(columns)
        if far is None:
            return f"one: every instant is near {comparison.basis}, on the branch of the first"
    odd = steps_that_stand_out(solution.values[:, columns])
    if not len(odd):
        return STEPWISE
    t, k = solution.t, int(odd[0])
    said = f"not known: the step from t = {t[k]:.6g} s to {t[k + 1]:.6g} s is much larger than its neighbours"
    return f"{said}, and {comparison.basis} gives another motion from t = {far:.6g} s" if comparison else said


def compared_closely(problem: Problem, better: BetterSolver, solution: Solution) -> Comparison | None:
    """Compare a solution with better values, at few instants only if that decides; None if there are none."""
    try:
        if better.exact:
            return better.compared(problem, solution)
        for count in _COMPARED:
            comparison = better.compared(problem, _thinned(solution, count))
            largest = comparison.estimate.largest
            if largest is not None and largest < LARGEST_UNWARNED:
                break
    except ServocoreError:
        return None
    return comparison


def _thinned(solution: Solution, count: int) -> Solution:
    """Return a solution at every so many of its instants, about `count`."""
    every = max(1, (len(solution.t) - 1) // count)
    kept = slice(0, (len(solution.t) - 1) // every * every + 1, every)
    return replace(solution, t=solution.t[kept], values=solution.values[kept])


def is_smooth(problem: Problem, formulation: Formulation, method: Method, solution: Solution) -> bool:
    """Whether a stable result of collocation on a form of index one is smooth from instant to instant, and so right.

    Third differences of all values are small.
    """
    index, values = problem.dae(formulation).index, solution.values
    if index > 1 or not isinstance(method, RadauIIA) or method.orders(index).forces <= 1 or len(values) < _COMPARED[0]:
        return False
    return bool((np.abs(np.diff(values, 3, axis=0)).max(axis=0) <= NOTICED * np.ptp(values, axis=0)).all())
