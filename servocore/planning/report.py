"""`PlanReport`: duration, certificate and solution process of a plan."""

from __future__ import annotations

import math
from dataclasses import dataclass


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
    """What a look at many instants of a plan found.

    Attributes
    ----------
    violation : float
        Largest excess over any limit, divided by half its range; 0 if all are kept.
    worst : str
        The limit that is nearest to its bound, or broken most.
    instants : int
        How many were looked at.
    active : tuple of Active
        What holds the plan back, and when.
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
        where it is not smooth enough or was not asked for.
    degree : int
        Of that polynomial law.
    certificate : Certificate
        A look at twenty thousand instants by the exact inversion.
    grid_error : float
        By how much the duration fell when the grid was made twice as fine, in s; what another doubling would gain is
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
        Of a plan that chose its way: least distance from what it keeps out of, in m; infinite where there is nothing.
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
        """What holds the plan back, and when."""
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
    """Return what a status of the solver means."""
    return _WORDS.get(status, "not settled" if "_" in status else status)


def _taken(duration: float) -> str:
    """Return what a law to compare with takes, in words where it is no number."""
    if math.isnan(duration):
        return "not as smooth as the plan"
    return f"{duration:.4g} s" if math.isfinite(duration) else "does not keep the limits"


def _gained(grid_error: float) -> str:
    many = "half as many intervals"
    return f"{many} were too few" if math.isnan(grid_error) else f"{grid_error:.2g} s longer on {many}"
