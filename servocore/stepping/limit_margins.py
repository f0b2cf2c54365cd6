"""Margins of a scene's limits as one compiled function, and what messages say of them."""

from __future__ import annotations

import casadi as ca

from servocore.model.limits import Limit
from servocore.model.system import MechanicalSystem
from servocore.numerics.expressions import highest_derivative
from servocore.stepping.program import LimitText


def limit_texts(limits: tuple[Limit, ...]) -> tuple[LimitText, ...]:
    """Return what to say of each limit, without its expression."""
    return tuple(LimitText(limit.quantity, limit.unit, limit.reason, limit.bound) for limit in limits)


def limits_order(system: MechanicalSystem, limits: tuple[Limit, ...]) -> int:
    """Highest derivative of the reference that the limits use."""
    margins = [limit.on(system) for limit in limits]
    return highest_derivative(ca.vertcat(ca.SX(0, 1), *margins), system.gamma)


def compile_margins(system: MechanicalSystem, limits: tuple[Limit, ...], order: int) -> ca.Function:
    """Compile (gamma (m, order + 1), p) -> how far each limit is, positive where it is kept."""
    gamma = system.gamma[:, : order + 1]
    margins = [limit.on(system) - limit.bound for limit in limits]
    return ca.Function("sc_margins", [gamma, system.p], [ca.densify(ca.vertcat(ca.SX(0, 1), *margins))])
