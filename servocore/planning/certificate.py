"""The certificate of a plan: its limits checked by exact inversion at twenty thousand instants."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from servocore.checks.limits import require_feasible
from servocore.checks.motion_limits import limited_values, motion_limits
from servocore.model.limits import Limit
from servocore.numerics.compiled_calls import Array
from servocore.planning.report import Active, Certificate
from servocore.problem import Problem
from servocore.solvers.branch_continuation import exact_states, prepared_table

_INSTANTS = 20_001
_MOMENT = 0.02  # of the duration
_ACTIVE = 0.01  # of the range: so near to its bound a quantity holds the plan back


def certify(problems: tuple[Problem, ...]) -> Certificate:
    """Look at the path of problems that differ in their parameters; raises `InvalidReference` if it is out of reach."""
    certificates = [_certify(problem) for problem in problems]
    worst = max(certificates, key=lambda each: each.violation)
    active = tuple(dict.fromkeys(limit for one in certificates for limit in one.active))
    return Certificate(worst.violation, worst.worst, _INSTANTS, active)


def _certify(problem: Problem) -> Certificate:
    require_feasible(problem)
    limits, path = motion_limits(problem), problem.reference
    t = np.linspace(path.start_time, path.end_time, _INSTANTS)
    values = limited_values(problem, exact_states(problem, prepared_table(problem)), t)
    worst, name, active = -np.inf, "", list[Active]()
    for limit, quantity in zip(limits, values, strict=True):
        for bound, over in sides(limit, quantity):
            excess = float(
                np.max(np.where(np.isnan(over) & limit.rate, -np.inf, np.where(np.isnan(over), np.inf, over)))
            )
            if excess > worst:
                worst, name = excess, limit.quantity
            active += _spells(limit, bound, t, over > -_ACTIVE)
    return Certificate(max(worst, 0.0), name, _INSTANTS, tuple(active))


def sides(limit: Limit, values: Array) -> list[tuple[float, Array]]:
    """Return each bound of a limit, and by how much values are beyond it, divided by half the range."""
    low, high = limit.bound, limit.upper
    both = np.isfinite(low) and np.isfinite(high)
    violations = []
    for bound, over in ((low, low - values), (high, values - high)):
        if np.isfinite(bound):
            violations.append((bound, over / ((high - low) / 2.0 if both else abs(bound) or 1.0)))
    return violations


def _spells(limit: Limit, bound: float, t: Array, touched: npt.NDArray[np.bool_]) -> list[Active]:
    """Return from when to when a limit is touched; what is left for a moment only counts as one spell."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], touched.astype(int), [0]])))
    short = np.flatnonzero(edges[2::2] - edges[1:-1:2] < _MOMENT * len(t))
    edges = np.delete(edges, [*(2 * short + 1), *(2 * short + 2)])
    return [
        Active(limit.quantity, bound, limit.unit, float(t[begin]), float(t[end - 1]), limit.told(bound))
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    ]
