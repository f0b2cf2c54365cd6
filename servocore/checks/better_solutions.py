"""How far a solution is from better answers to the same problem, and whether its motion is one.

Forms of index two and more err by the step, and near a singular configuration a step may land on a root that satisfies
every equation and is wrong all the same: a bridge that turns the long way round, a winch whose direction cosines cannot
follow it. Without internal dynamics the exact answer at every instant is known, on the branch that the run began on.
With them the same initial value problem is solved again by a method of high order, at steps halved until the difference
to the run is larger than what half the step changes. That costs more than a run of backward Euler: such a run is
checked first by its values alone, and compared, at some hundred instants, only if that leaves a doubt.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from servocore.checks.findings import FEWEST, ROUND_OFF
from servocore.errors import ServocoreError, ServocoreWarning
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import subdivided
from servocore.solution import ErrorEstimate, Solution

LARGEST_UNWARNED = 0.05
"""Of an input's peak: an input further from the exact one is warned of; of the range of a coordinate: one further from
the better motion may be on another branch."""

NOTICED = 0.02
"""Of a range: about the third differences of a wave at 20 instants a period, less than which says nothing; of a peak: a
tolerance that is larger does not prove by itself that inputs are accurate."""

_HALF = 0.5  # of the peak: from here on the angle is named that a step cannot follow
_BESIDE = 0.6  # of the larger step on either side: a step of the motion further from their mean stands out


@dataclass(frozen=True, eq=False)
class Comparison:
    """The values of a run beside better ones of the same names at the same instants.

    Attributes
    ----------
    solution : Solution
        The run in question, at some of its instants, the inputs first.
    better : ndarray, shape (N, number of channels)
        Better values there.
    basis : str
        Their source.
    known : ndarray of bool, shape (inputs,)
        Whether the difference of an input is the error of the run, rather than that of the better values.
    """

    solution: Solution
    better: Array
    basis: str
    known: npt.NDArray[np.bool_]

    @property
    def off(self) -> Array:
        """Distance of the inputs, shape (N, inputs)."""
        inputs = slice(len(self.known))
        return np.asarray(np.abs(self.solution.values[:, inputs] - self.better[:, inputs]))

    @property
    def estimate(self) -> ErrorEstimate:
        """Largest distance of every input that is known."""
        peaks = np.abs(self.better[:, : len(self.known)]).max(axis=0)
        largest = np.maximum(self.off.max(axis=0), np.finfo(float).eps * peaks)
        rows = zip(self.solution.names, largest.tolist(), self.known, strict=False)
        errors = {name: error if known else None for name, error, known in rows}
        return ErrorEstimate(errors, dict(zip(errors, peaks.tolist(), strict=True)), self.basis)


def steps_that_stand_out(q: Array) -> npt.NDArray[np.intp]:
    """Return the steps of a motion (N, n) that are far from the mean of the ones before and after.

    A motion that changes branch has such a step, and one that hardly resolves its path.
    """
    steps = np.diff(q, axis=0)
    if len(steps) < 3:
        return np.arange(len(steps))
    # The first and the last step have neighbours on one side only, which are continued.
    continued = np.vstack([2.0 * steps[1] - steps[2], steps, 2.0 * steps[-2] - steps[-3]])
    sizes = np.abs(continued)
    beside = _BESIDE * np.maximum(sizes[:-2], sizes[2:]) + NOTICED * np.ptp(q, axis=0)
    return np.flatnonzero((np.abs(steps - (continued[:-2] + continued[2:]) / 2.0) > beside).any(axis=1))


def warn_of_wrong_inputs(solution: Solution, comparison: Comparison, advice: str) -> None:
    """Warn if a run gives an input that is off by more than `LARGEST_UNWARNED` of its peak."""
    relative = {k: v for k, v in comparison.estimate.relative.items() if v is not None}
    name = max(relative, key=lambda each: relative[each], default="")
    if not name or not relative[name] > LARGEST_UNWARNED:
        return
    column = solution.names.index(name)
    k, unit = int(comparison.off[:, column].argmax()), solution.unit(name)
    at = int(np.searchsorted(solution.t, comparison.solution.t[k]))
    turn = _fastest_turn(solution, at, _HALF / relative[name]) if relative[name] > _HALF else ""
    share = f"{100.0 * relative[name]:.2g} % of" if relative[name] < 1.0 else f"{relative[name]:.3g} times"
    step = (solution.t[-1] - solution.t[0]) / (len(solution.t) - 1)
    warnings.warn(
        f"{solution.route}, step {step:.6g} s: {name} is off by {share} its peak; at"
        f" t = {comparison.solution.t[k]:.6g} s it is {comparison.solution.values[k, column]:.4g} {unit},"
        f" {comparison.basis} gives {comparison.better[k, column]:.4g} {unit}; {turn}{advice}",
        ServocoreWarning,
        stacklevel=5,
    )


def _fastest_turn(solution: Solution, k: int, factor: float) -> str:
    """Name the angle that turns most within the step to instant `k`, and the turn it may make.

    Bodies given by their directors exert a torque of J turn^3/h^2 too much on a turn a step, so that the error of the
    inputs is proportional to the turn at a given speed; `factor` scales it to the limit.
    """
    step = np.abs(solution.values[k] - solution.values[k - 1])
    turns = {each.name: float(turn) for each, turn in zip(solution.channels, step, strict=True) if each.unit == "rad"}
    name = max(turns, key=lambda each: turns[each], default="")
    if k == 0 or not turns.get(name):
        return ""
    return (
        f"{name} turns by {turns[name]:.2g} rad within this step, where about {min(factor, 1.0) * turns[name]:.2g} rad"
        f" would be an error of half the peak; "
    )


_MOST_HALVINGS = 3


@dataclass(frozen=True, eq=False)
class BetterSolver:
    """The more accurate solver that solutions are compared with.

    Attributes
    ----------
    run : callable
        (problem, instants) -> a better solution of the same problem, which may reach beyond the instants.
    exact : bool
        Whether its results do not depend on its steps.
    basis : str
        Its name in messages.
    """

    run: Callable[[Problem, Array], Solution]
    exact: bool
    basis: str

    def compared(self, problem: Problem, solution: Solution) -> Comparison:
        """Compare a solution with better values at its instants.

        Raises
        ------
        ServocoreError
            If there are none.
        """
        t, inputs = solution.t, len(problem.system.inputs)
        if self.exact:
            exact = self.run(problem, t)
            better = exact.values
            if not np.array_equal(exact.t, t):
                better = np.column_stack([np.interp(t, exact.t, column) for column in better.T])
            return Comparison(solution, better, self.basis, np.ones(inputs, dtype=bool))
        found, failed = list[Array](), ServocoreError("no step was small enough")
        for parts in 2 ** np.arange(_MOST_HALVINGS + 1):
            try:
                found.append(self.run(problem, subdivided(t, int(parts))).values[::parts])
            except ServocoreError as error:
                failed = error
                continue
            if len(found) > 1:
                *_, last, better = found
                best = better[:, :inputs]
                doubt, off = (np.abs(best - each[:, :inputs]).max(axis=0) for each in (last, solution.values))
                # At half the step they err by less than they changed: a larger difference is the error of the run.
                known = (off >= doubt) | (np.maximum(off, doubt) <= ROUND_OFF * np.abs(best).max(axis=0))
                if known.all():
                    break
        if len(found) < 2:
            raise failed
        return Comparison(solution, better, self.basis, known)


def unknown_errors(problem: Problem, solution: Solution, why: str) -> ErrorEstimate:
    """Return the estimate of a solution whose errors are unknown, with the reason."""
    peaks = {quantity.name: float(np.abs(solution[quantity.name]).max()) for quantity in problem.system.inputs}
    return ErrorEstimate(dict.fromkeys(peaks), peaks, f"unknown: {why}")


def stated_branch(problem: Problem, solution: Solution, better: BetterSolver | None, advice: str) -> str:
    """Warn if inputs are far from better ones, and return on which branch the motion of a solution is.

    It is compared with better values, those of steps at some hundred instants only. If there are none, warn of inputs
    that nothing confirms.

    Parameters
    ----------
    problem, solution : Problem, Solution
        The problem, and the result.
    better : BetterSolver or None
        Of better values; None where the result is not doubtful.
    advice : str
        Remedy for inputs that are far off.
    """
    columns = [solution.names.index(name) for name in problem.system.coordinates.names]
    comparison = None
    if better is not None:
        every = 1 if better.exact else max(1, (len(solution.t) - 1) // FEWEST)
        kept = slice(0, (len(solution.t) - 1) // every * every + 1, every)
        try:
            comparison = better.compared(problem, replace(solution, t=solution.t[kept], values=solution.values[kept]))
        except ServocoreError as error:
            warnings.warn(
                f"{solution.route}: the inputs could not be compared with more accurate ones, and may be wrong:"
                f" {error}",
                ServocoreWarning,
                stacklevel=5,
            )
    if comparison is not None:
        warn_of_wrong_inputs(solution, comparison, advice)
        own, exact = comparison.solution.values[:, columns], comparison.better[:, columns]
        far = np.abs(own - exact) > LARGEST_UNWARNED * np.ptp(exact, axis=0) + ROUND_OFF * np.abs(exact).max()
        if not far.any():
            return f"one: every instant is near {comparison.basis}, on the branch of the first"
    odd = steps_that_stand_out(solution.values[:, columns])
    if not len(odd):
        return "one: no step of the motion stands out from its neighbours"
    t, k = solution.t, int(odd[0])
    said = f"not known: the step from t = {t[k]:.6g} s to {t[k + 1]:.6g} s is much larger than its neighbours"
    if comparison is None:
        return said
    time = comparison.solution.t[far.any(axis=1).argmax()]
    return f"{said}, and {comparison.basis} gives another motion from t = {time:.6g} s"
