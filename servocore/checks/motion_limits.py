"""Limits on what moves: coordinates, velocities, multipliers, inputs, and the rates of all these.

Where a problem is flat, its exact inversion tells every quantity at every instant, so that the limits are kept between
the instants of a grid as well. Elsewhere a run is judged by what it reports.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.checks.instants import survey
from servocore.errors import InvalidModel, InvalidReference, LimitBroken
from servocore.model.limits import Expression, Limit, Named, reported_quantities
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.expressions import highest_derivative, time_derivative
from servocore.problem import Problem, ResolvedSystem, resolve
from servocore.solution import Solution
from servocore.structure.derivative_array import DerivativeArray

States = Callable[[Array], Array]
"""Times (N,) -> unknowns of the derivative array, shape (size, N)."""

_ROUND_OFF = 1e-9  # of the bounds: beyond them by less is on them
_BEND = 0.05  # of its range: a quantity that changes by more between two instants is looked at in between
_SLIGHT = 1e-4  # of the bounds: a range that says nothing
_MOST_INSTANTS = 20_000
_HALVINGS = 50
_SECTIONS, _ROUNDS = 9, 5
HIDDEN = "limit "
"""What the names of observables begin with that only limits need."""


def motion_limits(problem: Problem) -> tuple[Limit, ...]:
    """Return the limits of a problem that the path alone does not tell."""
    return tuple(limit for limit in problem.limits if not limit.of_path)


def counts_turns(expression: Expression, rate: bool, system: MechanicalSystem) -> bool:
    """Whether what a limit compares is an angle that is known up to full turns only."""
    return isinstance(expression, Named) and not rate and reported_quantities(system)[expression.name].wraps


# Flat problems: at all instants --------------------------------------------------------------------------------------


def require_limits(problem: Problem, states: States) -> None:
    """Raise `LimitBroken` if a path leads a flat problem beyond a limit at any time, with the first.

    Parameters
    ----------
    problem : Problem
        Without internal dynamics, with `motion_limits`.
    states : callable
        Its exact inversion at any instants of the path.
    """
    limits, watched = motion_limits(problem), watched_limits(problem)
    _require_derivatives(problem, limits, watched)

    def evaluate(t: Array) -> Array:
        return watched.values(problem, t, states(t))

    _Survey(problem.name, limits, watched.wraps, evaluate).require(survey(problem.reference))


def limited_values(problem: Problem, states: States, t: Array) -> Array:
    """Return what the `motion_limits` of a flat problem compare, (limits, N), at instants (N,); angles without jumps.

    `states` is its exact inversion at any instants of the path.
    """
    watched = watched_limits(problem)
    values = watched.values(problem, t, states(t))
    angles = np.array(watched.wraps, dtype=bool)
    return np.where(angles[:, None], np.unwrap(values, axis=1), values)


@dataclass(frozen=True, eq=False)
class Watched:
    """What limits compare, as one function of an exact inversion.

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
    """Return what the `motion_limits` of a flat problem compare."""
    wanted = tuple((limit.expression, limit.rate) for limit in motion_limits(problem))
    return problem.resolved.once(compile_watched, wanted)


def compile_watched(resolved: ResolvedSystem, wanted: tuple[tuple[Expression, bool], ...]) -> Watched:
    """Compile expressions, and rates of those marked, for an exact inversion; meant for `ResolvedSystem.once`.

    The rate of what stands last in the derivative array follows from the array differentiated once more, which is
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

    y has one column more than the array: what is differentiated once more may stand there.
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
    """A derivative array differentiated once more: what is new in it.

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


