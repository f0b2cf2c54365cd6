"""What limits compare, as expressions of the path's derivatives at an instant, divided by their ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, LimitBroken
from servocore.model.limits import Limit, Named, reported_quantities
from servocore.numerics.calls import Array, at_instants
from servocore.numerics.expressions import highest_derivative, time_derivative
from servocore.problem import Problem, ResolvedSystem
from servocore.structure.inversion import inversion

_ROUNDED = 1e-5  # a length that counts as none: a cone is rounded off so far from its tip


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
        Whether each depends on more than the place.
    """

    limits: tuple[Limit, ...]
    function: ca.Function
    values: ca.Function
    order: int
    lower: Array
    moving: tuple[bool, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """What each row compares."""
        return tuple(each.quantity for each in self.limits)


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
        If its inversion is no expression of the path.
    """
    return problem.resolved.once(_compile_rows, problem.limits, tuple(rest.tolist()), tuple(problem.p.tolist()))


def require_at_rest(rows: Rows, problem: Problem, places: Array, room: float = 0.0) -> None:
    """Raise `LimitBroken` if a limit is broken where nothing moves: then no speed keeps it.

    Parameters
    ----------
    rows : Rows
        The limits.
    problem : Problem
        Whose they are.
    places : ndarray, shape (n, m)
        Of the way.
    room : float
        What must be left, as a part of half the range.
    """
    still = np.zeros((len(places), rows.order + 1, places.shape[1]))
    still[:, 0] = places
    (values,) = at_instants(rows.values, jets=still, p=problem.p)
    (scaled,) = at_instants(rows.function, jets=still, p=problem.p)
    for limit, value, row, low in zip(rows.limits, values, scaled, rows.lower, strict=True):
        bad = np.flatnonzero(~((row < 1.0 - room) & (row > low + room)))
        if not len(bad):
            continue
        found = float(value[bad[0]])
        below = found - limit.bound < limit.upper - found
        side, bound = ("lower", limit.bound) if below else ("upper", limit.upper)
        place = ", ".join(f"{each:.4g}" for each in places[bad[0]])
        raise LimitBroken(
            f"{problem.name}: no law keeps the limit of {limit.quantity}: even at rest at ({place}) it is {found:.6g}"
            f" {limit.unit}, and its {side} limit is {bound:.6g} {limit.unit}"
        )


def quantities(resolved: ResolvedSystem, limits: Sequence[Limit]) -> tuple[list[ca.SX], ca.SX]:
    """Return what limits compare as expressions of the symbols (gamma, p) of a system, and gamma's columns.

    Raises
    ------
    InvalidModel
        If the exact inversion is no expression.
    """
    array, system = resolved.array, resolved.system
    explicit = resolved.once(inversion).expression
    if explicit is None:
        raise InvalidModel(
            f"{system.name}: no formula gives its motion from the path, and planning needs one; another model of the"
            f" same scene may have it"
        )
    gamma, n = system.gamma, len(system.coordinates)
    known = dict(
        zip(array.unknowns, ca.vertsplit(explicit(gamma[:, : array.reference_order + 1], system.p)[0]), strict=True)
    )

    def entry(j: int, order: int) -> ca.SX:
        if (j, order) not in known:
            known[j, order] = time_derivative(entry(j, order - 1), gamma)
        return known[j, order]

    forces = system.lam.numel() + system.u.numel()
    symbols = ca.vertcat(system.q, system.v, system.lam, system.u)
    values = ca.vertcat(
        *[entry(j, 0) for j in range(n)], *[entry(j, 1) for j in range(n)], *[entry(n + j, 0) for j in range(forces)]
    )
    found = []
    for each in limits:
        smooth = each.on(system) if not _has_tip(resolved, each) else rounded(each.on(system))
        value = ca.substitute(smooth, symbols, values)
        found.append(time_derivative(value, gamma) if each.rate else value)
    return found, gamma


def _compile_rows(
    resolved: ResolvedSystem, limits: tuple[Limit, ...], rest: tuple[float, ...], p: tuple[float, ...]
) -> Rows:
    system = resolved.system
    found, gamma = quantities(resolved, limits)
    order = max(resolved.array.reference_order, *(highest_derivative(each, gamma) for each in found))
    still = np.zeros((len(rest), order + 1))
    still[:, 0] = rest
    given = [gamma[:, : order + 1], system.p]
    values = ca.Function("sc_values", given, [ca.densify(ca.vertcat(*found))], {"cse": True})
    at_rest = np.asarray(values(still, p)).ravel()
    rows, lower = [], []
    for limit, value, here in zip(limits, found, at_rest, strict=True):
        row, low = _row(limit, value, float(here), _has_tip(resolved, limit))
        rows.append(row)
        lower.append(low)
    function = ca.Function("sc_rows", given, [ca.densify(ca.vertcat(*rows))], {"cse": True})
    moving = tuple(highest_derivative(each, gamma) > 0 for each in found)
    return Rows(limits, function, values, order, np.array(lower), moving)


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
    """Whether a limit compares what is never negative and has no derivative where it is zero, as a length has."""
    system = resolved.system
    if not isinstance(limit.expression, Named) or not reported_quantities(system)[limit.expression.name].never_negative:
        return False
    expression = limit.on(system)
    function = ca.Function("sc_tip", ca.symvar(expression), [expression])
    return any(function.instruction_id(k) == ca.OP_SQRT for k in range(function.n_instructions()))


def rounded(expression: ca.SX) -> ca.SX:
    """Return an expression with every square root rounded off at zero, a little larger than it was."""
    symbols = ca.symvar(expression)
    function = ca.Function("sc_rounded", symbols, [expression])
    work: dict[int, ca.SX] = {}
    result = ca.SX(0)
    for k in range(function.n_instructions()):
        operation, into = function.instruction_id(k), function.instruction_output(k)
        given = function.instruction_input(k)
        if operation == ca.OP_INPUT:
            work[into[0]] = symbols[given[0]][given[1]]
        elif operation == ca.OP_CONST:
            work[into[0]] = ca.SX(function.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            result = work[given[0]]
        elif operation == ca.OP_SQRT:
            work[into[0]] = ca.sqrt(work[given[0]] + _ROUNDED**2)
        elif len(given) == 1:
            work[into[0]] = ca.SX.unary(operation, work[given[0]])
        else:
            work[into[0]] = ca.SX.binary(operation, work[given[0]], work[given[1]])
    return result
