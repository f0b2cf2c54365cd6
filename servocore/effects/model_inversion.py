"""Inputs and positions of a model's drives along a path, by inversion of the model.

Of a plant without an inversion they are known where the path rests: by its equilibria.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.effects.position_loops import measured_in
from servocore.errors import InconsistentStart
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.solvers.exact_inversion import require_signs, require_solved
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
        Quantities that the drives measure, by name.
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
    require_solved(problem.system.name, t, rows)
    m, n = len(problem.system.inputs), len(problem.system.coordinates)
    inputs, y, rates, q, v, signs = np.split(rows, np.cumsum([m, m, m, n, n]), axis=1)
    require_signs(problem.system.name, t, [quantity for quantity, _ in _positive(problem.system)], signs)
    y[:, wraps] = np.unwrap(y[:, wraps], axis=0)
    return Inverted(t, inputs, y - y[0], rates, np.concatenate([q[0], v[0]]), q[-1], 1e6 * seconds / _CHUNK)


def _positive(system: MechanicalSystem) -> list[tuple[Quantity, ca.SX]]:
    """Return the quantities that must be positive, of those that depend on the configuration alone."""
    known = [*zip(system.coordinates.quantities, ca.vertsplit(system.q), strict=True), *system.observables.items()]
    others = ca.vertcat(system.v, system.lam, system.u, ca.vec(system.gamma))
    return [(each, expression) for each, expression in known if each.positive and not ca.depends_on(expression, others)]


@made_once
def _drive_signals(resolved: ResolvedSystem, measured: tuple[str, ...]) -> tuple[ExactEvaluation, list[bool]]:
    """Compile inputs, positions and rates of the drives, q, v and signs; and say which positions wrap."""
    system = resolved.system
    quantities, y = measured_in(system, measured)
    positive = (each for _, each in _positive(system))
    wanted = [system.u, y, ca.jtimes(y, system.q, system.v), system.q, system.v, *positive]
    return exact_evaluation(resolved, reading(resolved, wanted)), [quantity.wraps for quantity in quantities]


_ITERATIONS = 50
_SOLVED = 1e-9  # of the largest force or length


def at_rest(problem: Problem, measured: tuple[str, ...]) -> Inverted:
    """Return the equilibria at both ends of a path that rests there, as a motion of two instants.

    grad V + G^T lam + B^T u = f and g = 0 with the output on the path, by Newton's method from the model's guess.

    Raises
    ------
    InconsistentStart
        If there is no equilibrium near the guess.
    """
    reference, system = problem.reference, problem.system
    ends = np.array([reference.start_time, reference.end_time])
    m, n = len(system.inputs), len(system.coordinates)
    equilibria = np.array([_equilibrium(problem, time) for time in ends])
    _, y = measured_in(system, measured)
    positions = np.hstack(
        [np.asarray(ca.Function("y", [system.q], [y])(equilibrium[:n])) for equilibrium in equilibria]
    ).T
    still = np.zeros((2, m))
    start = np.concatenate([equilibria[0, :n], np.zeros(n)])
    return Inverted(ends, equilibria[:, -m:], positions - positions[0], still, start, equilibria[1, :n], np.nan)


def _equilibrium(problem: Problem, time: float) -> Array:
    """Return (q, lam, u) at rest with the output where the path is at a time."""
    guess, balance = _statics(problem.resolved)
    place = problem.reference.jet(time, 0)[0]
    unknowns = guess(place, problem.p)[0]
    for _ in range(_ITERATIONS):
        residual, jacobian = balance(unknowns, place, problem.p)
        if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
            break
        change = np.linalg.lstsq(jacobian, -residual, rcond=1e-12)[0]
        unknowns = unknowns + change
        if np.abs(change).max() < 1e-13 * np.abs(unknowns).max():
            break
    residual, _ = balance(unknowns, place, problem.p)
    if not np.abs(residual).max() <= _SOLVED * np.abs(unknowns).max():
        raise InconsistentStart(
            f"{problem.system.name}: no equilibrium was found with the output where the path is at t = {time:.6g} s"
        )
    return unknowns


@made_once
def _statics(resolved: ResolvedSystem) -> tuple[Call, Call]:
    """Compile (place, p) -> guess of (q, lam, u), and (unknowns, place, p) -> residual of the statics, Jacobian."""
    system = resolved.system
    place, unknowns = system.gamma[:, 0], ca.vertcat(system.q, system.lam, system.u)
    forces = ca.substitute(system.bias, system.v, ca.SX.zeros(len(system.coordinates))) + system.constraint_forces
    rows = ca.vertcat(forces, system.constraints, system.output - place)
    at_rest_ = ca.substitute(system.guess, ca.vec(system.gamma[:, 1:]), ca.SX.zeros(system.gamma[:, 1:].numel()))
    balance = ca.densify(rows), ca.densify(ca.jacobian(rows, unknowns))
    # With no force in the rope the Jacobian would be singular: least squares give those that hold the guess.
    matrix, load = (ca.substitute(expression, system.q, at_rest_) for expression in (
        ca.horzcat(system.G.T, system.input_matrix.T), -(forces - system.constraint_forces)))  # fmt: skip
    normal = ca.mtimes(matrix.T, matrix) + 1e-9 * ca.SX.eye(matrix.size2())
    held = ca.solve(normal, ca.mtimes(matrix.T, load))
    first = ca.Function("sc_rest_guess", [place, system.p], [ca.densify(ca.vertcat(at_rest_, held))])
    return Call(first), Call(ca.Function("sc_rest", [unknowns, place, system.p], list(balance)))
