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
import numpy.typing as npt

from servocore.checks.wrong_inputs import (
    LARGEST_UNWARNED,
    Comparison,
    steps_that_stand_out,
    warn_of_wrong_inputs,
)
from servocore.errors import ServocoreError
from servocore.formulations.base import Formulation
from servocore.methods.base import Method
from servocore.methods.collocation import RadauIIA
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import ErrorEstimate, Solution
from servocore.stepping.exact_evaluation import ExactEvaluation

STEPWISE = "one: no step of the motion stands out from its neighbours"

Run = Callable[[Problem, Array], Solution]
"""(problem, instants) -> its solution."""

LOOSE_TOLERANCE = 0.01
"""A larger tolerance alone does not prove that inputs are accurate."""

_MOST_HALVINGS = 3
_SURE = 2.0  # times the change of the better values at half the step: a larger difference is the error of the run
_FLOOR = 1e-11  # of the peak: round-off of the better values
_COARSER = 8  # times the step, of the run that decides whether a closer check is worth its cost
_SHORT, _LONG = 128, 512  # steps: fewer are checked closely, more against a step twice as large
_SAFE = 0.02  # of the peak: by how much an input may be off, judged by two steps, without a closer look
_COARSE_ENOUGH = 0.3  # of the peak: by how much it may change with the step
_EVERY = 8  # instants, where the exact inversion costs as much as a step
_SUSPICIOUS = 0.04  # of the peak: an input that is off by more, at one of these, is checked everywhere
_SMOOTH = 0.02  # of the range: of third differences, those of a wave at 20 instants a period
_FEW, _MANY = 40, 400  # instants at which a run with internal dynamics is checked, at first and then


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
    beside : callable or None
        Gives the same as `run` for less, from a solution; None where it fails.
    """

    run: Run | None
    exact: bool
    basis: str
    beside: Callable[[Problem, Solution], Solution | None] | None = None

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
            found_beside = self.beside(problem, solution) if self.beside else None
            better = _on_the_grid(found_beside or self.run(problem, t), solution)
            known = np.ones(better.shape[1], dtype=bool)
            return Comparison(inputs, t, solution.values, better, known, self.basis)
        last: Array | None = None
        comparison, failed = None, ServocoreError("no step was small enough")
        for halvings in range(_MOST_HALVINGS + 1):
            parts = 2**halvings
            fine = np.interp(np.arange((len(t) - 1) * parts + 1) / parts, np.arange(len(t)), t)
            try:
                better = self.run(problem, fine).values[::parts]
            except ServocoreError as error:
                failed = error
                continue
            if last is not None:
                doubt, off = (np.abs(better - each).max(axis=0) for each in (last, solution.values))
                known = (off >= _SURE * doubt) | (np.maximum(off, doubt) <= _FLOOR * np.abs(better).max(axis=0))
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


def warn_and_state_branch(
    problem: Problem,
    better: BetterSolver,
    solution: Solution,
    doubtful: bool,
    how: tuple[Formulation, Method | None],
) -> str:
    """Warn if inputs are far from better ones, and return on which branch the motion of a solution is.

    Parameters
    ----------
    problem, better, solution : Problem, BetterSolver, Solution
        The problem, the more accurate solver, and the result.
    doubtful : bool
        Whether a closer check is needed in any case.
    how : tuple of Formulation and Method or None
        Form and method, on which the advice depends.
    """
    places = {name: k for k, name in enumerate(solution.names)}
    columns = [places[name] for name in problem.system.coordinates.names]
    odd = steps_that_stand_out(solution.values[:, columns])
    if not doubtful and not len(odd):
        return STEPWISE
    try:
        comparison = _compared_closely(problem, better, solution)
    except ServocoreError:
        return f"not known: {_standing_out(solution, odd)}" if len(odd) else STEPWISE
    warn_of_wrong_inputs(problem, *how, solution, comparison)
    far = comparison.far_from_better(columns)
    if far is None:
        return f"one: every instant is near {better.basis}, on the branch of the first"
    if not len(odd):
        return STEPWISE
    return f"not known: {_standing_out(solution, odd)}, and {better.basis} gives another motion from t = {far:.6g} s"


def _compared_closely(problem: Problem, better: BetterSolver, solution: Solution) -> Comparison:
    """Compare a solution with better values, at few instants only if that decides and each of them is costly."""
    if better.exact:
        return better.compared(problem, solution)
    comparison = better.compared(problem, _thinned(solution, _FEW))
    largest = comparison.estimate.largest
    return (
        comparison
        if largest is not None and largest < _SUSPICIOUS
        else better.compared(problem, _thinned(solution, _MANY))
    )


def _thinned(solution: Solution, count: int) -> Solution:
    """Return a solution at every so many of its instants, about `count`."""
    every = max(1, (len(solution.t) - 1) // count)
    kept = slice(0, (len(solution.t) - 1) // every * every + 1, every)
    return replace(solution, t=solution.t[kept], values=solution.values[kept])


def _standing_out(solution: Solution, steps: npt.NDArray[np.intp]) -> str:
    k = int(steps[0])
    return f"the step from t = {solution.t[k]:.6g} s to {solution.t[k + 1]:.6g} s is much larger than its neighbours"


def inputs_may_be_far(problem: Problem, solution: Solution, exact: ExactEvaluation) -> bool:
    """Whether inputs may be far from the exact ones, which can be computed at every instant.

    Parameters
    ----------
    problem, solution : Problem, Solution
        Without internal dynamics, and its solution.
    exact : ExactEvaluation
        Of the inputs and more. Where it is an expression every instant is checked, else some, with a tighter limit.
    """
    everywhere = exact.is_expression
    inputs = solution.values[:, : len(problem.system.inputs)]
    at = np.arange(len(inputs)) if everywhere else _samples(inputs)
    known = exact.by_expression(problem, solution.t[at])[0][: inputs.shape[1]].T
    allowed = LARGEST_UNWARNED if everywhere else _SUSPICIOUS
    # Not <=, so that NaN counts as far.
    return not bool((np.abs(inputs[at] - known).max(axis=0) <= allowed * np.abs(known).max(axis=0)).all())


def _samples(inputs: Array) -> npt.NDArray[np.intp]:
    """Return some instants: the first, where inputs are largest and change most, and every so often."""
    last = len(inputs) - 1
    largest, steepest = np.abs(inputs).argmax(axis=0), np.abs(np.diff(inputs, axis=0)).argmax(axis=0)
    return np.unique([*range(min(3, last)), *range(0, last, _EVERY), last, *largest, *steepest, *(steepest + 1)])


def changes_with_the_step(
    problem: Problem, formulation: Formulation, method: Method, run: Run, solution: Solution
) -> bool:
    """Whether a run at a much larger step says that inputs may be far from right.

    Collocation on a form of index one needs no such run where its stable result is smooth from instant to instant.
    """
    index, t = problem.dae(formulation).index, solution.t
    orders, steps = method.orders(index), len(t) - 1
    order = orders.forces
    factor = _COARSER if steps < _LONG else 2 * _COARSER
    if index <= 1 and isinstance(method, RadauIIA) and order > 1 and _is_smooth(solution.values):
        return False
    if steps < _SHORT or order < 1 or (index > 1 and not orders.damped):
        return True
    inputs = slice(len(problem.system.inputs))
    try:
        coarse = run(problem, t[: steps // factor * factor + 1 : factor]).values[:, inputs]
    except ServocoreError:
        return True
    change = np.abs(coarse - solution.values[::factor, inputs][: len(coarse)]).max(axis=0)
    allowed = min(_COARSE_ENOUGH, _SAFE * (factor**order - 1))
    return not bool((change <= allowed * np.abs(solution.values[:, inputs]).max(axis=0)).all())


def _is_smooth(values: Array) -> bool:
    """Whether the third differences of all values are small."""
    if len(values) < _FEW // 2:
        return False
    return bool((np.abs(np.diff(values, 3, axis=0)).max(axis=0) <= _SMOOTH * np.ptp(values, axis=0)).all())
