"""Independent parts of equations, rows and columns of a matrix that have no entries in common with the others.

Dense linear algebra costs the cube of the size of a matrix, so that ranks and condition numbers come from independent
parts, small ones of one shape together as stacks. Of large parts, which are sparse, only the extreme singular values
are computed, from sparse factors. Rows and columns are scaled first: rank and condition do not depend on units.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array, Places

Product = Callable[[Array], Array]

LARGE = 128
"""Rows from which on sparse factors replace singular values."""

_WHOLE = 32  # rows and columns of matrices that are decomposed in less time than their parts are found
_SWEEPS = 6  # of equilibration
_WELL_CONDITIONED = 1e10  # condition of J J^T up to which its factors serve
_SUBSPACE = 6  # vectors of Lanczos' method, which starts from a vector that is nearly right
_ACCURATE = 1e-4  # residual of the extreme singular values of large parts; their error is about its square


@dataclass(frozen=True, eq=False)
class Part:
    """An independent part of a sparse matrix.

    Attributes
    ----------
    rows, columns : ndarray of int
        Of the matrix, in rising order.
    entries : ndarray of int
        Indices of its entries among those of the matrix, column by column.
    places : tuple of (ndarray of int, ndarray of int)
        Row and column in the part of each of these.
    """

    rows: Places
    columns: Places
    entries: Places
    places: tuple[Places, Places]

    def dense(self, entries: Array) -> Array:
        """Return the part at N instants, shape (N, rows, columns), from all entries of the matrix, shape (nnz, N)."""
        matrices = np.zeros((entries.shape[1], len(self.rows), len(self.columns)))
        matrices[:, self.places[0], self.places[1]] = entries[self.entries].T
        return matrices


def places_of(pattern: ca.Sparsity) -> tuple[Places, Places]:
    """Return the row and the column of every entry of a matrix, column by column."""
    rows, columns = (np.array(indices, dtype=np.intp) for indices in pattern.get_triplet())
    return rows, columns


def parts_of(pattern: ca.Sparsity) -> tuple[Part, ...]:
    """Return the independent parts of a matrix; an empty row or column is a part of its own."""
    (height, width), (rows, columns) = pattern.shape, places_of(pattern)
    # Rows and columns as nodes of one graph with edges both ways: its strong components are the parts.
    both = np.concatenate([rows, columns + height]), np.concatenate([columns + height, rows])
    graph = ca.Sparsity.triplet(height + width, height + width, *(nodes.tolist() for nodes in both))
    _, order, ends = graph.scc()
    numbers = _numbers(order, ends)
    return _parts(pattern, numbers[:height], numbers[height:], len(ends) - 1)


def triangular_blocks(pattern: ca.Sparsity) -> tuple[Part, ...]:
    """Return the diagonal blocks of a matrix in block triangular form, in that order."""
    count, row_order, column_order, row_ends, column_ends, *_ = pattern.btf()
    return _parts(pattern, _numbers(row_order, row_ends), _numbers(column_order, column_ends), count)


def _numbers(order: Sequence[int], ends: Sequence[int]) -> Places:
    """Return the number of the group of every item, from the items in the order of the groups."""
    numbers = np.empty(len(order), dtype=np.intp)
    numbers[list(order)] = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
    return numbers


def _parts(pattern: ca.Sparsity, of_row: Places, of_column: Places, count: int) -> tuple[Part, ...]:
    """Return the parts of a matrix from the number of the part of every row and column."""
    rows, columns = places_of(pattern)
    inside = np.flatnonzero(of_row[rows] == of_column[columns])
    members, of_width, entries = (_members(each, count) for each in (of_row, of_column, of_row[rows[inside]]))
    return tuple(
        Part(high, wide, its, (np.searchsorted(high, rows[its]), np.searchsorted(wide, columns[its])))
        for high, wide, its in zip(members, of_width, (inside[each] for each in entries), strict=True)
    )


def _members(numbers: Places, count: int) -> list[Places]:
    """Return the indices of the items of every group, in rising order."""
    return np.split(np.argsort(numbers, kind="stable"), np.cumsum(np.bincount(numbers, minlength=count))[:-1])


def of_one_shape(parts: Sequence[Part]) -> list[list[Part]]:
    """Return the parts in groups of equal numbers of rows and columns."""
    groups: dict[tuple[int, int], list[Part]] = {}
    for part in parts:
        groups.setdefault((len(part.rows), len(part.columns)), []).append(part)
    return list(groups.values())


def filled(matrix: ca.DM) -> Array:
    """Return a sparse matrix as a dense array; CasADi's own conversion copies every zero by itself."""
    array = np.zeros(matrix.shape)
    array[places_of(matrix.sparsity())] = matrix.nonzeros()
    return array


