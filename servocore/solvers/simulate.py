"""`simulate`: forward dynamics of a scene under given inputs, to verify that the load follows its path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from servocore.checks.along_motion import left_out, steps_passed, with_switches
from servocore.checks.before_run import require_smooth
from servocore.checks.between_instants import Moments
from servocore.checks.findings import ROUND_OFF, told
from servocore.errors import (
    InconsistentStart,
    IntegrationFailed,
    InvalidSetting,
    described,
    require_callable,
    require_positive,
    require_real,
)
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene, require_scene
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import JUMPS
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import numbers_of
from servocore.solution import Solution, Statistics
from servocore.solvers.energy_momentum import BALANCE, EnergyMomentum, SampledInputs, conserved_motion, scheme_of
from servocore.solvers.forward_integration import integrated
from servocore.solvers.runs import with_run_quantities
from servocore.stepping.exact_evaluation import along_path, exact_unknowns
from servocore.stepping.forward_dynamics import forward_rate
from servocore.stepping.observation import observed, violations_of
from servocore.stepping.prescribed_initial_values import with_initial_values
from servocore.structure.derivative_array import DerivativeArray

_SMALLEST_RTOL = 1e-13

Inputs = Callable[[float], Array]
"""Time in s -> inputs u, shape (m,)."""


def simulate(
    scene: Scene,
    inputs: Solution | Inputs,
    *,
    t: Array | None = None,
    model: str | None = None,
    start: Mapping[str, float] | None = None,
    rtol: float = 1e-9,
    atol: float = 1e-9,
    time_limit: float | None = None,
    method: EnergyMomentum | None = None,
    step: float | None = None,
) -> Solution:
    """Integrate the equations of motion (1) without the servo constraints, under given inputs.

    The holonomic constraints are differentiated twice and stabilized, see `servocore.stepping.forward_dynamics`; the
    resulting ordinary differential equation is integrated by SciPy's DOP853 with error control, or by its Radau where
    it turns out to be very stiff. `EnergyMomentum` takes constant steps and differentiates no constraint.

    Parameters
    ----------
    scene : Scene
        Gives the model, its parameters, and by its reference the initial state that is not given by `start`.
    inputs : Solution or callable
        A solution with the scene's inputs, interpolated by a cubic spline between its first time and its last; or a
        function of time.
    t : ndarray, optional
        Where to report, in rising order; the times of the solution when not given.
    model : str, optional
        Model to integrate; the scene's smallest when not given.
    start : mapping of str to float, optional
        Initial values of coordinates and rates by name, ``theta`` and ``theta_dot``. Where the holonomic constraints
        require it the others are moved, as little as possible.
    rtol, atol : float
        Tolerances of the integrator on positions and velocities.
    time_limit : float, optional
        Seconds after which the integration is given up.
    method : EnergyMomentum, optional
        The scheme with a constant step, instead of DOP853 with error control.
    step : float, optional
        Its step in s; the times at which to report are whole steps after the first.

    Returns
    -------
    Solution
        Observables, outputs and coordinates, with `tracking_error`; the statistics count integrator steps, and
        evaluations of the accelerations as factorizations. With `EnergyMomentum` also ``energy``, the ``work`` of
        inputs and forces since the start, and ``angular_momentum_x``, ``_y``, ``_z`` about the origin.

    Raises
    ------
    InconsistentStart
        If the reference gives no initial state, or the constraints cannot hold with the values of `start`.
    InvalidReference
        If the path is so rough that it does not start at rest, and no whole state is given.
    IntegrationFailed
        If the integrator gives up, time runs out, a force that jumps with the sign of a velocity, as dry friction,
        changes sides without end, or the potential or the mass has a step where the motion passes.
    InvalidSetting
        If neither times nor a solution are given, times do not rise or leave those of the inputs, or there are not as
        many inputs as the scene has, or `start` names no coordinate, or a step goes without a method.
    InvalidModel
        If the system has no energy that `EnergyMomentum` conserves, or a constraint that is redundant at home, and was
        left out, does not hold.
    """
    require_scene(scene, "simulate")
    problem = Problem.of(scene, model, start)
    for what, value in (("rtol", rtol), ("atol", atol), ("time_limit", time_limit if time_limit is not None else 1.0)):
        require_positive(value, what, "a positive number")
    if rtol < _SMALLEST_RTOL:
        raise InvalidSetting(f"rtol must be {_SMALLEST_RTOL:g} or more, not {rtol:g}: numbers are no more accurate")
    if isinstance(inputs, Solution):
        instants = _rising_times(inputs.t if t is None else t)
        evaluate: SampledInputs = _interpolated(inputs, problem.system, instants)
    else:
        require_callable(inputs, "the inputs", "a Solution or a function of time")
        if t is None:
            raise InvalidSetting("inputs given as a function need the times at which to report")
        instants, evaluate = _rising_times(t), _checked(inputs, problem.system)
    if method is None and step is None:
        return _report(problem, instants, *_integrated(problem, evaluate, instants, (rtol, atol, time_limit)))
    return _conserved(problem, evaluate, instants, method, step)


def _conserved(problem: Problem, inputs: SampledInputs, t: Array, method: object, step: float | None) -> Solution:
    """Return the motion by the energy-momentum scheme, with its balance of energy."""
    if not isinstance(method, EnergyMomentum):
        raise InvalidSetting(
            f"a forward simulation at constant step needs method=EnergyMomentum(), not {described(method)}"
        )
    require_real(step, "the step of the energy-momentum scheme", "a time in s", InvalidSetting)
    scheme_of(problem, method)  # first: a system without a conserved energy needs no start
    start = _initial_state(problem, float(t[0]))
    (states, forces, balance), totals = conserved_motion(problem, method, start, inputs, t, float(step or 0.0))
    known = _report(problem, t, (states, forces, inputs(t).T), totals)
    return replace(
        known,
        channels=(*known.channels, *BALANCE),
        values=np.column_stack([known.values, balance]),
        route=f"{problem.system.name}, {method.name}",
    )


def _integrated(
    problem: Problem, inputs: SampledInputs, t: Array, tolerance: tuple[float, float, float | None]
) -> tuple[tuple[Array, ...], tuple[int, int, int, float]]:
    """Return states, multipliers and inputs (rows, N) at instants, with the integrator's totals."""
    system, p = problem.system, problem.p
    move, undisturbed = _free_motion(problem.resolved), np.zeros(len(system.outputs))
    clocks = system.time.numel()  # 0 or 1

    def moved(state: Array, now: Array, u: Array) -> tuple[Array, ...]:
        return move(state, u, undisturbed, p, *(now,) * clocks)

    def rate(time: float, state: Array) -> Array:
        now = np.array([time])
        return moved(state, now, inputs(now))[0]

    start = _initial_state(problem, float(t[0]))
    states, steps, evaluations = integrated(system.name, system.coordinates.names, rate, start, t, *tolerance)
    u = inputs(t)
    # Multipliers belong to the instants of the report, not to the integrator's own steps.
    forces = [moved(*instant)[1] for instant in zip(states.T, t, u, strict=True)]
    return (states, np.array(forces).reshape(len(t), -1).T, u.T), (steps, 0, evaluations, 0.0)


