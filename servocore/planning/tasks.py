"""Planning tasks, along a curve or free in space, and the laws that the search starts from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import factorial
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel, InvalidReference, InvalidSetting, LimitBroken, ServocoreError
from servocore.model.limits import limit_named, reported_quantities
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array
from servocore.planning.integrator_chains import Law, sampled_law
from servocore.planning.limit_rows import Inner, Rows, limit_rows, require_at_rest
from servocore.planning.space import Space
from servocore.planning.time_laws import law_between, peaks, polynomial_path, shortest, smooth_polynomial
from servocore.planning.transcription import Task
from servocore.problem import Problem
from servocore.references.base import Reference, points
from servocore.references.bspline import pieces_of
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.profiles import three_phase
from servocore.references.rest_to_rest import RestToRest
from servocore.references.timed_path import chained

Way: TypeAlias = Reference | npt.ArrayLike | Sequence[Sequence[float]]
"""A reference, of which the curve counts and not the times, or waypoints (n, m)."""

_ROOM = 2e-4  # of the half range, kept free: plans then keep their limits exactly
_REST_POINTS = 401
_COMPARED, _ALIKE = 21, 1e-5  # instants at which rows of two models are compared, and how well they agree
_HOPS = ((0.15, 0.3), (0.5, 0.7))  # of the way's length: how far aside free plans start; the second if all are blocked
_STARTS = 4  # at most: where bodies leave hardly any room each takes long


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
        if not ends[0] <= 1.0 <= ends[1]:
            raise InvalidSetting(
                f"the range of {name} is one of factors and has to hold 1, its own value, as 0.9..1.1 does:"
                f" {ends[0]:g}..{ends[1]:g} does not"
            )
        if name not in scene.parameter_values():
            raise InvalidSetting(
                f"{scene.name} has no parameter {name}; there are {', '.join(scene.parameter_values())}"
            )
    own, corners = scene.parameter_values(), list(product(*robust.values())) if robust else []
    varied = [{k: own[k] * factor for k, factor in zip(robust, factors, strict=True)} for factors in corners]
    problems = [Problem.of(each, model) for each in (scene, *(scene.with_parameters(**each) for each in varied))]
    first = problems[0]
    if not first.flat or first.follow_branch:
        why = "follows a branch" if first.flat else "has internal dynamics"
        raise InvalidModel(f"{scene.name} {why}: its inputs depend on the past of the path; it has no plan")
    if first.system.time.numel():
        raise InvalidModel(f"{scene.name}: its equations depend on time, and it has no plan")
    if all(limit.of_path for limit in first.limits):
        raise InvalidSetting(f"{scene.name} has no limits: without any there is no fastest law")
    return problems


def with_a_formula(
    scene: Scene, corners: Sequence[Problem], robust: Mapping[str, tuple[float, float]], curve: PiecewisePolynomial
) -> Sequence[Problem]:
    """Return the corners by the model that has its limits as expressions of the path; as they are without one.

    Where the motion itself is unknown at every point of the grid, a plan takes many times as long. Another model
    does only if it has the same limits, to round-off, along a smooth law on the curve.
    """
    if not _of_motion(corners, curve):
        return corners
    for name in scene.models:
        try:
            candidates = corner_problems(scene, name, robust)
            if not _of_motion(candidates, curve) and _agree(corners, candidates, curve, scene.reference.duration):
                return candidates
        except ServocoreError:  # it has not all quantities that are limited
            continue
    return corners


def _of_motion(corners: Sequence[Problem], curve: PiecewisePolynomial) -> bool:
    return any(limit_rows(corner, curve.ends[0]).inner.size for corner in corners)


def _agree(one: Sequence[Problem], other: Sequence[Problem], curve: PiecewisePolynomial, duration: float) -> bool:
    """Whether limits of two models are the same along the smooth polynomial law."""
    path = polynomial_path(curve, duration, one[0].array.reference_order)
    values = []
    for problem in (*one, *other):
        rows = limit_rows(problem, curve.ends[0])
        values.append(rows.at(path.jet(np.linspace(0.0, duration, _COMPARED), rows.order), problem.p)[0])
    return np.allclose(values[: len(one)], values[len(one) :], rtol=0.0, atol=_ALIKE, equal_nan=True)


def _kept_at_rest(corners: Sequence[Problem], begin: Array, places: Array) -> list[Rows]:
    """Return the limits of all corners; raises `InvalidReference` if one cannot be kept at rest at places."""
    every = [limit_rows(corner, begin) for corner in corners]
    for rows, corner in zip(every, corners, strict=True):
        require_at_rest(rows, corner, places, _ROOM)
    return every


def task_along(curve: PiecewisePolynomial, corners: Sequence[Problem], length: int) -> Task:
    """Return the task of a law along a curve; raises `InvalidReference` if a limit cannot be kept at rest."""
    every = _kept_at_rest(corners, curve.ends[0], curve.jet(np.linspace(0.0, 1.0, _REST_POINTS), 0)[:, 0])
    orders = 1 + max(length, *(rows.order for rows in every))
    s = ca.SX.sym("s", 1, orders)
    gamma = ca.horzcat(*chained(slopes_at(curve, s[0], orders - 1), ca.horzsplit(s)))
    return _task(s, gamma, every, corners, np.array([[0.0], [1.0]]), length)


def task_free(ends: Array, corners: Sequence[Problem], length: int, space: Space) -> Task:
    """Return the task of a law between places (2, m); raises `InvalidReference` if a limit cannot be kept at one."""
    every = _kept_at_rest(corners, ends[0], ends)
    orders = max(2, length, *(rows.order for rows in every)) + 1
    gamma, system = ca.SX.sym("gamma", ends.shape[1], orders), corners[0].system
    clear = ca.Function("sc_clear", [system.gamma, system.p], [space.rows(system.gamma, system.parameters)])
    padded = ca.horzcat(gamma, ca.SX.zeros(ends.shape[1], system.gamma.size2() - orders))
    return _task(gamma, gamma, every, corners, ends, length, clear(padded, corners[0].p))


def _task(
    jets: ca.SX,
    gamma: ca.SX,
    every: Sequence[Rows],
    corners: Sequence[Problem],
    ends: Array,
    length: int,
    away: ca.SX | None = None,
) -> Task:
    """Stack the limits of all corners, on the path gamma of chains; `away` are rows of obstacles, of a free path."""
    of_jets, given = ca.Function("sc_path", [jets], [gamma]), ca.MX.sym("jets", *jets.shape)
    expressions, lower, symbols, equations, begun, integrands = [], list[Array](), [], [], [], []
    for rows, corner in zip(every, corners, strict=True):
        kept = np.flatnonzero(rows.moving) if away is None else np.arange(len(rows.limits))
        symbols.append(ca.SX.sym("inner", rows.inner.size))
        values, zero, added, _ = rows.inner.local(gamma[:, : rows.order + 1], symbols[-1], corner.p)
        equations.append(zero)
        integrands.append(added)
        begun.append(rows.inner.start(of_jets(given)[:, : rows.order + 1], corner.p))
        expressions.append(values[kept.tolist()])
        lower.append(rows.lower[kept])
    if away is not None:
        expressions.append(away)
        lower.append(np.full(away.numel(), -np.inf))
    bounds, way = np.concatenate(lower), float(np.linalg.norm(ends[1] - ends[0]))
    sizes = peaks(smooth_polynomial(length), length)[:, None] * np.full(ends.shape[1], way)
    sizes[0] = np.maximum(np.abs(ends).max(axis=0), way)
    stacked = [ca.vertcat(*each) for each in (expressions, equations, integrands)]
    local = ca.Function(
        "sc_local_rows", [jets, ca.vertcat(*symbols)], [ca.densify(each) for each in stacked], {"cse": True}
    )
    return Task(
        inner=Inner(local, ca.Function("sc_inner", [given], [ca.vertcat(*begun)])),
        most=np.concatenate([rows.most for rows in every]),
        lower=np.where(np.isfinite(bounds), -1.0 + _ROOM, -np.inf),
        upper=np.full(len(bounds), 1.0 - _ROOM),
        start=ends[0],
        end=ends[1],
        length=length,
        peaks=sizes,
        forward=away is None,
    )


def gravity_of(problem: Problem) -> float:
    """Return the acceleration by which a load hangs, in m/s2: zero where no parameter is called so."""
    return float(dict(zip(problem.system.parameters.names, problem.p, strict=True)).get("gravity", 0.0))


def rope_is_depth(problem: Problem, places: Array) -> bool:
    """Whether at rest at some places (n, m) the rope is as long as the load is low: the trolley is at height zero."""
    if not {"l", "gravity"} <= {*reported_quantities(problem.system), *problem.system.parameters.names}:
        return False
    rows = limit_rows(replace(problem, limits=(limit_named(problem.system, "l", (None, 1.0)),)), places[0])
    return np.allclose(rows.at_rest(places, problem.p)[2], -places[:, -1])


def starts_along(task: Task, polynomial: float, intervals: int) -> list[tuple[str, Law]]:
    """Return laws to start from, the best first."""
    own, far = smooth_polynomial(task.length), smooth_polynomial(task.length + 2)
    tried = ((own, "", 1.02), (own, ", slow", 3.0), (three_phase(), "", 1.5), (far, "", 1.02), (own, ", fast", 0.5))
    return [
        (f"{law.name} law{pace}", law_between(task.start, task.end, task.length, law, share * polynomial, intervals))
        for law, pace, share in tried
    ]


def starts_free(
    task: Task, corners: Sequence[Problem], space: Space, intervals: int
) -> tuple[list[tuple[str, Law]], float]:
    """Return laws to start a free plan from, those that clear all bodies first, and a typical duration."""
    way = task.end - task.start
    length = float(np.linalg.norm(way))
    starts = _begun(task, corners, space, intervals, {"the line": np.zeros(len(way))})
    for shares in _HOPS:
        aside = {
            f"a way {share:g} of its length {name}": share * length * direction
            for share in shares
            for name, direction in _directions(way / length)
        }
        starts += _begun(task, corners, space, intervals, aside)
        if not all(blocked for blocked, *_ in starts):
            break
    if not starts:
        raise LimitBroken(
            f"{corners[0].name}: no way was found from which to start: at rest on the line between the ends, and beside"
            f" it, a limit is broken"
        )
    starts.sort(key=lambda each: each[:2])
    return [(name, law) for _, _, name, law in starts[:_STARTS]], starts[0][1]


def _begun(
    task: Task, corners: Sequence[Problem], space: Space, intervals: int, offsets: Mapping[str, Array]
) -> list[tuple[bool, float, str, Law]]:
    """Return ways that pass beside the middle, if limits can be kept on them: blocked or not, duration, name, law."""
    gravity, starts = gravity_of(corners[0]), []
    for name, offset in offsets.items():
        middle = [(task.start + task.end) / 2.0 + offset] if offset.any() else []
        curve = through_points(np.array([task.start, *middle, task.end]))
        try:
            duration = shortest(task_along(curve, corners, task.length), smooth_polynomial(task.length))
        except LimitBroken:
            continue
        if not np.isfinite(duration):
            continue
        path = polynomial_path(curve, 1.02 * duration, task.length)
        jets = path.jet(np.linspace(0.0, path.duration, intervals + 1), task.length).transpose(1, 0, 2)
        law = sampled_law(jets, path.duration, task.length)
        starts.append((space.clearance(path, gravity) <= 0.0, duration, f"law along {name}", law))
    return starts


def _directions(way: Array) -> list[tuple[str, Array]]:
    """Return unit vectors across a way: upwards first, then to both sides."""
    up = np.eye(len(way))[-1]
    up = up - way * float(up @ way)
    if len(way) < 2 or np.linalg.norm(up) < 1e-6:
        return []
    up /= np.linalg.norm(up)
    if len(way) != 3:
        return [("above", up)]
    left = np.cross(up, way)
    return [("above", up), ("to the left", left), ("to the right", -left)]


# Curves to be passed through as fast as limits allow: P(s), 0 <= s <= 1, of pieces, never at rest in s ----------------

_DEGREE = 7
_NATURAL = 4
_SAMPLES = (9, 13, 17, 25, 33)  # pieces cost time: no more of them than the curve needs
_CLOSE, _CLOSE_ENOUGH = 1e-5, 2e-4  # of the length
_LOOKED_AT = 2001
_STILL = 1e-12  # of the coordinates: round-off of a fit to samples that rest


def through_points(waypoints: Array) -> PiecewisePolynomial:
    """Return the natural spline of degree 7 through waypoints (n, m), by chord length; a line through two.

    Raises
    ------
    InvalidReference
        If two waypoints that follow one another coincide.
    """
    chords = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    repeated = np.flatnonzero(chords == 0.0)
    if len(waypoints) < 2:
        raise InvalidReference("a path needs two waypoints or more, not one")
    if repeated.size:
        raise InvalidReference(f"waypoints {repeated[0]} and {repeated[0] + 1} coincide: the path does not move there")
    if len(waypoints) <= _NATURAL:  # through so few points it is one polynomial: no fourth derivative to be made small
        u = np.append(0.0, np.cumsum(chords)) / chords.sum() - 0.5
        factors: Array = np.linalg.solve(np.vander(u, increasing=True), waypoints).astype(np.float64)
        return _curve(np.array([0.0, 1.0]), factors[None])
    natural = [(order, np.zeros(waypoints.shape[1])) for order in (4, 5, 6)]
    return _spline(waypoints, np.append(0.0, np.cumsum(chords)), (natural, natural))


def along(reference: Reference) -> PiecewisePolynomial:
    """Return the curve that a reference passes through, without its times; its `fit_error` is how far it is from it.

    Paths that rest at an end often begin with a curvature that is infinite there: such an end is smoothed.

    Raises
    ------
    InvalidReference
        If a spline does not come close enough: the curve has a corner, or turns back.
    """
    if isinstance(reference, RestToRest):
        return through_points(np.array([reference.start, reference.end]))
    t = np.linspace(reference.start_time, reference.end_time, _LOOKED_AT)
    places = reference.jet(t, 0)[:, 0]
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    if not np.ptp(places, axis=0).max() > _STILL * np.abs(places).max():
        raise InvalidReference("the path stays where it is: there is nothing to be passed through")
    moving = np.append(True, np.diff(way) > 0.0)
    way, t = way[moving], t[moving]
    for count in _SAMPLES:
        at = np.interp(np.linspace(0.0, way[-1], count), way, t)
        curve = _spline(reference.jet(at, 0)[:, 0], np.interp(at, t, way), None)
        finer = np.interp(np.linspace(0.0, way[-1], 20 * count), way, t)
        s = np.interp(finer, t, way) / way[-1]
        deviation = float(_distance(curve, reference.jet(finer, 0)[:, 0], s).max()) / way[-1]
        if deviation <= _CLOSE:
            break
    if deviation <= _CLOSE_ENOUGH:
        return replace(curve, fit_error=deviation * float(way[-1]))
    raise InvalidReference(
        f"no smooth curve follows the path: a spline of degree {_DEGREE} leaves it by {deviation * way[-1]:.3g} m,"
        f" which a corner or a place where it turns back explains"
    )


def _distance(curve: PiecewisePolynomial, places: Array, s: Array) -> Array:
    """Return how far places are from a curve, across it: where along it each belongs is known to a little only."""
    for _ in range(3):
        jet = curve.jet(np.clip(s, 0.0, 1.0), 1)
        away = places - jet[:, 0]
        s = s + np.sum(away * jet[:, 1], axis=1) / np.sum(jet[:, 1] ** 2, axis=1)
    return np.asarray(np.linalg.norm(places - curve.jet(np.clip(s, 0.0, 1.0), 0)[:, 0], axis=1))


def _spline(points: Array, s: Array, ends: Any) -> PiecewisePolynomial:
    """Interpolate points; `s` are the ways to them."""
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - the library is imported where SciPy is not

    spline = make_interp_spline(s / s[-1], points, k=_DEGREE, bc_type=ends)
    return _curve(*pieces_of(spline))


def _curve(knots: Array, coefficients: Array) -> PiecewisePolynomial:
    degree = coefficients.shape[1] - 1
    ends = np.stack([np.power(u, np.arange(degree + 1)) @ coefficients[k] for k, u in ((0, -0.5), (-1, 0.5))])
    smoothness = 99 if len(knots) == 2 else degree - 1
    return PiecewisePolynomial.of(knots, coefficients, smoothness, ends, (False, False))


def slopes_at(curve: PiecewisePolynomial, s: ca.SX, order: int) -> list[ca.SX]:
    """Return P and its derivatives by s up to an order as expressions of s, columns (m, 1)."""
    knots, factors = curve.knots, curve.coefficients
    degree, count = factors.shape[1] - 1, len(knots) - 1

    def piecewise(values: Array) -> ca.SX:
        return ca.pw_const(s, ca.DM(knots[1:-1]), ca.DM(values)) if count > 1 else ca.SX(float(values[0]))

    length = piecewise(np.diff(knots))
    u = (s - piecewise((knots[1:] + knots[:-1]) / 2.0)) / length
    terms = [ca.vertcat(*[piecewise(factors[:, k, row]) for row in range(curve.dimension)]) for k in range(degree + 1)]
    slopes = []
    for nu in range(order + 1):
        value = ca.SX.zeros(curve.dimension)
        for k in range(degree, nu - 1, -1):
            value = value * u + terms[k] * (factorial(k) // factorial(k - nu))
        slopes.append(value / length**nu)
    return slopes
