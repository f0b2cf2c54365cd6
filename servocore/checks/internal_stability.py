"""Whether internal dynamics remain, and whether they are stable: the class of a problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem

FLAT = "flat"
MINIMUM_PHASE = "minimum phase"
WEAKLY_MINIMUM_PHASE = "weakly minimum phase"
NON_MINIMUM_PHASE = "non-minimum phase"
SINGULAR = "singular here"

ADVICE = {
    FLAT: "Reduced: the inputs follow from the reference and its derivatives at every instant, to round-off",
    MINIMUM_PHASE: "Reduced with a method that integrates the internal dynamics forward in time",
    WEAKLY_MINIMUM_PHASE: "Reduced with a method that integrates the internal dynamics, which are not damped",
    NON_MINIMUM_PHASE: "StableInversion: forward in time the unstable internal dynamics let errors grow exponentially",
    SINGULAR: "another path, other parameters or another model",
}
"""The recommended method, by the kind of internal dynamics."""


@dataclass(frozen=True)
class InternalDynamics:
    """The internal dynamics of a problem, linearized at rest.

    Attributes
    ----------
    kind : str
        As `StructureReport.classification`.
    eigenvalues : tuple of complex
        In 1/s, the fastest growing first.
    """

    kind: str
    eigenvalues: tuple[complex, ...]

    @property
    def growth(self) -> float:
        """Fastest rate of growth in 1/s."""
        return max((value.real for value in self.eigenvalues), default=0.0)


def internal_dynamics(problem: Problem) -> InternalDynamics:
    """Linearize the internal dynamics of a problem at rest; unlike `analyse` without a look along the reference."""
    if problem.flat:
        return InternalDynamics(FLAT, ())
    return _linearized(problem.resolved, tuple(problem.p.tolist()))


@made_once
def _linearized(resolved: ResolvedSystem, p: tuple[float, ...]) -> InternalDynamics:
    # Imported where there are any: a flat problem has no internal dynamics.
    from servocore.structure.zero_dynamics import DAMPED, internal_equilibrium, linearization  # noqa: PLC0415

    linear = linearization(resolved.array)
    eigenvalues = internal_equilibrium(linear, np.array(p), np.array(resolved.system.home)).eigenvalues
    return InternalDynamics(_classified(eigenvalues, DAMPED), eigenvalues)


def _classified(eigenvalues: tuple[complex, ...], damped: float) -> str:
    if not eigenvalues:
        return FLAT
    if not np.isfinite(eigenvalues).all():
        return SINGULAR
    growth = max(value.real - damped * abs(value) for value in eigenvalues)
    decay = max(value.real + damped * abs(value) for value in eigenvalues)
    if growth > 0.0:
        return NON_MINIMUM_PHASE
    return MINIMUM_PHASE if decay < 0.0 else WEAKLY_MINIMUM_PHASE
