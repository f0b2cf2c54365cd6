"""What a run must keep at all times: limits on what moves, and inputs that are finite between the instants as well."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from servocore.checks.between_instants import look_between, suspects
from servocore.checks.motion_limits import (
    States,
    compile_watched,
    judged,
    motion_limits,
    require_limits,
    require_reported,
    with_watched,
)
from servocore.model.limits import Named
from servocore.numerics.calls import Array, at_instants, side_by_side
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.solvers.following import BranchTable, prepared_table
from servocore.structure.derivative_array import DerivativeArray
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


def survey_between(problem: Problem, solution: Solution) -> None:
    """Look between the instants of a solution where something seems to grow beyond what it reports.

    Raises
    ------
    IntegrationFailed
        If an input or an observable has a pole between two instants, or a sign that it must not have.
    """
    if problem.follow_branch or not isinstance(problem.resolved.outcome, DerivativeArray) or not problem.flat:
        return
    suspected = suspects(problem, solution)
    if not suspected:
        return
    names = tuple(dict.fromkeys(solution.channels[channel].name for channel, _ in suspected))
    watched = problem.resolved.once(compile_watched, tuple((Named(name), False) for name in names))
    states = exact_states(problem, prepared_table(problem))

    def values(channel: int, t: Array) -> Array:
        jets = problem.reference.jet(t, watched.order)
        (found,) = at_instants(watched.function, states(t), jets=jets, p=problem.p)
        return np.asarray(found[names.index(solution.channels[channel].name)])

    look_between(solution, suspected, values)
