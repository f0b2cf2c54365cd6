"""Curves to be passed through as fast as limits allow: P(s), 0 <= s <= 1, of pieces, never at rest in s."""

from __future__ import annotations

from dataclasses import replace
from math import factorial
from typing import Any

import casadi as ca
import numpy as np

from servocore.errors import InvalidReference
from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference
from servocore.references.bspline import pieces_of
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.rest_to_rest import RestToRest

_DEGREE = 7
_NATURAL = 4
_SAMPLES = (9, 13, 17, 25, 33)  # pieces cost time: no more of them than the curve needs
_CLOSE, _CLOSE_ENOUGH = 1e-5, 2e-4  # of the length
_LOOKED_AT = 2001


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
    return _spline(waypoints, chords, (natural, natural))


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
    if not way[-1] > 0.0:
        raise InvalidReference("the path stays where it is: there is nothing to be passed through")
    moving = np.append(True, np.diff(way) > 0.0)
    way, t = way[moving], t[moving]
    deviation = np.inf
    for count in _SAMPLES:
        at = np.interp(np.linspace(0.0, way[-1], count), way, t)
        chosen = reference.jet(at, 0)[:, 0]
        curve = _spline(chosen, np.interp(at, t, way), None)
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


def _spline(points: Array, chords: Array, ends: Any) -> PiecewisePolynomial:
    """Interpolate points; `chords` are the distances between them, or the ways to them."""
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - the library is imported where SciPy is not

    s = np.append(0.0, np.cumsum(chords)) if len(chords) < len(points) else chords
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
