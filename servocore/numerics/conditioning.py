"""Condition numbers of matrices whose rows and columns are scaled, so that they do not depend on units.

Matrices of many independent parts are decomposed part by part, small parts together as stacks. Of large parts, which
are sparse, only the extreme singular values are computed, from sparse factors: the cost of dense ones is the cube of
the size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

import numpy as np
import numpy.typing as npt

from servocore.numerics.components import LARGE, SWEEPS, Part, equilibrated, of_one_shape

Array = npt.NDArray[np.float64]
Product = Callable[[Array], Array]

_WELL_CONDITIONED = 1e10  # condition of J J^T up to which its factors serve
_SUBSPACE = 10  # vectors of Lanczos' method
_ACCURATE = 1e-4  # residual of the extreme singular values of large parts; their error is about its square


def condition_number(matrix: Array) -> float:
    """Return the condition number of a matrix after its rows and columns are scaled to unit maximum."""
    if not np.isfinite(matrix).all():
        return float("inf")
    values = np.linalg.svd(equilibrated(matrix), compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0.0 else float("inf")


def condition_numbers(parts: Sequence[Part], entries: Array) -> Array:
    """Return the condition numbers of a sparse square matrix at N instants, from its entries (nnz, N)."""
    finite = np.atleast_1d(np.isfinite(entries).all(axis=0))
    largest, least = np.zeros(len(finite)), np.full(len(finite), np.inf)
    if any(len(part.rows) != len(part.columns) for part in parts):
        return np.full(len(finite), np.inf)
    entries = entries if finite.all() else np.where(finite, entries, 0.0)
    for same in of_one_shape(parts):  # stacked: calls for hundreds of parts take longer than decompositions
        if len(same[0].rows) >= LARGE:
            extremes = np.array([_extreme_singular_values(part, entries) for part in same])
        else:
            stacked = equilibrated(np.stack([part.dense(entries) for part in same]))
            extremes = np.linalg.svd(stacked, compute_uv=False)[:, :, [0, -1]]
        largest = np.maximum(largest, extremes[:, :, 0].max(axis=0))
        least = np.minimum(least, extremes[:, :, 1].min(axis=0))
    regular = finite & (least > 0.0)
    return np.where(regular, largest / np.where(regular, least, 1.0), np.inf)


def _extreme_singular_values(part: Part, entries: Array) -> Array:
    """Return the largest and the least singular value of a large scaled part at N instants, shape (N, 2)."""
    from scipy.sparse import csc_array  # noqa: PLC0415 - few matrices are large
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    size, found = len(part.rows), np.zeros((entries.shape[1], 2))
    vectors = [np.ones(size)] * 2  # those of one instant are close to those of the next
    for k, values in enumerate(_equilibrated_entries(part, entries).T):
        matrix = csc_array((values, part.places), (size, size))
        with suppress(RuntimeError):  # of a matrix that is exactly singular
            solve, transposed = splu(matrix).solve, matrix.T.tocsc()
            inverse, vectors[1] = _norm(solve, partial(solve, trans="T"), vectors[1])
            largest, vectors[0] = _norm(matrix.dot, transposed.dot, vectors[0])
            found[k] = largest, 1.0 / inverse
    return found


def _norm(times: Product, times_transposed: Product, start: Array) -> tuple[float, Array]:
    """Return the norm of a matrix and the vector that it stretches most, from products with it and its transpose."""
    from scipy.sparse.linalg import LinearOperator, eigsh  # noqa: PLC0415

    square = LinearOperator((len(start),) * 2, matvec=lambda x: times_transposed(times(x)), dtype=np.float64)
    squares, vectors = eigsh(square, k=1, v0=start, ncv=_SUBSPACE, tol=_ACCURATE)
    return float(np.sqrt(squares[0])), vectors[:, 0]


def gram_solver(matrix: Array, damping: float = 0.0) -> Product | None:
    """Return the product with (J J^T + damping)^-1 of a sparse J; None if it is inaccurate.

    Then the rows are far from dependent: the condition number of J is less than the root of that of J J^T.
    """
    height, width = matrix.shape
    if height > width:
        return None
    from scipy.sparse import csr_array, eye_array  # noqa: PLC0415
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    rows = csr_array(matrix)
    gram = (rows @ rows.T + damping * eye_array(height)).tocsc()
    with suppress(RuntimeError):  # of a matrix that is exactly singular
        solve: Product = splu(gram).solve
        if np.linalg.norm(gram.data) * _norm(solve, solve, np.ones(height))[0] < _WELL_CONDITIONED:
            return solve
    return None


def _equilibrated_entries(part: Part, entries: Array) -> Array:
    """Scale the entries of a sparse part at N instants as `equilibrated` does, shape (its entries, N)."""
    scaled = np.array(entries[part.entries])
    for sweep in range(SWEEPS):
        for places in part.places:
            largest = np.zeros((len(part.rows), scaled.shape[1]))
            np.maximum.at(largest, places, np.abs(scaled))
            factor = np.where(largest > 0.0, largest, 1.0)[places]
            scaled /= np.sqrt(factor) if sweep < SWEEPS - 1 else factor
    return scaled
