"""Quantities of limits, as expressions of the path's derivatives at an instant, divided by their ranges.

Lengths in them are smoothed: their square roots are differentiable at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import casadi as ca
import numpy as np

from servocore.errors import InvalidReference, LimitBroken
from servocore.model.limits import Limit, Named, reported_quantities
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.expressions import highest_derivative, time_derivative
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import computed, holds_any, rebuilt
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.readings import compile_watched, next_derivatives, with_rates
from servocore.structure.inversion import inversion

_SLIGHT = 1e-3  # of derivatives: where the guess of a motion is no formula, it is off by then


@dataclass(frozen=True, eq=False)
class Inner:
    """A function of the motion at an instant: unknowns of its own, none where a formula gives the motion from the path.

    Attributes
    ----------
    local : casadi.Function
        (jets, unknowns, parameters) -> rows, equations that are zero, and more, see where one is made.
    start : casadi.Function
        (jets, parameters) -> unknowns that solve the equations.
    """

    local: ca.Function
    start: ca.Function

    @property
    def size(self) -> int:
        """How many unknowns there are, and equations."""
        return int(self.start.numel_out(0))

    @cached_property
    def solved(self) -> ca.Function:
        """(jets, parameters) -> the results of `local` at the unknowns that solve its equations."""
        kind: Any = ca.MX if self.size else ca.SX
        jets, *p = (kind.sym(f"x{k}", *self.start.size_in(k)) for k in range(self.start.n_in()))
        results = self.local.call([jets, *self.start.call([jets, *p]), *p])
        return ca.Function("sc_solved", [jets, *p], results, {"cse": True})


@dataclass(frozen=True, eq=False)
class Rows:
    """Limits as rows of numbers between -1 and 1, or below 1 where there is no lower one.

    Attributes
    ----------
    limits : tuple of Limit
        One a row; those of what a run adds up are kept by integrals.
    inner : Inner
        (gamma (m, order + 1), unknowns, p) -> rows, equations, integrands, and the rows as quantities with their units.
    order : int
        Highest derivative of the path in gamma.
    lower : ndarray, shape (rows,)
        -1, or -inf where there is no lower bound.
    moving : tuple of bool
        Whether each may depend on more than the place.
    most : ndarray, shape (integrands,)
        Upper bounds of the integrals of the integrands over the time: limits of what a run adds up, a side each.
    """

    limits: tuple[Limit, ...]
    inner: Inner
    order: int
    lower: Array
    moving: tuple[bool, ...]
    most: Array

    def at(self, jets: Array, p: Array) -> list[Array]:
        """Return rows, integrands, and rows as quantities, at instants: (rows, N) of jets (N, order + 1, m)."""
        rows, _, *others = at_instants(self.inner.solved, jets=jets, p=p)
        return [rows, *others]

    def at_rest(self, places: Array, p: Array) -> list[Array]:
        """Return the same where nothing moves, at places (N, m)."""
        still = np.zeros((len(places), self.order + 1, places.shape[1]))
        still[:, 0] = places
        return self.at(still, p)


def limit_rows(problem: Problem, rest: Array) -> Rows:
    """Return the limits of a problem without internal dynamics as rows.

    Parameters
    ----------
    problem : Problem
        With limits.
    rest : ndarray, shape (m,)
        A place at which it can rest: gives bounds of zero a scale.

    Raises
    ------
    InvalidModel
        If a limit is on the rate of something that is differentiated already.
    """
    return _compile_rows(problem.resolved, problem.limits, tuple(rest.tolist()), tuple(problem.p.tolist()))


def require_at_rest(rows: Rows, problem: Problem, places: Array, room: float = 0.0) -> None:
    """Raise `LimitBroken` if a limit is broken where nothing moves: then no speed keeps it.

    Parameters
    ----------
    rows : Rows
        The limits.
    problem : Problem
        Problems that the rows belong to.
    places : ndarray, shape (n, m)
        Of the way.
    room : float
        Least margin, as a part of half the range.
    """
    scaled, _, values = rows.at_rest(places, problem.p)
    for limit, value, row, low in zip(rows.limits, values, scaled, rows.lower, strict=True):
        bad = np.flatnonzero(~((row < 1.0 - room) & (row > low + room)))
        if not len(bad):
            continue
        place, at_rest = ", ".join(f"{coordinate:.4g}" for coordinate in places[bad[0]]), float(value[bad[0]])
        if not np.isfinite(at_rest):
            raise InvalidReference(f"{problem.name}: no motion is found that rests at ({place})")
        below = at_rest - limit.bound < limit.upper - at_rest
        side, bound = ("lower", limit.bound) if below else ("upper", limit.upper)
        raise LimitBroken(
            f"{problem.name}: no law keeps the limit of {limit.quantity}: even at rest at ({place}) it is"
            f" {limit.with_unit(at_rest)}, and its {side} limit is {limit.with_unit(bound)}"
        )


def _is_explicit(resolved: ResolvedSystem, rest: Array, p: Array) -> bool:
    """Whether an expression gives the motion from the path: near a place of rest, the guess of its model is exact."""
    explicit = inversion(resolved.array).differentiable
    if explicit is None:
        return False
    gamma = np.full((len(rest), resolved.array.reference_order + 1), _SLIGHT)
    gamma[:, 0] = rest
    return bool(np.isfinite(np.asarray(explicit(gamma, p)[0])).all())


_Motion = tuple[ca.SX, ca.SX, Sequence[ca.SX], ca.Function, int]
"""Unknowns of an instant beside the path, equations of them, gamma and p that are zero, quantities of limits, the
function (gamma (m, order + 1), p) -> unknowns, and that order."""


def _lifted(resolved: ResolvedSystem, limits: Sequence[Limit], smooth: Sequence[ca.SX]) -> _Motion:
    """Return the motion as unknowns: the derivative array, differentiated once more where a rate takes that.

    Raises
    ------
    InvalidModel
        If a limit is on the rate of something that is differentiated already.
    """
    array, system = resolved.array, resolved.system
    order = compile_watched(resolved, tuple((limit.expression, limit.rate) for limit in limits)).order
    marked = [(expression, limit.rate) for limit, expression in zip(limits, smooth, strict=True)]
    values, y = with_rates(array, marked)
    column, gamma = array.column(array.unknowns), system.gamma[:, : order + 1]
    entries = ca.jacobian_sparsity(ca.vertcat(*values), ca.vec(y)).get_col()
    G, p = ca.MX.sym("G", *gamma.shape), ca.MX.sym("p", system.p.numel())
    state = inversion(resolved.array).function(G[:, : array.reference_order + 1], p)[0]
    if {(c % y.size1(), c // y.size1()) for c in entries} <= set(array.unknowns):
        return column, array.residual, values, ca.Function("sc_lifted", [G, p], [state]), order
    unknowns, rows, following = next_derivatives(array, y, gamma)
    start = ca.Function("sc_lifted", [G, p], [ca.vertcat(state, following(state, G, p))])
    return ca.vertcat(column, unknowns), ca.vertcat(array.residual, rows), values, start, order


def _explicit(resolved: ResolvedSystem, limits: Sequence[Limit], smooth: Sequence[ca.SX]) -> _Motion:
    """Return quantities of limits as expressions of gamma and p, without unknowns."""
    array, system = resolved.array, resolved.system
    formula = cast("ca.Function", inversion(array).differentiable)
    unknowns = formula(system.gamma[:, : array.reference_order + 1], system.p)[0]
    n, variables = len(system.coordinates), array.y.size1()
    entries = [(j, order) for order in (0, 1) for j in range(n)] + [(j, 0) for j in range(n, variables)]
    motion = ca.vertcat(system.q, system.v, system.lam, system.u)
    values = ca.substitute(list(smooth), [motion], [unknowns[array.places(entries)]])
    rated = zip(values, limits, strict=True)
    values = [time_derivative(value, system.gamma) if limit.rate else value for value, limit in rated]
    order = max(array.reference_order, *(highest_derivative(value, system.gamma) for value in values))
    given, none = [system.gamma[:, : order + 1], system.p], ca.SX(0, 1)
    return none, none, values, ca.Function("sc_no_unknowns", given, [none]), order


@made_once
def _compile_rows(
    resolved: ResolvedSystem, limits: tuple[Limit, ...], rest: tuple[float, ...], p: tuple[float, ...]
) -> Rows:
    system = resolved.system
    tips = [_has_tip(resolved, limit) for limit in limits]
    smooth = [rounded(limit.on(system)) if tip else limit.on(system) for limit, tip in zip(limits, tips, strict=True)]
    by_formula = _is_explicit(resolved, np.array(rest), np.array(p))
    unknowns, equations, values, start, order = (_explicit if by_formula else _lifted)(resolved, limits, smooth)
    order = max(order, *(highest_derivative(value, system.gamma) for value in values))
    sides = [side for limit, value in zip(limits, values, strict=True) for side in _integrals(limit, value)]

    def rows_of(rows: Sequence[ca.SX], lower: Sequence[float]) -> Rows:
        results = [ca.vertcat(ca.SX(0, 1), *each) for each in (rows, [equations], [each for each, _ in sides], values)]
        given = [system.gamma[:, : order + 1], unknowns, system.p]
        function = ca.Function("sc_local_rows", given, [ca.densify(each) for each in results], {"cse": True})
        G, symbols = (ca.MX.sym(name, *each.shape) for name, each in (("gamma", given[0]), ("p", system.p)))
        begun = ca.Function("sc_start", [G, symbols], [start(G[:, : start.size2_in(0)], symbols)])
        moving = tuple(not by_formula or highest_derivative(value, system.gamma) > 0 for value in values)
        most = np.array([bound for _, bound in sides])
        return Rows(limits, Inner(function, begun), order, np.array(lower), moving, most)

    here = rows_of(values, []).at_rest(np.array([rest]), np.array(p))[0][:, 0]
    rows = [_row(*each) for each in zip(limits, values, here.tolist(), tips, strict=True)]
    return rows_of([row for row, _ in rows], [low for _, low in rows])


def _row(limit: Limit, value: ca.SX, here: float, tip: bool) -> tuple[ca.SX, float]:
    """Return a row and its lower bound; a limit of what a run adds up has a row that keeps its bound everywhere."""
    if limit.over_run:
        return ca.SX(0.0), -np.inf
    low, high = limit.bound, limit.upper
    if np.isfinite(low) and np.isfinite(high):
        return (value - (low + high) / 2.0) / ((high - low) / 2.0), -1.0
    bound, sign = (high, 1.0) if np.isfinite(high) else (low, -1.0)
    if tip and not limit.rate and np.isfinite(high):
        # The square has a derivative at the tip. A row "0 <= square" would be active there without a normal.
        return (value / high) ** 2, -np.inf
    scale = abs(bound) or abs(here - bound) or 1.0
    return 1.0 + sign * (value - bound) / scale, -np.inf


def _integrals(limit: Limit, integrand: ca.SX) -> list[tuple[ca.SX, float]]:
    """Return both sides of a limit of what a run adds up: integrands, and upper bounds of their integrals.

    A mean square below its bound is an integral of their difference below zero. Other limits have none.
    """
    found, added = [], limit.over_run
    for side, sign in ((limit.upper, 1.0), (limit.bound, -1.0)):
        if added and np.isfinite(side):
            bound = side * abs(side) if added.rms else side
            scale = sign * (abs(bound) or 1.0)
            found.append(((integrand - bound) / scale, 0.0) if added.rms else (integrand / scale, bound / scale))
    return found


def _has_tip(resolved: ResolvedSystem, limit: Limit) -> bool:
    """Whether a limit is on a quantity that is never negative and has no derivative at zero, such as a length."""
    system = resolved.system
    if not isinstance(limit.expression, Named) or not reported_quantities(system)[limit.expression.name].never_negative:
        return False
    return holds_any(limit.on(system), {ca.OP_SQRT})


_ROUNDED = 1e-5  # a length that counts as none: a cone is rounded off so far from its tip


def rounded(expression: ca.SX) -> ca.SX:
    """Return an expression with every square root rounded off at zero, a little larger than it was."""

    def rule(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
        return ca.sqrt(taken[0] + _ROUNDED**2) if operation == ca.OP_SQRT else computed(operation, taken)

    return rebuilt(expression, rule)
