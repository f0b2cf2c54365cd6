"""The search for the fastest law: from several starts, on a coarse and a fine grid, with bounds that are narrowed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from servocore.errors import PlanningFailed
from servocore.planning.integrator_chains import Law
from servocore.planning.report import in_words
from servocore.planning.transcription import SOLVED, Outcome, Task, Transcription

EXCESS = 1e-4
"""Of half its range: a limit broken by less counts as kept."""

_ROUNDS = 8  # of solving and narrowing bounds, at the most
_FINER, _FINEST = 10, 4800  # points of the finer grid between two of the program, and at least in all
_CHECKS = 3  # points of an interval at which the program keeps the limits
_REFINEMENTS = 2  # how often the grid is doubled
_NARROWEST = 0.9  # of half the range
_BETWEEN = "limits broken between the points of the grid"


@dataclass(frozen=True)
class SearchResult:
    """A law that the solver and a finer grid agree about, and how it was found."""

    outcome: Outcome
    coarse: float
    iterations: int
    rounds: int
    start: str


def planned(
    task: Task,
    begun: Sequence[tuple[str, Law]],
    scale: float,
    intervals: int,
    progress: Callable[[str], None],
) -> SearchResult:
    """Return the fastest law for a task.

    Parameters
    ----------
    task : Task
        Boundary conditions and limits of the law.
    begun : sequence of (str, Law)
        Laws on half as many intervals to start from, the best first.
    scale : float
        A typical duration in s.
    intervals : int
        Of the grid, even.
    progress : callable
        Called with a text on the progress.

    Raises
    ------
    PlanningFailed
        If no start leads to one, with the status of the solver from each.
    """
    half, whole = (Transcription.of(task, count, _CHECKS, scale) for count in (intervals // 2, intervals))
    free = np.zeros((len(task.upper), half.intervals * _CHECKS)), np.full(len(task.totals), EXCESS)
    failures = []
    for doubled in (True, False):  # half as many intervals may be too few
        for name, start in begun:
            coarse = half.solve(start, *free, progress) if doubled else Outcome(start, SOLVED, 0)
            outcome, iterations, rounds = coarse, 0, 0
            if coarse.solved:
                outcome, iterations, rounds = _refined(whole, coarse.law.refined(), progress)
            if outcome.solved:
                duration = coarse.law.duration if doubled else np.nan
                return SearchResult(outcome, duration, coarse.iterations + iterations, rounds, name)
            failures += [f"{in_words(outcome.status)}, from the {name}"] if doubled else []
    raise PlanningFailed(f"no law was found, which does not say that there is none: {'; '.join(failures)}")


def _refined(whole: Transcription, start: Law, progress: Callable[[str], None]) -> tuple[Outcome, int, int]:
    """Solve, and go on on grids twice as fine where limits stay broken between the points."""
    outcome, iterations, rounds = _tightened(whole, start, progress)
    for doubled in range(1, _REFINEMENTS + 1):
        if outcome.status != _BETWEEN:
            break
        program = Transcription.of(whole.task, whole.intervals * 2**doubled, whole.checks, whole.scale)
        outcome, more, again = _tightened(program, outcome.law.refined(), progress)
        iterations, rounds = iterations + more, rounds + again
    return outcome, iterations, rounds


def _tightened(program: Transcription, start: Law, progress: Callable[[str], None]) -> tuple[Outcome, int, int]:
    """Solve, look on a finer grid, narrow bounds where something went beyond them, and solve again."""
    task, m = program.task, program.checks
    finer = max(_FINER, -(-_FINEST // (program.intervals * m)))
    narrowed = np.zeros((len(task.upper), program.intervals * m))
    less = np.full(len(task.totals), EXCESS)
    iterations, outcome = 0, Outcome(start, "not run", 0)
    for rounds in range(_ROUNDS):
        outcome = program.solve(start, narrowed, less, progress)
        iterations += outcome.iterations
        if not outcome.solved:
            return outcome, iterations, rounds
        parts = np.linspace(0.0, 1.0, finer * m + 1)
        jets = outcome.law.jets(parts)
        over = task.excess(jets).reshape(len(task.upper), program.intervals, len(parts))
        once = np.append(np.arange(jets.shape[2] - 1) % len(parts) < len(parts) - 1, True)  # ends of intervals
        beyond = task.over_all(jets[:, :, once], outcome.law.duration)
        if over.max(initial=0.0) <= EXCESS and beyond.max(initial=0.0) <= 0.0:
            return outcome, iterations, rounds
        spans = np.stack([over[:, :, finer * j : finer * (j + 1) + 1].max(axis=2) for j in range(m)], axis=2)
        after = spans.reshape(len(task.upper), -1)
        before = np.concatenate([np.zeros((len(task.upper), 1)), after[:, :-1]], axis=1)
        worst = np.maximum(after, before)
        # More would leave nothing between two bounds.
        narrowed = np.minimum(narrowed + np.where(worst > 0.0, 1.05 * worst + 1e-6, 0.0), _NARROWEST)
        less = less + np.maximum(1.05 * beyond, 0.0)
        start = outcome.law
    return replace(outcome, status=_BETWEEN), iterations, _ROUNDS
