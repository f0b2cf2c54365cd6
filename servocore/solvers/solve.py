"""`solve`: from a scene to its inputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from servocore.checks.before_run import ADVICE, internal_dynamics, require_feasible, require_smooth, warn_before_run
from servocore.checks.better_solutions import LARGEST_UNWARNED, steps_that_stand_out, unknown_errors
from servocore.checks.between_instants import hidden_values
from servocore.checks.findings import Finding, told
from servocore.checks.motion import Motion, passed, poles_passed
from servocore.errors import (
    InconsistentStart,
    IntegrationFailed,
    InvalidSetting,
    ServocoreError,
    require_callable,
    require_formulation,
    require_method,
    require_real,
)
from servocore.formulations.base import Formulation
from servocore.formulations.reduced import Reduced
from servocore.methods.base import Method
from servocore.model.scene import Scene, require_scene
from servocore.numerics.compiled_calls import Array
from servocore.numerics.step_operations import KINKS
from servocore.problem import Problem
from servocore.references.base import time_grid
from servocore.solution import ErrorEstimate, Solution, Statistics
from servocore.solvers.exact_inversion import EXACT, Pointwise
from servocore.solvers.route import Adaptive, JudgedRoute, Route
from servocore.solvers.runs import Progress, with_run_quantities
from servocore.stepping.exact_evaluation import exact_unknowns, unknowns_near
from servocore.stepping.prescribed_initial_values import require_start
from servocore.stepping.program import program_of


def solve(
    scene: Scene,
    formulation: Formulation | None = None,
    method: Method | Route | None = None,
    *,
    step: float | Adaptive | None = None,
    output_step: float | None = None,
    model: str | None = None,
    start: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    native: bool | None = None,
    checks: bool = True,
    certify: bool = False,
) -> Solution:
    """Compute the inputs that make the servo output follow the scene's reference.

    Parameters
    ----------
    scene : Scene
        With its reference and parameters.
    formulation, method : Formulation, Method or Route, optional
        The recommendation of the analysis when neither is given; else `Reduced` and `BackwardEuler`.
    step : float or Adaptive, optional
        Step in s, which must divide the duration of the path (a 200th of it when not given), or the accuracy wanted.
    output_step : float, optional
        With `Adaptive`: time between reported instants, a 200th of the duration when not given.
    model : str, optional
        Model of the scene; its smallest when not given.
    start : mapping of str to float, optional
        Initial values of the internal dynamics by name, ``theta`` and ``theta_dot``; at rest when not given.
    progress : callable, optional
        Called with (steps done, steps in all) from time to time.
    native : bool, optional
        Whether as machine code: True makes it first, False never; else it comes in the background for many solves.
    checks : bool
        False leaves out limits and warnings.
    certify : bool
        Whether the result must not be refuted by `servocore.certify`, by which inputs may be off by 1e-8 of their
        peaks, and those of time steps by 5 %. Undecided certificates are warned of.

    Returns
    -------
    Solution
        Inputs, observables, outputs and coordinates at the instants, and how the run went.

    Raises
    ------
    ServocoreError
        If the path or the motion breaks a limit, the path lacks derivatives, the step does not fit, no compiler is
        there for `native`, no initial values are found, a step is not solved, or the motion changes branch where two
        meet, or an input has a pole, or the certificate is refuted.

    Warns
    -----
    ServocoreWarning
        If the run cannot succeed as it is set up, or an input is off by more than 5 % of its peak, or may be.
    """
    require_scene(scene, "solve")
    if formulation is not None:
        require_formulation(formulation)
    if method is not None:
        require_method(method)
    _require_settings(step, output_step, progress)
    problem, advice, form = Problem.of(scene, model, start), "", formulation or Reduced()
    if formulation is None and method is None:
        method, advice = recommended(problem)
    times = time_grid(problem.reference, output_step if isinstance(step, Adaptive) else step)
    if problem.start:
        require_start(problem)
    route = chosen_route(problem, form, method, step, native, checks)
    is_route = route is method  # a user's route has no checks, and chooses its instants
    checked = checks or is_route
    if checked:
        require_feasible(problem, None if is_route else times)

    try:
        solution = _run(problem, route, times, progress or (lambda *_: None), checked)
    except (InconsistentStart, IntegrationFailed) as error:
        from servocore.checks.failure_causes import explained  # noqa: PLC0415 - looked for where something failed

        raise explained(problem, error) from None
    solution = replace(
        solution,
        statistics=_checked(problem, route, solution) if checked else solution.statistics,
        advice=advice,
        estimator=solution.estimator or partial(error_estimate, problem, route),
        fit_estimator=partial(_fit_effect, problem, route),
        origin=problem,
        motion=None,
    )
    if certify:
        from servocore.certificate.certify import require_certified  # noqa: PLC0415 - few ask

        require_certified(solution, 1e-8 if isinstance(route, Pointwise) else LARGEST_UNWARNED)
    return solution


def _run(problem: Problem, route: Route, times: Array, progress: Progress, checked: bool) -> Solution:
    """Run a route, and bring the exact motion that checks read; raise `LimitBroken` for a limit that is not kept.

    Without internal dynamics limits are kept by the exact motion, with them at the instants of the run.
    """
    limits = problem.motion_limits if checked else ()
    if limits and not problem.flat:
        from servocore.checks.motion_limits import with_limits_required, with_watched  # noqa: PLC0415 - few have limits

        watched = with_watched(problem)
        return with_limits_required(watched, with_run_quantities(route.run(watched, times, progress)))
    solution = with_run_quantities(route.run(problem, times, progress))
    motion: Motion | None = solution.motion
    if checked and problem.flat and motion is None and len(solution.t) > 1:
        try:
            motion = Pointwise(Reduced()).run(problem, solution.t).motion
        except ServocoreError:
            if limits:
                raise
            if problem.resolved.holds(KINKS):  # the guess of the model may still do
                motion = Motion(problem, solution.t, exact_unknowns(problem, solution.t)[0], by_guess=True)
        solution = replace(solution, motion=motion)
    if not limits or motion is None:
        return solution
    from servocore.checks.motion_limits import with_limits_kept  # noqa: PLC0415 - as above

    return with_limits_kept(motion, solution)


def _checked(problem: Problem, route: Route, solution: Solution) -> Statistics:
    """Refuse or warn of what checks find; return the statistics with the branch stated."""
    statements = told(problem.system.name, solution.route, [*_findings(problem, solution)])
    stated = solution.statistics.branch  # a user's route states its branch itself
    if isinstance(route, JudgedRoute):
        stated = route.branch_statement(problem, solution)
    return replace(solution.statistics, branch=stated + statements)


def _findings(problem: Problem, solution: Solution) -> Iterator[Finding]:
    """Yield what the checks find, refusals first."""
    motion, coordinates = solution.motion, problem.system.coordinates.names
    if motion is None and not set(coordinates) <= set(solution.names):
        return  # a user's route reports what it will
    t, kinked = solution.t if motion is None else motion.t, problem.resolved.holds(KINKS)
    if kinked or problem.resolved.redundant or problem.resolved.mass_varies:
        from servocore.checks.along_motion import jumps, left_out, negative_masses  # noqa: PLC0415 - many need none

        q = np.stack([solution[name] for name in coordinates]) if motion is None else motion.q
        yield from negative_masses(problem, t, q)
        yield from left_out(problem, t, q)
    if not problem.flat:
        inputs = solution.values[:, : len(problem.system.inputs)]
        odd = steps_that_stand_out(inputs)
        if kinked or len(odd):
            motion = Motion(problem, t, unknowns_near(problem, solution, t), by_guess=False)
            yield from poles_passed(motion, odd, inputs.T, problem.system.inputs)
    if motion is None:
        return
    if kinked:
        yield from jumps(motion)
    if motion.values is not None:
        yield from passed(motion)
        if not problem.follow_branch:  # through singularities, beside which values are round-off
            yield from hidden_values(motion, program_of(problem, Reduced()), motion.values)


def _require_settings(step: float | Adaptive | None, output_step: float | None, progress: Progress | None) -> None:
    """Raise `InvalidSetting` if a setting is of the wrong kind."""
    if step is not None and not isinstance(step, Adaptive):
        require_real(step, "the step", "a time in s or Adaptive(...)", InvalidSetting)
    if output_step is not None:
        require_real(output_step, "the output step", "a time in s", InvalidSetting)
        if not isinstance(step, Adaptive):
            raise InvalidSetting("output_step needs step=Adaptive(...); at constant step every step is reported")
    if progress is not None:
        require_callable(progress, "progress", "a function of (steps done, steps in all)")


def chosen_route(
    problem: Problem,
    formulation: Formulation,
    method: Method | Route | None,
    step: float | Adaptive | None,
    native: bool | None,
    checks: bool,
) -> Route:
    """Return the route that fits the form: its index decides, and whether a step or a tolerance is given.

    Raises
    ------
    InvalidSetting
        If a stable inversion has another form than `Reduced`, a tolerance for its steps, or a start.
    """
    if isinstance(method, JudgedRoute):
        method.require_suits(problem, formulation, adaptive=isinstance(step, Adaptive))
    if hasattr(method, "run"):  # to ask the protocol takes as long as a check
        return cast(Route, method)
    if checks:
        require_smooth(problem)  # names inputs that drive nothing; forms of the problem do not
    stepped = bool(problem.dae(formulation).x.numel())
    if stepped and method is None:
        from servocore.methods.backward_euler import BackwardEuler  # noqa: PLC0415 - a flat scene takes no steps

        method = BackwardEuler()
    if checks:
        warn_before_run(problem, formulation, method)
    if method is None or not stepped:
        return Pointwise(formulation, native)
    from servocore.solvers.fixed_step import FixedStep, ToTolerance  # noqa: PLC0415 - as above

    if isinstance(step, Adaptive):
        return ToTolerance(formulation, method, native, step)
    return FixedStep(formulation, method, native)


def error_estimate(problem: Problem, route: Route, solution: Solution) -> ErrorEstimate:
    """Return how far the inputs of a solution by a route are from more accurate ones."""
    try:
        if not (isinstance(route, JudgedRoute) or problem.flat):
            raise ServocoreError(f"no more accurate solver of {problem.system.name} is known for this route")
        better = route.better(problem) if isinstance(route, JudgedRoute) else EXACT
        return better.compared(problem, solution).estimate
    except ServocoreError as error:
        return unknown_errors(problem, solution, str(error))


def _fit_effect(problem: Problem, route: Route, solution: Solution) -> ErrorEstimate | None:
    """Return how much inputs depend on the samples that a path is fitted to; None if no samples were fitted.

    Paths fitted to half of the samples each are independent: their difference has twice the deviation of the path's own
    error, which makes the largest of all differences a moderate upper estimate.
    """
    from servocore.references.piecewise import PiecewisePolynomial  # noqa: PLC0415 - for paths of samples only
    from servocore.references.timed_path import TimeAugmented  # noqa: PLC0415

    path = problem.reference.path if isinstance(problem.reference, TimeAugmented) else problem.reference
    if not isinstance(path, PiecewisePolynomial) or path.refitted is None or not isinstance(route, JudgedRoute):
        return None
    fits = [solution]
    try:
        for half in path.refitted():
            reference = half if path is problem.reference else TimeAugmented.of(half)
            fits.append(route.run(replace(problem, reference=reference), solution.t))
    except ServocoreError as error:
        return unknown_errors(problem, solution, str(error))
    peaks = unknown_errors(problem, solution, "").peaks
    apart = {name: float(np.ptp([fit[name] for fit in fits], axis=0).max()) for name in peaks}
    return ErrorEstimate(apart, peaks, "fits to every second sample")


def recommended(problem: Problem) -> tuple[Method | Route | None, str]:
    """Return the method that the analysis recommends for the reduced form, None if it needs none, and its advice."""
    dynamics = internal_dynamics(problem)
    advice = f"{dynamics.kind}: {ADVICE[dynamics.kind]}"
    if problem.flat:
        return None, advice  # without differential states all methods are one
    if not dynamics.grows:
        from servocore.methods.collocation import RadauIIA  # noqa: PLC0415 - a flat scene takes no steps

        return RadauIIA(3), advice
    from servocore.solvers.stable_inversion import StableInversion  # noqa: PLC0415 - few scenes need it

    return StableInversion(), advice
