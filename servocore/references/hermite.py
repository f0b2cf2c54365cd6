"""Paths through rows of a position and its first derivatives: Hermite polynomials between rows."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cache
from math import perm
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from servocore.references.piecewise import REST_ORDER, PiecewisePolynomial

if TYPE_CHECKING:
    from servocore.references.base import FloatArray

REDUNDANT = 1e-10
"""Rows are left out for good if the others give them back to this fraction of the peaks."""

REST = 1e-9
"""An end is at rest if its derivatives are below this fraction of their peaks (they are then made zero)."""

NEGLIGIBLE = 1e-6
"""Derivatives below this fraction of (largest coordinate)/(duration^order) count as zero."""


MINOR = 0.1
"""A column counts as having at least this fraction of the peak of its group (x, y and z together)."""


class Disagreement(NamedTuple):
    """Where two tables of derivatives differ most, relative to the peak of the derivative."""

    fraction: float
    row: int
    order: int
    component: int


def disagreement(given: FloatArray, found: FloatArray, duration: float) -> Disagreement:
    """Find the entry that differs most between two tables of derivatives of the same path.

    Parameters
    ----------
    given, found : ndarray, shape (n, order+1, dimension)
        Plain derivatives.
    duration : float
        Time that the table spans, in s.

    Returns
    -------
    Disagreement
        The worst entry.
    """
    fraction = np.abs(given - found) / _peaks(np.concatenate([given, found]), duration)
    row, order, component = np.unravel_index(int(np.argmax(fraction)), fraction.shape)
    return Disagreement(float(fraction[row, order, component]), int(row), int(order), int(component))


def hermite(t: FloatArray, derivatives: FloatArray) -> tuple[PiecewisePolynomial, Disagreement | None]:
    """Path with the given position, velocity, acceleration, jerk and snap at every row.

    Between two rows runs the polynomial of degree 9 that has the ten data of both. Round-off in its snap
    grows like 1/h^4 between rows a short time h apart. So of rows that lie denser than the path needs only
    some are used: 1, 2, 4, ... pieces are tried, as long as more of them give the rows left out back at
    least half as well as fewer did. If the densest try is the best one, all rows are used.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times in s, increasing, at least two.
    derivatives : ndarray, shape (n, 5, dimension)
        Plain derivatives 0 to 4 in m/s^k.

    Returns
    -------
    path : PiecewisePolynomial
        `smoothness` 4, `max_order` 9. It rests before (after) a first (last) row whose derivatives are zero;
        otherwise the polynomial goes on. `fit_error` is the largest distance of a row left out from the path
        made without it; None for two rows, which leave nothing out.
    worst : Disagreement or None
        How well the rows agree with one another: the worst entry of a row left out.
    """
    duration = float(t[-1] - t[0])
    rows, rests = _resting_ends(derivatives, duration)
    best, pieces = None, 1
    while 2 * pieces < len(t):
        kept = np.linspace(0, len(t) - 1, pieces + 1).round().astype(int)
        path = _through_rows(t[kept], rows[kept], rests)
        found = path.jet(t, REST_ORDER)
        worst = disagreement(rows, found, duration)
        if best is None or worst.fraction < 2.0 * best[1].fraction:
            error = float(np.linalg.norm(rows[:, 0] - found[:, 0], axis=1).max())
            best = replace(path, fit_error=error), worst
        pieces *= 2
    if best is None:
        return _through_rows(t, rows, rests), None
    path, worst = best
    if 2 * len(path.knots) >= pieces and worst.fraction > REDUNDANT:  # the densest try was best: take all
        path = replace(_through_rows(t, rows, rests), fit_error=path.fit_error)
    return path, worst


def _peaks(derivatives: FloatArray, duration: float) -> FloatArray:
    """Find the largest magnitude (order+1, dimension) of each column, but at least what is negligible."""
    columns = np.abs(derivatives).max(axis=0)
    groups = columns.max(axis=1)
    least = NEGLIGIBLE * groups[0] / duration ** np.arange(len(groups)) + np.finfo(np.float64).tiny
    whole: FloatArray = np.maximum(columns, np.maximum(MINOR * groups, least)[:, None])
    return whole


def _resting_ends(derivatives: FloatArray, duration: float) -> tuple[FloatArray, tuple[bool, bool]]:
    """Find which ends rest, and make their derivatives exactly zero in a copy of the rows."""
    rows = derivatives.copy()
    limit = REST * _peaks(rows, duration)[1:]
    first, last = (bool((np.abs(rows[end, 1:]) <= limit).all()) for end in (0, -1))
    if first:
        rows[0, 1:] = 0.0
    if last:
        rows[-1, 1:] = 0.0
    return rows, (first, last)


def _through_rows(t: FloatArray, rows: FloatArray, rests: tuple[bool, bool]) -> PiecewisePolynomial:
    """Join Hermite polynomials that take up every row."""
    powers = np.diff(t)[:, None, None] ** np.arange(REST_ORDER + 1)[:, None]  # h^k d/dt^k = d/du^k
    data = np.concatenate([rows[:-1] * powers, rows[1:] * powers], axis=1)
    return PiecewisePolynomial(
        start_time=float(t[0]),
        end_time=float(t[-1]),
        dimension=rows.shape[2],
        max_order=2 * REST_ORDER + 1,
        smoothness=REST_ORDER,
        knots=t.copy(),
        coefficients=np.einsum("ij,njd->nid", _taylor_from_ends(), data),
        ends=rows[[0, -1], 0].copy(),
        rests_before=rests[0],
        rests_after=rests[1],
    )


@cache
def _taylor_from_ends() -> FloatArray:
    """Matrix (10, 10) from derivatives 0 to 4 by u at u = -1/2 and u = 1/2 to coefficients of u^0 ... u^9."""
    count = 2 * (REST_ORDER + 1)
    rows = [
        [perm(i, k) * end ** (i - k) if i >= k else Fraction(0) for i in range(count)]
        for end in (Fraction(-1, 2), Fraction(1, 2))
        for k in range(REST_ORDER + 1)
    ]
    table = [[*row, *(Fraction(int(i == j)) for j in range(count))] for i, row in enumerate(rows)]
    for column in range(count):  # Gauss-Jordan in rational arithmetic: the inverse is exact
        pivot = next(r for r in range(column, count) if table[r][column])
        table[column], table[pivot] = table[pivot], table[column]
        table[column] = [value / table[column][column] for value in table[column]]
        for r in range(count):
            if r != column and table[r][column]:
                table[r] = [a - table[r][column] * b for a, b in zip(table[r], table[column], strict=True)]
    return np.array([[float(value) for value in row[count:]] for row in table])
