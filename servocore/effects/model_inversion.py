"""Inputs and positions of a model's drives along a path, by inversion of the model.

Of a plant without an inversion they are known where the path rests: by its equilibria.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.checks.failure_causes import guessed_configuration
from servocore.effects.position_loops import PositionLoops, measured_in
from servocore.errors import InconsistentStart, InvalidModel
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.solvers.exact_inversion import require_answers
from servocore.stepping.exact_evaluation import ExactEvaluation, exact_evaluation
from servocore.stepping.readings import reading

_CHUNK = 250  # instants in one call: one length of compiled maps serves all paths


@dataclass(frozen=True, eq=False)
class Inverted:
    """Inputs and positions of drives that make a model follow a path, at instants evenly apart.

    Attributes
    ----------
    problem : Problem
        The model, with the path.
    measured : tuple of str
        Quantities that the drives measure.
    t : ndarray, shape (N,)
        From the start of the path to its end.
    inputs, positions, rates : ndarray, shape (N, m)
        Positions count from the start, where encoders are zeroed.
    start, end : ndarray, shape (2 n,) and (n,)
        State at the start, and configuration at the end.
    microseconds : float
        Processor time an instant, where it took least.
    """

    problem: Problem
    measured: tuple[str, ...]
    t: Array
    inputs: Array
    positions: Array
    rates: Array
    start: Array
    end: Array
    microseconds: float = np.nan

    @property
    def signals(self) -> Array:
        """Inputs, positions and rates side by side, shape (N, 3 m)."""
        return np.column_stack([self.inputs, self.positions, self.rates])

    def gains(self, loops: PositionLoops | None) -> Array:
        """Return the gains of the drives at the end, shape (2, m): per unit of each position, and of its rate.

        Parameters
        ----------
        loops : PositionLoops or None
            Bandwidth and damping; zeros for None.
        """
        system = self.problem.system
        _, y = measured_in(system, self.measured)
        if loops is None:
            return np.zeros((2, len(system.inputs)))
        wanted = [system.mass, system.G, system.input_matrix, ca.jacobian(y, system.q)]
        matrices = ca.Function("matrices", [system.q, system.p], [ca.densify(expression) for expression in wanted])
        M, G, B, J = (np.asarray(matrix) for matrix in matrices(self.end, self.problem.p))
        bordered = np.block([[M, G.T], [G, np.zeros((len(G), len(G)))]])
        mobility = np.linalg.solve(bordered, np.vstack([-B.T, np.zeros((len(G), len(B)))]))[: len(M)]
        accelerations = np.diag(J @ mobility)  # acceleration of each position by its own input
        for name, each in zip(self.measured, accelerations, strict=True):
            if not abs(each) > 0.0:
                raise InvalidModel(f"{system.name}: no input moves {name}, which its drive measures")
        return np.stack([loops.bandwidth**2 / accelerations, 2 * loops.damping * loops.bandwidth / accelerations])


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
    evaluation, wraps, positive = _drive_signals(problem.resolved, measured)
    t = np.linspace(problem.reference.start_time, problem.reference.end_time, count)
    padded = np.concatenate([t, np.full(-count % _CHUNK, t[-1])])
    parts, seconds = [], np.inf
    for k in range(0, len(padded), _CHUNK):
        began = time.process_time()
        parts.append(evaluation(problem, padded[k : k + _CHUNK])[0])
        seconds = min(seconds, time.process_time() - began)
    rows = np.hstack(parts)[:, :count].T
    require_answers(problem.system.name, t, rows, positive)
    m, n = len(problem.system.inputs), len(problem.system.coordinates)
    inputs, y, rates, q, v, _ = np.split(rows, np.cumsum([m, m, m, n, n]), axis=1)
    y[:, wraps] = np.unwrap(y[:, wraps], axis=0)
    start = np.concatenate([q[0], v[0]])
    return Inverted(problem, measured, t, inputs, y - y[0], rates, start, q[-1], 1e6 * seconds / _CHUNK)


@made_once
def _drive_signals(
    resolved: ResolvedSystem, measured: tuple[str, ...]
) -> tuple[ExactEvaluation, list[bool], list[Quantity]]:
    """Compile inputs, positions and rates of the drives, q, v and what must be positive; which positions wrap."""
    system = resolved.system
    quantities, y = measured_in(system, measured)
    known = *zip(system.coordinates.quantities, ca.vertsplit(system.q), strict=True), *resolved.must_be_positive
    positive = {quantity: expression for quantity, expression in known if quantity.positive}
    wanted = [system.u, y, ca.jtimes(y, system.q, system.v), system.q, system.v, *positive.values()]
    evaluation = exact_evaluation(resolved, reading(resolved, wanted))
    return evaluation, [quantity.wraps for quantity in quantities], list(positive)


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
    read = ca.Function("y", [system.q], [measured_in(system, measured)[1]])
    positions = np.hstack([np.asarray(read(equilibrium[:n])) for equilibrium in equilibria]).T
    start = np.concatenate([equilibria[0, :n], np.zeros(n)])
    still = np.zeros((2, m))
    return Inverted(
        problem, measured, ends, equilibria[:, -m:], positions - positions[0], still, start, equilibria[1, :n]
    )


def _equilibrium(problem: Problem, time: float) -> Array:
    """Return (q, lam, u) at rest with the output where the path is at a time."""
    import scipy.optimize  # noqa: PLC0415 - kept out of the run time of an FMU

    balance = _statics(problem.resolved)
    place, n = problem.reference.jet(time, 0)[0], len(problem.system.coordinates)
    unknowns = np.zeros(n + problem.system.lam.numel() + len(problem.system.inputs))
    unknowns[:n] = guessed_configuration(problem, time)
    # With no force in the rope the Jacobian would be singular: those are taken that hold the guess.
    residual, jacobian = balance(unknowns, place, problem.p)
    unknowns[n:] = np.linalg.lstsq(jacobian[:n, n:], -residual[:n])[0]
    rows, slopes = (lambda x, k=k: balance(x, place, problem.p)[k] for k in range(2))
    found = scipy.optimize.root(rows, unknowns, jac=slopes, method="lm", tol=1e-15).x
    if not np.abs(balance(found, place, problem.p)[0]).max() <= _SOLVED * np.abs(found).max():
        raise InconsistentStart(
            f"{problem.system.name}: no equilibrium was found with the output where the path is at t = {time:.6g} s"
        )
    return np.asarray(found, dtype=np.float64)


@made_once
def _statics(resolved: ResolvedSystem) -> Call:
    """Compile ((q, lam, u), place, p) -> residual of the statics, Jacobian."""
    system = resolved.system
    place, unknowns = system.gamma[:, 0], ca.vertcat(system.q, system.lam, system.u)
    forces = ca.substitute(system.bias, system.v, ca.SX.zeros(len(system.coordinates))) + system.constraint_forces
    rows = ca.vertcat(forces, system.constraints, system.output - place)
    balance = [ca.densify(rows), ca.densify(ca.jacobian(rows, unknowns))]
    return Call(ca.Function("sc_rest", [unknowns, place, system.p], balance))
