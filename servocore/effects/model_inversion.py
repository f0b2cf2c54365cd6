"""Inputs and positions of a model's drives along a path, by inversion of the model."""

from __future__ import annotations

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.effects.drives import measured_in
from servocore.errors import IntegrationFailed
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.exact_evaluation import ExactEvaluation, exact_evaluation, reading

_CHUNK = 250  # instants in one call: one length of compiled maps serves all paths


@dataclass(frozen=True, eq=False)
class Inverted:
    """Inputs and positions of drives that make a model follow a path, at instants evenly apart.

    Attributes
    ----------
    t : ndarray, shape (N,)
        From the start of the path to its end.
    inputs, positions, rates : ndarray, shape (N, m)
        Positions count from the start, where encoders are zeroed.
    start, end : ndarray, shape (2 n,) and (n,)
        State at the start, and configuration at the end.
    microseconds : float
        Processor time an instant, where it took least.
    """

    t: Array
    inputs: Array
    positions: Array
    rates: Array
    start: Array
    end: Array
    microseconds: float


def inverted(problem: Problem, measured: tuple[str, ...], count: int) -> Inverted:
    """Invert a model without internal dynamics along its path, instant by instant.

    Parameters
    ----------
    problem : Problem
        The model, with the path.
    measured : tuple of str
        What the drives measure, by name.
    count : int
        Instants.

    Raises
    ------
    IntegrationFailed
        If an instant is not solved, or a length is negative.
    """
    evaluation, wraps = _drive_signals(problem.resolved, measured)
    t = np.linspace(problem.reference.start_time, problem.reference.end_time, count)
    padded = np.concatenate([t, np.full(-count % _CHUNK, t[-1])])
    parts, seconds = [], np.inf
    for k in range(0, len(padded), _CHUNK):
        began = time.process_time()
        parts.append(evaluation(problem, padded[k : k + _CHUNK])[0])
        seconds = min(seconds, time.process_time() - began)
    rows = np.hstack(parts)[:, :count].T
    unsolved = ~np.isfinite(rows).all(axis=1)
    if unsolved.any():
        raise IntegrationFailed(
            f"{problem.system.name}: the equations were not solved at t = {t[int(unsolved.argmax())]:.6g} s"
        )
    m, n = len(problem.system.inputs), len(problem.system.coordinates)
    inputs, y, rates, q, v, signs = np.split(rows, np.cumsum([m, m, m, n, n]), axis=1)
    _require_signs(problem, t, signs)
    y[:, wraps] = np.unwrap(y[:, wraps], axis=0)
    return Inverted(t, inputs, y - y[0], rates, np.concatenate([q[0], v[0]]), q[-1], 1e6 * seconds / _CHUNK)


def _positive(system: MechanicalSystem) -> list[tuple[Quantity, ca.SX]]:
    """Return what must be positive, of all that configurations alone tell."""
    known = [*zip(system.coordinates.quantities, ca.vertsplit(system.q), strict=True), *system.observables.items()]
    others = ca.vertcat(system.v, system.lam, system.u, ca.vec(system.gamma))
    return [(each, expression) for each, expression in known if each.positive and not ca.depends_on(expression, others)]


def _require_signs(problem: Problem, t: Array, values: Array) -> None:
    """Raise `IntegrationFailed` if something has a sign that it must not have."""
    wrong = np.argwhere(~(values > 0.0))
    if len(wrong):
        k, which = (int(name) for name in wrong[0])
        quantity = _positive(problem.system)[which][0]
        raise IntegrationFailed(
            f"{problem.system.name}: at t = {t[k]:.6g} s {quantity.name} is {values[k, which]:.4g} {quantity.unit},"
            f" {quantity.wrong_sign}"
        )


@made_once
def _drive_signals(resolved: ResolvedSystem, measured: tuple[str, ...]) -> tuple[ExactEvaluation, list[bool]]:
    """Compile inputs, positions and rates of the drives, q, v and signs; and say which positions wrap."""
    system = resolved.system
    quantities, y = measured_in(system, measured)
    positive = (each for _, each in _positive(system))
    wanted = [system.u, y, ca.jtimes(y, system.q, system.v), system.q, system.v, *positive]
    return exact_evaluation(resolved, reading(resolved, wanted)), [quantity.wraps for quantity in quantities]
