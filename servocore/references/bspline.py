"""Fits by splines of degree 9, the linear algebra behind `through` and `sampled`.

Only making a spline needs SciPy; evaluating it does not. SciPy is imported inside the functions because an
FMU evaluates references and must run where SciPy is not installed.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import TYPE_CHECKING

import numpy as np

from servocore.errors import InvalidReference
from servocore.references.piecewise import REST_ORDER, PiecewisePolynomial

if TYPE_CHECKING:
    from scipy.interpolate import BSpline
    from scipy.sparse import csc_array

    from servocore.references.base import FloatArray

DEGREE = 9
SMOOTHNESS = DEGREE - 1


@dataclass(frozen=True)
class Ends:
    """Which ends of a spline are at rest: derivatives 1 to 4 are zero there."""

    start: bool
    end: bool

    @property
    def unknowns_removed(self) -> int:
        """Number of spline coefficients that rest decides."""
        return REST_ORDER * (self.start + self.end)


def interpolation_knots(t: FloatArray, ends: Ends) -> FloatArray:
    """Inner knots with which a spline of degree 9 through all samples has as many unknowns as samples.

    At an end at rest every sample but the first is a knot; at a free end the four next to it are none
    either ("not-a-knot", de Boor, *A Practical Guide to Splines*, chapter XIII).

    Parameters
    ----------
    t : ndarray, shape (n,)
        Sample times in s.
    ends : Ends
        Which ends rest.

    Returns
    -------
    ndarray, shape (n - 10 + unknowns removed,)
        Inner knots in s.
    """
    first, last = (1 if rests else 1 + REST_ORDER for rests in (ends.start, ends.end))
    return t[first : len(t) - last]


def fit(t: FloatArray, positions: FloatArray, inner_knots: FloatArray, ends: Ends) -> BSpline:
    """Least-squares spline of degree 9, C^8; an interpolating one if there are as many unknowns as samples.

    Rest at an end means that the first (last) five B-spline coefficients are equal: their columns of the
    collocation matrix A are added up. Least squares are solved in the augmented form [I A; A^T 0] (Bjorck,
    *Numerical Methods for Least Squares Problems*, section 2.5), which does not square the condition of A.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Sample times in s, increasing.
    positions : ndarray, shape (n, dimension)
        Samples in m.
    inner_knots : ndarray, shape (k,)
        Knots strictly between first and last sample.
    ends : Ends
        Which ends rest.

    Returns
    -------
    scipy.interpolate.BSpline
        The spline, values of shape (dimension,).

    Raises
    ------
    InvalidReference
        If the samples do not determine the spline, because they are spaced too unevenly.
    """
    from scipy.interpolate import BSpline  # noqa: PLC0415
    from scipy.sparse import block_array, csc_array, eye_array  # noqa: PLC0415
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    knots = np.concatenate([np.full(DEGREE + 1, t[0]), inner_knots, np.full(DEGREE + 1, t[-1])])
    spread = _spread(len(knots) - DEGREE - 1, ends)
    matrix = csc_array(BSpline.design_matrix(t, knots, DEGREE) @ spread)
    samples, unknowns = matrix.shape
    try:
        if samples == unknowns:
            solution = splu(matrix).solve(positions)
        else:
            whole = block_array([[eye_array(samples), matrix], [matrix.T, None]], format="csc")
            right = np.concatenate([positions, np.zeros((unknowns, positions.shape[1]))])
            factors = splu(whole)
            solution = factors.solve(right)
            solution += factors.solve(right - whole @ solution)  # one refinement: 1e-12 becomes 1e-15
            solution = solution[samples:]
    except RuntimeError:  # SuperLU: "Factor is exactly singular"
        raise InvalidReference(
            "the times of the samples are spaced too unevenly for a smooth path: spread them more evenly"
        ) from None
    return BSpline(knots, spread @ solution, DEGREE)


def _spread(count: int, ends: Ends) -> csc_array:
    """Matrix (count, unknowns) of zeros and ones that repeats the unknown of an end at rest five times."""
    from scipy.sparse import csc_array  # noqa: PLC0415

    column = np.arange(count)
    if ends.start:
        column = np.maximum(column - REST_ORDER, 0)
    if ends.end:
        column = np.minimum(column, column[-1] - REST_ORDER)
    return csc_array((np.ones(count), (np.arange(count), column)))


def to_path(spline: BSpline, ends: Ends, fit_error: float | None) -> PiecewisePolynomial:
    """Turn a spline into a reference that needs no SciPy.

    Parameters
    ----------
    spline : scipy.interpolate.BSpline
        From `fit`.
    ends : Ends
        Which ends rest; where one does not, the end polynomial goes on outside.
    fit_error : float or None
        See `Reference`.

    Returns
    -------
    PiecewisePolynomial
        C^8 inside; C^4 over all time if an end rests.
    """
    knots = np.unique(spline.t)
    middle, length = (knots[1:] + knots[:-1]) / 2.0, np.diff(knots)
    taylor = [spline(middle, nu=k) * (length**k / factorial(k))[:, None] for k in range(DEGREE + 1)]
    return PiecewisePolynomial(
        start_time=float(knots[0]),
        end_time=float(knots[-1]),
        dimension=spline.c.shape[1],
        max_order=DEGREE,
        smoothness=REST_ORDER if ends.start or ends.end else SMOOTHNESS,
        fit_error=fit_error,
        knots=knots,
        coefficients=np.stack(taylor, axis=1),
        ends=np.array(spline.c[[0, -1]]),
        rests_before=ends.start,
        rests_after=ends.end,
    )
