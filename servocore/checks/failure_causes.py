"""Why a problem was not solved, looked for after it was not: the path is out of reach, or the equations are singular.

Unsolved points are examined by least squares, which ends anywhere: at the nearest configuration to a point that is out
of reach, and at a solution where the equations have lost rank.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from servocore.checks.along_motion import jumps, slack_rope
from servocore.checks.branches import constraint_rows
from servocore.checks.findings import BISECTIONS, ROUND_OFF, bisected
from servocore.checks.motion import Motion
from servocore.errors import InvalidReference, ServocoreError
from servocore.numerics.compiled_calls import Array, Call, call_of, side_by_side
from servocore.numerics.components import condition_number
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import survey
from servocore.stepping.exact_evaluation import exact_unknowns
from servocore.structure.inversion import LARGEST_RESIDUAL, inversion, system_jacobian
from servocore.structure.signature import lost_rank

SINGULAR_CONDITION = 1e12
"""Of the equilibrated system Jacobian: beyond it the equations determine nothing."""

_INSTANTS = 41  # of the path that are examined
_STARTS, _SPREAD = 8, 1.5  # of the search for the nearest configuration, in nominal magnitudes
_HELD = 1e4  # weight of the holonomic constraints, which must hold
_REACHED = 1e-6  # of the size of the path: a smaller miss is none


def explained(problem: Problem, error: ServocoreError) -> ServocoreError:
    """Return the error that names the cause of a failure, if one is found, and the error itself if not."""
    if missed := out_of_reach(problem):
        return InvalidReference(missed)
    reason = ""
    if problem.flat and problem.reference.max_order >= problem.array.reference_order:
        reason = slack_rope(problem) or _jump(problem)
    reason = reason or singular(problem)
    return type(error)(reason) if reason else error


def _jump(problem: Problem) -> str:
    """Say where the motion of a problem without internal dynamics jumps, from the guess of its model."""
    t = survey(problem.reference)
    jump = next(jumps(Motion(problem, t, exact_unknowns(problem, t)[0], by_guess=True)), None)
    return f"{problem.system.name}: {jump.what}" if jump else ""


Nearest = Callable[[float, list[Array]], tuple[Array, float, Array]]
"""(time, configurations to start from) -> the configuration nearest to the path there, the largest miss of an output
relative to the size of the path, and the misses (outputs,) in their units; configurations in nominal magnitudes."""


def _nearest_of(problem: Problem) -> Nearest:
    """Return the search for the configurations of a system that are nearest to its path."""
    reference, nominal = problem.reference, np.array(problem.system.coordinates.nominal)
    times = np.linspace(reference.start_time, reference.end_time, _INSTANTS)
    # Outputs of one unit have one scale, so that distances are those in space.
    units = np.array([quantity.unit for quantity in problem.system.outputs])
    largest = np.abs(reference.jet(times, 0)[:, 0, : len(units)]).max(axis=0)
    size = np.array([largest[units == unit].max(initial=0.0) for unit in units])
    size = np.where(size > 0.0, size, max(float(largest.max(initial=0.0)), 1e-9))

    def rows(x: Array, place: Array) -> tuple[Array, Array]:
        residual, jacobian = constraint_rows(problem.resolved)(x * nominal, place, problem.p)
        return residual, jacobian.reshape(len(residual), -1) * nominal

    # Constraints hold to a part of the change of their rows over the range of a coordinate.
    _, jacobian = rows(_guess(problem, float(times[0])), reference.jet(float(times[0]), 0)[0])
    scale = np.abs(np.nan_to_num(jacobian)).max(axis=1)
    constraints = len(scale) - len(size)
    weights = np.concatenate([_HELD / np.where(scale > 0.0, scale, 1.0)[:constraints], 1.0 / size])

    def nearest(time: float, starts: list[Array]) -> tuple[Array, float, Array]:
        place = reference.jet(time, 0)[0]

        def weighed(x: Array) -> tuple[Array, Array]:
            residual, jacobian = rows(x, place)
            return residual * weights, jacobian * weights[:, None]

        found = [(starts[0], np.nan_to_num(weighed(starts[0])[0], nan=np.inf))]  # exact where a formula is the guess
        for start in starts:
            if np.linalg.norm(found[-1][1]) < _REACHED:
                break
            found.append(_least_squares(weighed, start))
        x, residual = min(found, key=lambda each: float(np.linalg.norm(each[1])))
        return x, float(np.abs(residual[constraints:]).max(initial=0.0)), residual[constraints:] * size

    return nearest


def _least_squares(evaluate: Callable[[Array], tuple[Array, Array]], start: Array) -> tuple[Array, Array]:
    """Return where the squares of residuals are least, and the residuals there."""
    import scipy.optimize  # noqa: PLC0415 - kept out of the run time of an FMU

    def part(k: int) -> Callable[[Array], Array]:
        return lambda x: np.nan_to_num(evaluate(x)[k], nan=1e6, posinf=1e6, neginf=-1e6)

    result = scipy.optimize.least_squares(
        part(0), np.nan_to_num(start), part(1), xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=60
    )
    return result.x, evaluate(result.x)[0]


def out_of_reach(problem: Problem) -> str:
    """Say where the path of a problem is first out of reach, and by how much at most; empty if it never is.

    Every configuration that the holonomic constraints allow counts. The nearest one to a point may be a saddle, as the
    axis of a crane is on the way to the other side: a miss counts if starts from all around lead to no better one.
    """
    reference, nearest = problem.reference, _nearest_of(problem)
    times = np.linspace(reference.start_time, reference.end_time, _INSTANTS).tolist()
    x, missed = _guess(problem, times[0]), dict[int, float]()
    for k, time in enumerate(times):
        x, far, _ = nearest(time, [_guess(problem, time), x])
        if not far < _REACHED:
            missed[k] = far
    while missed:
        k = max(missed, key=missed.__getitem__)
        _, far, miss = nearest(times[k], _around(problem, x))
        if not far < _REACHED:
            break
        del missed[k]
    else:
        return ""
    first, begin = min(missed), times[0]
    if first:
        guess = _guess(problem, times[first - 1])
        starts = [guess, *_around(problem, guess)]
        ends = times[first - 1], times[first]
        _, begin = bisected(lambda time: nearest(time, starts)[1] < _REACHED, *ends, BISECTIONS // 2)
    return _miss_in_words(problem, begin, times[k], miss)


def _guess(problem: Problem, time: float) -> Array:
    """Return the guess of the model at an instant in nominal magnitudes."""
    return np.asarray(guessed_configuration(problem, time) / problem.system.coordinates.nominal)


def guessed_configuration(problem: Problem, time: float) -> Array:
    """Return the guess of the model at an instant, shape (n,); home where that is not finite."""
    system, reference = problem.system, problem.reference
    gamma = np.zeros(system.gamma.shape)
    order = min(gamma.shape[1] - 1, reference.max_order)
    gamma[:, : order + 1] = reference.jet(time, order).T
    guess = np.asarray(system.guess_function(gamma, problem.p)).ravel()
    return guess if np.isfinite(guess).all() else system.home_configuration(problem.p)[0]


def _around(problem: Problem, x: Array) -> list[Array]:
    """Return configurations from which to look again, in nominal magnitudes: home, and random ones about it and `x`."""
    home = problem.system.home_configuration(problem.p)[0] / np.array(problem.system.coordinates.nominal)
    generator = np.random.default_rng(8)
    size = np.maximum(1.0, np.abs(x))
    spread = [_SPREAD * generator.standard_normal(len(x)) for _ in range(_STARTS)]
    return [home, *(x + part * size for part in spread), *(home + part for part in spread)]


def _miss_in_words(problem: Problem, begin: float, time: float, miss: Array) -> str:
    place, outputs = problem.reference.jet(time, 0)[0], problem.system.outputs
    worst = [k for k in range(len(miss)) if abs(miss[k]) > 1e-3 * np.abs(miss).max()]
    listed = " and ".join(
        f"{outputs[k].name} = {place[k]:.6g} {outputs[k].unit} by {abs(miss[k]):.3g} {outputs[k].unit}" for k in worst
    )
    if len(worst) > 1 and len({outputs[k].unit for k in worst}) == 1:
        listed += f", {np.linalg.norm(miss[worst]):.3g} {outputs[worst[0]].unit} in all"
    return (
        f"{problem.name}: from t = {begin:.6g} s on the path is out of reach; at t = {time:.6g} s the nearest"
        f" configuration found misses {listed}"
    )


def singular(problem: Problem) -> str:
    """Return where along the path the equations are first singular, and in which unknowns; empty if not found.

    With internal dynamics only the start is examined: later configurations are not known.
    """
    reference, array = problem.reference, problem.array
    if reference.max_order < array.reference_order:
        return ""
    times = np.linspace(reference.start_time, reference.end_time, _INSTANTS if problem.flat else 1)
    J, guess, last = call_of(system_jacobian(array)), call_of(inversion(array).guess), None
    states, _ = exact_unknowns(problem, times)
    for k, time in enumerate(times):
        values, jet = states[:, k], side_by_side(reference.jet(np.array([time]), array.reference_order))
        if not np.isfinite(values).all():
            values = _solved(problem, jet, guess(jet, problem.p)[0] if last is None else last)
        if not np.isfinite(values).all():
            return ""
        matrix = J(values, jet, problem.p)[0]
        if not condition_number(matrix) < SINGULAR_CONDITION:
            return singular_in_words(problem, float(time), values, matrix)
        last = values
    return ""


def _solved(problem: Problem, jet: Array, start: Array) -> Array:
    """Return all unknowns of the derivative array, states as they start, by least squares; NaN if that fails."""
    array = problem.array
    free, evaluate = array.places(array.determined), _compiled_array(problem.resolved)

    def rows(x: Array) -> tuple[Array, Array]:
        values = start.copy()
        values[free] = x
        residual, jacobian = evaluate(values, jet, problem.p)
        return residual, jacobian.reshape(len(residual), -1)

    values = start.copy()
    if np.isfinite(start).all():
        x, residual = _least_squares(rows, start[free])
        values[free] = x if np.linalg.norm(residual) < LARGEST_RESIDUAL else np.nan
    return values


@made_once
def _compiled_array(resolved: ResolvedSystem) -> Call:
    array = resolved.array
    gamma = array.system.gamma[:, : array.reference_order + 1]
    jacobian = ca.jacobian(array.residual, array.column(array.determined))
    results = [ca.densify(array.residual), ca.densify(jacobian)]
    return Call(ca.Function("sc_array_rows", [array.column(array.unknowns), gamma, array.system.p], results))


def singular_in_words(problem: Problem, time: float, values: Array, jacobian: Array) -> str:
    """Return the sentence that the equations are singular at an instant, and in which unknowns.

    Parameters
    ----------
    problem : Problem
        The problem with these equations.
    time : float
        In s.
    values : ndarray, shape (size,)
        Unknowns of the derivative array there; NaN where they were not found.
    jacobian : ndarray, shape (size, size)
        System Jacobian.
    """
    name, array, reference = problem.system.name, problem.array, problem.reference
    jet = reference.jet(time, min(array.reference_order, reference.max_order))
    moves = np.abs(jet[1:]).max(initial=0.0) > ROUND_OFF * np.abs(jet).max(initial=0.0)
    if len(jet) > array.reference_order and not moves:
        state = values if np.isfinite(values).all() else call_of(inversion(array).guess)(jet.T, problem.p)[0]
        J = call_of(system_jacobian(array))(state, jet.T, problem.p)[0]
        if not condition_number(J) < SINGULAR_CONDITION:
            return f"{name} {_cause_at_rest(problem, time, jet, state)}; {lost_rank(array.signature, J)}"
    said = f"{name} is singular at t = {time:.6g} s: the system Jacobian has condition {condition_number(jacobian):.2g}"
    return f"{said}, {lost_rank(array.signature, jacobian)}" if np.isfinite(jacobian).all() else said


def _cause_at_rest(problem: Problem, time: float, jet: Array, state: Array) -> str:
    """Return why the system Jacobian is singular where the path rests.

    Velocities and higher derivatives that are numbers without symmetry show whether the configuration is the cause.
    """
    array, names = problem.array, problem.system.coordinates.names
    places = array.places(unknown for unknown in array.unknowns if unknown[1])
    moving = np.array(state)
    moving[places] = np.random.default_rng(5).uniform(0.1, 0.3, len(places))
    where = ", ".join(f"q.{name} = {state[array.unknowns.index((k, 0))]:.4g}" for k, name in enumerate(names))
    at, singular_there = f"t = {time:.6g} s ({where})", "the system Jacobian is singular there"
    if condition_number(call_of(system_jacobian(array))(moving, jet.T, problem.p)[0]) < SINGULAR_CONDITION:
        return f"has no relative degree at rest, at {at}: {singular_there}, and with velocities it is not"
    if array.signature.equations.combined:
        return (
            f"is singular at {at}: either there is no relative degree, or terms cancel where its combined equations"
            " hold and nowhere else, which structural analysis does not see"
        )
    return f"has no relative degree at {at}: {singular_there}, whatever the velocities"
