"""`solve`: the only loop over time."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.analysis import ADVICE, NON_MINIMUM_PHASE, internal_dynamics
from servocore.calls import Call
from servocore.errors import InconsistentStart, IntegrationFailed, InvalidReference, InvalidSetting
from servocore.feasibility import require_feasible, side_by_side
from servocore.formulations import Formulation, Reduced
from servocore.methods import BackwardEuler, Method
from servocore.program import Program
from servocore.references import Reference
from servocore.scene import Scene
from servocore.solution import Solution, Statistics
from servocore.stepper import Stepper
from servocore.symbols import Array

Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

CHUNK = 512
"""Most steps in one compiled loop: cheap to build, and progress can be shown in between."""

_DEFAULT_STEPS = 200


def solve(
    scene: Scene,
    formulation: Formulation | None = None,
    method: Method | None = None,
    *,
    step: float | None = None,
    model: str | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Compute the inputs that make the servo output follow the scene's reference.

    Parameters
    ----------
    scene : Scene
        The problem, with its reference and parameters.
    formulation : Formulation, optional
        What the analysis recommends when not given (`Reduced`, unless the internal dynamics are unstable).
    method : Method, optional
        `BackwardEuler` when not given.
    step : float, optional
        Step size in s; must divide the duration of the reference. A 200th of the duration when not given.
    model : str, optional
        Model of the scene; its smallest when not given.
    progress : callable, optional
        Called with (steps done, steps in all) after every chunk of steps.

    Returns
    -------
    Solution
        At start_time, start_time + step, ..., end_time.

    Raises
    ------
    InvalidReference
        If the path breaks a limit of the scene or lacks derivatives.
    InvalidSetting
        If the step is not positive, exceeds the duration or does not divide it.
    InconsistentStart
        If no consistent initial values are found.
    IntegrationFailed
        If a step is not solved.
    """
    t, step = time_grid(scene.reference, step)
    advice = ""
    if formulation is None:
        formulation, advice = recommended(scene, model)
    stepper = Stepper(scene, formulation, method or BackwardEuler(), step, model)
    program, p = stepper.program, stepper.parameters
    _require_derivatives(scene.reference, program)
    require_feasible(scene.reference, stepper.system, scene.limits, p)
    jets = scene.reference.jet(t, program.start_order)
    past = scene.reference.jet(t[0] + step * np.array(program.start_instants), program.start_order)
    state, report = program.begin(past, p, step)
    if not report.converged or not report.residual < np.inf:
        raise InconsistentStart(f"{program.name}: no consistent initial values at t = {t[0]:.6g} s")
    states, counts, residuals = _run(scene, program, p, t, step, state, progress)
    values, violations = _observe(program, states, jets, p)
    statistics = Statistics(
        len(t) - 1,
        int(counts[0].sum()),
        int(counts[1].sum()),
        float(max(report.residual, residuals.max(initial=0.0))),
        *(float(each) for each in violations.max(axis=1)),
    )
    return Solution(t, program.channels, values, program.name, statistics, scene.reference.fit_error, advice)


def recommended(scene: Scene, model: str | None = None) -> tuple[Formulation, str]:
    """Return the formulation that the analysis recommends and what it says.

    Raises
    ------
    InvalidSetting
        If the internal dynamics are unstable, so that no integration forward in time can succeed.
    """
    kind, rate = internal_dynamics(scene, model)
    if kind == NON_MINIMUM_PHASE:
        raise InvalidSetting(
            f"{scene.name} has unstable internal dynamics (non-minimum phase): integrating forward in time, errors grow"
            f" like exp({rate:.3g} t); name a formulation and a method to do it all the same"
        )
    return Reduced(), f"{kind}: {ADVICE[kind]}"


