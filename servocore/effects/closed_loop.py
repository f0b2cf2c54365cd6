"""Simulation of a plant under given inputs and position loops, until some time after the end of its path."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.effects.model_inversion import Inverted
from servocore.effects.position_loops import held, measured_in
from servocore.errors import InvalidModel
from servocore.numerics.compiled_calls import Array, Call, chained, mapped, repeated
from servocore.numerics.memoization import made_once
from servocore.problem import ResolvedSystem
from servocore.stepping.forward_dynamics import forward_rate, runge_kutta

COARSEST = 0.02
"""Largest step of a run, in s."""

_STABLE = 1.0  # step times the fastest eigenvalue: the classical method is stable to 2.8
_SMALLEST = 1e-5  # s: a plant that is stiffer is not run


@dataclass(frozen=True, eq=False)
class Loop:
    """A plant with drives, compiled.

    Attributes
    ----------
    step : casadi.Function
        (state, signals (3 m, 3), p, gains (2 m), zero (m), h) -> state; signals are inputs, positions and rates at the
        begin, the middle and the end of the step.
    read : Call
        State -> positions of the drives.
    linear : Call
        (state, signal, p, gains, zero) -> Jacobians of the rate by the state and by the inputs, of the output by the
        state.
    seen : casadi.Function
        (state, p) -> output, and the hanging body if there is one.
    """

    step: ca.Function
    read: Call
    linear: Call
    seen: ca.Function


@made_once
def compile_loop(resolved: ResolvedSystem, measured: tuple[str, ...], hanging: tuple[str, ...]) -> Loop:
    """Compile a plant with drives.

    Parameters
    ----------
    resolved : ResolvedSystem
        The plant.
    measured : tuple of str
        Names of the quantities that its drives measure.
    hanging : tuple of str
        Observables of q that together say how far the load hangs to the side; empty for none.
    """
    system = resolved.system
    if system.time.numel():
        raise InvalidModel(f"{system.name}: its equations depend on time; position loops need equations that do not")
    quantities, y = measured_in(system, measured)
    m, state = len(system.inputs), ca.vertcat(system.q, system.v)
    read = ca.Function("sc_drives", [state], [ca.densify(y), ca.densify(ca.jtimes(y, system.q, system.v))])
    rate = forward_rate(system, held=False)
    x, p, h = ca.MX.sym("x", state.numel()), ca.MX.sym("p", system.p.numel()), ca.MX.sym("h")
    signals, gains, zero = ca.MX.sym("w", 3 * m, 3), ca.MX.sym("k", 2 * m), ca.MX.sym("zero", m)

    def driven(now: ca.MX, signal: ca.MX) -> ca.MX:
        at, moving = read(now)
        return rate(now, held(quantities, signal, at - zero, moving, gains), ca.DM.zeros(m), p)[0]

    def given(time: ca.MX | float) -> ca.MX:  # the parabola through begin, middle and end
        s = 2 * time / h
        return signals @ ca.vertcat((s - 1) * (s - 2) / 2, s * (2 - s), s * (s - 1) / 2)

    after = runge_kutta(lambda now, time: driven(now, given(time)), x, h)
    swing = [expression for quantity, expression in system.observables.items() if quantity.name in hanging]
    signal = ca.MX.sym("now", 3 * m)
    seen = ca.Function("sc_loop_seen", [state, system.p], [ca.densify(ca.vertcat(system.output, *swing))])
    rates, output = driven(x, signal), seen(x, p)[: len(system.outputs)]
    jacobians = ca.jacobian(rates, x), ca.jacobian(rates, signal)[:, :m], ca.jacobian(output, x)
    step = ca.Function("sc_loop_step", [x, signals, p, gains, zero, h], [after])
    linear = ca.Function("sc_loop_linear", [x, signal, p, gains, zero], [ca.densify(each) for each in jacobians])
    return Loop(step, Call(read), Call(linear), seen)


@dataclass(frozen=True, eq=False)
class Run:
    """The results of a run.

    Attributes
    ----------
    moving : int
        Steps until the end of the path; more follow after it, or none.
    deviation : ndarray, shape (N, outputs)
        Output less path.
    hanging : ndarray, shape (N, any)
        Lateral displacement of the load, less its value at rest at the end.
    """

    moving: int
    deviation: Array
    hanging: Array

    @property
    def error(self) -> float:
        """Largest distance of the output from the path while that lasts; infinite where the plant did not survive."""
        deviation = self.deviation[: self.moving + 1]
        return float(np.linalg.norm(deviation, axis=1).max()) if np.isfinite(deviation).all() else np.inf

    @property
    def swing(self) -> float | None:
        """Peak swing after the end, of the hanging body or of the output about its mean; None where not simulated."""
        after = self.deviation[self.moving :]
        if len(after) < 2 or not np.isfinite(after).all():
            return None
        swing = self.hanging[self.moving :] if self.hanging.shape[1] else after - after.mean(axis=0)
        return float(np.linalg.norm(swing, axis=1).max())


def run_loop(
    plant: Inverted,
    model: Inverted,
    gains: Array,
    change: Array | float = 0.0,
    hanging: tuple[str, ...] = (),
    *,
    tail: float = 0.0,
    coarsest: float = COARSEST,
) -> Run:
    """Run a plant under the inputs of a model, with loops that hold its drives on the positions of the model.

    Parameters
    ----------
    plant : Inverted
        Its motion under its own inputs: it starts where that starts, and where that ends it hangs at rest.
    model : Inverted
        Motion of a model along the same path.
    gains : ndarray, shape (2, m)
        See `Inverted.gains`.
    change : ndarray, shape (N, m), or float
        Of the inputs of the model, at its instants.
    hanging : tuple of str
        See `compile_loop`.
    tail : float
        Time in s that the plant runs on after the end of the path, under the last inputs.
    coarsest : float
        Largest step, in s.

    Raises
    ------
    InvalidModel
        If the plant is too stiff to be run, or its equations depend on time.
    """
    problem, p, signals = plant.problem, plant.problem.p, model.signals
    loop = compile_loop(problem.resolved, plant.measured, hanging)
    zero = loop.read(plant.start)[0]
    signals[:, : len(zero)] += change
    jacobian = loop.linear(plant.start, signals[0], p, gains.ravel(), zero)[0]
    fastest = float(np.abs(np.linalg.eigvals(jacobian)).max()) if np.isfinite(jacobian).all() else np.inf
    step = min(coarsest, _STABLE / max(fastest, 1e-12))
    if not step > _SMALLEST:
        raise InvalidModel(
            f"{problem.system.name} is too stiff for a forward simulation: it needs steps of {step:.1g} s"
        )
    duration = model.t[-1] - model.t[0]  # longer than the path where its inputs begin before it
    moving, after = (int(np.ceil(time / step)) for time in (duration, tail))
    h = duration / moving
    at = model.t[0] + h / 2 * np.arange(2 * (moving + after) + 1)
    states = _integrated(loop, plant.start, _sampled(model.t, signals, at), (p, gains.ravel(), zero), h)
    seen = _seen(loop, states, p)
    at_end = _seen(loop, np.concatenate([plant.end, np.zeros(len(plant.end))])[None], p)[0]
    count = len(problem.system.outputs)
    path = problem.reference.jet(at[::2], 0)[:, 0]
    return Run(moving, seen[:, :count] - path, seen[:, count:] - at_end[count:])


def linear_answers(plant: Inverted, gains: Array, change: Array, hanging: tuple[str, ...]) -> Array:
    """Return how far changes of its inputs move a plant's output, if it were linear about rest at both ends of a path.

    Parameters
    ----------
    plant : Inverted
        Its own motion, from its start to its end.
    gains : ndarray, shape (2, m)
        Of the loops that hold its drives.
    change : ndarray, shape (N, m)
        Disturbance of the inputs, at the instants of the motion.
    hanging : tuple of str
        See `compile_loop`.

    Returns
    -------
    ndarray, shape (2,)
        Largest distances, linear about the start and about the end; infinite where there is no linear plant.
    """
    import scipy.signal  # noqa: PLC0415 - kept out of the run time of an FMU

    loop, n, errors = compile_loop(plant.problem.resolved, plant.measured, hanging), len(plant.end), []
    for q, u in ((plant.start[:n], plant.inputs[0]), (plant.end, plant.inputs[-1])):
        state = np.concatenate([q, np.zeros(n)])
        place, rate = loop.read(state)
        signal = np.concatenate([u, 0 * place, rate])
        A, B, C = loop.linear(state, signal, plant.problem.p, gains.ravel(), place)
        if not all(np.isfinite(matrix).all() for matrix in (A, B, C)):
            return np.full(2, np.inf)
        _, response, _ = scipy.signal.lsim((A, B, C, np.zeros((len(C), len(u)))), change, plant.t - plant.t[0])
        errors.append(np.linalg.norm(response.reshape(len(change), -1), axis=1).max())
    return np.array(errors)


def _seen(loop: Loop, states: Array, p: Array) -> Array:
    """Return outputs and hanging bodies, shape (N, outputs + hanging)."""
    observed = mapped(loop.seen, len(states))(states.T, repeated(p, len(states)))[0]
    return observed.reshape(-1, len(states), order="F").T


def _sampled(t: Array, signals: Array, at: Array) -> Array:
    """Return signals at other times; those after the last one are the last ones, at rest."""
    import scipy.interpolate  # noqa: PLC0415 - kept out of the run time of an FMU

    samples: Array = scipy.interpolate.make_interp_spline(t, signals, k=5)(np.clip(at, t[0], t[-1]))
    m = signals.shape[1] // 3
    samples[at > t[-1] + 1e-9 * (t[-1] - t[0]), 2 * m :] = 0.0
    return samples


def _integrated(loop: Loop, start: Array, signals: Array, held: tuple[Array, Array, Array], h: float) -> Array:
    """Return the states at the ends of all steps, shape (steps + 1, 2 n)."""
    steps = len(signals) // 2
    blocks = np.stack([signals[0:-1:2], signals[1::2], signals[2::2]], axis=1).reshape(3 * steps, -1).T
    arguments = [repeated(argument, steps) for argument in held]
    states = chained(loop.step, steps)(start, blocks, *arguments, np.full(steps, h))[0]
    return np.vstack([start, states.reshape(len(start), -1, order="F").T])
