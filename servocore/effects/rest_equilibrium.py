"""The equilibrium of a plant at rest with its output on the path: the start of a plant without an inversion."""

from __future__ import annotations

import casadi as ca
import numpy as np

from servocore.effects.drives import measured_in
from servocore.effects.model_inversion import Inverted
from servocore.errors import InconsistentStart
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem

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