def time_grid(reference: Reference, step: float | None) -> tuple[Array, float]:
    """Return the instants from start to end, a whole number of equal steps, and the step.

    Raises
    ------
    InvalidSetting
        If the step is not positive, exceeds the duration or does not divide it.
    """
    duration = reference.duration
    if step is None:
        step = duration / _DEFAULT_STEPS
    if not 0.0 < step < float("inf"):
        raise InvalidSetting(f"the step must be positive and finite, not {step} s")
    if step > duration * (1 + 1e-9):
        raise InvalidSetting(f"the step of {step:g} s is larger than the duration of {duration:g} s")
    count = round(duration / step)
    if abs(count * step - duration) > 1e-6 * step:
        below, above = duration / np.ceil(duration / step), duration / max(1, np.floor(duration / step))
        raise InvalidSetting(
            f"the step of {step:g} s does not divide the duration of {duration:g} s;"
            f" the nearest that do are {below:.10g} s and {above:.10g} s"
        )
    # k * step rather than a running sum; the last instant is the end of the path to the last bit.
    t: Array = reference.start_time + np.arange(count + 1, dtype=np.float64) * (duration / count)
    t[-1] = reference.end_time
    return t, duration / count


def _require_derivatives(reference: Reference, program: Program) -> None:
    needed = program.start_order
    if reference.max_order < needed:
        raise InvalidReference(
            f"the path has derivatives up to order {reference.max_order}, {program.name} needs order {needed}"
        )


def _run(
    scene: Scene, program: Program, p: Array, t: Array, step: float, state: Array, progress: Progress | None
) -> tuple[Array, Array, Array]:
    """Step through all instants; returns states (size, N + 1), counts (2, N) and residuals (N,)."""
    count = len(t) - 1
    chunks = -(-count // CHUNK)
    length = -(-count // chunks)
    loop = _accumulated(program.step, length)
    states, counts, residuals = [state[:, None]], [], []
    for begin in range(0, count, length):
        used = min(length, count - begin)
        # A last chunk that is not full is padded with the final instant; what it gives there is dropped.
        ends = t[np.minimum(np.arange(begin + 1, begin + length + 1), count)]
        nodes = [scene.reference.jet(ends - (1.0 - c) * step, program.order) for c in program.nodes]
        gamma = np.concatenate(nodes, axis=1)
        found, count_rows, worst = loop(
            states[-1][:, -1],
            side_by_side(gamma),
            np.full((1, length), step),
            np.tile(p[:, None], length),
        )
        found, count_rows, worst = found[:, :used], count_rows[:, :used], worst.ravel()[:used]
        failed = ~np.isfinite(found).all(axis=0) | ~np.isfinite(worst)
        if failed.any():
            at = int(failed.argmax())
            before = found[:, at - 1] if at else states[-1][:, -1]
            _fail(scene, program, p, before, t[begin + at], step)
        states.append(found)
        counts.append(count_rows)
        residuals.append(worst)
        if progress is not None:
            progress(begin + used, count)
    return np.hstack(states), np.hstack(counts), np.concatenate(residuals)


def _fail(scene: Scene, program: Program, p: Array, state: Array, time: float, step: float) -> None:
    nodes = np.array([time + c * step for c in program.nodes])
    worst = program.worst_equation(state, scene.reference.jet(nodes, program.order), step, p)
    raise IntegrationFailed(
        f"{program.name}: the step from t = {time:.6g} s to {time + step:.6g} s was not solved;"
        f" the worst equation is the {worst}. Likely causes: a step too large for the path, or a configuration"
        f" close to a singular one"
    )


def _observe(program: Program, states: Array, jets: Array, p: Array) -> tuple[Array, Array]:
    """Return observed values (N, channels), angles made continuous, and violations (4, N)."""
    count = len(jets)
    values, violations = _mapped(program.observe, count)(states, side_by_side(jets), np.tile(p[:, None], count))
    table = values.T
    for k, channel in enumerate(program.channels):
        if channel.wraps:
            table[:, k] = np.unwrap(table[:, k])
    return table, violations


@lru_cache(maxsize=128)
def _mapped(function: ca.Function, count: int) -> Call:
    return Call(function.map(count))


@lru_cache(maxsize=128)
def _accumulated(function: ca.Function, count: int) -> Call:
    return Call(function.mapaccum(f"{function.name()}_loop", count))
