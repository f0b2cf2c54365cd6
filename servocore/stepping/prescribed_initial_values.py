"""Initial values given by a user: states of internal dynamics, or the whole motion for `simulate`.

A start is a mapping from names to numbers: ``theta`` is a coordinate in its unit, ``theta_dot`` its rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from servocore.errors import InconsistentStart, InvalidModel, InvalidSetting, require_kind, require_real
from servocore.formulations.reduced import Reduced
from servocore.numerics.compiled_calls import Array, Call, call_of, mapped, side_by_side
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import inversion

Start = Mapping[str, float]

_RATE = "_dot"
_CLOSED = 1e-9  # largest accepted residual of constraints, relative to the coordinates
_ITERATIONS = 50


def prescribed_start(problem: Problem, restart: ca.Function, gamma: Array, step: float) -> tuple[Array, float]:
    """Return the first state of a run with the problem's start, and the residual of its equations.

    Parameters
    ----------
    problem : Problem
        With a start of its internal states.
    restart : casadi.Function
        `Program.restart` of the program.
    gamma : ndarray, shape (instants, start_order + 1, m)
        Reference jets at the instants that its start needs.
    step : float
        In s.

    Raises
    ------
    InvalidSetting
        If the start does not name the states of the internal dynamics.
    InconsistentStart
        If the equations have no solution with these values.
    """
    unknowns, residual = (each[:, 0] for each in start_unknowns(problem, gamma[:1], problem.p[None]))
    if not np.isfinite(unknowns).all():
        time = problem.reference.start_time
        raise InconsistentStart(
            f"{problem.system.name}: no consistent initial values at t = {time:.6g} s with {_listed(problem.start)}"
        )
    return call_of(restart)(unknowns, side_by_side(gamma), step, problem.p)[0], float(residual[0])


def start_unknowns(problem: Problem, gamma: Array, p: Array) -> tuple[Array, Array]:
    """Return the unknowns of the derivative array where cases of a problem start, and residuals of their equations.

    Internal states are those of the start of the problem, or the guess of the model.

    Parameters
    ----------
    problem : Problem
        With the equations and the start of all cases.
    gamma : ndarray, shape (N, orders, m)
        Reference jets at the start, of the order of the derivative array or more.
    p : ndarray, shape (N, parameters)
        Parameters of the cases.

    Returns
    -------
    tuple of ndarray, shapes (size, N) and (1, N)
        All unknowns of a case are NaN where some are not found.

    Raises
    ------
    InvalidSetting
        If the start does not name the states of the internal dynamics.
    """
    array, count = problem.array, len(gamma)
    states = _states(array, problem.start, problem.system.name) if problem.start else []
    # With these as states the array determines all other unknowns.
    guess, search = _inversion(problem.resolved, array.named(states))
    given = side_by_side(gamma[:, : array.reference_order + 1]), p.T
    values = mapped(guess, count)(*given)[0].reshape(-1, count, order="F")
    values[array.places(states)] = np.reshape([*problem.start.values()], (-1, 1))
    unknowns, _, residual = mapped(search, count)(*given, values)
    unknowns, residual = unknowns.reshape(-1, count, order="F"), residual.reshape(1, -1)
    return np.where(np.isfinite(unknowns).all(axis=0) & np.isfinite(residual), unknowns, np.nan), residual


def require_start(problem: Problem) -> None:
    """Raise `InvalidSetting` unless the start of a problem names states of its internal dynamics."""
    array, name = problem.array, problem.system.name
    states = _states(array, problem.start, name)
    try:
        _inversion(problem.resolved, array.named(states))
    except InvalidModel as error:
        names = ", ".join(_plain(*state) for state in array.named_states)
        raise InvalidSetting(
            f"{name}: {', '.join(problem.start)} cannot all be given: the path determines one of them; {names} can"
        ) from error


@made_once
def _inversion(resolved: ResolvedSystem, states: tuple[tuple[str, int], ...]) -> tuple[ca.Function, ca.Function]:
    """Compile the guess of the unknowns, and Newton's method with these states given; the usual ones if there are none.

    Raises
    ------
    InvalidModel
        If the equations do not determine all other unknowns.
    """
    inverse = inversion(Reduced(states=states).array(resolved.system))
    return inverse.guess, inverse.search


def _states(array: DerivativeArray, start: Start, name: str) -> list[tuple[int, int]]:
    """Return variable and order of every state in a start."""
    _require_numbers(start, name)
    _require_clear(start, [_plain(array.names[j], order) for j, order in array.unknowns], name)
    known = {_plain(array.names[j], order): (j, order) for j, order in array.unknowns}
    wrong = [name for name in start if name not in known]
    if wrong or len(start) != len(array.states):
        names = ", ".join(_plain(*state) for state in array.named_states)
        raise InvalidSetting(
            f"{name}: a start gives the {len(array.states)} states of the internal dynamics, such as {names},"
            f" not {', '.join(wrong or start)}"
            if array.states
            else f"{name} has no internal dynamics: its motion follows from the path, without a start"
        )
    return [known[name] for name in start]


def _require_numbers(start: Start, name: str) -> None:
    require_kind(start, Mapping, f"{name}: a start", "values by name, such as {'theta': 0.1}", InvalidSetting)
    for label, value in start.items():
        require_real(value, f"{name}: the start of {label}", "a finite number", InvalidSetting)
        if not np.isfinite(value):
            raise InvalidSetting(f"{name}: the start of {label} must be a finite number, not {value!r}")


def _require_clear(start: Start, names: Sequence[str], system: str) -> None:
    """Raise `InvalidSetting` if a coordinate in a start has the name of another one's rate."""
    for name in start:
        if names.count(name) > 1:
            raise InvalidSetting(
                f"{system}: in a start {name} is both a coordinate and the rate of {name.removesuffix(_RATE)}: the"
                " coordinate needs another name"
            )


