"""`simulate`: forward dynamics of a scene under given inputs, to see whether the load goes where it should."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.structure.derivative_array import derivative_array
from servocore.errors import InconsistentStart, IntegrationFailed, InvalidSetting
from servocore.structure.inversion import compile_inversion
from servocore.stepping.program import Channel
from servocore.problem import prepared
from servocore.model.scene import Scene
from servocore.solution import Solution, Statistics
from servocore.model.symbols import Array, Quantity
from servocore.model.system import MechanicalSystem

Inputs = Callable[[float], Array]
"""Time in s -> inputs u, shape (m,)."""

STABILISATION_RATE = 10.0
"""Rate in 1/s at which violations of the holonomic constraints decay."""


def simulate(
    scene: Scene,
    inputs: Solution | Inputs,
    *,
    t: Array | None = None,
    model: str | None = None,
    rtol: float = 1e-9,
    atol: float = 1e-9,
) -> Solution:
    """Integrate the equations of motion (1) without the servo constraints, under given inputs.

    The holonomic constraints are differentiated twice and stabilised: g'' + 2 a g' + a^2 g = 0 with
    a = `STABILISATION_RATE`; the resulting ordinary differential equation goes to SciPy's DOP853 with error control.

    Parameters
    ----------
    scene : Scene
        Gives the model, its parameters, and by its reference the initial state.
    inputs : Solution or callable
        A solution with the scene's inputs, interpolated by a cubic spline; or a function of time.
    t : ndarray, optional
        Where to report; the times of the solution when not given.
    model : str, optional
        Model to integrate; the scene's smallest when not given.
    rtol, atol : float
        Tolerances of the integrator on positions and velocities.

    Returns
    -------
    Solution
        Observables, outputs and coordinates, with `tracking_error`; the statistics count integrator steps, and
        evaluations of the accelerations as factorisations.

    Raises
    ------
    InconsistentStart
        If the reference gives no initial state.
    IntegrationFailed
        If the integrator gives up.
    InvalidSetting
        If neither times nor a solution are given.
    """
    import scipy.integrate  # noqa: PLC0415 - kept out of the run time of an FMU

    base = scene.model(model)
    p = base.parameters.values(scene.parameters)
    system = prepared(base, p)[0]
    if isinstance(inputs, Solution):
        t = inputs.t if t is None else t
        evaluate = interpolated(inputs, system)
    else:
        evaluate = inputs
    if t is None:
        raise InvalidSetting("inputs given as a function need the times at which to report")
    accelerate = _accelerations(system)
    n = len(system.coordinates)

    def rate(time: float, state: Array) -> Array:
        acceleration, _ = accelerate(state, evaluate(time), p)
        return np.concatenate([state[n:], np.asarray(acceleration).ravel()])

    start = _initial_state(scene, system, p, float(t[0]))
    found = scipy.integrate.solve_ivp(
        rate, (float(t[0]), float(t[-1])), start, method="DOP853", rtol=rtol, atol=atol, dense_output=True
    )
    if found.status != 0 or found.sol is None or not np.isfinite(found.y).all():
        raise IntegrationFailed(
            f"{system.name}: the forward simulation stopped at t = {found.t[-1]:.6g} s: {found.message}"
        )
    states = found.sol(t)
    forces = [
        np.asarray(accelerate(state, evaluate(time), p)[1]).ravel() for time, state in zip(t, states.T, strict=True)
    ]
    counts = (len(found.t) - 1, int(found.nfev))
    return _report(scene, system, p, np.asarray(t), states, np.array(forces).reshape(len(t), -1), evaluate, counts)


def interpolated(solution: Solution, system: MechanicalSystem) -> Inputs:
    """Return the inputs of a solution as a function of time: a cubic spline through its samples."""
    import scipy.interpolate  # noqa: PLC0415 - kept out of the run time of an FMU

    table = np.column_stack([solution[each.name] for each in system.inputs])
    spline = scipy.interpolate.make_interp_spline(solution.t, table, k=min(3, len(solution.t) - 1))

    def evaluate(time: float) -> Array:
        values: Array = spline(time)
        return values

    return evaluate


@lru_cache(maxsize=32)
def _accelerations(system: MechanicalSystem) -> ca.Function:
    """Return ((q, v), u, p) -> (v_dot, lam) from the stabilised equations of index one."""
    g_dot = ca.mtimes(system.G, system.v)
    a = STABILISATION_RATE
    stabilised = ca.jtimes(g_dot, system.q, system.v) + 2 * a * g_dot + a**2 * system.constraints
    m_h = system.lam.numel()
    matrix = ca.blockcat([[system.mass, system.G.T], [system.G, ca.SX(m_h, m_h)]])
    right = ca.vertcat(system.bias + ca.mtimes(system.input_matrix.T, system.u), stabilised)
    state = ca.vertcat(system.q, system.v)
    terms = ca.Function("sc_terms", [state, system.u, system.p], [matrix, -right], {"cse": True})
    arguments = [
        ca.MX.sym("state", state.numel()),
        ca.MX.sym("u", len(system.inputs)),
        ca.MX.sym("p", system.p.numel()),
    ]
    found = ca.solve(*terms(*arguments), "qr")
    n = len(system.coordinates)
    return ca.Function("sc_accelerations", arguments, [found[:n], found[n:]])


@lru_cache(maxsize=32)
def _inversion(system: MechanicalSystem) -> tuple[ca.Function, tuple[int, ...], int]:
    """Return the exact inversion, the places of q and v among its results, and the order it needs."""
    array = derivative_array(system)
    places = [array.position(f"q.{name}", order) for order in (0, 1) for name in system.coordinates.names]
    return compile_inversion(array), tuple(places), array.reference_order


def _initial_state(scene: Scene, system: MechanicalSystem, p: Array, time: float) -> Array:
    inversion, places, order = _inversion(system)
    found, _, residual = inversion(scene.reference.jet(time, order).T, p)
    state: Array = np.asarray(found).ravel()[list(places)]
    if not np.isfinite(state).all() or not np.isfinite(float(residual)):
        raise InconsistentStart(f"{system.name}: no consistent initial state at t = {time:.6g} s")
    return state


def _report(
    scene: Scene,
    system: MechanicalSystem,
    p: Array,
    t: Array,
    states: Array,
    multipliers: Array,
    inputs: Inputs,
    counts: tuple[int, int],
) -> Solution:
    known = _observed(system)
    gamma = scene.reference.jet(t, 1)
    position_and_rate = ca.vertcat(system.output, ca.mtimes(system.C, system.v))
    evaluate = ca.Function(
        "sc_report",
        [ca.vertcat(system.q, system.v), system.lam, system.u, system.p],
        [
            ca.vertcat(*known.values()),
            position_and_rate,
            system.constraints,
            ca.mtimes(system.G, system.v),
        ],
    ).map(len(t))
    u = np.array([inputs(time) for time in t]).T
    values, motion, g, g_dot = (
        np.asarray(each) for each in evaluate(states, multipliers.T, u, np.tile(p[:, None], len(t)))
    )
    m = len(system.outputs)
    deviation = np.linalg.norm(motion[:m].T - gamma[:, 0], axis=1)
    rate_deviation = np.linalg.norm(motion[m:].T - gamma[:, 1], axis=1)
    for row, quantity in zip(values, known, strict=True):
        if quantity.wraps:
            row[:] = np.unwrap(row)
    channels = tuple(Channel(each.name, each.unit, each.description, each.wraps) for each in known)
    tracking = Channel("tracking_error", system.outputs[0].unit, "distance of the servo output from the reference")
    steps, evaluations = counts
    statistics = Statistics(
        steps, 0, evaluations, 0.0,
        float(deviation.max()), float(rate_deviation.max()),
        float(np.abs(g).max(initial=0.0)), float(np.abs(g_dot).max(initial=0.0)),
    )  # fmt: skip
    table = np.column_stack([values.T, deviation])
    return Solution(t, (*channels, tracking), table, f"{system.name}, forward simulation", statistics)


def _observed(system: MechanicalSystem) -> dict[Quantity, ca.SX]:
    """Observables that do not need the reference, outputs, and coordinates whose names are still free."""
    known = {k: e for k, e in system.observables.items() if not ca.depends_on(e, ca.vec(system.gamma))}
    known |= {each: system.u[k] for k, each in enumerate(system.inputs)}
    names = {each.name for each in known}
    for quantities, expressions in ((system.outputs, system.output), (system.coordinates.quantities, system.q)):
        for k, each in enumerate(quantities):
            if each.name not in names:
                known[each] = expressions[k]
                names.add(each.name)
    return known
