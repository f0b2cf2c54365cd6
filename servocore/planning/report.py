"""`PlanReport`: duration, certificate and solution process of a plan.

The certificate evaluates the limits by exact inversion at twenty thousand instants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from servocore.checks.before_run import require_feasible
from servocore.checks.motion_limits import limited_values
from servocore.model.limits import Limit
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solvers.exact_inversion import prepared_motion


@dataclass(frozen=True)
class Active:
    """A limit that a plan touches: which, its bound, and from when to when."""

    quantity: str
    bound: float
    unit: str
    begin: float
    end: float
    told: str = ""


@dataclass(frozen=True)
class Certificate:
    """Limits of a plan at many instants.

    Attributes
    ----------
    violation : float
        Largest excess over any limit, divided by half its range; 0 if all are kept.
    worst : str
        The limit that is nearest to its bound, or broken most.
    instants : int
        Number of instants.
    active : tuple of Active
        Active constraints, and when they are.
    """

    violation: float
    worst: str
    instants: int
    active: tuple[Active, ...]


@dataclass(frozen=True)
class PlanReport:
    """How good a plan is, and how it is known.

    Attributes
    ----------
    duration : float
        In s.
    degree9, three_phase : float
        Shortest durations of the polynomial law that is as smooth as the plan (degree 9 for most) and of the best
        three-phase law along the same way within the same limits, in s; infinite where a law cannot keep them, NaN
        where it is not smooth enough or was not requested.
    degree : int
        Of that polynomial law.
    certificate : Certificate
        Limits at twenty thousand instants by exact inversion.
    grid_error : float
        By how much the duration fell when the grid was made twice as fine, in s; the gain of another doubling is
        about half of that. NaN where half as many intervals were too few.
    status : str
        The solver's own word.
    iterations, rounds : int
        Of the solver in all, and how often it was called again with bounds narrowed where something went beyond them
        between two points of the grid.
    start : str
        The law that the solver started from.
    deviation : float
        How far the path is from the curve of the reference that was given, in m.
    clearance : float
        Of a plan with a free path: least distance from its obstacles, in m; infinite where there are none.
    """

    duration: float
    degree9: float
    three_phase: float
    degree: int
    certificate: Certificate
    grid_error: float
    status: str
    iterations: int
    rounds: int
    start: str
    deviation: float = 0.0
    clearance: float = math.inf

    @property
    def active(self) -> tuple[Active, ...]:
        """Active constraints, and when they are."""
        return self.certificate.active

    @property
    def violation(self) -> float:
        """Largest excess over any limit, divided by half its range; 0 if all are kept."""
        return self.certificate.violation

    def __str__(self) -> str:
        lines = [
            f"duration        {self.duration:.4g} s",
            f"{f'degree {self.degree}':<16}{_taken(self.degree9)}",
            f"three-phase     {_taken(self.three_phase)}",
            f"violation       {self.violation:.1e} of half a range at {self.certificate.instants} instants",
            f"grid            {_gained(self.grid_error)}",
            f"solver          {in_words(self.status)}, {self.iterations} iterations, from {self.start}",
        ]
        if self.deviation:
            lines.append(f"curve           followed to {self.deviation:.2g} m")
        if math.isfinite(self.clearance):
            lines.append(f"clearance       {self.clearance:.3g} m")
        lines += [
            f"active          {spell.begin:.3f} s to {spell.end:.3f} s: {spell.quantity} at"
            f" {spell.told or f'{spell.bound:g} {spell.unit}'}"
            for spell in self.active
        ]
        return "\n".join(lines)


_WORDS = {
    "Solve_Succeeded": "solved",
    "Infeasible_Problem_Detected": "no law that keeps all limits near the start",
    "Maximum_Iterations_Exceeded": "not settled in as many iterations as are allowed",
    "Restoration_Failed": "stuck where no small change keeps the limits better",
}


def in_words(status: str) -> str:
    """Return the meaning of a status of the solver."""
    return _WORDS.get(status, "not settled" if "_" in status else status)


def _taken(duration: float) -> str:
    """Return the duration of a law for comparison, in words where it is no number."""
    if math.isnan(duration):
        return "not as smooth as the plan"
    return f"{duration:.4g} s" if math.isfinite(duration) else "does not keep the limits"


def _gained(grid_error: float) -> str:
    many = "half as many intervals"
    return f"{many} were too few" if math.isnan(grid_error) else f"{grid_error:.2g} s longer on {many}"


_INSTANTS = 20_001
_MOMENT = 0.02  # of the duration
_ACTIVE = 0.01  # of the range: so near to its bound a quantity holds the plan back


def certify(problems: tuple[Problem, ...]) -> Certificate:
    """Evaluate limits of problems that differ in their parameters; raises `InvalidReference` if it is out of reach."""
    certificates = [_certify(problem) for problem in problems]
    worst = max(certificates, key=lambda each: each.violation)
    active = tuple(dict.fromkeys(limit for one in certificates for limit in one.active))
    return Certificate(worst.violation, worst.worst, _INSTANTS, active)


def _certify(problem: Problem) -> Certificate:
    require_feasible(problem)
    limits, path = problem.motion_limits, problem.reference
    t = np.linspace(path.start_time, path.end_time, _INSTANTS)
    values = limited_values(prepared_motion(problem), t)
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
    """Return from when to when a constraint is active; short gaps are closed."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], touched.astype(int), [0]])))
    short = np.flatnonzero(edges[2::2] - edges[1:-1:2] < _MOMENT * len(t))
    edges = np.delete(edges, [*(2 * short + 1), *(2 * short + 2)])
    return [
        Active(limit.quantity, bound, limit.unit, float(t[begin]), float(t[end - 1]), limit.with_unit(bound))
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    ]
