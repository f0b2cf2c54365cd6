"""`fastest`: how soon a manoeuvre can be over within the limits, with a certificate that it keeps them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel, InvalidReference, InvalidSetting, PlanningFailed
from servocore.model.limits import Bounds
from servocore.model.scene import Scene, require_scene
from servocore.planning.certificate import certify
from servocore.planning.curves import along, slopes_at, through_points
from servocore.planning.laws import peaks, shape_of, shortest_three_phase, smooth_polynomial
from servocore.planning.report import PlanReport
from servocore.planning.rows import limit_rows, require_at_rest
from servocore.planning.search import EXCESS, planned
from servocore.planning.transcription import Task
from servocore.problem import Problem
from servocore.references.base import Reference, points
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.profiles import three_phase
from servocore.references.timed_path import TimedPath, chained

Way: TypeAlias = Reference | npt.ArrayLike | Sequence[Sequence[float]]
"""A reference, of which the curve counts and not the times, or waypoints (n, m)."""

_ROOM = 2e-4  # of the half range, kept free: what is planned then keeps its limits with no excess at all
_REST_POINTS = 401


def fastest(
    scene: Scene,
    path: Way,
    limits: Mapping[str, Bounds | None] | None = None,
    *,
    smooth: int = 0,
    robust: Mapping[str, tuple[float, float]] | None = None,
    model: str | None = None,
    intervals: int = 80,
    progress: Callable[[str], None] | None = None,
) -> tuple[Reference, PlanReport]:
    """Return the fastest law along a way that keeps all limits of a scene, and what is known about it.

    Parameters
    ----------
    scene : Scene
        Without internal dynamics; its own limits count.
    path : Reference or array_like, shape (n, m)
        The curve of a reference, without its times, or waypoints: the line between two, the natural spline of degree 7
        through more.
    limits : mapping of str to bounds, optional
        More limits, as `Scene.with_limits` takes them.
    smooth : int
        How many derivatives of the inputs shall be continuous, besides the inputs themselves.
    robust : mapping of str to pair, optional
        Factors of parameters by name, a smallest and a largest: the limits are kept at all corners as well, as with
        ``{"load_mass": (0.9, 1.1)}`` by a load ten per cent lighter or heavier.
    model : str, optional
        Model of the scene; its smallest when not given.
    intervals : int
        Of the grid, even. The duration is above the shortest by about one part in `intervals`.
    progress : callable, optional
        Told in a few words what is under way.

    Returns
    -------
    Reference
        The path with its times, at rest before and after.
    PlanReport
        Its duration, what holds it back, and how it is known that the limits are kept.

    Raises
    ------
    InvalidReference
        If a limit cannot be kept at any speed, because it is broken at rest, or the way is none.
    InvalidModel
        If the model has internal dynamics, or no formula gives its motion from the path.
    InvalidSetting
        If there are no limits, or something asked for makes no sense.
    PlanningFailed
        If the solver found no law from any start.

    Examples
    --------
    >>> path, report = sc.fastest(crane, [(5, 0, -5), (-2, 2, -2)], {"M_b": 1000, "F": 60, "swing": "5 deg"})
    >>> sc.solve(crane.with_reference(path))
    """
    require_scene(scene, "fastest")
    if not (isinstance(intervals, int) and intervals >= 4 and intervals % 2 == 0):
        raise InvalidSetting(f"a plan needs an even number of intervals, 4 or more, not {intervals!r}")
    if not (isinstance(smooth, int) and 0 <= smooth <= 2):
        raise InvalidSetting(
            f"smooth says how many derivatives of the inputs shall be continuous, 0 to 2, not {smooth!r}"
        )
    bounded = scene.with_limits(**(limits or {}))
    curve = curve_of(path, len(scene.model(model).outputs), scene.name)
    corners = tuple(corner_problems(bounded, model, robust or {}))
    length = corners[0].array.reference_order + smooth
    task = task_along(curve, corners, length)
    found = planned(task, intervals, progress)
    reference = TimedPath.of(curve, found.outcome.law.path())
    certificate = certify(tuple(replace(each, reference=reference) for each in corners))
    if certificate.violation > EXCESS:
        raise PlanningFailed(
            f"{scene.name}: the law that was found breaks the limit of {certificate.worst} by"
            f" {certificate.violation:.2g} of half its range between the points that the solver looked at"
        )
    smooth_enough = length <= three_phase().smoothness and np.isfinite(found.polynomial)
    report = PlanReport(
        duration=reference.duration,
        degree9=found.polynomial,
        three_phase=shortest_three_phase(task, found.polynomial)[0] if smooth_enough else np.nan,
        certificate=certificate,
        grid_error=found.coarse - reference.duration,
        status=found.outcome.status,
        iterations=found.iterations,
        rounds=found.rounds,
        start=found.start,
    )
    return reference, report


def curve_of(path: Way, outputs: int, name: str) -> PiecewisePolynomial:
    """Return the curve of a reference or through waypoints; raises `InvalidReference` if it does not fit the scene."""
    curve = along(path) if isinstance(path, Reference) else through_points(points(path, "waypoint"))
    if curve.dimension != outputs:
        raise InvalidReference(f"{name} needs a path with {outputs} components, this one has {curve.dimension}")
    return curve


def corner_problems(scene: Scene, model: str | None, robust: Mapping[str, tuple[float, float]]) -> list[Problem]:
    """Return the problem at the scene's own parameters and at all corners of ranges of some of them."""
    for name, ends in robust.items():
        if not (isinstance(ends, tuple | list) and len(ends) == 2 and ends[0] <= ends[1]):
            raise InvalidSetting(f"the range of {name} must be a smallest and a largest factor, not {ends!r}")
        if name not in scene.parameter_values():
            raise InvalidSetting(
                f"{scene.name} has no parameter {name}; there are {', '.join(scene.parameter_values())}"
            )
    own = scene.parameter_values()
    corners = (
        [{k: factor * own[k] for k, factor in zip(robust, each, strict=True)} for each in product(*robust.values())]
        if robust
        else []
    )
    found = [Problem.of(each, model) for each in (scene, *(scene.with_parameters(**corner) for corner in corners))]
    first = found[0]
    if not first.flat or first.follow_branch:
        why = "follows a branch" if first.flat else "has internal dynamics"
        raise InvalidModel(f"{scene.name} {why}: its inputs depend on what was before, and no plan can be made for it")
    if first.system.time.numel():
        raise InvalidModel(f"{scene.name}: its equations hold the time, and no plan can be made for it")
    if not any(not each.of_path for each in first.limits):
        raise InvalidSetting(f"{scene.name} has no limits: without any there is no fastest law")
    return found