@made_once
def _free_motion(resolved: ResolvedSystem) -> Call:
    """Compile (state, u, d, p) -> (state_dot, lam, u): forward dynamics under given inputs."""
    return Call(forward_rate(resolved.system, held=False))


def _initial_state(problem: Problem, time: float) -> Array:
    """Return (q, v) at a time: that of the exact inversion, with the values of the problem's start in their places."""
    system = problem.system
    # A whole state needs no exact inversion, and no path that is smooth.
    if len(problem.start) == 2 * len(system.coordinates):
        return with_initial_values(problem, time, np.zeros(len(problem.start)), problem.start)
    # Whether a path joins the rest before it smoothly matters at its beginning alone.
    if time == problem.reference.start_time:
        require_smooth(problem)
    array = problem.array
    places = [array.position(f"q.{name}", order) for order in (0, 1) for name in system.coordinates.names]
    state: Array = exact_unknowns(problem, np.array([time]))[0][places, 0]
    if not np.isfinite(state).all():
        raise InconsistentStart(f"{system.name}: no consistent initial state at t = {time:.6g} s")
    return with_initial_values(problem, time, state, problem.start) if problem.start else state


def _require_no_steps(problem: Problem, t: Array, states: Array) -> None:
    """Raise `IntegrationFailed` if a motion (2 n, N) passes a step of the potential or of the mass: it is no motion."""
    outcome = problem.resolved.outcome
    if not isinstance(outcome, DerivativeArray) or len(t) < 2 or not problem.resolved.holds(JUMPS):
        return
    from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415 - kept out of the run time of an FMU

    n = len(problem.system.coordinates)
    places = [outcome.places((k, order) for k in range(n)) for order in (0, 1)]
    motion = CubicHermiteSpline(t, states[:n], states[n:], axis=1)

    def unknowns(times: Array) -> Array:
        values = np.zeros((len(outcome.unknowns), len(times)))
        values[places[0]], values[places[1]] = motion(times), motion(times, 1)
        return values

    _, switches = with_switches(problem, lambda _, __, times: unknowns(times), Moments(t, unknowns(t)))
    told(problem.system.name, "", steps_passed(problem, *switches))


