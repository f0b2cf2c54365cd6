"""Paths made of polynomial pieces, from splines and Hermite data, evaluated with NumPy alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import perm

import numpy as np
from numpy.polynomial.polynomial import polyval

from servocore.numerics.compiled_calls import lock_arrays
from servocore.references.base import FloatArray, Reference

_AT_ONCE = 4096  # times: their coefficients fit in the processor's cache, and those of a million in no memory


@dataclass(frozen=True, kw_only=True, eq=False)
class PiecewisePolynomial(Reference):
    """One polynomial between every two neighbouring knots, expanded about the middle of its piece.

    With u = (t - middle)/length, -1/2 <= u <= 1/2, powers of u stay small and the sums are clean at both
    ends of a piece.

    Before the start the path rests at its first point if `rests_before`, else the first polynomial goes on;
    after the end likewise with the last point and the last polynomial, which far outside means little.

    Attributes
    ----------
    knots : ndarray, shape (pieces+1,)
        Where pieces meet, in s, increasing.
    coefficients : ndarray, shape (pieces, degree+1, dimension)
        Factors of u^0, u^1, ... in m.
    ends : ndarray, shape (2, dimension)
        First and last point in m.
    rests_before, rests_after : bool
        Whether the path starts from rest and ends at rest: derivatives 1 to `smoothness` are exactly zero there.
    refitted : callable or None
        Of a path fitted to samples: returns two paths, each fitted to every second sample in the same way.
    """

    knots: FloatArray
    coefficients: FloatArray
    ends: FloatArray
    rests_before: bool
    rests_after: bool
    refitted: Callable[[], tuple[PiecewisePolynomial, PiecewisePolynomial]] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        lock_arrays(self, "knots", "coefficients", "ends")

    @classmethod
    def of(
        cls,
        knots: FloatArray,
        coefficients: FloatArray,
        smoothness: int,
        ends: FloatArray,
        rests: tuple[bool, bool],
        fit_error: float | None = None,
    ) -> PiecewisePolynomial:
        """Return a path with times, dimension and highest derivative of its pieces; `rests` are before and after."""
        return cls(
            start_time=float(knots[0]),
            end_time=float(knots[-1]),
            dimension=coefficients.shape[2],
            max_order=coefficients.shape[1] - 1,
            smoothness=smoothness,
            fit_error=fit_error,
            knots=knots,
            coefficients=coefficients,
            ends=ends,
            rests_before=rests[0],
            rests_after=rests[1],
        )

    @property
    def stretches(self) -> FloatArray:
        """The knots."""
        return self.knots

    @property
    def degree(self) -> int:
        """Degree of the pieces."""
        return int(self.coefficients.shape[1]) - 1

    def _derivatives(self, t: FloatArray, order: int) -> FloatArray:
        gamma = np.empty((t.size, order + 1, self.dimension))
        for first in range(0, t.size, _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            self._on_pieces(t[some], gamma[some])
        if self.rests_before:  # a derivative above `smoothness` is the one just after
            resting = t <= self.start_time
            gamma[resting, 0] = self.ends[0]
            gamma[resting, 1 : self.smoothness + 1] = 0.0
            gamma[t < self.start_time, 1:] = 0.0
        if self.rests_after:
            resting = t >= self.end_time
            gamma[resting, 0] = self.ends[1]
            gamma[resting, 1:] = 0.0
        return gamma

    def _on_pieces(self, t: FloatArray, gamma: FloatArray) -> None:
        """Fill in the derivatives of the polynomials at some times."""
        piece = np.clip(np.searchsorted(self.knots, t, side="right") - 1, 0, len(self.knots) - 2)
        left, right = self.knots[piece], self.knots[piece + 1]
        length = right - left
        u = ((t - left) - (right - t)) / (2.0 * length)
        factors = np.moveaxis(self.coefficients[piece], 1, 0)
        for k in range(gamma.shape[1]):
            slopes = np.array([perm(i, k) for i in range(k, len(factors))], dtype=np.float64)
            gamma[:, k] = polyval(u[:, None], slopes[:, None, None] * factors[k:], tensor=False) / length[:, None] ** k
