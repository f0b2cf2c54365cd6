"""Bodies to keep out of: how far away they are, as numbers and as smooth expressions, and where they are nearest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TypeAlias

import casadi as ca
import numpy as np

from servocore.errors import InvalidSetting
from servocore.numerics.compiled_calls import Array

_POWER = 8
_TIP = 1e-6
_HALVINGS = 24  # where along a rope a box is nearest: the error counts by its square


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
        away = (place - ca.DM(self.centre)) / self.radius
        return 2.0 - ca.sqrt(ca.sumsqr(away) + _TIP**2)

    def nearest(self, begin: ca.SX, end: ca.SX) -> ca.SX:
        """Return the place between two others whose `row` is largest.

        Parameters
        ----------
        begin, end : casadi.SX, shape (m,)
            Places, in m.

        Returns
        -------
        casadi.SX, shape (m,)
            In m.
        """
        way = end - begin
        part = ca.dot(ca.DM(self.centre) - begin, way) / (ca.sumsqr(way) + _TIP**2)
        return begin + ca.fmin(ca.fmax(part, 0.0), 1.0) * way

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
        away = (place - ca.DM(self.centre)) / self._sizes
        return 2.0 - (ca.sum1(away**_POWER) + _TIP**_POWER) ** (1.0 / _POWER)

    @property
    def _sizes(self) -> ca.DM:
        """Half axes of the smooth body around the box."""
        return ca.DM(np.array(self.half) * len(self.half) ** (1.0 / _POWER))

    def nearest(self, begin: ca.SX, end: ca.SX) -> ca.SX:
        """Return the place between two others whose `row` is largest, but for what hardly counts.

        Parameters
        ----------
        begin, end : casadi.SX, shape (m,)
            Places, in m.

        Returns
        -------
        casadi.SX, shape (m,)
            In m.
        """
        away, way = (begin - ca.DM(self.centre)) / self._sizes, (end - begin) / self._sizes
        low, part = ca.SX(0.0), ca.SX(0.5)
        for k in range(1, _HALVINGS + 1):  # the norm is convex along the way: its slope changes sign once
            low = ca.if_else(ca.dot((away + part * way) ** (_POWER - 1), way) < 0.0, part, low)
            part = low + 0.5 ** (k + 1)
        # Where the norm is least it does not change with the part to first order: the part may count as a constant.
        return begin + part * (end - begin)

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
        return replace(self, half=tuple(max(each, size) for each in self.half))

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


Body: TypeAlias = Sphere | Box


def _require_finite(numbers: Iterable[float]) -> None:
    for each in numbers:
        if not np.isfinite(each):
            raise InvalidSetting(f"a body to keep out of needs finite numbers, not {each}")