def _plain(variable: str, order: int) -> str:
    """Return the name of a derivative in a start: theta, theta_dot."""
    return variable.split(".", 1)[1] + ("", "_dot", "_ddot")[order] if order < 3 else f"{variable} {order}"


def _listed(start: Start) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in start.items())


def with_initial_values(problem: Problem, time: float, state: Array, start: Start) -> Array:
    """Return the state (q, v) with the values of a start, the others projected onto the constraints.

    The projection is the closest one in units of the nominal magnitudes.

    Raises
    ------
    InvalidSetting
        If the start names no coordinate.
    InconsistentStart
        If the holonomic constraints cannot hold with these values.
    """
    system = problem.system
    _require_numbers(start, system.name)
    names = (*system.coordinates.names, *(name + _RATE for name in system.coordinates.names))
    wrong = [name for name in start if name not in names]
    if wrong:
        raise InvalidSetting(f"{system.name}: a start gives coordinates and their rates, not {', '.join(wrong)}")
    _require_clear(start, names, system.name)
    free, consistent = np.array([name not in start for name in names]), state.copy()
    consistent[~free] = [start[name] for name in names if name in start]
    if not system.lam.numel():
        return consistent
    n, nominal = len(system.coordinates), np.array(system.coordinates.nominal)
    rows, rates = _constraint_rows(problem.resolved)
    clock = problem.reference.jet(time, 1).T
    for function, part in ((rows, slice(0, n)), (rates, slice(n, 2 * n))):
        # Positions first: the constraints of velocities depend on G at the positions.
        moves = free[part] * nominal
        for _ in range(_ITERATIONS):
            residual, jacobian = function(consistent, clock, problem.p)
            # Rows of one length, in units of nominal magnitudes, so that one tolerance serves metres and radians.
            scale = np.maximum(np.abs(jacobian * nominal).max(axis=1, initial=0.0), 1e-300)
            jacobian = jacobian * moves / scale[:, None]
            # The least-norm step; redundant rows make the Jacobian rank deficient, which lstsq tolerates.
            change = moves * np.linalg.lstsq(jacobian, -residual.ravel() / scale, rcond=1e-12)[0]
            consistent[part] += change
            if not np.abs(change).max(initial=0.0) > 1e-15 * np.abs(consistent[part]).max(initial=0.0):
                break
        residual = function(consistent, clock, problem.p)[0].ravel() / scale
        if not np.abs(residual).max(initial=0.0) <= _CLOSED * max(1.0, np.abs(consistent[part] / nominal).max()):
            worst = system.listed_constraints([int(np.abs(residual).argmax())])
            raise InconsistentStart(
                f"{system.name}: with {_listed(start)} at t = {time:.6g} s the holonomic constraint {worst} cannot hold"
            )
    return consistent


@made_once
def _constraint_rows(resolved: ResolvedSystem) -> tuple[Call, Call]:
    """Compile (state, gamma, p) -> constraints and their Jacobian by q, and -> their rates and Jacobian by v."""
    system = resolved.system
    arguments = [ca.vertcat(system.q, system.v), system.gamma[:, :2], system.p]
    G = ca.densify(system.G)
    pairs = ([ca.densify(system.constraints), G], [ca.densify(system.constraint_rate), G])
    rows, rates = (Call(ca.Function("sc_constraints", arguments, pair)) for pair in pairs)
    return rows, rates
