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
from functools import cached_property

import numpy as np

from servocore.checks.findings import FEWEST, ROUND_OFF
from servocore.errors import ServocoreError, ServocoreWarning
from servocore.numerics.compiled_calls import Array, Mask, Places
from servocore.problem import Problem
from servocore.references.base import subdivided
from servocore.solution import ErrorEstimate, Solution
from servocore.stepping.prescribed_initial_values import start_unknowns

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
    coarser : ndarray, shape (N, inputs)
        Inputs there by the solver of the better values with a larger step; the better ones where it has no step.
    """

    solution: Solution
    better: Array
    basis: str
    coarser: Array

    @cached_property
    def distances(self) -> tuple[Array, Array]:
        """Distances of the inputs of the run and of the coarser ones from the better ones, each (N, inputs)."""
        better = self.better[:, : self.coarser.shape[1]]
        return np.abs(self.solution.values[:, : better.shape[1]] - better), np.abs(self.coarser - better)

    @property
    def known(self) -> Mask:
        """Whether the distance of an input is the error of the run, rather than that of the better values."""
        off, doubt = (each.max(axis=0) for each in self.distances)
        round_off = ROUND_OFF * np.abs(self.better[:, : len(off)]).max(axis=0)
        # At half the step they err by less than they changed: a larger difference is the error of the run.
        return np.asarray((off >= doubt) | (np.maximum(off, doubt) <= round_off))

    @property
    def estimate(self) -> ErrorEstimate:
        """Largest distance of every input that is known."""
        bounds = self.bounds
        rows = zip(bounds.items(), self.known, strict=True)
        return replace(bounds, absolute={name: error if known else None for (name, error), known in rows})

    @property
    def bounds(self) -> ErrorEstimate:
        """Largest distance of every input that is known; of the others, that of the better ones from the coarser."""
        off, doubt = self.distances
        peaks = np.abs(self.better[:, : off.shape[1]]).max(axis=0)
        largest = np.where(self.known, np.maximum(off.max(axis=0), np.finfo(float).eps * peaks), doubt.max(axis=0))
        names = self.solution.names[: off.shape[1]]
        absolute, sizes = (dict(zip(names, row.tolist(), strict=True)) for row in (largest, peaks))
        return ErrorEstimate(absolute, sizes, self.basis)

    @property
    def doubtful(self) -> dict[str, float]:
        """Bounds of the inputs that are off by more than `LARGEST_UNWARNED` of their peaks, or may be."""
        return {k: v for k, v in self.bounds.relative.items() if v is not None and v > LARGEST_UNWARNED}


def steps_that_stand_out(q: Array) -> Places:
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
    """Warn if a run gives an input that is off by more than `LARGEST_UNWARNED` of its peak, or may well be."""
    relative = comparison.doubtful
    if not relative:
        return
    known = comparison.estimate
    name = max(relative, key=lambda each: (known[each] is not None, relative[each]))
    column, unit, turn = solution.names.index(name), solution.unit(name), ""
    off, doubt = (each[:, column] for each in comparison.distances)
    k = int((doubt if known[name] is None else off).argmax())
    share = f"{100.0 * relative[name]:.2g} % of" if relative[name] < 0.995 else f"{relative[name]:.3g} times"
    found, other = f"is off by {share} its peak", ""
    if known[name] is None:
        found = f"may be wrong, more accurate values change by {share} its peak with their step"
        other = f", and {comparison.coarser[k, column]:.4g} {unit} with a larger step"
    elif relative[name] > _HALF:
        at = int(np.searchsorted(solution.t, comparison.solution.t[k]))
        turn = _fastest_turn(solution, at, _HALF / relative[name])
    step = (solution.t[-1] - solution.t[0]) / (len(solution.t) - 1)
    warnings.warn(
        f"{solution.route}, step {step:.6g} s: {name} {found}; at"
        f" t = {comparison.solution.t[k]:.6g} s it is {comparison.solution.values[k, column]:.4g} {unit},"
        f" {comparison.basis} gives {comparison.better[k, column]:.4g} {unit}{other}; {turn}{advice}",
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
_RESOLVED = 2.0  # radians of a mode in a step of radau5, which errs by 2e-6 of its amplitude then
_SEEN = 0.5  # radians between two instants, where errors of a mode that decays have their peak too
_UNRESOLVED = 16.0  # radians in a step that no method follows: Gauss and Radau have ten stages at most


def excited_mode(problem: Problem, solution: Solution) -> tuple[float, float]:
    """Return the fastest mode of internal dynamics that counts: radians in a step, and its largest share of a peak.

    Modes that have not decayed after a step of the solution count if it resolves them, or if the start excites them:
    more than `LARGEST_UNWARNED` of the peak of an input is their free motion. A start at rest excites none.
    """
    from servocore.structure.zero_dynamics import free_modes  # noqa: PLC0415 - a flat problem has no internal dynamics

    array, step = problem.array, float(np.ptp(solution.t)) / solution.statistics.steps
    gamma = problem.reference.jet(problem.reference.start_time, array.reference_order)
    s, swings = free_modes(array, start_unknowns(problem, gamma[None], problem.p[None])[0][:, 0], gamma.T, problem.p)
    peaks, s = np.abs(solution.values[:, : len(array.inputs)]).max(axis=0), s * step
    shares = (swings[array.inputs].T / np.maximum(peaks, max(1e-6 * peaks.max(), 1e-300))).max(axis=1)
    # What has decayed after a step is over for methods that damp it, but not for others.
    lasting = np.exp(np.minimum(s.real, 0.0)) * shares > LARGEST_UNWARNED
    radians = np.where(lasting, np.abs(s), np.minimum(np.abs(s), _RESOLVED))
    radians[~((np.abs(s) <= _RESOLVED) | (shares > LARGEST_UNWARNED))] = 0.0
    k = int(radians.argmax())
    return float(radians[k]), float(shares[k])


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
    excited : (float, float), optional
        `excited_mode` of the one solution that it is for, where that is known.
    """

    run: Callable[[Problem, Array], Solution]
    exact: bool
    basis: str
    excited: tuple[float, float] | None = None

    def compared(self, problem: Problem, solution: Solution, every: int = 1) -> Comparison:
        """Compare a solution with better values at its instants, or some of them.

        Parameters
        ----------
        problem, solution : Problem, Solution
            The problem, and the result.
        every : int
            How many instants further on the next one is compared; better steps begin with that many of the solution.

        Raises
        ------
        ServocoreError
            If there are none.
        """
        t, inputs = solution.t, len(problem.system.inputs)
        if self.exact:
            exact = self.run(problem, t)
            better = np.column_stack([np.interp(t, exact.t, column) for column in exact.values.T])
            return Comparison(solution, better, self.basis, better[:, :inputs])
        radians, share = self.excited or excited_mode(problem, solution)
        if radians > _UNRESOLVED:
            step = float(np.ptp(t)) / solution.statistics.steps
            raise ServocoreError(
                f"the start excites a free oscillation of {radians / step:.4g} rad/s, {100.0 * min(share, 1.0):.3g} %"
                f" of the peak of an input, that steps of {step:.4g} s do not follow; steps of"
                f" {0.5 * step / radians:.2g} s do, or a start without it"
            )
        radians *= solution.statistics.steps / (len(t) - 1)  # between two instants
        every = max(1, min(every, int(_SEEN / max(radians, 1e-300))))
        kept = slice(0, (len(t) - 1) // every * every + 1, every)
        solution, t = replace(solution, t=t[kept], values=solution.values[kept]), t[kept]
        found, failed, comparison = list[Array](), ServocoreError("no step was small enough"), None
        first = [max(1, int(np.ceil(radians / _RESOLVED))) * 2**k for k in range(_MOST_HALVINGS + 1)]
        # Larger steps than those of a solution may say nothing of it: where they leave a doubt, more are halved.
        for parts in (*first, *(k for k in (every, 2 * every) if k > first[-1])):
            if comparison is not None and parts > first[-1] and not comparison.doubtful:
                break
            try:
                found.append(self.run(problem, subdivided(t, parts)).values[::parts])
            except ServocoreError as error:
                failed = error
                continue
            if len(found) > 1:
                comparison = Comparison(solution, found[-1], self.basis, found[-2][:, :inputs])
                if comparison.known.all():
                    break
        if comparison is None:
            raise failed
        return comparison


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
    doubts, elsewhere = list[str](), list[str]()
    if better is not None:
        try:
            comparison = better.compared(problem, solution, max(1, (len(solution.t) - 1) // FEWEST))
        except ServocoreError as error:
            doubts.append("no more accurate motion is known")
            warnings.warn(
                f"{solution.route}: the inputs could not be compared with more accurate ones, and may be wrong:"
                f" {error}",
                ServocoreWarning,
                stacklevel=5,
            )
        else:
            warn_of_wrong_inputs(solution, comparison, advice)
            own, exact = comparison.solution.values[:, columns], comparison.better[:, columns]
            far = np.abs(own - exact) > LARGEST_UNWARNED * np.ptp(exact, axis=0) + ROUND_OFF * np.abs(exact).max()
            if not far.any():
                return f"one: every instant is near {comparison.basis}, on the branch of the first"
            time = comparison.solution.t[far.any(axis=1).argmax()]
            elsewhere.append(f"{comparison.basis} is elsewhere from t = {time:.6g} s on")
    odd, t = steps_that_stand_out(solution.values[:, columns]), solution.t
    if len(odd):
        begin, end = t[odd[0]], t[odd[0] + 1]
        doubts.append(f"the step from t = {begin:.6g} s to {end:.6g} s is much larger than its neighbours")
    said = ", and ".join([*doubts, *elsewhere] or ["no step of the motion stands out from its neighbours"])
    return f"{'not known' if doubts else 'one'}: {said}"