def _report(problem: Problem, t: Array, columns: tuple[Array, ...], totals: tuple[int, int, int, float]) -> Solution:
    known, function = _observation(problem.resolved)
    _require_no_steps(problem, t, columns[0])
    told(problem.system.name, "", left_out(problem, t, columns[0][: len(problem.system.coordinates)]))
    values, violations = along_path(problem, function, t, *columns)
    # atan2 jumps by a full turn where a motion is continuous.
    wraps = [quantity.wraps for quantity in known]
    values[wraps] = np.unwrap(values[wraps], axis=1)
    unit = problem.system.outputs[0].unit
    tracking = Quantity("tracking_error", unit, "distance of the servo output from the reference")
    statistics = Statistics(*totals, *violations.max(axis=1).tolist())
    table = np.column_stack([values.T, violations[0]])
    name = f"{problem.system.name}, forward simulation"
    return with_run_quantities(Solution(t, (*known, tracking), table, name, statistics))


@made_once
def _observation(resolved: ResolvedSystem) -> tuple[tuple[Quantity, ...], ca.Function]:
    """Compile (state, lam, u, gamma, p) -> observed values, and violations (4,), of the path as distances.

    Quantities of higher derivatives of the path are not observed: the motion need not follow it.
    """
    system, gamma, path = resolved.system, resolved.system.gamma[:, :2], resolved.system.path
    known = [
        (quantity, expression)
        for quantity, expression in observed(system)
        if not ca.depends_on(expression, ca.vec(system.path))
    ]
    known.sort(key=lambda pair: pair[0] not in system.observables)  # they come first, the others keep their order
    distances = ca.norm_2(system.output - path[:, 0]), ca.norm_2(ca.mtimes(system.C, system.v) - path[:, 1])
    violations = ca.vertcat(*distances, violations_of(system)[2:])
    results = ca.vertcat(*(expression for _, expression in known)), violations
    arguments = [ca.vertcat(system.q, system.v), system.lam, system.u, gamma, system.p]
    function = ca.Function("sc_report", arguments, [ca.densify(result) for result in results])
    return tuple(quantity for quantity, _ in known), function


# Inputs as functions of time ------------------------------------------------------------------------------------------


