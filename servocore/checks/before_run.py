"""Warnings before a run: that it cannot succeed, or is less accurate than expected."""

from __future__ import annotations

import warnings

import numpy as np

from servocore.checks.internal_stability import NON_MINIMUM_PHASE, internal_dynamics
from servocore.errors import InvalidReference, ServocoreWarning
from servocore.formulations.base import Formulation
from servocore.methods.base import Method
from servocore.problem import Problem

_CALLER = 6  # the line that called `solve`


def warn_before_run(problem: Problem, formulation: Formulation, method: Method) -> None:
    """Warn of internal dynamics that grow, of a path that is too rough, and of inputs that do not converge.

    Raises
    ------
    InvalidReference
        If the path is so rough that inputs hold impulses.
    """
    require_smooth(problem)
    _warn_of_growth(problem)
    _warn_of_jumps(problem)
    _warn_of_index(problem, formulation, method)


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


def _warn(text: str) -> None:
    warnings.warn(text, ServocoreWarning, stacklevel=_CALLER)


def _warn_of_growth(problem: Problem) -> None:
    """Warn before unstable internal dynamics are integrated forward in time."""
    dynamics, reference = internal_dynamics(problem), problem.reference
    if dynamics.kind == NON_MINIMUM_PHASE:
        _warn(
            f"{problem.name} has unstable internal dynamics (non-minimum phase): forward in time errors grow like"
            f" exp({dynamics.growth:.3g} t), {np.exp(dynamics.growth * reference.duration):.2g}-fold by"
            f" t = {reference.end_time:g} s; the method StableInversion finds the bounded solution"
        )


def _warn_of_jumps(problem: Problem) -> None:
    """Warn if the path is not smooth enough for continuous inputs."""
    order, reference = problem.array.reference_order, problem.reference
    if reference.smoothness < order <= reference.max_order:
        _warn(
            f"the inputs of {problem.name} need the path's derivative of order {order}, but the path is continuous up"
            f" to order {reference.smoothness} only: the inputs jump between t = {reference.start_time:g} s and"
            f" {reference.end_time:g} s, the ends included, wherever that derivative does"
        )


def _warn_of_index(problem: Problem, formulation: Formulation, method: Method) -> None:
    """Warn before a method runs on a form of an index on which its inputs do not converge."""
    dae = problem.dae(formulation)
    order = method.orders(dae.index).forces
    if dae.index > 3 and order < 1:
        _warn(
            f"{dae.name}, {method.name}: the form has index {dae.index}, on which the inputs of {method.name} err like"
            f" the step to the power {order} and no step is small enough; use the form Reduced()"
        )