def singular_values(matrix: Array) -> Array:
    """Return the singular values of a matrix, largest first, from those of its independent parts if it is large."""
    if max(matrix.shape) <= _WHOLE:
        return np.asarray(np.linalg.svd(matrix, compute_uv=False))
    pattern = ca.Sparsity.triplet(*matrix.shape, *(indices.tolist() for indices in np.nonzero(matrix)))
    parts = [part for part in parts_of(pattern) if len(part.entries)]
    entries = matrix[places_of(pattern)][:, None]
    of_parts = [_decomposed(same, entries).ravel() for same in of_one_shape(parts)]
    # Empty rows and columns are singular values of zero, which no part brings.
    values = np.sort(np.concatenate([*of_parts, np.zeros(min(matrix.shape))]))[::-1]
    return np.asarray(values[: min(matrix.shape)])


def _decomposed(parts: Sequence[Part], entries: Array) -> Array:
    """Return the singular values of parts of one shape at N instants, shape (parts, N, values)."""
    return np.asarray(np.linalg.svd(np.stack([part.dense(entries) for part in parts]), compute_uv=False))


def equilibrated(matrix: Array) -> Array:
    """Scale rows and columns to unit maximum (Ruiz 2001), so that rank and condition do not depend on units."""
    places, scaled = np.nonzero(matrix), np.zeros(matrix.shape)
    scaled[places] = _equilibrated(places, matrix[places][:, None])[:, 0]
    return scaled


def _equilibrated(places: Iterable[Places], entries: Array) -> Array:
    """Scale the entries of sparse matrices, shape (nnz, N), at these rows and columns, as `equilibrated` does."""
    sizes, lines = np.abs(entries, dtype=np.float64), []
    for of_entry in places:
        line = np.unique(of_entry, return_inverse=True)[1]
        order = np.argsort(line, kind="stable")
        lines.append((order, np.flatnonzero(np.diff(line[order], prepend=-1)), line))
    for sweep in range(_SWEEPS if len(sizes) else 0):
        for order, starts, line in lines:
            largest = np.maximum.reduceat(sizes[order], starts)
            factor = np.where(largest > 0.0, largest, 1.0)
            sizes /= (np.sqrt(factor) if sweep < _SWEEPS - 1 else factor)[line]
    return np.copysign(sizes, entries)


def condition_number(matrix: Array) -> float:
    """Return the condition number of a matrix after its rows and columns are scaled to unit maximum."""
    return float(np.linalg.cond(equilibrated(matrix))) if np.isfinite(matrix).all() else float("inf")