def task_along(curve: PiecewisePolynomial, corners: Sequence[Problem], length: int) -> Task:
    """Return what a law along a curve must do; raises `InvalidReference` if a limit cannot be kept at rest."""
    begin, places = curve.ends[0], curve.jet(np.linspace(0.0, 1.0, _REST_POINTS), 0)[:, 0]
    every = [limit_rows(each, begin) for each in corners]
    for rows, each in zip(every, corners, strict=True):
        require_at_rest(rows, each, places, _ROOM)
    orders = 1 + max(length, *(each.order for each in every))
    s = ca.SX.sym("s", 1, orders)
    inner = [s[:, k] for k in range(orders)]
    gamma = ca.horzcat(*chained(slopes_at(curve, s[0], orders - 1), inner))
    found, lower = [], []
    for rows, each in zip(every, corners, strict=True):
        kept = np.flatnonzero(rows.moving)
        found.append(rows.function(gamma[:, : rows.order + 1], each.p)[kept.tolist()])
        lower.append(rows.lower[kept])
    function = ca.Function("sc_task", [s], [ca.densify(ca.vertcat(*found))], {"cse": True})
    bounds = np.concatenate(lower)
    shape = shape_of(smooth_polynomial(length))
    return Task(
        rows=function,
        lower=np.where(np.isfinite(bounds), -1.0 + _ROOM, -np.inf),
        upper=np.full(len(bounds), 1.0 - _ROOM),
        start=np.zeros(1),
        end=np.ones(1),
        length=length,
        peaks=peaks(shape, length)[:, None],
        forward=True,
    )
