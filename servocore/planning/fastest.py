"""`fastest`: near time-optimal trajectories within limits, with a proof that they keep them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from servocore.errors import InvalidSetting, LimitBroken, PlanningFailed, require_callable
from servocore.model.limits import RATE, Bounds
from servocore.model.scene import Scene, require_scene, within_limits
from servocore.planning.integrator_chains import Law
from servocore.planning.report import PlanReport, in_words, kept_limits
from servocore.planning.space import Space
from servocore.planning.tasks import (
    Way,
    corner_problems,
    curve_of,
    gravity_of,
    rope_is_depth,
    starts_along,
    starts_free,
    task_along,
    task_free,
    with_a_formula,
)
from servocore.planning.time_laws import LONGEST, shortest, shortest_three_phase, smooth_polynomial
from servocore.planning.transcription import CHECKS, SOLVED, Outcome, Task, Transcription
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.profiles import three_phase
from servocore.references.timed_path import TimedPath

_THIN = 0.4  # of the way, by the intervals: a thinner body may lie between two places at which the solver looks


def fastest(
    scene: Scene,
    path: Way,
    limits: Mapping[str, Bounds | None] | None = None,
    *,
    free: Space | None = None,
    smooth: int = 0,
    robust: Mapping[str, tuple[float, float]] | None = None,
    model: str | None = None,
    intervals: int = 80,
    certify: bool = True,
    progress: Callable[[str], None] | None = None,
) -> tuple[Reference, PlanReport]:
    """Return a near time-optimal trajectory along a path that keeps all limits of a scene, and a report.

    The default of 80 intervals is 1 to 2 % above the infimum, which inputs with jumps at the ends would reach.

    Parameters
    ----------
    scene : Scene
        Without internal dynamics; its own limits count.
    path : Reference or array_like, shape (n, m)
        The curve of a reference, without its times, or waypoints: the line between two, the natural spline of degree 7
        through more.
    limits : mapping of str to bounds, optional
        More limits, as `Scene.with_limits` takes them.
    free : Space, optional
        Whether the way between two points is free as well, with its obstacles. Every input needs a limit then.
    smooth : int
        How many derivatives of the inputs shall be continuous, besides the inputs themselves.
    robust : mapping of str to pair, optional
        Factors of parameters by name, a smallest and a largest: the limits are kept at all corners as well, as with
        ``{"load_mass": (0.9, 1.1)}`` by a load ten per cent lighter or heavier.
    model : str, optional
        Model of the scene that the certificate is made with; its smallest when not given. Where it has no formula for
        the motion and another model with the same limits has one, the law is looked for with that.
    intervals : int
        Of the grid, even. The duration is above the shortest by about one part in `intervals`.
    certify : bool
        Whether to prove that the limits are kept, rather than to evaluate them at twenty thousand instants.
    progress : callable, optional
        Called with a text on the progress.

    Returns
    -------
    Reference
        The path with its times, at rest before and after.
    PlanReport
        Duration, active constraints, and whether it is proved that the limits are kept: for all times, and with
        `robust` for all parameters in their ranges. Clearances from obstacles are evaluated at instants.

    Raises
    ------
    InvalidReference
        If the way is none.
    LimitBroken
        If a limit cannot be kept at any speed, because it is broken at rest, or limits are too tight for a million
        seconds.
    InvalidModel
        If the model has internal dynamics, or a limit is on the rate of something that is differentiated already.
    InvalidSetting
        If there are no limits, or a setting is invalid.
    PlanningFailed
        If the solver found no law from any start.

    Examples
    --------
    >>> import servocore as sc
    >>> crane, limits = sc.scenes.rotary_crane(), {"M_b": 1000, "F": 60, "swing": "5 deg"}
    >>> path, report = sc.fastest(crane, [(5, 0, -5), (-2, 2, -2)], limits)
    >>> report.duration < 20.0
    True
    >>> solution = sc.solve(crane.with_reference(path).with_limits(**limits))
    """
    require_scene(scene, "fastest")
    _require_settings(intervals, smooth)
    if progress is not None:
        require_callable(progress, "progress", "a function of a text")
    told = progress or (lambda _: None)
    bounded = within_limits(scene, limits)
    if isinstance(path, Reference) and path.dimension == scene.reference.dimension:
        scene.with_reference(path)  # which refuses units that are implausible for the scene
    curve = curve_of(path, len(scene.model(model).outputs), scene.name)
    corners = corner_problems(bounded, model, robust or {})
    length = corners[0].array.reference_order + smooth
    quick = with_a_formula(bounded, corners, robust or {}, curve)
    task, begun, scale = _begun(bounded, curve, quick, length, free, intervals, told)
    outcome, coarse, start = planned(task, begun, 1.02 * scale, intervals, told)
    law = outcome.law.path()
    reference = TimedPath.of(curve, law) if free is None else law
    clearance = np.inf if free is None else free.clearance(law, gravity_of(quick[0]))
    if free is not None and clearance < 0.0:
        raise PlanningFailed(
            f"{scene.name}: on the path that was found {', '.join(free.clearance_of)} do not keep clear of the bodies"
        )
    planned_corners = [replace(corner, reference=reference) for corner in corners]
    kept = kept_limits(bounded.with_reference(reference), model, planned_corners, robust or {}, certify)
    if kept.violation > EXCESS:
        # Rates of a length or an angle jump where it is zero. Programs see them rounded off there, on any grid.
        of = kept.worst.removesuffix(RATE)
        cure = f"limit {of} itself, or its rate less tightly" if of != kept.worst else "take more intervals or widen it"
        raise PlanningFailed(
            f"{scene.name}: the law that was found breaks the limit of {kept.worst} by"
            f" {kept.violation:.2g} of half its range between the points of the solver's grid; {cure}"
        )
    polynomial, ramped = _compared(task, scale) if free is None else _on_the_line(curve, quick, length)
    return reference, PlanReport(
        duration=reference.duration,
        degree9=polynomial,
        three_phase=ramped,
        degree=2 * length + 1,
        limits=kept,
        grid_error=coarse - reference.duration,
        status=outcome.status,
        iterations=outcome.iterations,
        rounds=outcome.rounds,
        start=start,
        deviation=reference.fit_error or 0.0,
        clearance=clearance,
    )


def _require_settings(intervals: int, smooth: int) -> None:
    """Refuse a grid or a smoothness that no plan has."""
    if not (isinstance(intervals, int) and intervals >= 4 and intervals % 2 == 0):
        raise InvalidSetting(f"a plan needs an even number of intervals, 4 or more, not {intervals!r}")
    if isinstance(smooth, bool) or not (isinstance(smooth, int) and 0 <= smooth <= 2):
        raise InvalidSetting(
            f"smooth says how many derivatives of the inputs shall be continuous, 0 to 2, not {smooth!r}"
        )


def _begun(
    scene: Scene,
    curve: PiecewisePolynomial,
    corners: Sequence[Problem],
    length: int,
    free: Space | None,
    intervals: int,
    told: Callable[[str], None],
) -> tuple[Task, list[tuple[str, Law]], float]:
    """Return the task of a plan, laws to start from, and a typical duration in s."""
    if free is not None:
        thick = _thickened(free, scene, curve, corners[0], intervals)
        task = task_free(curve.ends, corners, length, thick)
        told("looking for ways to start from")
        return task, *starts_free(task, corners, thick, intervals // 2)
    task = task_along(curve, corners, length)
    told("looking for a law to start from")
    scale = shortest(task, smooth_polynomial(length))
    if not np.isfinite(scale):
        raise LimitBroken(
            f"{scene.name}: limits so tight that a smooth law keeps them in no {LONGEST:g} s are not planned"
        )
    return task, starts_along(task, scale, intervals // 2), scale


def _thickened(space: Space, scene: Scene, curve: PiecewisePolynomial, problem: Problem, intervals: int) -> Space:
    """Return the obstacles as the solver sees them; raise unless a free path can be planned between a line's ends."""
    if len(curve.knots) > 2 or curve.coefficients.shape[1] > 2:
        raise InvalidSetting("a plan with a free path runs from one point to another: give two points")
    limited = {limit.quantity for limit in scene.limits}
    for quantity in problem.system.inputs:
        if quantity.name not in limited:
            raise InvalidSetting(f"a plan with a free path needs a limit of every input; {quantity.name} has none")
    space.require(problem.system, hangs=scene.tracked == "load" and rope_is_depth(problem, curve.ends))
    thick = space.thickened(_THIN * float(np.linalg.norm(curve.ends[1] - curve.ends[0])) / intervals)
    for place in curve.ends:
        thick.require_rest(scene.name, place)
    return thick


