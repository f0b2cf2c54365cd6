"""Runs within limits: limits of the motion, and inputs that are finite between the instants as well."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from servocore.checks.between_instants import refuse_or_warn_of_poles, suspected_poles
from servocore.checks.impulses import has_kinks_or_jumps, require_no_jumps
from servocore.checks.motion_limits import (
    compile_watched,
    limited_values,
    motion_limits,
    require_limits,
    require_reported,
    with_limits_required,
    with_watched,
)
from servocore.errors import IntegrationFailed
from servocore.model.limits import Limit, Named
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import Margin, Solution
from servocore.solvers.branch_continuation import exact_states, prepared_table, system_jacobians
from servocore.stepping.exact_evaluation import unknowns_from
from servocore.structure.derivative_array import DerivativeArray


def run_within_limits(problem: Problem, run: Callable[[Problem], Solution]) -> Solution:
    """Run a problem and return its solution; raise `InvalidReference` where the motion breaks a limit.

    Without internal dynamics the limits are kept at all times. With them, and where a branch is followed from instant
    to instant, they are kept at the instants of the run.
    """
    limits = motion_limits(problem)
    if not limits:
        return run(problem)
    if not problem.flat or problem.follow_branch:
        watched = with_watched(problem)
        solution = with_limits_required(watched, run(watched))
        reported = [(limit, solution[limit.quantity]) for limit in limits if limit.quantity in solution]
        return replace(solution, margins=_margins(reported, solution.t))
    solution = run(problem)
    states = exact_states(problem, prepared_table(problem))
    require_limits(problem, states)
    require_reported(problem, solution)
    exact = limited_values(problem, states, solution.t)
    return replace(solution, margins=_margins(zip(limits, exact, strict=True), solution.t))


def _margins(limited: Iterable[tuple[Limit, Array]], t: Array) -> dict[str, Margin]:
    """Return the margins of limits by name, of quantities known at instants `t`."""
    margins = {}
    for limit, values in limited:
        left = np.minimum(values - limit.bound, limit.upper - values)
        least = int(np.nanargmin(left))
        bound = limit.bound if values[least] - limit.bound < limit.upper - values[least] else limit.upper
        margins[limit.quantity] = Margin(float(left[least]), float(t[least]), float(values[least]), bound, limit.unit)
    return margins


def require_no_impulses(problem: Problem, solution: Solution, beside: Callable[[Problem, Solution], Array]) -> None:
    """Raise `IntegrationFailed` if the motion of a solution jumps between its instants, so that inputs hold impulses.

    Without internal dynamics the exact motion is checked; with them all that follows from internal states and path.
    """
    if not (isinstance(problem.resolved.outcome, DerivativeArray) and has_kinks_or_jumps(problem.resolved)):
        return
    if problem.flat and not problem.follow_branch:
        try:
            prepared_table(problem)
        except IntegrationFailed:  # the guess of the model may still do
            require_no_jumps(problem, solution.t, exact_states(problem, None))
        return
    known = beside(problem, solution)

    def states(t: Array) -> Array:
        return unknowns_from(problem, t, np.stack([np.interp(t, solution.t, row) for row in known]))

    require_no_jumps(problem, solution.t, states)


def _require_regular(problem: Problem, solution: Solution, states: Array, suspected: list[tuple[int, int]]) -> None:
    """Raise `IntegrationFailed` if the system Jacobian changes the sign of its determinant beside a suspect.

    `states` are all unknowns (size, N) at the instants of the solution.
    """
    t = solution.t
    signs, _ = np.linalg.slogdet(system_jacobians(problem, t, states))
    for channel, k in suspected:
        for first in range(max(0, k - 2), min(len(t) - 1, k + 2)):
            if signs[first] * signs[first + 1] < 0.0:
                quantity, values = solution.channels[channel], solution.values[first : first + 2, channel]
                raise IntegrationFailed(
                    f"{solution.route}: between t = {t[first]:.6g} s and {t[first + 1]:.6g} s the equations are"
                    f" singular, the determinant of the system Jacobian changes its sign, and {quantity.name} has a"
                    f" pole: it goes from {values[0]:.4g} to {values[1]:.4g} {quantity.unit}"
                )


def check_between_instants(
    problem: Problem,
    solution: Solution,
    beside: Callable[[Problem, Solution], Array],
    native: bool | None = False,
) -> bool:
    """Check between the instants of a solution where a quantity seems to exceed the reported values, and warn.

    Returns whether it warned.

    Parameters
    ----------
    problem, solution : Problem, Solution
        The problem and its solution.
    beside : callable
        (problem, solution) -> all unknowns of the derivative array (size, N) nearest to it.
    native : bool or None
        Whether machine code may look first whether there is something; see `JustInTime`.

    Raises
    ------
    IntegrationFailed
        If an input or an observable has a pole between two instants, or a sign that it must not have.
    """
    if problem.follow_branch or not isinstance(problem.resolved.outcome, DerivativeArray):
        return False
    suspected = suspected_poles(problem, solution, native)
    if not suspected:
        return False
    if not problem.flat:
        _require_regular(problem, solution, beside(problem, solution), suspected)
        return False
    channels = _channels_to_invert(problem, solution, suspected)
    names = tuple(solution.channels[channel].name for channel in channels)
    watched = compile_watched(problem.resolved, tuple((Named(name), False) for name in names))

    try:
        table = prepared_table(problem)
    except IntegrationFailed:  # that close to a singular point a branch cannot be followed; the guess may still do
        table = None
    followed = exact_states(problem, table)

    def exact(t: Array) -> Array:
        return watched.values(problem, t, followed(t))

    left = _confirmed(problem, solution, suspected, channels, exact(solution.t))
    return refuse_or_warn_of_poles(solution, left, lambda k, t: exact(t)[channels.index(k)]) if left else False


def _channels_to_invert(problem: Problem, solution: Solution, suspected: list[tuple[int, int]]) -> list[int]:
    """Return the channels of suspected poles, and coordinates: where one turns back, inputs are suspected."""
    channels = list(dict.fromkeys(channel for channel, _ in suspected))
    coordinates = problem.system.coordinates.quantities
    return channels + [k for k, channel in enumerate(solution.channels) if channel in coordinates and k not in channels]


def _confirmed(
    problem: Problem, solution: Solution, suspected: list[tuple[int, int]], channels: list[int], exact: Array
) -> list[tuple[int, int]]:
    """Return the suspected poles that remain with exact values (channels, N): most are errors of a method.

    Where exact values are not known, all remain.
    """
    if not np.isfinite(exact).all():
        return suspected
    values = solution.values.copy()
    values[:, channels] = exact.T
    before = {channel for channel, _ in suspected}
    return [suspect for suspect in suspected_poles(problem, replace(solution, values=values)) if suspect[0] in before]