@dataclass(frozen=True, eq=False)
class _Survey:
    """Limits along a path, and the values that they compare, shape (limits, N), at any instants."""

    name: str
    limits: tuple[Limit, ...]
    wraps: tuple[bool, ...]
    evaluate: Callable[[Array], Array]
    sizes: tuple[float, ...] = ()

    def require(self, t: Array) -> None:
        """Raise `LimitBroken` for the limit that is broken first; `t` are instants to begin with."""
        t, values = self._dense(t)
        sized = replace(self, sizes=tuple(map(_size, self.limits, values)))
        broken = [(*found, row) for row in range(len(self.limits)) if (found := sized._broken(row, t, values[row]))]
        if broken:
            first, worst, value, row = min(broken)
            raise LimitBroken(_sentence(self.name, self.limits[row], first, worst, value))

    def _dense(self, t: Array) -> tuple[Array, Array]:
        """Return instants between which no quantity changes much, and the values there."""
        values = self._unwrapped(self.evaluate(t))
        while True:
            known = np.where(np.isfinite(values), values, 0.0)
            sizes = np.maximum(np.ptp(known, axis=1), _SLIGHT * np.array(list(map(_size, self.limits, known))))
            steep = np.abs(np.diff(known, axis=1)) > _BEND * sizes[:, None]
            at = np.flatnonzero((steep & (np.diff(t) > 1e-9 * np.ptp(t))).any(axis=0))
            if not len(at) or len(t) + len(at) > _MOST_INSTANTS:
                return t, values
            middle = (t[at] + t[at + 1]) / 2
            values = self._unwrapped(np.insert(values, at + 1, self.evaluate(middle), axis=1))
            t = np.insert(t, at + 1, middle)

    def _unwrapped(self, values: Array) -> Array:
        for row in np.flatnonzero(self.wraps):
            values[row] = np.unwrap(values[row])
        return values

    def _broken(self, row: int, t: Array, values: Array) -> tuple[float, float, float] | None:
        """Return when a limit is broken first, and when it is worst and how the quantity is then; None if never."""
        margins = self._margin(row, values)
        bad = np.flatnonzero(~(margins >= 0.0))
        first = int(bad[0]) if len(bad) else len(t)
        for k in self._valleys(margins[: first + 1]):
            at, margin, value = self._lowest(row, t, values, int(k))
            if not margin >= 0.0:
                before = max(int(k) - 1, 0)
                return self._crossing(row, float(t[before]), at, float(values[before])), at, value
        if not len(bad):
            return None
        spell = bad[: 1 + int(np.argmax(np.diff([*bad, len(t) + 1]) > 1))]
        at, _, value = self._lowest(row, t, values, int(spell[np.nan_to_num(margins[spell], nan=-np.inf).argmin()]))
        if first == 0:
            return float(t[0]), at, value
        return self._crossing(row, float(t[first - 1]), float(t[first]), float(values[first - 1])), at, value

    def _valleys(self, margins: Array) -> npt.NDArray[np.intp]:
        """Return local minima that may come down to zero between instants, to judge by second differences."""
        if len(margins) < 3 or not np.isfinite(margins[:-1]).all():
            return np.zeros(0, dtype=np.intp)
        bend = np.abs(np.diff(margins, 2))
        low = (margins[1:-1] <= margins[:-2]) & (margins[1:-1] <= margins[2:]) & (margins[1:-1] <= bend)
        return np.flatnonzero(low & (margins[1:-1] >= 0.0)) + 1

    def _lowest(self, row: int, t: Array, values: Array, k: int) -> tuple[float, float, float]:
        """Return where a margin is lowest around an instant, that margin and the value."""
        begin, end, found = t[max(k - 1, 0)], t[min(k + 1, len(t) - 1)], (float(t[k]), 0.0, float(values[k]))
        if not np.isfinite(values[k]):
            return found
        for _ in range(_ROUNDS):
            at = np.linspace(begin, end, _SECTIONS)
            tried = self._near(row, at, float(values[k]))
            margins = np.nan_to_num(self._margin(row, tried), nan=np.inf)
            lowest = int(margins.argmin())
            begin, end = at[max(lowest - 1, 0)], at[min(lowest + 1, _SECTIONS - 1)]
            found = float(at[lowest]), float(margins[lowest]), float(tried[lowest])
        return found

    def _crossing(self, row: int, good: float, bad: float, near: float) -> float:
        """Return the first time at which a limit is broken, between one at which it is kept and one at which not."""
        for _ in range(_HALVINGS):
            middle = (good + bad) / 2
            if not good < middle < bad:
                break
            kept = self._margin(row, self._near(row, np.array([middle]), near))[0] >= 0.0
            good, bad = (middle, bad) if kept else (good, middle)
        return bad

    def _margin(self, row: int, values: Array) -> Array:
        return _margin(self.limits[row], values, self.sizes[row])

    def _near(self, row: int, t: Array, near: float) -> Array:
        """Return the values of one row; an angle known up to full turns comes out near the value given."""
        values: Array = self.evaluate(t)[row]
        return values + 2.0 * np.pi * np.round((near - values) / (2.0 * np.pi)) if self.wraps[row] else values


