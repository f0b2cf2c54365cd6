"""Quantities of limits, as expressions of the path's derivatives at an instant, divided by their ranges.

Lengths in them are smoothed: their square roots are differentiable at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import casadi as ca
import numpy as np

from servocore.checks.motion_limits import compile_watched, limited_expressions, next_derivatives
from servocore.errors import InvalidReference, LimitBroken
from servocore.model.limits import Limit, Named, reported_quantities
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.expressions import highest_derivative, time_derivative
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import computed, holds_any, rebuilt
from servocore.problem import Problem, ResolvedSystem
from servocore.structure.inversion import inversion

_SLIGHT = 1e-3  # of derivatives: where the guess of a motion is no formula, it is off by then


@dataclass(frozen=True, eq=False)
class Rows:
    """Limits as rows of numbers between -1 and 1, or below 1 where there is no lower one.

    Attributes
    ----------
    limits : tuple of Limit
        One a row.
    function, values : casadi.Function
        (gamma (m, order + 1), p) -> rows, and the same as quantities with their units.
    order : int
        Highest derivative of the path in gamma.
    lower : ndarray, shape (rows,)
        -1, or -inf where there is no lower bound.
    moving : tuple of bool
        Whether each may depend on more than the place.
    local : casadi.Function
        (gamma, unknowns, p) -> rows, equations that are zero, integrands of `totals`.
    totals : tuple of Limit
        Those of what the whole law adds up.
    start : casadi.Function
        (gamma, p) -> these unknowns; none where a formula gives the motion from the path.
    """

    limits: tuple[Limit, ...]
    function: ca.Function
    values: ca.Function
    order: int
    lower: Array
    moving: tuple[bool, ...]
    local: ca.Function
    totals: tuple[Limit, ...]
    start: ca.Function

    @property
    def by_formula(self) -> bool:
        """Whether a formula gives the motion from the path."""
        return self.start.numel_out(0) == 0


@dataclass(frozen=True, eq=False)
class _Motion:
    """Quantities of limits, with unknowns of an instant beside the path and their equations: none by a formula.

    Attributes
    ----------
    unknowns, equations : casadi.SX
        Symbols, and as many expressions of them, gamma and p that are zero: the derivative array, and where a limit is
        on the rate of its highest derivative, that array differentiated once more.
    values : tuple of casadi.SX
        Quantities of limits.
    start : casadi.Function
        (gamma (m, order + 1), p) -> unknowns, by Newton's method.
    order : int
        Of the path's derivatives in gamma.
    """

    unknowns: ca.SX
    equations: ca.SX
    values: tuple[ca.SX, ...]
    start: ca.Function
    order: int


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
    limits = problem.limits, problem.run_limits
    return _compile_rows(problem.resolved, *limits, tuple(rest.tolist()), tuple(problem.p.tolist()))


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
    still = np.zeros((len(places), rows.order + 1, places.shape[1]))
    still[:, 0] = places
    (values,) = at_instants(rows.values, jets=still, p=problem.p)
    (scaled,) = at_instants(rows.function, jets=still, p=problem.p)
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
    explicit = inversion(resolved.array).expression
    if explicit is None:
        return False
    gamma = np.full((len(rest), resolved.array.reference_order + 1), _SLIGHT)
    gamma[:, 0] = rest
    return bool(np.isfinite(np.asarray(explicit(gamma, p)[0])).all())


def _lifted(resolved: ResolvedSystem, limits: Sequence[Limit], expressions: Sequence[ca.SX]) -> _Motion:
    """Return the motion of a system as unknowns, with quantities of limits, of which `expressions` are without rates.

    Raises
    ------
    InvalidModel
        If a limit is on the rate of something that is differentiated already.
    """
    array, system = resolved.array, resolved.system
    order = compile_watched(resolved, tuple((limit.expression, limit.rate) for limit in limits)).order
    values, y = limited_expressions(
        resolved, [(expression, limit.rate) for expression, limit in zip(expressions, limits, strict=True)]
    )
    column, gamma = array.column(array.unknowns), system.gamma[:, : order + 1]
    entries = ca.jacobian_sparsity(ca.vertcat(*values), ca.vec(y)).get_col()
    beyond = [
        unknown for unknown in {(c % y.size1(), c // y.size1()) for c in entries} if unknown not in array.unknowns
    ]
    G, p = ca.MX.sym("G", *gamma.shape), ca.MX.sym("p", system.p.numel())
    state = inversion(resolved.array).function(G[:, : array.reference_order + 1], p)[0]
    if not beyond:
        start = ca.Function("sc_lifted", [G, p], [state])
        return _Motion(column, array.residual, tuple(values), start, order)
    following = next_derivatives(array, y, gamma)
    start = ca.Function("sc_lifted", [G, p], [ca.vertcat(state, following.function(state, G, p))])
    equations = ca.vertcat(array.residual, following.rows)
    return _Motion(ca.vertcat(column, following.unknowns), equations, tuple(values), start, order)


def _explicit(resolved: ResolvedSystem, limits: Sequence[Limit], smooth: Sequence[ca.SX]) -> _Motion:
    """Return quantities of limits as expressions of gamma and p, of which `smooth` are without rates."""
    array, gamma = resolved.array, resolved.system.gamma
    values, y = limited_expressions(
        resolved, [(expression, limit.rate) for limit, expression in zip(limits, smooth, strict=True)]
    )
    formula = cast("ca.Function", inversion(array).expression)
    unknowns = formula(gamma[:, : array.reference_order + 1], resolved.system.p)[0]
    known = dict(zip(array.unknowns, ca.vertsplit(unknowns), strict=True))

    def entry(j: int, order: int) -> ca.SX:
        if (j, order) not in known:
            known[j, order] = time_derivative(entry(j, order - 1), gamma)
        return known[j, order]

    rows = y.size1()
    used = sorted({(c % rows, c // rows) for c in ca.jacobian_sparsity(ca.vertcat(*values), ca.vec(y)).get_col()})
    values = ca.substitute(
        values, [ca.vertcat(*[y[j, k] for j, k in used])], [ca.vertcat(*[entry(j, k) for j, k in used])]
    )
    order, nothing = max(array.reference_order, *(highest_derivative(value, gamma) for value in values)), ca.SX(0, 1)
    start = ca.Function("sc_no_unknowns", [gamma[:, : order + 1], resolved.system.p], [nothing])
    return _Motion(nothing, nothing, tuple(values), start, order)


@made_once
def _compile_rows(
    resolved: ResolvedSystem,
    local: tuple[Limit, ...],
    totals: tuple[Limit, ...],
    rest: tuple[float, ...],
    p: tuple[float, ...],
) -> Rows:
    system, gamma, limits = resolved.system, resolved.system.gamma, (*local, *totals)
    tips = [_has_tip(resolved, limit) for limit in limits]
    smooth = [rounded(limit.on(system)) if tip else limit.on(system) for limit, tip in zip(limits, tips, strict=True)]
    by_formula = _is_explicit(resolved, np.array(rest), np.array(p))
    motion = (_explicit if by_formula else _lifted)(resolved, limits, smooth)
    order = max(motion.order, *(highest_derivative(value, gamma) for value in motion.values))
    still = np.zeros((len(rest), order + 1))
    still[:, 0] = rest
    given = [gamma[:, : order + 1], system.p]
    own, integrands = motion.values[: len(local)], motion.values[len(local) :]
    values = _of_path(given, own, motion)
    at_rest = np.asarray(values(still, p)).ravel()
    rows, lower = [], []
    for limit, value, here, tip in zip(local, own, at_rest, tips[: len(local)], strict=True):
        row, low = _row(limit, value, float(here), tip)
        rows.append(row)
        lower.append(low)
    arguments = [given[0], motion.unknowns, given[1]]
    results = [ca.vertcat(ca.SX(0, 1), *rows), motion.equations, ca.vertcat(ca.SX(0, 1), *integrands)]
    rows_here = ca.Function("sc_local_rows", arguments, [ca.densify(each) for each in results], {"cse": True})
    moving = tuple(not by_formula or highest_derivative(value, gamma) > 0 for value in own)
    function, start = _of_path(given, rows, motion), _start(given, motion)
    return Rows(local, function, values, order, np.array(lower), moving, rows_here, totals, start)


def _of_path(given: list[ca.SX], expressions: Sequence[ca.SX], motion: _Motion) -> ca.Function:
    """Compile (gamma, p) -> expressions, of unknowns as well that are searched for."""
    values = [ca.densify(ca.vertcat(ca.SX(0, 1), *expressions))]
    if not motion.unknowns.numel():
        return ca.Function("sc_rows", given, values, {"cse": True})
    gamma, p = (ca.MX.sym(name, *each.shape) for name, each in zip(("gamma", "p"), given, strict=True))
    direct = ca.Function("sc_direct", [given[0], motion.unknowns, given[1]], values, {"cse": True})
    return ca.Function("sc_rows", [gamma, p], [direct(gamma, _start(given, motion)(gamma, p), p)])


def _start(given: list[ca.SX], motion: _Motion) -> ca.Function:
    gamma, p = (ca.MX.sym(name, *each.shape) for name, each in zip(("gamma", "p"), given, strict=True))
    return ca.Function("sc_start", [gamma, p], [motion.start(gamma[:, : motion.order + 1], p)])


def _row(limit: Limit, value: ca.SX, here: float, tip: bool) -> tuple[ca.SX, float]:
    """Return a row and its lower bound."""
    low, high = limit.bound, limit.upper
    if np.isfinite(low) and np.isfinite(high):
        return (value - (low + high) / 2.0) / ((high - low) / 2.0), -1.0
    bound, sign = (high, 1.0) if np.isfinite(high) else (low, -1.0)
    if tip and not limit.rate and np.isfinite(high):
        # The square has a derivative at the tip. A row "0 <= square" would be active there without a normal.
        return (value / high) ** 2, -np.inf
    scale = abs(bound) or abs(here - bound) or 1.0
    return 1.0 + sign * (value - bound) / scale, -np.inf


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