def _compared(task: Task, polynomial: float) -> tuple[float, float]:
    """Return the shortest durations of the polynomial and the best three-phase law."""
    smooth_enough = task.length <= three_phase().smoothness and np.isfinite(polynomial)
    return polynomial, shortest_three_phase(task, polynomial)[0] if smooth_enough else np.nan


def _on_the_line(curve: PiecewisePolynomial, corners: Sequence[Problem], length: int) -> tuple[float, float]:
    """Return the same on the line between the ends of a free path: infinite where a limit is broken at rest there."""
    try:
        line = task_along(curve, corners, length)
        return _compared(line, shortest(line, smooth_polynomial(length)))
    except LimitBroken:
        return np.inf, np.inf


# The search: from several starts, on a coarse and a fine grid, with bounds that are narrowed --------------------------

EXCESS = 1e-4
"""Of half its range: a limit broken by less counts as kept."""

_ROUNDS = 8  # of solving and narrowing bounds, at the most
_FINER, _FINEST = 10, 4800  # points of the finer grid between two of the program, and at least in all
_REFINEMENTS = 2  # how often the grid is doubled
_NARROWEST = 0.9  # of half the range
_BETWEEN = "limits broken between the points of the grid"


def planned(
    task: Task,
    begun: Sequence[tuple[str, Law]],
    scale: float,
    intervals: int,
    progress: Callable[[str], None],
) -> tuple[Outcome, float, str]:
    """Return the fastest law for a task, its duration on half as many intervals, and the law that it began with.

    Parameters
    ----------
    task : Task
        Boundary conditions and limits of the law.
    begun : sequence of (str, Law)
        Laws on half as many intervals to start from, the best first.
    scale : float
        A typical duration in s.
    intervals : int
        Of the grid, even.
    progress : callable
        Called with a text on the progress.

    Raises
    ------
    PlanningFailed
        If no start leads to one, with the status of the solver from each.
    """
    half, whole = (Transcription(task, count, scale) for count in (intervals // 2, intervals))
    free = np.zeros((len(task.upper), half.intervals * CHECKS)), np.full(len(task.most), EXCESS)
    failures = []
    for doubled in (True, False):  # half as many intervals may be too few
        for name, start in begun:
            coarse = half.solve(start, *free, progress) if doubled else Outcome(start, SOLVED, 0)
            outcome = _refined(whole, coarse, progress) if coarse.status == SOLVED else coarse
            if outcome.status == SOLVED:
                return outcome, coarse.law.duration if doubled else np.nan, name
            failures += [f"{in_words(outcome.status)}, from the {name}"] if doubled else []
    raise PlanningFailed(
        f"no law was found, which does not say that there is none: {'; '.join(failures)}; wider limits or other"
        " intervals may help"
    )


def _refined(whole: Transcription, found: Outcome, progress: Callable[[str], None]) -> Outcome:
    """Solve on a grid twice as fine, and on still finer ones where limits stay broken between the points."""
    for doubled in range(_REFINEMENTS + 1):
        finer = Transcription(whole.task, whole.intervals * 2**doubled, whole.scale) if doubled else whole
        found = _tightened(finer, found, progress)
        if found.status != _BETWEEN:
            break
    return found


def _tightened(program: Transcription, found: Outcome, progress: Callable[[str], None]) -> Outcome:
    """Solve from a law on half as many intervals, narrow bounds where a finer grid is beyond them, and solve again."""
    task, m = program.task, CHECKS
    finer = max(_FINER, -(-_FINEST // (program.intervals * m)))
    narrowed = np.zeros((len(task.upper), program.intervals * m))
    less = np.full(len(task.most), EXCESS)
    law, iterations, begun = found.law.refined(), found.iterations, found.rounds
    for rounds in range(begun, begun + _ROUNDS):
        outcome = program.solve(law, narrowed, less, progress)
        law, iterations = outcome.law, iterations + outcome.iterations
        outcome = replace(outcome, iterations=iterations, rounds=rounds)
        if outcome.status != SOLVED:
            return outcome
        parts = np.linspace(0.0, 1.0, finer * m + 1)
        values, integrands = (each.reshape(-1, program.intervals, len(parts)) for each in task.values(law.jets(parts)))
        over, beyond = task.excess(values), task.over_all(integrands, law.duration)
        if over.max(initial=0.0) <= EXCESS and beyond.max(initial=0.0) <= 0.0:
            return outcome
        spans = np.stack([over[:, :, finer * j : finer * (j + 1) + 1].max(axis=2) for j in range(m)], axis=2)
        after = spans.reshape(len(task.upper), -1)
        before = np.concatenate([np.zeros((len(task.upper), 1)), after[:, :-1]], axis=1)
        worst = np.maximum(after, before)
        # More would leave nothing between two bounds.
        narrowed = np.minimum(narrowed + np.where(worst > 0.0, 1.05 * worst + 1e-6, 0.0), _NARROWEST)
        less = less + np.maximum(1.05 * beyond, 0.0)
    return Outcome(law, _BETWEEN, iterations, begun + _ROUNDS)
