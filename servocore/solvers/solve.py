"""`solve`: from a scene to its inputs."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from servocore.solvers.accuracy import Adaptive, Fixed
from servocore.analysis import ADVICE, NON_MINIMUM_PHASE, internal_dynamics
from servocore.solvers.boundary_value import BoundaryValue, solve_boundary_value
from servocore.solvers.adaptive import solve_to_tolerance
from servocore.structure.derivative_array import derivative_array
from servocore.errors import InvalidSetting, ServocoreWarning
from servocore.checks.limits import require_feasible
from servocore.formulations import Formulation, Reduced
from servocore.solvers.fixed_step import Progress, observe, run, statistics
from servocore.methods import BackwardEuler, Method, RadauIIA
from servocore.checks.wrong_inputs import angles_of, follow_angles, warn_of_wrong_inputs
from servocore.checks.branches import require_one_branch
from servocore.solvers.state_selection import solve_with_states
from servocore.problem import prepared
from servocore.references import Reference
from servocore.model.scene import Scene
from servocore.solution import Solution
from servocore.stepping.stepper import Stepper
from servocore.model.symbols import Array

_DEFAULT_STEPS = 200


def solve(
    scene: Scene,
    formulation: Formulation | None = None,
    method: Method | BoundaryValue | None = None,
    *,
    step: float | Fixed | Adaptive | None = None,
    output_step: float | None = None,
    model: str | None = None,
    progress: Progress | None = None,
    native: bool = False,
    checks: bool = True,
) -> Solution:
    """Compute the inputs that make the servo output follow the scene's reference.

    Parameters
    ----------
    scene : Scene
        The problem, with its reference and parameters.
    formulation : Formulation, optional
        What the analysis recommends when not given (`Reduced`, unless the internal dynamics are unstable).
    method : Method, optional
        `BackwardEuler` when not given; `RadauIIA` of three stages when the formulation is not given either.
    step : float, Fixed or Adaptive, optional
        Step size in s, which must divide the duration of the reference; a 200th of the duration when not given. Or
        the accuracy wanted of the inputs.
    output_step : float, optional
        With `Adaptive`: time between reported instants, a 200th of the duration when not given.
    model : str, optional
        Model of the scene; its smallest when not given.
    progress : callable, optional
        Called with (steps done, steps in all) after every chunk of steps.
    native : bool
        Whether a C compiler shall turn the program into machine code first, see `Stepper`: for many solves.
    checks : bool
        False leaves out what finds mistakes: the survey of the scene's limits, the warnings, and the search of the
        result for wrong branches. For many solves on paths like one that was solved with them.

    Returns
    -------
    Solution
        At start_time, start_time + step, ..., end_time.

    Raises
    ------
    InvalidReference
        If the path breaks a limit of the scene or lacks derivatives.
    InvalidSetting
        If the step is not positive, exceeds the duration or does not divide it; if there is no C compiler for `native`.
    InconsistentStart
        If no consistent initial values are found.
    IntegrationFailed
        If a step is not solved, an angle turns too far between two instants to tell which way, or the motion changes
        branch where the constraints lose rank.

    Warns
    -----
    ServocoreWarning
        Before the run if it cannot succeed: internal dynamics that grow, a path that is too rough, a form of an index
        on which the inputs of the method do not converge. After it if an input is off by more than half of its peak.
    """
    advice = ""
    if formulation is None and method is None:
        formulation, method, advice = recommended(scene, model)
    if isinstance(method, BoundaryValue):
        return replace(_solve_bounded(scene, formulation, method, step, model, progress), advice=advice)
    formulation = formulation or Reduced()
    if checks:
        warn_of_growth(scene, model)
        warn_of_jumps(scene, model)
    control = step if isinstance(step, Adaptive) else Fixed(step) if not isinstance(step, Fixed) else step
    if output_step is not None and not isinstance(control, Adaptive):
        raise InvalidSetting("an output step of its own goes with error control; without it every step is reported")
    setting = output_step if isinstance(control, Adaptive) else control.h
    t, h = time_grid(scene.reference, setting)
    stepper = Stepper(scene, formulation, method or BackwardEuler(), h, model, native)
    if checks:
        warn_of_index(stepper)
        require_feasible(scene.reference, stepper.system, scene.limits, stepper.parameters, t)
    if isinstance(control, Adaptive):
        solution = solve_to_tolerance(stepper, control, t, progress)
    elif isinstance(formulation, Reduced) and stepper.index == 1:
        solution = solve_with_states(stepper, formulation, t, progress)
    else:
        solution = solve_at_constant_step(stepper, t, progress, checks)
    if checks:
        require_one_branch(stepper.system, scene.reference, stepper.parameters, solution)
    return replace(solution, advice=advice)


def solve_at_constant_step(
    stepper: Stepper, t: Array, progress: Progress | None = None, checks: bool = True
) -> Solution:
    """Step through the instants `t`, one step of the stepper apart, and report every one."""
    reference, program, p = stepper.scene.reference, stepper.program, stepper.parameters
    done = run(reference, program, p, t, stepper.step, progress)
    values, violations = observe(program, reference, p, t, done.states, angles_of(stepper))
    follow_angles(stepper, t, done.states, values)
    if checks:
        warn_of_wrong_inputs(stepper, t, values)
    summary = statistics(done, values[:, : len(stepper.system.inputs)], violations)
    return Solution(t, program.channels, values, program.name, summary, reference.fit_error)


def _solve_bounded(
    scene: Scene,
    formulation: Formulation | None,
    route: BoundaryValue,
    step: float | Fixed | Adaptive | None,
    model: str | None,
    progress: Progress | None,
) -> Solution:
    if formulation not in (None, Reduced()):
        raise InvalidSetting(f"a bounded inversion works on the reduced form, not on {formulation}")
    if isinstance(step, Adaptive):
        raise InvalidSetting("a bounded inversion controls its mesh itself; give its tolerance to BoundaryValue")
    _, h = time_grid(scene.reference, step.h if isinstance(step, Fixed) else step)
    base = scene.model(model)
    p = base.parameters.values(scene.parameters)
    system = prepared(base, p)[0]
    require_feasible(scene.reference, system, scene.limits, p)
    solution = solve_boundary_value(system, scene.reference, p, route, h, progress)
    require_one_branch(system, scene.reference, p, solution)
    return solution


def recommended(scene: Scene, model: str | None = None) -> tuple[Formulation, Method | BoundaryValue, str]:
    """Return the formulation and the method that the analysis recommends, and what it says."""
    kind, _ = internal_dynamics(scene, model)
    method = BoundaryValue() if kind == NON_MINIMUM_PHASE else RadauIIA(3)
    return Reduced(), method, f"{kind}: {ADVICE[kind]}"


def warn_of_growth(scene: Scene, model: str | None = None) -> None:
    """Warn before unstable internal dynamics are integrated forward in time."""
    kind, rate = internal_dynamics(scene, model)
    if kind == NON_MINIMUM_PHASE:
        warnings.warn(
            f"{scene.name} has unstable internal dynamics (non-minimum phase): forward in time errors grow like"
            f" exp({rate:.3g} t), {np.exp(rate * scene.reference.duration):.2g}-fold by"
            f" t = {scene.reference.end_time:g} s; the method BoundaryValue finds the bounded solution",
            ServocoreWarning,
            stacklevel=3,
        )


def warn_of_jumps(scene: Scene, model: str | None = None) -> None:
    """Warn if the path is not smooth enough for continuous inputs."""
    base = scene.model(model)
    order = derivative_array(prepared(base, base.parameters.values(scene.parameters))[0]).reference_order
    reference = scene.reference
    if reference.smoothness < order <= reference.max_order:
        warnings.warn(
            f"the inputs of {scene.name} need the path's derivative of order {order}, but the path is continuous up to"
            f" order {reference.smoothness} only: the inputs jump between t = {reference.start_time:g} s and"
            f" {reference.end_time:g} s, the ends included, wherever that derivative does",
            ServocoreWarning,
            stacklevel=3,
        )


def warn_of_index(stepper: Stepper) -> None:
    """Warn before a method runs on a form of an index on which its inputs do not converge."""
    if stepper.index <= 1:
        return
    # What a form says of its index holds where the structural index is five.
    index = stepper.index + max(0, derivative_array(stepper.system).signature.index - 5)
    order = stepper.method.orders(index).forces
    if index > 3 and order < 1:
        warnings.warn(
            f"{stepper.program.name}: the form has index {index}, on which the inputs of {stepper.method.name} err like"
            f" the step to the power {order} and no step is small enough; use the form Reduced(), or BackwardEuler()",
            ServocoreWarning,
            stacklevel=3,
        )


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
