"""Paths made of polynomial pieces, evaluated with NumPy alone; those through rows of derivatives, by Hermite."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import comb, factorial, perm
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
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


# Hermite polynomials between rows of a position and its first derivatives -------------------------------------------

REDUNDANT = 1e-10
"""Rows are left out for good if the others give them back to this fraction of the peaks."""

REST = 1e-9
"""An end is at rest if its derivatives are below this fraction of their peaks (they are then made zero)."""

NEGLIGIBLE = 1e-6
"""Derivatives below this fraction of (largest coordinate)/(duration^order) count as zero."""


MINOR = 0.1
"""A column counts as having at least this fraction of the peak of its group (all components together)."""


class Disagreement(NamedTuple):
    """Where two tables of derivatives differ most, relative to the peak of the derivative."""

    fraction: float
    row: int
    order: int
    component: int


def disagreement(expected: FloatArray, actual: FloatArray, duration: float) -> Disagreement:
    """Find the entry that differs most between two tables of derivatives of the same path.

    Parameters
    ----------
    expected, actual : ndarray, shape (n, order+1, dimension)
        Plain derivatives.
    duration : float
        Time that the table spans, in s.

    Returns
    -------
    Disagreement
        The worst entry.
    """
    fraction = np.abs(expected - actual) / _peaks(np.concatenate([expected, actual]), duration)
    row, order, component = np.unravel_index(int(np.argmax(fraction)), fraction.shape)
    return Disagreement(float(fraction[row, order, component]), int(row), int(order), int(component))


def hermite(t: FloatArray, derivatives: FloatArray) -> tuple[PiecewisePolynomial, Disagreement | None]:
    """Path with the given positions and derivatives up to some order k, such as the fourth, at every row.

    Between two rows runs the polynomial of degree 2 k + 1 that has the data of both. Round-off in its
    derivative k grows like 1/h^k between rows a short time h apart. So of rows that lie denser than the path
    needs only some are used: 1, 2, 4, ... pieces are tried, as long as more of them give the rows left out
    back at least half as well as fewer did. If the densest try is the best one, all rows are used.

    All are used as well where derivative k follows more closely from the lower ones of all rows than any row left out
    does from the others: rows may be few, and where the polynomials of a path meet none can be left out.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times in s, increasing, at least two.
    derivatives : ndarray, shape (n, k + 1, dimension)
        Plain derivatives 0 to k in m, m/s, ...

    Returns
    -------
    path : PiecewisePolynomial
        `smoothness` k, `max_order` 2 k + 1. It rests before (after) a first (last) row whose derivatives are zero;
        otherwise the polynomial goes on. `fit_error` is the largest distance of a row left out from the path
        made without it, or between two rows from the path made without derivative k; None for two rows, which leave
        nothing out.
    worst : Disagreement or None
        How well the rows agree with one another: the worst entry of a row left out, or of derivative k.
    """
    duration = float(t[-1] - t[0])
    rows, rests = _resting_ends(derivatives, duration)
    order = rows.shape[1] - 1
    taylor = _taylor_from_ends(order)
    best, pieces = None, 1
    while 2 * pieces < len(t):
        kept = np.linspace(0, len(t) - 1, pieces + 1).round().astype(int)
        path = _through_rows(t[kept], rows[kept], rests, taylor)
        derivatives_of_path = path.jet(t, order)
        worst = disagreement(rows, derivatives_of_path, duration)
        if best is None or worst.fraction < 2.0 * best[1].fraction:
            error = float(np.linalg.norm(rows[:, 0] - derivatives_of_path[:, 0], axis=1).max())
            best = replace(path, fit_error=error), worst
        pieces *= 2
    if best is None:
        return _through_rows(t, rows, rests, taylor), None
    path, worst = best
    if worst.fraction <= REDUNDANT:
        return path, worst
    every = _through_rows(t, rows, rests, taylor)
    follows, distance = _without_the_highest(t, rows, every)
    if follows.fraction < worst.fraction:
        return replace(every, fit_error=distance), follows
    if 2 * len(path.knots) >= pieces:  # the densest try was best: take all
        path = replace(every, fit_error=path.fit_error)
    return path, worst


def _without_the_highest(t: FloatArray, rows: FloatArray, path: PiecewisePolynomial) -> tuple[Disagreement, float]:
    """Compare with the path through all rows but for their highest derivative: there, and in m half-way between rows.

    Between two rows h apart it errs by h^(2 k) in position, and in derivative k by h^k: it has no row to do without.
    """
    order = rows.shape[1] - 1
    lower = _through_rows(t, rows[:, :order], (False, False), _taylor_from_ends(order - 1))
    between = (t[1:] + t[:-1]) / 2.0
    apart = np.linalg.norm(lower.jet(between, 0)[:, 0] - path.jet(between, 0)[:, 0], axis=1)
    found = rows.copy()  # the lower ones are those given but for round-off, which is much beside columns of zeros
    found[:, order] = lower.jet(t, order)[:, order]
    return disagreement(rows, found, path.duration), float(apart.max())


def _peaks(derivatives: FloatArray, duration: float) -> FloatArray:
    """Find the largest magnitude (order+1, dimension) of each column, but at least what is negligible."""
    columns = np.abs(derivatives).max(axis=0)
    groups = columns.max(axis=1)
    least = NEGLIGIBLE * groups[0] / duration ** np.arange(len(groups)) + np.finfo(np.float64).tiny
    return np.asarray(np.maximum(columns, np.maximum(MINOR * groups, least)[:, None]))


def _resting_ends(derivatives: FloatArray, duration: float) -> tuple[FloatArray, tuple[bool, bool]]:
    """Find which ends rest, and make their derivatives exactly zero in a copy of the rows."""
    rows = derivatives.copy()
    small = np.abs(rows[[0, -1], 1:]) <= REST * _peaks(rows, duration)[1:]
    rests = bool(small[0].all()), bool(small[1].all())
    rows[np.array([0, -1])[list(rests)], 1:] = 0.0
    return rows, rests


def _through_rows(t: FloatArray, rows: FloatArray, rests: tuple[bool, bool], taylor: FloatArray) -> PiecewisePolynomial:
    """Join Hermite polynomials that take up every row; `taylor` is `_taylor_from_ends`."""
    order = rows.shape[1] - 1
    powers = np.diff(t)[:, None, None] ** np.arange(order + 1)[:, None]  # h^k d/dt^k = d/du^k
    data = np.concatenate([rows[:-1] * powers, rows[1:] * powers], axis=1)
    origin = rows[:-1, 0]  # of a piece: digits of its position would be lost in those of its derivatives
    data[:, 0], data[:, order + 1] = 0.0, rows[1:, 0] - origin
    coefficients = np.einsum("ij,njd->nid", taylor, data)
    coefficients[:, 0] += origin
    return PiecewisePolynomial.of(t.copy(), coefficients, order, rows[[0, -1], 0].copy(), rests)


def _taylor_from_ends(order: int) -> FloatArray:
    """Matrix from derivatives 0 to `order` by u at u = -1/2, then at u = 1/2, to coefficients of u^0, u^1, ...

    The polynomial that has derivative k of one at u = -1/2 and no other datum is, with r = 1/2 + u and s = 1/2 - u,
    s^(order+1) r^k/k! sum_(j <= order-k) binom(order+j, j) r^j: exact in floating point but for the factorial.
    """
    r, s = Polynomial([0.5, 1.0]), Polynomial([0.5, -1.0])
    columns = [
        (
            away ** (order + 1) * (sign * near) ** k * sum(comb(order + j, j) * near**j for j in range(order - k + 1))
        ).coef
        for near, away, sign in ((r, s, 1.0), (s, r, -1.0))
        for k in range(order + 1)
    ]
    scale = [float(factorial(k)) for k in range(order + 1)] * 2
    return np.column_stack(columns).astype(np.float64) / scale