def _margin(limit: Limit, values: Array, size: float) -> Array:
    """Return how far values are within a limit, negative beyond it; what is on it but for round-off is within."""
    margins: Array = np.minimum(values - limit.bound, limit.upper - values) + _ROUND_OFF * size
    if limit.rate:  # of the length of a vector, where that is zero
        margins = np.where(np.isnan(margins), np.inf, margins)
    return margins


def _size(limit: Limit, values: Array) -> float:
    """Return the size of the bounds, where these are zero that of the values."""
    known = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    bounds = max((abs(each) for each in (limit.bound, limit.upper) if np.isfinite(each)), default=0.0)
    return float(bounds or known)


def _sentence(name: str, limit: Limit, first: float, worst: float, value: float) -> str:
    below = value - limit.bound < limit.upper - value
    which, bound = ("lower", limit.bound) if below else ("upper", limit.upper)
    why = f" {limit.reason}:" if limit.reason else ""
    if not np.isfinite(value):
        return f"{name}: at t = {first:.6g} s{why} {limit.quantity} is not finite, and has a limit"
    return (
        f"{name}: at t = {first:.6g} s{why} {limit.quantity} goes beyond its {which} limit of {bound:.6g} {limit.unit};"
        f" it reaches {value:.6g} {limit.unit} at t = {worst:.6g} s"
    )


# Runs: at the instants that they report ------------------------------------------------------------------------------


def with_watched(problem: Problem) -> Problem:
    """Return the problem with what its limits compare among the observables, for runs that report it."""
    limits = motion_limits(problem)
    if not limits:
        return problem
    resolved = problem.resolved.once(_observing, tuple((limit.expression, limit.rate) for limit in limits))
    return replace(problem, resolved=resolved)


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


def judged(problem: Problem, solution: Solution) -> Solution:
    """Return a solution of a problem `with_watched` as its user wants it; raise `LimitBroken` if it breaks limits.

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
        raise LimitBroken(_sentence(problem.name, limit, first, first, value))
    shown = [k for k in range(len(solution.channels)) if k not in hidden]
    return replace(solution, channels=tuple(solution.channels[k] for k in shown), values=solution.values[:, shown])


def require_reported(problem: Problem, solution: Solution) -> None:
    """Raise `LimitBroken` if what a solution of a flat problem reports under a name breaks its limit.

    The exact motion keeps it by then; a step that errs may not.
    """
    for limit in motion_limits(problem):
        name = limit.expression.name if isinstance(limit.expression, Named) else ""
        if not limit.rate and name in solution:
            for first, value, _ in _first_at(limit, solution.t, solution[name]):
                raise LimitBroken(
                    f"{_sentence(solution.route, limit, first, first, value)}; the exact motion keeps that limit"
                )


def _first_at(limit: Limit, t: Array, values: Array) -> list[tuple[float, float, Limit]]:
    bad = np.flatnonzero(~(_margin(limit, values, _size(limit, values)) >= 0.0))
    return [(float(t[bad[0]]), float(values[bad[0]]), limit)] if len(bad) else []
