"""Limits of a motion: coordinates, velocities, multipliers, inputs, and the rates of all these.

Where a problem is flat, its exact inversion gives every quantity at every instant, so that the limits are kept between
the instants of a grid as well. Elsewhere a run is judged by its reported values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from servocore.checks.limits import LimitSurvey, broken_limit, margin_within, size_of_bounds
from servocore.errors import InvalidModel, InvalidReference, LimitBroken
from servocore.model.limits import Expression, Limit, Named, reported_quantities
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.expressions import highest_derivative, time_derivative
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem, resolve
from servocore.references.base import survey
from servocore.solution import Solution
from servocore.structure.derivative_array import DerivativeArray

States = Callable[[Array], Array]
"""Times (N,) -> unknowns of the derivative array, shape (size, N)."""

HIDDEN = "limit "
"""Prefix of the names of observables that only limits need."""


def motion_limits(problem: Problem) -> tuple[Limit, ...]:
    """Return the limits of a problem that do not follow from the path alone."""
    return tuple(limit for limit in problem.limits if not limit.of_path)


def counts_turns(expression: Expression, rate: bool, system: MechanicalSystem) -> bool:
    """Whether the quantity of a limit is an angle that is known up to full turns only."""
    return isinstance(expression, Named) and not rate and reported_quantities(system)[expression.name].wraps


# Flat problems: at all instants --------------------------------------------------------------------------------------


def require_limits(problem: Problem, states: States) -> None:
    """Raise `LimitBroken` if a path leads a flat problem beyond a limit at any time, with the first.

    Parameters
    ----------
    problem : Problem
        Without internal dynamics.
    states : callable
        Its exact inversion at any instants of the path.
    """
    limits = motion_limits(problem)
    if not limits:
        return
    watched = watched_limits(problem)
    _require_derivatives(problem, limits, watched)

    def evaluate(t: Array) -> Array:
        return watched.values(problem, t, states(t))

    LimitSurvey(problem.name, limits, watched.wraps, evaluate).require(survey(problem.reference))


def limited_values(problem: Problem, states: States, t: Array) -> Array:
    """Return the quantities of the `motion_limits` of a flat problem, (limits, N), at instants (N,); angles continuous.

    `states` is its exact inversion at any instants of the path.
    """
    if not motion_limits(problem):
        return np.zeros((0, len(t)))
    watched = watched_limits(problem)
    values = watched.values(problem, t, states(t))
    angles = np.array(watched.wraps, dtype=bool)
    return np.where(angles[:, None], np.unwrap(values, axis=1), values)


@dataclass(frozen=True, eq=False)
class Watched:
    """The quantities of limits, as one function of an exact inversion.

    Attributes
    ----------
    function : casadi.Function
        (unknowns of the derivative array, gamma (m, order + 1), p) -> values (limits,).
    order : int
        Of the path's derivatives in gamma.
    needs : tuple of int
        Highest derivative of the path that each value depends on.
    wraps : tuple of bool
        Whether each is an angle that is known up to full turns only.
    """

    function: ca.Function
    order: int
    needs: tuple[int, ...]
    wraps: tuple[bool, ...]

    def values(self, problem: Problem, t: Array, states: Array) -> Array:
        """Return the values (limits, N) at instants (N,) where the unknowns of the derivative array are (size, N)."""
        (found,) = at_instants(self.function, states, jets=problem.reference.jet(t, self.order), p=problem.p)
        return found


def watched_limits(problem: Problem) -> Watched:
    """Return the function of the quantities of the `motion_limits` of a flat problem."""
    wanted = tuple((limit.expression, limit.rate) for limit in motion_limits(problem))
    return compile_watched(problem.resolved, wanted)


@made_once
def compile_watched(resolved: ResolvedSystem, wanted: tuple[tuple[Expression, bool], ...]) -> Watched:
    """Compile expressions, and rates of those marked, for an exact inversion.

    The rate of the highest derivative in the array follows from the array differentiated once more, which is
    linear in it.
    """
    array, system = resolved.array, resolved.system
    limits = [(Limit("", "", -np.inf, "", expression), rate) for expression, rate in wanted]
    values, y = limited_expressions(resolved, [(each.on(system), rate) for each, rate in limits])
    rows = array.y.size1()
    needs, used = [], set[tuple[int, int]]()
    top = dict(array.unknowns)  # the highest of each comes last
    for value in values:
        entries = {(c % rows, c // rows) for c in ca.jacobian_sparsity(value, ca.vec(y)).get_col()}
        orders = [array.reference_order - (top[j] - k) for j, k in entries]
        needs.append(max([*orders, highest_derivative(value, system.gamma)]))
        used |= entries
    beyond = sorted(each for each in used if each not in array.unknowns)
    if any(k > top[j] + 1 for j, k in beyond):
        raise InvalidModel(f"{system.name}: a limit is on the rate of something that is differentiated already")
    order = max([*needs, array.reference_order + bool(beyond)])
    wraps = tuple(counts_turns(expression, rate, system) for expression, rate in wanted)
    return Watched(_watching(array, y, ca.vertcat(*values), beyond, order), order, tuple(needs), wraps)


def limited_expressions(
    resolved: ResolvedSystem, expressions: Sequence[tuple[ca.SX, bool]]
) -> tuple[list[ca.SX], ca.SX]:
    """Return expressions of a system, and rates of those marked, by the symbols y of its derivative array, and these.

    y has one column more than the array: the derivatives of one order more are there.
    """
    array, system = resolved.array, resolved.system
    y = ca.horzcat(array.y, ca.SX.sym("next", array.y.size1()))
    n = len(system.coordinates)
    symbols = ca.vertcat(system.q, system.v, system.lam, system.u)
    values = ca.substitute([each for each, _ in expressions], [symbols], [ca.vertcat(y[:n, 0], y[:n, 1], y[n:, 0])])
    marked = zip(values, expressions, strict=True)
    return [time_derivative(each, y, system.gamma) if rate else each for each, (_, rate) in marked], y


@dataclass(frozen=True, eq=False)
class NextDerivatives:
    """A derivative array differentiated once more: the new rows and unknowns.

    Attributes
    ----------
    unknowns : casadi.SX, shape (variables,)
        The derivative of every variable that follows its last in the array.
    rows : casadi.SX, shape (variables,)
        Equations that hold them, linear in them: the last ones of the array, differentiated. Derivatives of others are
        in the array already.
    function : casadi.Function
        (unknowns of the array, gamma, p) -> the new ones.
    """

    unknowns: ca.SX
    rows: ca.SX
    function: ca.Function


def next_derivatives(array: DerivativeArray, y: ca.SX, gamma: ca.SX) -> NextDerivatives:
    """Differentiate a derivative array; `y` are its symbols and those that follow, gamma goes as far as the result."""
    column, p = array.column(array.unknowns), array.system.p
    unknowns = ca.vertcat(*[y[j, k + 1] for j, k in dict(array.unknowns).items()])  # of each the highest comes last
    last = {i: row for row, (i, _) in enumerate(array.rows)}
    rows = time_derivative(array.residual[list(last.values())], y, array.system.gamma)
    linear = [ca.jacobian(rows, unknowns), -ca.substitute(rows, unknowns, ca.SX.zeros(unknowns.shape))]
    matrix = ca.Function("sc_next", [column, gamma, p], linear, {"cse": True})
    given = [ca.MX.sym("given", *each.shape) for each in (column, gamma, p)]
    J, right = matrix(*given)
    return NextDerivatives(unknowns, rows, ca.Function("sc_next", given, [ca.solve(J, right, "qr")]))


def _watching(
    array: DerivativeArray, y: ca.SX, values: ca.SX, beyond: list[tuple[int, int]], order: int
) -> ca.Function:
    """Return the function of `Watched` for expressions of the symbols `y`, of which `beyond` are not in the array."""
    system, column = array.system, array.column(array.unknowns)
    gamma = system.gamma[:, : order + 1]
    further = ca.vertcat(ca.SX(0, 1), *[y[j, k] for j, k in beyond])
    arguments = [column, further, gamma, system.p]
    if foreign := ca.Function("sc_probe", arguments, [values], {"allow_free": True}).get_free():
        raise InvalidModel(f"{system.name}: a limit holds symbols that are none of this model: {foreign}")
    read = ca.Function("sc_read", arguments, [ca.densify(values)], {"cse": True})
    state, G, p = (ca.MX.sym("x", *each.shape) for each in (column, gamma, system.p))
    known = ca.MX(0, 1)
    if beyond:
        known = next_derivatives(array, y, gamma).function(state, G, p)[[j for j, _ in beyond]]
    return ca.Function("sc_watched", [state, G, p], [read(state, known, G, p)])


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
    limits = motion_limits(problem)
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
    """Return a solution of a problem `with_watched` without what was added; raise `LimitBroken` if it breaks limits.

    Rates of forces and inputs are those of their differences from instant to instant.
    """
    hidden = [k for k, channel in enumerate(solution.channels) if channel.name.startswith(HIDDEN)]
    if not hidden:
        return solution
    limits, t = motion_limits(problem), solution.t
    broken = []
    for limit, k in zip(limits, hidden, strict=True):
        values, at = solution.values[:, k], t
        if solution.channels[k].name.endswith("differenced"):
            values, at = np.diff(values) / np.diff(t), t[1:]
        broken += _first_at(limit, at, values)
    if broken:
        first, value, limit = min(broken, key=lambda each: each[0])
        raise LimitBroken(broken_limit(problem.name, limit, first, first, value))
    shown = [k for k in range(len(solution.channels)) if k not in hidden]
    return replace(solution, channels=tuple(solution.channels[k] for k in shown), values=solution.values[:, shown])


def require_reported(problem: Problem, solution: Solution) -> None:
    """Raise `LimitBroken` if a quantity of a solution of a flat problem breaks its limit.

    The exact motion keeps it by then; a step that errs may not.
    """
    for limit in motion_limits(problem):
        name = limit.expression.name if isinstance(limit.expression, Named) else ""
        if not limit.rate and name in solution:
            for first, value, _ in _first_at(limit, solution.t, solution[name]):
                raise LimitBroken(
                    f"{broken_limit(solution.route, limit, first, first, value)}; the exact motion keeps that limit"
                )


# Runs as a whole -----------------------------------------------------------------------------------------------------


def run_values(problem: Problem, states: States, t: Array) -> Array:
    """Return the values of `run_limits` of a flat problem, (limits,), from instants (N,) evenly from start to end."""
    values, found = limited_values(replace(problem, limits=problem.run_limits), states, t), []
    for limit, each in zip(problem.run_limits, values, strict=True):
        assert limit.over_run is not None
        total = np.trapezoid(limit.over_run.integrand(each), t)
        found.append(limit.over_run.of_sum(total, float(t[-1] - t[0])))
    return np.array(found)


def require_run_limits(problem: Problem, solution: Solution) -> None:
    """Raise `LimitBroken` if what a run adds up is beyond a limit at its end."""
    for limit in problem.run_limits:
        value = float(solution[limit.quantity][-1])
        if not margin_within(limit, np.array([value]), size_of_bounds(limit, np.array([value])))[0] >= 0.0:
            end = float(solution.t[-1])
            raise LimitBroken(f"{broken_limit(problem.name, limit, end, end, value)}, over the whole run")


def _first_at(limit: Limit, t: Array, values: Array) -> list[tuple[float, float, Limit]]:
    bad = np.flatnonzero(~(margin_within(limit, values, size_of_bounds(limit, values)) >= 0.0))
    return [(float(t[bad[0]]), float(values[bad[0]]), limit)] if len(bad) else []
