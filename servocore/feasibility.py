"""Whether a reference keeps the limits of its scene at all times, also between the instants of a grid."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.calls import Call
from servocore.program import LimitText, require_margins
from servocore.references import Reference
from servocore.scene import Limit
from servocore.symbols import Array
from servocore.system import MechanicalSystem

_SURVEY_POINTS = 2001
_REFINED_POINTS = 41
_REFINEMENTS = 3


def limit_texts(limits: tuple[Limit, ...]) -> tuple[LimitText, ...]:
    """Return what to say of each limit, without its expression."""
    return tuple(LimitText(each.quantity, each.unit, each.reason, each.bound) for each in limits)


def compile_margins(system: MechanicalSystem, limits: tuple[Limit, ...], order: int) -> ca.Function:
    """Compile (gamma (m, order + 1), p) -> how far each limit is, positive where it is kept."""
    gamma = system.gamma[:, : order + 1]
    margins = [each.expression(gamma, system.parameters) - each.bound for each in limits]
    return ca.Function("sc_margins", [gamma, system.p], [ca.densify(ca.vertcat(ca.SX(0, 1), *margins))])


def require_feasible(
    reference: Reference, system: MechanicalSystem, limits: tuple[Limit, ...], p: Array, t: Array | None = None
) -> None:
    """Raise `InvalidReference` if the path breaks a limit anywhere, or at the instants `t` one that counts there only.

    The margins are surveyed on a fine grid; around the smallest of each the grid is refined.
    """
    _require_at(reference, system, tuple(each for each in limits if each.at_instants_only), p, t)
    limits = tuple(each for each in limits if not each.at_instants_only)
    if not limits:
        return
    texts = limit_texts(limits)
    survey = np.linspace(reference.start_time, reference.end_time, _SURVEY_POINTS)
    surveyed = _margins(reference, system, limits, p, survey)
    for k, text in enumerate(texts):
        broken = ~(surveyed[k] > 0.0)
        if broken.any():
            first = int(broken.argmax())
            require_margins((text,), surveyed[k, [first]], float(survey[first]))
        t, lowest = survey, int(surveyed[k].argmin())
        for _ in range(_REFINEMENTS):
            t = np.linspace(t[max(0, lowest - 1)], t[min(len(t) - 1, lowest + 1)], _REFINED_POINTS)
            margin = _margins(reference, system, limits, p, t)[k]
            lowest = int(np.nan_to_num(margin, nan=-np.inf).argmin())
            require_margins((text,), margin[[lowest]], float(t[lowest]))


def _require_at(
    reference: Reference, system: MechanicalSystem, limits: tuple[Limit, ...], p: Array, t: Array | None
) -> None:
    if not limits or t is None:
        return
    for text, margin in zip(limit_texts(limits), _margins(reference, system, limits, p, t), strict=True):
        lowest = int(np.nan_to_num(margin, nan=-np.inf).argmin())
        require_margins((text,), margin[[lowest]], float(t[lowest]))


def _margins(reference: Reference, system: MechanicalSystem, limits: tuple[Limit, ...], p: Array, t: Array) -> Array:
    jets = reference.jet(t, limits_order(system, limits))
    (margins,) = _mapped_margins(system, limits, len(t))(side_by_side(jets), np.tile(p[:, None], len(t)))
    return margins.reshape(len(limits), len(t))


@lru_cache(maxsize=64)
def _mapped_margins(system: MechanicalSystem, limits: tuple[Limit, ...], count: int) -> Call:
    return Call(compile_margins(system, limits, limits_order(system, limits)).map(count))


@lru_cache(maxsize=64)
def limits_order(system: MechanicalSystem, limits: tuple[Limit, ...]) -> int:
    """Highest derivative of the reference that the limits use."""
    margins = [each.expression(system.gamma, system.parameters) for each in limits]
    columns = ca.jacobian_sparsity(ca.vertcat(ca.SX(0, 1), *margins), ca.vec(system.gamma)).get_col()
    return max((column // system.gamma.size1() for column in columns), default=0)


def side_by_side(jets: Array) -> Array:
    """Lay reference jets (N, orders, m) side by side as CasADi maps them: (m, N * orders)."""
    return jets.reshape(-1, jets.shape[2]).T
