"""How a law is looked for: from several starts, on a grid and on one twice as fine, with bounds that are narrowed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from servocore.errors import PlanningFailed
from servocore.planning.chains import Law
from servocore.planning.laws import law_of, shape_of, shortest, smooth_polynomial
from servocore.planning.transcription import Outcome, Task, Transcription
from servocore.references.profiles import three_phase

EXCESS = 1e-4
"""Of half its range: a limit broken by less counts as kept."""

_ROUNDS = 8
_FINER = 10
_CHECKS = 3


@dataclass(frozen=True)
class Found:
    """A law that the solver and a finer grid agree about, and how it was found."""

    outcome: Outcome
    polynomial: float
    coarse: float
    iterations: int
    rounds: int
    start: str


def starts(task: Task, polynomial: float, intervals: int) -> list[tuple[str, Law]]:
    """Return laws to start from, the best first."""
    own, far = smooth_polynomial(task.length), smooth_polynomial(task.length + 2)
    return [
        (f"{own.name} law", law_of(task, shape_of(own), 1.02 * polynomial, intervals)),
        (f"{own.name} law, slow", law_of(task, shape_of(own), 3.0 * polynomial, intervals)),
        ("three-phase law", law_of(task, shape_of(three_phase()), 1.5 * polynomial, intervals)),
        (f"{far.name} law", law_of(task, shape_of(far), 1.02 * polynomial, intervals)),
        (f"{own.name} law, fast", law_of(task, shape_of(own), 0.5 * polynomial, intervals)),
    ]


def planned(task: Task, intervals: int, progress: Callable[[str], None] | None = None) -> Found:
    """Return the fastest law for a task; raises `PlanningFailed` with the solver's words if no start leads to one."""
    if progress is not None:
        progress("looking for a law to start from")
    polynomial = shortest(task, shape_of(smooth_polynomial(task.length)))
    scale = 1.02 * polynomial
    half, whole = (Transcription.of(task, count, _CHECKS, scale) for count in (intervals // 2, intervals))
    said = []
    for name, start in starts(task, polynomial, intervals // 2):
        coarse = half.solve(start, np.zeros((len(task.upper), half.intervals * _CHECKS)), progress)
        first = coarse.law.refined() if coarse.solved else start.refined()
        outcome, iterations, rounds = _tightened(whole, first, progress)
        if outcome.solved:
            longer = coarse.law.duration if coarse.solved else np.nan
            return Found(outcome, polynomial, longer, coarse.iterations + iterations, rounds, name)
        said.append(f"{outcome.status} from the {name}")
    raise PlanningFailed(
        f"no law was found, which does not say that there is none; the solver's words: {'; '.join(said)}"
    )


def _tightened(program: Transcription, start: Law, progress: Callable[[str], None] | None) -> tuple[Outcome, int, int]:
    """Solve, look on a finer grid, narrow bounds where something went beyond them, and solve again."""
    task, m = program.task, program.checks
    narrowed = np.zeros((len(task.upper), program.intervals * m))
    iterations, outcome = 0, Outcome(start, "not run", 0)
    for rounds in range(_ROUNDS):
        outcome = program.solve(start, narrowed, progress)
        iterations += outcome.iterations
        if not outcome.solved:
            return outcome, iterations, rounds
        parts = np.linspace(0.0, 1.0, _FINER * m + 1)
        over = task.excess(outcome.law.jets(parts)).reshape(len(task.upper), program.intervals, -1)
        if over.max() <= EXCESS:
            return outcome, iterations, rounds
        spans = np.stack([over[:, :, _FINER * j : _FINER * (j + 1) + 1].max(axis=2) for j in range(m)], axis=2)
        after = spans.reshape(len(task.upper), -1)
        before = np.concatenate([np.zeros((len(task.upper), 1)), after[:, :-1]], axis=1)
        worst = np.maximum(after, before)
        narrowed += np.where(worst > 0.0, 1.05 * worst + 1e-6, 0.0)
        start = outcome.law
    return replace(outcome, status="limits broken between the points of the grid"), iterations, _ROUNDS
