"""`PlanReport`: duration, limits and solution process of a plan.

Limits are proved for all times and, with robust plans, for all parameters in between; where that is not decided, they
are evaluated by exact inversion at twenty thousand instants and at the corners of the parameters' ranges.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from servocore.certificate.certify import certify
from servocore.checks.before_run import require_feasible
from servocore.checks.motion_limits import limited_values
from servocore.model.limits import Limit
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array, Mask
from servocore.numerics.units import behind
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
    told: str


@dataclass(frozen=True, eq=False)
class KeptLimits:
    """How far a plan keeps its limits.

    Attributes
    ----------
    violation : float
        Largest excess over any limit, divided by half its range; 0 if all are kept.
    worst : str
        The limit that is nearest to its bound, or broken most.
    active : tuple of Active
        Active constraints, and when they are.
    evidence : str
        Whether that is proved, or at how many instants it was evaluated and why.
    """

    violation: float
    worst: str
    active: tuple[Active, ...]
    evidence: str


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
    limits : KeptLimits
        How far the limits are kept, and whether that is proved for all times.
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
    limits: KeptLimits
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
        return self.limits.active

    @property
    def violation(self) -> float:
        """Largest excess over any limit, divided by half its range; 0 if all are kept."""
        return self.limits.violation

    def __str__(self) -> str:
        lines = [
            f"duration        {self.duration:.4g} s",
            f"{f'degree {self.degree}':<16}{_taken(self.degree9)}",
            f"three-phase     {_taken(self.three_phase)}",
            f"limits          {self.limits.evidence}",
            f"grid            {_gained(self.grid_error)}",
            f"solver          {in_words(self.status)}, {self.iterations} iterations, from {self.start}",
        ]
        if self.deviation:
            lines.append(f"curve           followed to {self.deviation:.2g} m")
        if math.isfinite(self.clearance):
            lines.append(f"clearance       {self.clearance:.3g} m")
        lines += [
            f"active          {spell.begin:.3f} s to {spell.end:.3f} s: {spell.quantity} at {spell.told}"
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
_SHOWN = 2001  # instants at which active constraints are looked for where the limits are proved
_MOST_VARIED = 2  # parameters: a proof for the ranges of more takes minutes
_MOMENT = 0.02  # of the duration
_ACTIVE = 0.01  # of the range: so near to its bound a quantity holds the plan back


def kept_limits(
    scene: Scene,
    model: str | None,
    corners: Sequence[Problem],
    factors: Mapping[str, tuple[float, float]],
    proof: bool,
) -> KeptLimits:
    """Prove that a plan keeps its limits, or evaluate them at instants.

    Parameters
    ----------
    scene : Scene
        With its limits, on the planned path.
    model : str or None
        Its model.
    corners : sequence of Problem
        At its own parameters, and at the corners of their ranges.
    factors : mapping of str to (float, float)
        The ranges, as factors of parameters.
    proof : bool
        Whether to prove it.

    Raises
    ------
    InvalidReference
        If the path is out of reach.
    """
    for problem in corners:
        require_feasible(problem)
    values = scene.parameter_values()
    ranges = {
        name: (min(each), max(each))
        for name, ends in factors.items()
        if len(each := {values[name] * factor for factor in ends}) == 2
    }
    proved, evidence = False, f"not proved for more than {_MOST_VARIED} ranges of parameters" if proof else "not proved"
    if proof and len(ranges) <= _MOST_VARIED:
        certificate = certify(scene, parameters=ranges, model=model)
        proved, evidence = certificate.verdict == "proved", certificate.summary
    sampled = [_sampled(problem, _SHOWN if proved else _INSTANTS) for problem in corners]
    violation, worst, _ = max(sampled, key=lambda each: each[0])
    active = tuple(dict.fromkeys(limit for *_, spells in sampled for limit in spells))
    if not proved:
        told = f"violation {max(violation, 0.0):.1e} of half a range at {_INSTANTS} instants"
        return KeptLimits(max(violation, 0.0), worst, active, f"{told}; {evidence}")
    units = {each.name: each.unit for each in corners[0].system.parameters.declared}
    over = "".join(
        f", {name} from {low:.6g} to {high:.6g}{behind(units[name])}" for name, (low, high) in ranges.items()
    )
    return KeptLimits(0.0, worst, active, f"proved to be kept at all times{over}")


def _sampled(problem: Problem, instants: int) -> tuple[float, str, list[Active]]:
    """Return the largest excess over a limit at instants, that limit, and the active constraints."""
    limits, path = problem.motion_limits, problem.reference
    t = np.linspace(path.start_time, path.end_time, instants)
    values = limited_values(prepared_motion(problem), t)
    worst, name, active = -np.inf, "", list[Active]()
    for limit, quantity in zip(limits, values, strict=True):
        for bound, over in sides(limit, quantity):
            excess = float(np.where(np.isnan(over), -np.inf if limit.rate else np.inf, over).max())
            if excess > worst:
                worst, name = excess, limit.quantity
            active += _spells(limit, bound, t, over > -_ACTIVE)
    return worst, name, active


def sides(limit: Limit, values: Array) -> list[tuple[float, Array]]:
    """Return each bound of a limit, and by how much values are beyond it, divided by half the range."""
    low, high = limit.bound, limit.upper
    both = np.isfinite(low) and np.isfinite(high)
    beyond = ((low, low - values), (high, values - high))
    return [
        (bound, over / ((high - low) / 2.0 if both else abs(bound) or 1.0))
        for bound, over in beyond
        if np.isfinite(bound)
    ]


def _spells(limit: Limit, bound: float, t: Array, touched: Mask) -> list[Active]:
    """Return from when to when a constraint is active; short gaps are closed."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], touched.astype(int), [0]])))
    short = np.flatnonzero(edges[2::2] - edges[1:-1:2] < _MOMENT * len(t))
    edges = np.delete(edges, [*(2 * short + 1), *(2 * short + 2)])
    return [
        Active(limit.quantity, bound, limit.unit, float(t[begin]), float(t[end - 1]), limit.with_unit(bound))
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    ]
