"""Limits on what moves, for all that solves: by exact inversion where that is possible, else by the run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from servocore.checks.motion_limits import (
    States,
    judged,
    motion_limits,
    require_limits,
    require_reported,
    with_watched,
)
from servocore.numerics.calls import Array, at_instants, side_by_side
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.solvers.following import BranchTable, prepared_table
from servocore.structure.inversion import inversion


def run_within_limits(problem: Problem, run: Callable[[Problem], Solution]) -> Solution:
    """Run a problem and return its solution; raise `InvalidReference` where the motion breaks a limit.

    Without internal dynamics the limits are kept at all times. With them, and where a branch is followed from instant
    to instant, they are kept at the instants of the run.
    """
    if not motion_limits(problem):
        return run(problem)
    if not problem.flat or problem.follow_branch:
        watched = with_watched(problem)
        return judged(watched, run(watched))
    solution = run(problem)
    require_exact_within_limits(problem, prepared_table(problem))
    require_reported(problem, solution)
    return solution


def require_exact_within_limits(problem: Problem, table: BranchTable | None) -> None:
    """Raise `InvalidReference` if an exact inversion breaks a limit at any time of its path.

    Parameters
    ----------
    problem : Problem
        Without internal dynamics.
    table : BranchTable or None
        What `prepared_table` returned for it.
    """
    if motion_limits(problem):
        require_limits(problem, exact_states(problem, table))


def exact_states(problem: Problem, table: BranchTable | None) -> States:
    """Return the exact inversion of a problem as a function of times; `table` is its `prepared_table`."""
    order, inverse = problem.array.reference_order, problem.resolved.once(inversion)

    def states(t: Array) -> Array:
        jets = problem.reference.jet(t, order)
        if table is not None:
            return table.states_at(t, side_by_side(jets))
        return np.asarray(at_instants(inverse.function, jets=jets, p=problem.p)[0])

    return states
