"""Limits of a motion: coordinates, velocities, multipliers, inputs, and the rates of all these.

They are compared at the instants of a run: where a problem is flat with its exact inversion, elsewhere with the values
that are reported. `certify` proves them in between. What a run adds up, as an energy, counts at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from servocore.checks.findings import ROUND_OFF, bisected, least_between
from servocore.checks.motion import Motion
from servocore.errors import InvalidReference, LimitBroken
from servocore.formulations.reduced import Reduced
from servocore.model.limits import Expression, Limit
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import time_derivative
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem, resolve
from servocore.solution import Margin, Solution
from servocore.stepping.program import program_of
from servocore.stepping.readings import Watched, compile_watched

HIDDEN = "limit "
"""Prefix of the names of observables that only limits need."""


# A limit that is broken -----------------------------------------------------------------------------------------------


def margin_within(limit: Limit, values: Array, size: float) -> Array:
    """Return how far values are within a limit, negative beyond it; a value on it up to round-off is within."""
    margins: Array = np.minimum(values - limit.bound, limit.upper - values) + ROUND_OFF * size
    if limit.rate:  # of the length of a vector, where that is zero
        margins = np.where(np.isnan(margins), np.inf, margins)
    return margins


def first_broken(
    name: str, limit: Limit, t: Array, values: Array, evaluate: Callable[[Array], Array] | None = None
) -> tuple[float, str] | None:
    """Return when a limit is broken first at instants, and the sentence on it; None if it is kept.

    With `evaluate`, the quantity as a function of times, the time is the first between the instants, and the value the
    worst between those beside the worst instant. What a run adds up counts at its end.
    """
    if limit.over_run:
        t, values, evaluate = t[-1:], values[-1:], None
    bounds = [abs(each) for each in (limit.bound, limit.upper) if np.isfinite(each)]
    size = max(bounds, default=0.0) or float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
    margins = margin_within(limit, values, size)
    bad = np.flatnonzero(~(margins >= 0.0))
    if not len(bad):
        return None
    k, first = int(bad[0]), float(t[bad[0]])
    spell = bad[: 1 + int(np.argmax(np.diff([*bad, len(t) + 1]) > 1))]
    worst = int(spell[np.nan_to_num(margins[spell], nan=-np.inf).argmin()])
    when, value = float(t[worst]), float(values[worst])
    if evaluate is not None and np.isfinite(value):
        when = least_between(lambda at: margin_within(limit, evaluate(at), size), t, worst)
        value = float(evaluate(np.array([when]))[0])
        if k:
            _, first = bisected(
                lambda at: bool(margin_within(limit, evaluate(np.array([at])), size)[0] >= 0.0), float(t[k - 1]), first
            )
    why = f" {limit.reason}:" if limit.reason else ""
    if not np.isfinite(value):
        return first, f"{name}: at t = {first:.6g} s{why} {limit.quantity} is not finite, and has a limit"
    below = value - limit.bound < limit.upper - value
    which, bound = ("lower", limit.bound) if below else ("upper", limit.upper)
    return first, (
        f"{name}: at t = {first:.6g} s{why} {limit.quantity} goes beyond its {which} limit of {limit.with_unit(bound)};"
        f" it reaches {limit.with_unit(value)} at t = {when:.6g} s{', over the whole run' if limit.over_run else ''}"
    )


# Flat problems: by exact inversion ------------------------------------------------------------------------------------


def limited_values(motion: Motion, t: Array | None = None) -> Array:
    """Return the quantities of the `motion_limits` of a flat problem, (limits, N), at instants (N,); angles continuous.

    The instants are those of the motion when not given. What a run adds up has its value at the last one everywhere.
    """
    limits = motion.problem.motion_limits
    if not limits:
        return np.zeros((0, len(motion.t if t is None else t)))
    watched, problem = watched_limits(motion.problem), motion.problem
    values = _at_its_instants(motion, watched) if t is None else watched.values(problem, t, motion.at(t))
    of_run = [(k, added) for k, limit in enumerate(limits) if (added := limit.over_run)]
    whole = watched.values(problem, motion.t, motion.states) if of_run and t is not None else values
    for k, added in of_run:
        values[k] = added.course(motion.t, whole[k])[-1]
    angles = np.array([limit.counts_turns(problem.system) for limit in limits])
    return np.where(angles[:, None], np.unwrap(values, axis=1), values) if angles.any() else values


def _at_its_instants(motion: Motion, watched: Watched) -> Array:
    """Return the quantities of the `motion_limits` at the instants of a motion, those that are observed if all are."""
    names = [each.reported for each in motion.problem.motion_limits if not (each.rate or each.over_run)]
    if motion.values is None or len(names) < len(motion.problem.motion_limits) or "" in names:
        return watched.values(motion.problem, motion.t, motion.states)
    known = [channel.name for channel in program_of(motion.problem, Reduced()).channels]
    return motion.values[[known.index(name) for name in names]]


def require_limits(motion: Motion) -> Array:
    """Return the limited quantities at the instants of a motion; raise `LimitBroken` if one goes beyond its limit."""
    problem, limits = motion.problem, motion.problem.motion_limits
    _require_derivatives(problem, limits, watched_limits(problem))
    values = limited_values(motion)

    def near(row: int, t: Array) -> Array:
        """Return one of the quantities between the instants, an angle in the turn that it is in beside."""
        found: Array = limited_values(motion, t)[row]
        if limits[row].counts_turns(problem.system):
            found = found + 2.0 * np.pi * np.round((np.interp(t, motion.t, values[row]) - found) / (2.0 * np.pi))
        return found

    _require_kept(problem.name, limits, [(motion.t, row, partial(near, k)) for k, row in enumerate(values)])
    return values


def _require_kept(name: str, limits: Sequence[Limit], values: Sequence[tuple[Any, ...]]) -> None:
    """Raise `LimitBroken` for the limit that is broken first; see `first_broken` for what comes with it."""
    broken = [first_broken(name, limit, *each) for limit, each in zip(limits, values, strict=True)]
    if found := [each for each in broken if each is not None]:
        raise LimitBroken(min(found)[1])


def margins_of(limits: Sequence[Limit], values: Sequence[Array], t: Array) -> dict[str, Margin]:
    """Return the margins of limits by name, of quantities known at instants `t`; of what a run adds up, at its end."""
    margins = {}
    for limit, every in zip(limits, values, strict=True):
        each = np.where(t == t[-1], every, np.nan) if limit.over_run else every
        left = np.minimum(each - limit.bound, limit.upper - each)
        least = int(np.nanargmin(left))
        bound = limit.bound if each[least] - limit.bound < limit.upper - each[least] else limit.upper
        margins[limit.quantity] = Margin(float(left[least]), float(t[least]), float(each[least]), bound, limit.unit)
    return margins


def watched_limits(problem: Problem) -> Watched:
    """Return the function of the quantities of the `motion_limits` of a flat problem, or of what a run adds up."""
    wanted = tuple((limit.expression, limit.rate) for limit in problem.motion_limits)
    return compile_watched(problem.resolved, wanted)


def _require_derivatives(problem: Problem, limits: Sequence[Limit], watched: Watched) -> None:
    """Raise `InvalidReference` if the path has not the derivatives that a rate needs."""
    reference = problem.reference
    for limit, order in zip(limits, watched.needs, strict=True):
        if reference.max_order < order:
            raise InvalidReference(
                f"the limit of {limit.quantity} needs the path's derivative of order {order}, but the path has"
                f" derivatives up to order {reference.max_order}"
            )
        if limit.rate and reference.smoothness < order - 1:
            raise InvalidReference(
                f"the limit of {limit.quantity} cannot be kept: the path is continuous up to order"
                f" {reference.smoothness} only, where its derivative of order {order - 1} jumps that rate is infinite"
            )


# Runs: at the instants that they report ------------------------------------------------------------------------------


def with_watched(problem: Problem) -> Problem:
    """Return the problem with the quantities of its limits among the observables, for runs that report them."""
    limits = problem.motion_limits
    if not limits:
        return problem
    resolved = _observing(problem.resolved, tuple((limit.expression, limit.rate) for limit in limits))
    return replace(problem, resolved=resolved)


@made_once
def _observing(resolved: ResolvedSystem, wanted: tuple[tuple[Expression, bool], ...]) -> ResolvedSystem:
    system, hidden = resolved.system, {}
    forces = ca.vertcat(system.v, system.lam, system.u)
    for k, (expression, rate) in enumerate(wanted):
        value, suffix = Limit("", "", -np.inf, "", expression).on(system), ""
        if rate and ca.depends_on(value, forces):
            suffix = " differenced"
        elif rate:
            value = time_derivative(value, ca.horzcat(system.q, system.v), system.gamma)
        hidden[Quantity(f"{HIDDEN}{k}{suffix}")] = value
    system = replace(system, observables={**system.observables, **hidden})
    return resolve(system, system.home_parameters)


def with_limits_required(problem: Problem, solution: Solution) -> Solution:
    """Return a solution of a problem `with_watched`, less what was added; raise `LimitBroken` if it breaks limits.

    Rates of forces and inputs are those of their differences from instant to instant.
    """
    hidden = [k for k, channel in enumerate(solution.channels) if channel.name.startswith(HIDDEN)]
    if not hidden:
        return solution
    limits, t, values = problem.motion_limits, solution.t, list[tuple[Array, ...]]()
    for limit, k in zip(limits, hidden, strict=True):
        column = solution[limit.quantity] if limit.over_run else solution.values[:, k]
        differenced = solution.channels[k].name.endswith("differenced")
        values.append((t[1:], np.diff(column) / np.diff(t)) if differenced else (t, column))
    _require_kept(problem.name, limits, values)
    shown = [k for k in range(len(solution.channels)) if k not in hidden]
    channels = tuple(solution.channels[k] for k in shown)
    solution = replace(solution, channels=channels, values=solution.values[:, shown])
    reported = [limit for limit in limits if limit.quantity in solution]
    return replace(solution, margins=margins_of(reported, [solution[each.quantity] for each in reported], t))


def with_limits_kept(motion: Motion, solution: Solution) -> Solution:
    """Return a solution with its margins; raise `LimitBroken` if the exact motion or the solution breaks a limit."""
    values, limits, t = require_limits(motion), motion.problem.motion_limits, solution.t
    for limit in limits:
        known = not limit.rate and limit.reported in solution
        if known and (broken := first_broken(solution.route, limit, t, solution[limit.reported])):
            raise LimitBroken(f"{broken[1]}; the exact motion keeps that limit")
    parts = (len(motion.t) - 1) // (len(t) - 1)
    return replace(solution, margins=margins_of(limits, [*values[:, ::parts]], t))