def _rising_times(t: Any, what: str = "the times at which to report") -> Array:
    """Return times (N,) as an array; `what` names them in messages.

    Raises
    ------
    InvalidSetting
        If there are none, or they are no finite numbers in rising order.
    """
    times = np.atleast_1d(numbers_of(t, what, InvalidSetting))
    if times.ndim != 1 or not len(times) or not np.isfinite(times).all():
        raise InvalidSetting(
            f"{what} must be one row of finite numbers in s, not an array of shape {times.shape}"
            + ("" if np.isfinite(times).all() else f" that holds {times[~np.isfinite(times)][0]}")
        )
    falls = np.flatnonzero(np.diff(times) < 0.0)
    if len(falls):
        k = int(falls[0])
        raise InvalidSetting(f"{what} must rise, but {times[k + 1]:g} s follows {times[k]:g} s")
    return times


def _interpolated(solution: Solution, system: MechanicalSystem, t: Array) -> SampledInputs:
    """Return the inputs of a solution as a function of times: a cubic spline through its samples.

    A time may lie outside theirs by round-off.

    Parameters
    ----------
    solution : Solution
        With the inputs of the system by name.
    system : MechanicalSystem
        The system that they drive.
    t : ndarray, shape (N,)
        Times that they are to cover, in rising order.

    Raises
    ------
    InvalidSetting
        If an input is missing or not finite, or the times leave those of the solution.
    """
    import scipy.interpolate  # noqa: PLC0415 - kept out of the run time of an FMU

    names = [quantity.name for quantity in system.inputs]
    missing = [name for name in names if name not in solution]
    if missing:
        raise InvalidSetting(
            f"the solution lacks the inputs {', '.join(missing)} of {system.name}; it has {', '.join(solution.names)}"
        )
    known = _rising_times(solution.t, "the times of the inputs")
    if (np.diff(known) <= 0.0).any():
        raise InvalidSetting(f"the inputs are given twice at t = {known[int((np.diff(known) <= 0.0).argmax())]:g} s")
    first, last = float(known[0]), float(known[-1])
    # Times that were written to a file and read again may differ in the last digit.
    slack = ROUND_OFF * (last - first)
    if t[0] < first - slack or t[-1] > last + slack:
        raise InvalidSetting(
            f"the inputs are known from t = {first:g} s to {last:g} s, the simulation is to go from {t[0]:g} s to"
            f" {t[-1]:g} s: outside their time they are unknown"
        )
    table = np.column_stack([np.empty((len(solution.t), 0)), *(solution[name] for name in names)])
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        k, j = bad[0]
        raise InvalidSetting(f"the input {names[j]} of the solution is {table[k, j]} at t = {solution.t[k]:g} s")
    curve = scipy.interpolate.make_interp_spline(known, table, k=min(3, len(known) - 1))
    return lambda t: np.asarray(curve(np.minimum(np.maximum(t, first), last)))


def _checked(inputs: Callable[[float], Any], system: MechanicalSystem) -> SampledInputs:
    """Return a function of times whose values are checked: as many finite numbers as the system has inputs."""
    names = [quantity.name for quantity in system.inputs]

    def at(time: float) -> Array:
        answer = inputs(time)
        try:
            values = np.asarray(() if answer is None else answer, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError):
            raise InvalidSetting(f"the inputs at t = {time:.6g} s must be numbers, not {described(answer)}") from None
        if len(values) != len(names):
            raise InvalidSetting(
                f"the function of time returns {len(values)} inputs at t = {time:.6g} s, {system.name} has"
                f" {len(names)}: {', '.join(names)}"
            )
        if not np.isfinite(values).all():
            lost = int(np.flatnonzero(~np.isfinite(values))[0])
            raise IntegrationFailed(
                f"{system.name}: the forward simulation stopped at t = {time:.6g} s: the input {names[lost]} is"
                f" {values[lost]}"
            )
        return values

    return lambda t: np.array([at(time) for time in t.tolist()]).reshape(len(t), -1)
