"""Fits by splines of odd degree, such as 9, the linear algebra behind `through` and `sampled`.

Only making a spline needs SciPy; evaluating it does not. SciPy is imported inside the functions because an
FMU evaluates references and must run where SciPy is not installed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import factorial
from typing import TYPE_CHECKING

import numpy as np

from servocore.errors import InvalidReference
from servocore.references.base import FloatArray
from servocore.references.piecewise import PiecewisePolynomial

if TYPE_CHECKING:
    from scipy.interpolate import BSpline
    from scipy.sparse import csc_array, csr_array


REST_ORDER = 4
"""Default number of derivatives that vanish at an end at rest, as those of `DEGREE9` do."""


_MANY = 20_000  # samples from which on factors of the augmented form take too much memory
_CORRECTIONS, _AT_REST = 8, 1e-11


def require_order(order: int) -> None:
    """Raise `InvalidReference` unless derivatives 1 to `order` can vanish at an end at rest."""
    if not (isinstance(order, int) and order >= 1):
        raise InvalidReference(f"at an end at rest one or more whole derivatives vanish, not {order}")


@dataclass(frozen=True)
class Ends:
    """Which ends of a spline are at rest, and how many derivatives vanish there: that sets its degree.

    Attributes
    ----------
    start, end : bool
        Whether the spline starts and ends at rest.
    order : int
        Derivatives 1 to `order` are zero at an end at rest.

    Raises
    ------
    InvalidReference
        If `order` is not a whole number of one or more.
    """

    start: bool
    end: bool
    order: int = REST_ORDER

    def __post_init__(self) -> None:
        require_order(self.order)

    @property
    def degree(self) -> int:
        """Degree of the polynomial that joins two ends at rest, 2 order + 1."""
        return 2 * self.order + 1


def interpolation_knots(t: FloatArray, ends: Ends) -> FloatArray:
    """Inner knots with which a spline through all samples has as many unknowns as samples.

    At an end at rest every sample but the first is a knot; at a free end the `order` next to it are none
    either ("not-a-knot", de Boor, *A Practical Guide to Splines*, chapter XIII).

    Parameters
    ----------
    t : ndarray, shape (n,)
        Sample times in s.
    ends : Ends
        Which ends rest.

    Returns
    -------
    ndarray, shape (k,)
        Inner knots in s.
    """
    first, last = (1 if rests else 1 + ends.order for rests in (ends.start, ends.end))
    return t[first : len(t) - last]


def fit(
    t: FloatArray, positions: FloatArray, inner_knots: FloatArray, ends: Ends, speeds: FloatArray | None = None
) -> BSpline:
    """Least-squares spline, C^(degree - 1); an interpolating one if there are as many unknowns as samples.

    Rest at an end means that the first (last) order + 1 B-spline coefficients are equal: their columns of the
    collocation matrix A are added up. Least squares are solved in the augmented form [I A; A^T 0] (Bjorck,
    *Numerical Methods for Least Squares Problems*, section 2.5), which does not square the condition of A. Where
    samples are very many, its factors would fill the memory: then by corrected seminormal equations (section 2.4).

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
    speeds : ndarray, shape (n, dimension), optional
        First derivatives in m/s, to be met as well where they are no NaN: such times are inner knots twice.

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
    from scipy.sparse import block_array, csc_array, eye_array, vstack  # noqa: PLC0415
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    degree = ends.degree
    knots = np.concatenate([np.full(degree + 1, t[0]), inner_knots, np.full(degree + 1, t[-1])])
    spread = _spread(len(knots) - degree - 1, ends)
    matrix = BSpline.design_matrix(t, knots, degree) @ spread
    if speeds is not None and (known := np.isfinite(speeds).all(axis=1)).any():
        rates = BSpline(knots, np.eye(len(knots) - degree - 1), degree)(t[known], nu=1)
        matrix = vstack([matrix, csc_array(rates @ spread)])
        positions = np.concatenate([positions, speeds[known]])
    samples, unknowns = matrix.shape
    try:
        if samples == unknowns:
            solution = splu(csc_array(matrix)).solve(positions)
        elif samples > _MANY and (found := _by_normal_equations(matrix, positions)) is not None:
            solution = found
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
    return BSpline(knots, spread @ solution, degree)


def _by_normal_equations(matrix: csr_array, positions: FloatArray) -> FloatArray | None:
    """Return the least-squares solution; None if corrections do not come to rest at round-off.

    A^T A has the squared condition of A, some 1e8 for degree 9, which only slows the corrections down: each is computed
    from the residual, and so the answer is as good as that of an orthogonal factorization.
    """
    from scipy.sparse import csc_array  # noqa: PLC0415
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    transposed = matrix.T
    factors = splu(csc_array(transposed @ matrix))
    solution = factors.solve(transposed @ positions)
    least = np.inf
    for _ in range(_CORRECTIONS):
        change = factors.solve(transposed @ (positions - matrix @ solution))
        size = float(np.abs(change).max())
        if not size < 0.5 * least:  # round-off
            break
        solution += change
        least = size
    return np.asarray(solution) if least <= _AT_REST * np.abs(solution).max() else None


def _spread(count: int, ends: Ends) -> csc_array:
    """Matrix (count, unknowns) of zeros and ones that repeats the unknown of an end at rest order + 1 times."""
    from scipy.sparse import csc_array  # noqa: PLC0415

    column = np.arange(count)
    if ends.start:
        column = np.maximum(column - ends.order, 0)
    if ends.end:
        column = np.minimum(column, column[-1] - ends.order)
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
        C^(degree - 1) inside; C^order over all time if an end rests.
    """
    smoothness = ends.order if ends.start or ends.end else ends.degree - 1
    limits = np.array(spline.c[[0, -1]])
    return PiecewisePolynomial.of(*pieces_of(spline), smoothness, limits, (ends.start, ends.end), fit_error)


def pieces_of(spline: BSpline) -> tuple[FloatArray, FloatArray]:
    """Return the knots of a spline, and of every piece the factors of the powers of u; see `PiecewisePolynomial`."""
    knots = np.unique(spline.t)
    middle, length = (knots[1:] + knots[:-1]) / 2.0, np.diff(knots)
    taylor = [spline(middle, nu=k) * (length**k / factorial(k))[:, None] for k in range(spline.k + 1)]
    return knots, np.stack(taylor, axis=1)


def joined(legs: Sequence[PiecewisePolynomial]) -> PiecewisePolynomial:
    """Return one path of several, each of which starts at rest where and when the one before ends at rest."""
    return replace(
        legs[0],
        end_time=legs[-1].end_time,
        knots=np.concatenate([legs[0].knots, *(leg.knots[1:] for leg in legs[1:])]),
        coefficients=np.concatenate([leg.coefficients for leg in legs]),
        ends=np.array([legs[0].ends[0], legs[-1].ends[1]]),
    )