def condition_numbers(parts: Sequence[Part], entries: Array) -> Array:
    """Return the condition numbers of a sparse matrix at N instants, from its entries (nnz, N).

    They are infinite unless all entries are finite and all parts square and regular.
    """
    finite = np.atleast_1d(np.isfinite(entries).all(axis=0))
    largest, least = np.zeros(len(finite)), np.full(len(finite), np.inf)
    places = np.zeros((2, len(entries)), dtype=np.intp)
    for part in parts:
        places[:, part.entries] = part.rows[part.places[0]], part.columns[part.places[1]]
    entries = _equilibrated(places, entries if finite.all() else np.where(finite, entries, 0.0))
    for same in of_one_shape(parts):  # stacked: calls for hundreds of parts take longer than decompositions
        size = len(same[0].rows)
        if size != len(same[0].columns):
            values = np.zeros((1, entries.shape[1], 1))
        elif size >= LARGE:
            values = np.array([_extreme_singular_values(part, entries) for part in same])
        else:
            values = _decomposed(same, entries)
        largest = np.maximum(largest, values[:, :, 0].max(axis=0))
        least = np.minimum(least, values[:, :, -1].min(axis=0))
    regular = finite & (least > 0.0)
    return np.where(regular, largest / np.where(regular, least, 1.0), np.inf)


def _extreme_singular_values(part: Part, entries: Array) -> Array:
    """Return the largest and the least singular value of a large part at N instants, shape (N, 2)."""
    from scipy.sparse import csc_array  # noqa: PLC0415 - few matrices are large
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    size, found = len(part.rows), np.zeros((entries.shape[1], 2))
    rows, starts = part.places[0], np.searchsorted(part.places[1], np.arange(size + 1))
    vectors = [np.ones(size)] * 2  # those of one instant are close to those of the next
    for k, values in enumerate(np.ascontiguousarray(entries[part.entries].T)):
        matrix = csc_array((values, rows, starts), (size, size))
        with suppress(RuntimeError):  # of a matrix that is exactly singular
            solve = splu(matrix).solve
            inverse, vectors[1] = _norm(solve, partial(solve, trans="T"), vectors[1])
            largest, vectors[0] = _norm(matrix.dot, matrix.T.dot, vectors[0])
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


_SMALL = 3  # unknowns: parts up to this size are solved by a formula, cheaper than a function call


def isomorphic_parts(
    residual: ca.SX, unknowns: ca.SX, givens: ca.SX, beside: Sequence[ca.SX]
) -> list[list[tuple[Part, list[int]]]]:
    """Return the groups of two and more independent parts of residual(unknowns, givens) = 0 that are alike.

    With each part stand the indices of the givens on which it depends, in the order of its expressions.

    Parameters
    ----------
    residual, unknowns, givens : casadi.SX
        The equations; unknowns and givens are symbols.
    beside : sequence of casadi.SX
        Further expressions of the givens, as long as the residual: one entry per unknown, in the last one per row.
    """
    if unknowns.numel() <= 2 * _SMALL:
        return []
    shapes = of_one_shape(parts_of(ca.jacobian_sparsity(residual, unknowns)))
    square = [same for same in shapes if len(same[0].rows) == len(same[0].columns) > _SMALL]
    candidates = [part for same in square if len(same) > 1 for part in same]
    if not candidates:
        return []
    every = ca.vertcat(residual, *beside)
    depends = ca.jacobian_sparsity(every, givens).T
    starts, held, size = depends.colind(), depends.row(), unknowns.numel()
    groups: dict[str, list[tuple[Part, list[int]]]] = {}
    for part in candidates:
        own = part.rows, *[part.columns] * (len(beside) - 1), part.rows
        lines = [place * size + k for place, some in enumerate(own) for k in some.tolist()]
        known = sorted({given for line in lines for given in held[starts[line] : starts[line + 1]]})
        # Two parts are isomorphic if CasADi serializes them to the same text, names of symbols aside.
        symbols = [unknowns[part.columns.tolist()], givens[known]]
        groups.setdefault(_text(every[lines], symbols), []).append((part, known))
    return [group for group in groups.values() if len(group) > 1]


def _text(expressions: ca.SX, symbols: list[ca.SX]) -> str:
    """Return expressions of symbols as a text that does not depend on the names of the symbols."""
    renamed = [ca.SX.sym("x", symbol.numel()) for symbol in symbols]
    (results,) = ca.substitute([expressions], symbols, renamed)
    text: str = ca.Function("sc_part", renamed, [results]).serialize()
    return text
