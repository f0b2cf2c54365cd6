"""`Sphere` and `Box`: obstacles of a plan, as numbers and smooth expressions, and how near a moving segment comes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeAlias

import casadi as ca
import numpy as np

from servocore.errors import InvalidSetting
from servocore.numerics.compiled_calls import Array

_POWER = 8  # of the norm whose unit ball rounds the edges of a box: a larger one is nearer to the box, but stiffer
_TIP = 1e-6  # relative; keeps roots differentiable where a distance is zero
_HALVINGS = 24  # of a segment, to find its point nearest to a box: the error of the distance is of second order


@dataclass(frozen=True)
class Sphere:
    """All places nearer to a centre than a radius.

    Parameters
    ----------
    centre : tuple of float
        As many coordinates as the scene has outputs, m.
    radius : float
        In m.
    """

    centre: tuple[float, ...]
    radius: float

    def __post_init__(self) -> None:
        if not 0.0 < self.radius < np.inf:
            raise InvalidSetting(f"the radius of a sphere must be positive, not {self.radius:g} m")
        _require_finite(self.centre)

    def row(self, place: ca.SX) -> ca.SX:
        """Return an expression that is below one outside.

        Parameters
        ----------
        place : casadi.SX, shape (m,)
            A place, in m.

        Returns
        -------
        casadi.SX
            A number without unit.
        """
        offset = (place - ca.DM(self.centre)) / self.radius
        return 2.0 - ca.sqrt(ca.sumsqr(offset) + _TIP**2)

    def nearest(self, begin: ca.SX, end: ca.SX) -> ca.SX:
        """Return the point of a segment that is nearest to the sphere, where `row` is largest.

        Parameters
        ----------
        begin, end : casadi.SX, shape (m,)
            Ends of the segment, in m.

        Returns
        -------
        casadi.SX, shape (m,)
            In m.
        """
        segment = end - begin
        fraction = ca.dot(ca.DM(self.centre) - begin, segment) / (ca.sumsqr(segment) + _TIP**2)
        return begin + ca.fmin(ca.fmax(fraction, 0.0), 1.0) * segment

    def thickened(self, size: float) -> Sphere:
        """Return the sphere with a radius of at least a size in m.

        Parameters
        ----------
        size : float
            In m.

        Returns
        -------
        Sphere
            Around the same centre.
        """
        return replace(self, radius=max(self.radius, size))

    def distance(self, places: Array) -> Array:
        """Return how far places (..., m) are outside, in m; negative within.

        Parameters
        ----------
        places : ndarray, shape (..., m)
            In m.

        Returns
        -------
        ndarray, shape (...)
            In m.
        """
        return np.asarray(np.linalg.norm(places - np.array(self.centre), axis=-1) - self.radius)


@dataclass(frozen=True)
class Box:
    """All places that differ from a centre by less than half sizes, along every axis.

    Parameters
    ----------
    centre, half : tuple of float
        As many numbers as the scene has outputs, m.
    """

    centre: tuple[float, ...]
    half: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.half) != len(self.centre) or not min(self.half) > 0.0:
            raise InvalidSetting(f"a box needs a positive half size along each axis, not {self.half}")
        _require_finite((*self.centre, *self.half))

    def row(self, place: ca.SX) -> ca.SX:
        """Return an expression that is below one outside a smooth body around the box, which is a little larger.

        Parameters
        ----------
        place : casadi.SX, shape (m,)
            A place, in m.

        Returns
        -------
        casadi.SX
            A number without unit.
        """
        offset = (place - ca.DM(self.centre)) / self._sizes
        return 2.0 - (ca.sum1(offset**_POWER) + _TIP**_POWER) ** (1.0 / _POWER)

    @property
    def _sizes(self) -> ca.DM:
        """Half axes of the smooth body around the box."""
        return ca.DM(np.array(self.half) * len(self.half) ** (1.0 / _POWER))

    def nearest(self, begin: ca.SX, end: ca.SX) -> ca.SX:
        """Return the point of a segment that is nearest to the smooth body, where `row` is largest, by bisection.

        Parameters
        ----------
        begin, end : casadi.SX, shape (m,)
            Ends of the segment, in m.

        Returns
        -------
        casadi.SX, shape (m,)
            In m.
        """
        offset, segment = (begin - ca.DM(self.centre)) / self._sizes, (end - begin) / self._sizes
        low, fraction = ca.SX(0.0), ca.SX(0.5)
        for k in range(1, _HALVINGS + 1):  # the norm is convex along a segment: its slope changes sign once
            slope = ca.dot((offset + fraction * segment) ** (_POWER - 1), segment)
            low = ca.if_else(slope < 0.0, fraction, low)
            fraction = low + 0.5 ** (k + 1)
        # The norm is stationary there, so that its derivatives are right although the bisection is not differentiated.
        return begin + fraction * (end - begin)

    def thickened(self, size: float) -> Box:
        """Return the box with half sizes of at least a size in m.

        Parameters
        ----------
        size : float
            In m.

        Returns
        -------
        Box
            Around the same centre.
        """
        return replace(self, half=tuple(max(half, size) for half in self.half))

    def distance(self, places: Array) -> Array:
        """Return how far places (..., m) are outside, in m; negative within.

        Parameters
        ----------
        places : ndarray, shape (..., m)
            In m.

        Returns
        -------
        ndarray, shape (...)
            In m.
        """
        over = np.abs(places - np.array(self.centre)) - np.array(self.half)
        outside = np.linalg.norm(np.maximum(over, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(over.max(axis=-1), 0.0))


Obstacle: TypeAlias = Sphere | Box


def _require_finite(numbers: Iterable[float]) -> None:
    for number in numbers:
        if not np.isfinite(number):
            raise InvalidSetting(f"a body to keep out of needs finite numbers, not {number}")


_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
_SHRINKS = 32  # of the part of a segment where a body is nearest: to 2e-7 of it
_INSTANTS = 20_001  # of the first grid
_SPLIT, _LEVELS, _MOST = 16, 4, 1_000_000  # pieces of a doubtful interval, how often it is split, pieces at the most

Ends = Callable[[Array], tuple[Array, Array]]
"""Instants (N,) -> where a segment begins and ends, (N, m) each."""

Distance = Callable[[Array], Array]
"""Places (N, m) -> how far they are outside of a convex body, negative within."""


def least_distance(ends: Ends, distance: Distance, begin: float, end: float) -> float:
    """Return how near a moving segment comes to a body, in m.

    Parameters
    ----------
    ends : callable
        Of the segment.
    distance : callable
        From the body.
    begin, end : float
        Of the time.

    Returns
    -------
    float
        Negative where it enters the body, and where that cannot be excluded: where, between the closest instants
        evaluated, it might move as far as the body is away.
    """
    t = np.linspace(begin, end, _INSTANTS)
    spans, least = np.column_stack([t[:-1], t[1:]]), np.inf
    for level in range(_LEVELS):
        pieces = 1 if level == 0 else _SPLIT
        edges = spans[:, :1] + np.diff(spans, axis=1) * np.linspace(0.0, 1.0, pieces + 1)
        instants, places = np.unique(edges, return_inverse=True)
        begins_and_ends = ends(instants)
        distances = segment_distance(*begins_and_ends, distance)
        least = min(least, float(distances.min()))
        if least < 0.0:
            return least
        places = places.reshape(edges.shape)
        first, second = places[:, :-1].ravel(), places[:, 1:].ravel()
        moved = np.max([np.linalg.norm(points[second] - points[first], axis=1) for points in begins_and_ends], axis=0)
        # Between two instants no point moves farther than the ends do, so that no distance can fall below this.
        room = (distances[first] + distances[second] - moved) / 2.0
        doubtful = room <= 0.0
        if not doubtful.any():
            return least
        spans = np.column_stack([instants[first], instants[second]])[doubtful]
        if len(spans) * _SPLIT > _MOST:
            break
    return float(room.min())


def segment_distance(begin: Array, end: Array, distance: Distance) -> Array:
    """Return how far segments are from a convex body, by the golden section: along a segment the distance is convex.

    Parameters
    ----------
    begin, end : ndarray, shape (N, m)
        Of the segments.
    distance : callable
        From the body.

    Returns
    -------
    ndarray, shape (N,)
        In m, negative within.
    """
    low, high = np.zeros((len(begin), 1)), np.ones((len(begin), 1))
    least = np.minimum(distance(begin), distance(end))
    for _ in range(_SHRINKS):
        inner = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        values = [distance(begin + fraction * (end - begin)) for fraction in inner]
        least = np.minimum(least, np.minimum(*values))
        rises = (values[0] < values[1])[:, None]
        low, high = np.where(rises, low, inner[0]), np.where(rises, inner[1], high)
    return least
