"""Before a run: the class of a problem by its internal dynamics, limits of its path, and warnings that it may fail."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import partial

import numpy as np

from servocore.checks.findings import least_between
from servocore.errors import InvalidReference, ServocoreWarning
from servocore.formulations.base import Formulation
from servocore.methods.base import Method
from servocore.model.limits import Limit
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import survey
from servocore.stepping.exact_evaluation import PathFunction
from servocore.stepping.observation import compile_margins, limits_order

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

    @property
    def grows(self) -> bool:
        """Whether errors grow forward in time."""
        return self.kind == NON_MINIMUM_PHASE


def internal_dynamics(problem: Problem) -> InternalDynamics:
    """Linearize the internal dynamics of a problem at rest; unlike `analyse` without a look along the reference."""
    if problem.flat:
        return InternalDynamics(FLAT, ())
    return _linearized(problem.resolved, tuple(problem.p.tolist()))


@made_once
def _linearized(resolved: ResolvedSystem, p: tuple[float, ...]) -> InternalDynamics:
    # Imported where there are any: a flat problem has no internal dynamics.
    from servocore.structure.zero_dynamics import DAMPED, internal_equilibrium  # noqa: PLC0415

    eigenvalues = internal_equilibrium(resolved.array, np.array(p), np.array(resolved.system.home)).eigenvalues
    if not np.isfinite(eigenvalues).all():
        return InternalDynamics(SINGULAR, eigenvalues)
    growth = max(value.real - DAMPED * abs(value) for value in eigenvalues)
    decay = max(value.real + DAMPED * abs(value) for value in eigenvalues)
    kind = NON_MINIMUM_PHASE if growth > 0.0 else MINIMUM_PHASE if decay < 0.0 else WEAKLY_MINIMUM_PHASE
    return InternalDynamics(kind, eigenvalues)


_CALLER = 4  # the line that called `solve`
_FEWER = 8  # of the survey's instants one is enough where all margins are large


def warn_before_run(problem: Problem, formulation: Formulation, method: Method | None) -> None:
    """Warn of internal dynamics that grow, of a path that is too rough, and of inputs that do not converge."""
    dynamics, reference, doubts = internal_dynamics(problem), problem.reference, list[str]()
    if dynamics.grows:
        doubts.append(
            f"{problem.name} has unstable internal dynamics (non-minimum phase): forward in time errors grow like"
            f" exp({dynamics.growth:.3g} t), {np.exp(dynamics.growth * reference.duration):.2g}-fold by"
            f" t = {reference.end_time:g} s; the method StableInversion finds the bounded solution"
        )
    order = problem.array.reference_order
    if reference.smoothness < order <= reference.max_order:
        doubts.append(
            f"the inputs of {problem.name} need the path's derivative of order {order}, but the path is continuous up"
            f" to order {reference.smoothness} only: the inputs jump between t = {reference.start_time:g} s and"
            f" {reference.end_time:g} s, the ends included, wherever that derivative does"
        )
    dae = problem.dae(formulation)
    if method is not None and dae.index > 3 and (order := method.orders(dae.index).forces) < 1:
        doubts.append(
            f"{dae.name}, {method.name}: the form has index {dae.index}, on which the inputs of {method.name} err like"
            f" the step to the power {order} and no step is small enough; use the form Reduced()"
        )
    for text in doubts:
        warnings.warn(text, ServocoreWarning, stacklevel=_CALLER)


def require_smooth(problem: Problem) -> None:
    """Raise `InvalidReference` if a path is so rough that velocities jump with its derivatives: inputs are impulses.

    Where only the inputs jump, a warning is enough.
    """
    order, reference = problem.array.reference_order, problem.reference
    if reference.smoothness < order - 1 <= reference.max_order:
        raise InvalidReference(
            f"{problem.system.name} has index {problem.signature.index}: its velocities need the path's derivative of"
            f" order {order - 1}, but the path is continuous up to order {reference.smoothness} only: it would have to"
            f" be hit where that jumps; a law such as the polynomial of degree {2 * order + 1} is smooth enough"
        )


# Limits of the path --------------------------------------------------------------------------------------------------


def require_feasible(problem: Problem, t: Array | None = None) -> None:
    """Raise `InvalidReference` if the path breaks a limit, or at the instants `t` one that counts there only.

    Such limits are functions of the path alone: they are evaluated on a grid that follows the stretches of the path,
    and between its instants where a margin is so low that it may fall to zero there.
    """
    if t is not None and (at_instants := tuple(each for each in problem.path_limits if each.at_instants_only)):
        _require_kept(at_instants, _margins(problem, at_instants, t), t)
    limits = tuple(each for each in problem.path_limits if not each.at_instants_only)
    if not limits:
        return
    every = survey(problem.reference)
    for grid in (np.append(every[:-1:_FEWER], every[-1]), every):
        margins = _margins(problem, limits, grid)
        bends = np.abs(np.diff(margins, 2, axis=1)).max(axis=1, initial=0.0)
        low = ~(margins.min(axis=1) > bends)  # a smooth margin falls by an eighth of that between instants
        if not low.any():
            return
    _require_kept(limits, margins, every)  # of all instants, so that a refusal names the first
    for row in np.flatnonzero(low).tolist():
        one = limits[row : row + 1]
        margin = partial(_margins, problem, one)
        at = np.array([least_between(margin, every, int(margins[row].argmin()))])
        _require_kept(one, margin(at), at)


def _require_kept(limits: tuple[Limit, ...], margins: Array, t: Array) -> None:
    """Raise `InvalidReference` for a margin that is not positive, or no number."""
    for limit, margin in zip(limits, margins, strict=True):
        broken = ~(margin > 0.0)
        if broken.any():
            k = int(broken.argmax())
            raise InvalidReference(
                f"at t = {t[k]:.6g} s {limit.reason}: {limit.quantity} is {margin[k] + limit.bound:.4g} {limit.unit},"
                f" it must stay above {limit.bound:g} {limit.unit}"
            )


def _margins(problem: Problem, limits: tuple[Limit, ...], t: Array) -> Array:
    """Return how far each limit is at the instants, shape (limits, N)."""
    return _compiled_margins(problem.resolved, limits)(problem, t)[0]


@made_once
def _compiled_margins(resolved: ResolvedSystem, limits: tuple[Limit, ...]) -> PathFunction:
    order = limits_order(resolved.system, limits)
    return PathFunction(compile_margins(resolved.system, limits, order), False, resolved.system.name)
