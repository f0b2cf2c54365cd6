"""Runs whose inputs are far from the exact ones though every equation holds.

Forms of index two and more err by the step, and near a singular configuration a step may land on a root that satisfies
every equation and is wrong all the same: a bridge that turns the long way round, a winch whose direction cosines cannot
follow it. A comparison with exact inputs, or with much more accurate ones, shows it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from servocore.checks.findings import ROUND_OFF
from servocore.errors import ServocoreWarning
from servocore.formulations.base import Formulation
from servocore.formulations.original import Original
from servocore.methods.base import Method, errs_less_with_smaller_steps
from servocore.methods.collocation import RadauIIA
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import ErrorEstimate, Solution

LARGEST_UNWARNED = 0.05
"""Of an input's peak: an input further from the exact one is warned of."""

NOTICED = 0.02
"""Of a range: about the third differences of a wave at 20 instants a period, less than which says nothing; of a peak: a
tolerance that is larger does not prove by itself that inputs are accurate."""

_HALF = 0.5  # of the peak: from here on the angle is named that a step cannot follow
_BEYOND = 1e4  # times the peak: the size of a larger error is not reported
_SMALLEST_TURN = 0.01  # rad a step: not worth a word
_BESIDE = 0.6  # of the larger step on either side: a step of the motion further from their mean stands out
_ELSEWHERE = 0.1  # of the range of a coordinate: further from the better motion may be another branch


@dataclass(frozen=True, eq=False)
class Comparison:
    """The values of a run beside better ones of the same names at the same instants.

    Attributes
    ----------
    inputs : tuple of Quantity
        Names of the first columns.
    t : ndarray, shape (N,)
        Instants in s.
    values, better : ndarray, shape (N, number of channels)
        The values in question and the better ones, the inputs first.
    known : ndarray of bool, shape (inputs,) or longer
        Whether the difference is the error of the run, rather than that of the better values.
    basis : str
        Source of the better values.
    """

    inputs: tuple[Quantity, ...]
    t: Array
    values: Array
    better: Array
    known: npt.NDArray[np.bool_]
    basis: str

    @property
    def off(self) -> Array:
        """Distance of the inputs, shape (N, inputs)."""
        inputs = slice(len(self.inputs))
        differences: Array = np.abs(self.values[:, inputs] - self.better[:, inputs])
        return differences

    @property
    def estimate(self) -> ErrorEstimate:
        """Largest distance of every input that is known."""
        names = [quantity.name for quantity in self.inputs]
        peaks = np.abs(self.better[:, : len(names)]).max(axis=0)
        largest = np.maximum(self.off.max(axis=0), np.finfo(float).eps * peaks)
        rows = zip(names, largest.tolist(), self.known.tolist(), strict=False)
        errors = {name: error if known else None for name, error, known in rows}
        return ErrorEstimate(errors, dict(zip(names, peaks.tolist(), strict=True)), self.basis)

    def far_from_better(self, columns: list[int]) -> float | None:
        """Return the first time at which some columns are far from the better ones; None if there is none."""
        run, better = self.values[:, columns], self.better[:, columns]
        allowed = _ELSEWHERE * np.ptp(better, axis=0) + ROUND_OFF * np.abs(better).max()
        far = (np.abs(run - better) > allowed).any(axis=1)
        return float(self.t[far.argmax()]) if far.any() else None


def steps_that_stand_out(q: Array) -> npt.NDArray[np.intp]:
    """Return the steps of a motion (N, n) that are far from the mean of the ones before and after.

    A motion that changes branch has such a step, and one that hardly resolves its path.
    """
    steps = np.diff(q, axis=0)
    if len(steps) < 3:
        return np.arange(len(steps))
    # The first and the last step have neighbours on one side only, which are continued.
    before = np.vstack([2.0 * steps[1] - steps[2], steps[:-1]])
    after = np.vstack([steps[1:], 2.0 * steps[-2] - steps[-3]])
    beside = _BESIDE * np.maximum(np.abs(before), np.abs(after)) + NOTICED * np.ptp(q, axis=0)
    return np.flatnonzero((np.abs(steps - (before + after) / 2.0) > beside).any(axis=1))


def warn_of_wrong_inputs(
    problem: Problem, formulation: Formulation, method: Method | None, solution: Solution, comparison: Comparison
) -> None:
    """Warn if a run of steps gives an input that is off by more than `LARGEST_UNWARNED` of its peak."""
    relative = {k: v for k, v in comparison.estimate.relative.items() if v is not None}
    name = max(relative, key=lambda each: relative[each], default="")
    if not name or not relative[name] > LARGEST_UNWARNED:
        return
    column = solution.names.index(name)
    k, unit = int(comparison.off[:, column].argmax()), solution.unit(name)
    at = int(np.searchsorted(solution.t, comparison.t[k]))
    turn = _fastest_turn(solution, at, _HALF / relative[name]) if relative[name] > _HALF else ""
    advice = _advice(problem, formulation, method)
    step = (solution.t[-1] - solution.t[0]) / (len(solution.t) - 1)
    warnings.warn(
        f"{solution.route}, step {step:.6g} s: {name} is off by {_share_in_words(relative[name])}; at"
        f" t = {comparison.t[k]:.6g} s it is {comparison.values[k, column]:.4g} {unit},"
        f" {comparison.basis} gives {comparison.better[k, column]:.4g} {unit}; {turn}{advice}",
        ServocoreWarning,
        stacklevel=5,
    )


def _share_in_words(share: float) -> str:
    if share < 1.0:
        return f"{100.0 * share:.2g} % of its peak"
    return f"{share:.3g} times its peak" if share < _BEYOND else f"more than {_BEYOND:g} times its peak"


def _advice(problem: Problem, formulation: Formulation, method: Method | None) -> str:
    """Return the advice: the default route, unless this is it, and smaller steps only where the inputs converge."""
    if method is None:
        return "leave its horizon to StableInversion, with a smaller tolerance"
    index = problem.dae(formulation).index
    default = ""
    if problem.flat:
        default = "the default route, solve without a form and a method, has no step"
    elif index > 1 or method != RadauIIA(3):
        default = "the default route, solve without a form and a method, errs less"
    converges = method.orders(index).forces >= 1 and errs_less_with_smaller_steps(method, index)
    if converges and not isinstance(formulation, Original):
        return f"{default}; a smaller step errs less" if default else "a smaller step errs less"
    return default


def _fastest_turn(solution: Solution, k: int, factor: float) -> str:
    """Name the angle that turns most within the step to instant `k`, and the turn it may make.

    Bodies given by their directors exert a torque of J turn^3/h^2 too much on a turn a step, so that the error of the
    inputs is proportional to the turn at a given speed; `factor` scales it to the limit.
    """
    values = solution.values
    turns = {
        channel.name: abs(float(values[k, j] - values[k - 1, j]))
        for j, channel in enumerate(solution.channels)
        if channel.unit == "rad"
    }
    name = max(turns, key=lambda each: turns[each], default="")
    if k == 0 or not name or turns[name] < _SMALLEST_TURN:
        return ""
    return (
        f"{name} turns by {turns[name]:.2g} rad within this step, where about {min(factor, 1.0) * turns[name]:.2g} rad"
        f" would be an error of half the peak; "
    )
