"""Independent parts of equations, rows and columns of a matrix that have no entries in common with the others.

Dense linear algebra costs the cube of the size of a matrix, so that independent parts are cheaper one by one. The other
subjects are scales of rows and columns, and the assignment of rows to columns with the largest sum of weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Places = npt.NDArray[np.intp]

LARGE = 128
"""Rows from which on sparse factors replace singular values."""

SWEEPS = 6
"""Of equilibration."""


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


def parts_of(pattern: ca.Sparsity) -> tuple[Part, ...]:
    """Return the independent parts of a matrix; an empty row or column is a part of its own."""
    height, width = pattern.shape
    rows, columns = (np.array(indices, dtype=np.intp) for indices in pattern.get_triplet())
    # Rows and columns as nodes of one graph with edges both ways: its strong components are the parts.
    both = np.concatenate([rows, columns + height]), np.concatenate([columns + height, rows])
    graph = ca.Sparsity.triplet(height + width, height + width, *(nodes.tolist() for nodes in both))
    _, order, ends = graph.scc()
    number, place = np.empty(height + width, dtype=np.intp), np.empty(height + width, dtype=np.intp)
    members = []
    for k, (first, last) in enumerate(pairwise(ends)):
        each = np.sort(np.array(order[first:last], dtype=np.intp))
        places = each[each < height], each[each >= height] - height
        number[each] = k
        place[places[0]], place[places[1] + height] = np.arange(len(places[0])), np.arange(len(places[1]))
        members.append(places)
    by_part = np.argsort(number[rows], kind="stable")
    entries = np.split(by_part, np.cumsum(np.bincount(number[rows], minlength=len(members)))[:-1])
    return tuple(
        Part(*places, its, (place[rows[its]], place[columns[its] + height]))
        for places, its in zip(members, entries, strict=True)
    )


def of_one_shape(parts: Sequence[Part]) -> list[list[Part]]:
    """Return the parts in groups of equal numbers of rows and columns."""
    groups: dict[tuple[int, int], list[Part]] = {}
    for part in parts:
        groups.setdefault((len(part.rows), len(part.columns)), []).append(part)
    return list(groups.values())


def filled(matrix: ca.DM) -> Array:
    """Return a sparse matrix as a dense array; CasADi's own conversion copies every zero by itself."""
    array = np.zeros(matrix.shape)
    array[tuple(np.array(matrix.sparsity().get_triplet(), dtype=np.intp))] = matrix.nonzeros()
    return array


def singular_values(matrix: Array) -> Array:
    """Return the singular values of a matrix, largest first, from those of its independent parts."""
    places = (indices.tolist() for indices in np.nonzero(matrix))
    parts = [part for part in parts_of(ca.Sparsity.triplet(*matrix.shape, *places)) if len(part.entries)]
    of_parts = [
        np.linalg.svd(np.stack([matrix[np.ix_(part.rows, part.columns)] for part in same]), compute_uv=False).ravel()
        for same in of_one_shape(parts)
    ]
    # Empty rows and columns are singular values of zero, which no part brings.
    values = np.sort(np.concatenate([*of_parts, np.zeros(min(matrix.shape))]))[::-1]
    return np.asarray(values[: min(matrix.shape)])


def equilibrated(matrix: Array) -> Array:
    """Scale rows and columns to unit maximum (Ruiz 2001), so that rank and condition do not depend on units.

    Takes one matrix, or many stacked.
    """
    scaled = np.array(matrix, dtype=np.float64)
    size = np.empty_like(scaled)  # in place: allocation in every sweep takes longer than the divisions
    for sweep in range(SWEEPS if matrix.size else 0):
        for axis in (-1, -2):
            largest = np.abs(scaled, out=size).max(axis=axis, keepdims=True)
            factor = np.where(largest > 0.0, largest, 1.0)
            scaled /= np.sqrt(factor) if sweep < SWEEPS - 1 else factor
    return scaled


def has_full_rank(matrix: Array) -> bool:
    """Whether a matrix is square and of full rank after its rows and columns are scaled."""
    height, width = matrix.shape
    scaled = equilibrated(matrix)
    if height != width:
        return False
    if height >= LARGE:
        with suppress(np.linalg.LinAlgError):
            # Frobenius norms bound the condition number, at a tenth of the time of singular values.
            if np.linalg.norm(scaled) * np.linalg.norm(np.linalg.inv(scaled)) * np.finfo(np.float64).eps * height < 1.0:
                return True
    return bool(np.linalg.matrix_rank(scaled) == height)


_SMALL = 3  # unknowns: parts up to this size are solved by a formula, cheaper than a function call


@dataclass(frozen=True, eq=False)
class IsomorphicParts:
    """Isomorphic parts, which share one compiled solver.

    Attributes
    ----------
    parts : list of Part
        Rows and columns of each.
    givens : list of list of int
        Indices of the system's givens on which each part depends, in the order of the solver's arguments.
    """

    parts: list[Part]
    givens: list[list[int]]


def isomorphic_parts(residual: ca.SX, unknowns: ca.SX, givens: ca.SX, beside: Sequence[ca.SX]) -> list[IsomorphicParts]:
    """Return the groups of two and more independent parts of residual(unknowns, givens) = 0 that are alike.

    Parameters
    ----------
    residual, unknowns, givens : casadi.SX
        The equations; unknowns and givens are symbols.
    beside : sequence of casadi.SX
        Further expressions of the givens, as long as the residual: one entry per unknown, in the last one per row.
    """
    if unknowns.numel() <= 2 * _SMALL:
        return []
    parts = parts_of(ca.jacobian_sparsity(residual, unknowns))
    shapes: dict[tuple[int, int], list[Part]] = {}
    for part in parts:
        if len(part.rows) == len(part.columns) > _SMALL:
            shapes.setdefault((len(part.rows), len(part.entries)), []).append(part)
    candidates = [part for same in shapes.values() if len(same) > 1 for part in same]
    if not candidates:
        return []
    places = {entry.element_hash(): k for k, entry in enumerate(ca.vertsplit(givens) if givens.numel() else ())}
    groups: dict[str, IsomorphicParts] = {}
    for part in candidates:
        rows, columns = part.rows.tolist(), part.columns.tolist()
        expressions = [residual[rows], *(vector[columns] for vector in beside[:-1]), beside[-1][rows]]
        hashes = (symbol.element_hash() for symbol in ca.symvar(ca.vertcat(*expressions)))
        known = sorted(places[key] for key in hashes if key in places)
        # Two parts are isomorphic if CasADi serializes them to the same text, names of symbols aside.
        group = groups.setdefault(_text(expressions, [unknowns[columns], givens[known]]), IsomorphicParts([], []))
        group.parts.append(part)
        group.givens.append(known)
    return [group for group in groups.values() if len(group.parts) > 1]


def _text(expressions: list[ca.SX], symbols: list[ca.SX]) -> str:
    """Return expressions of symbols as a text that does not depend on the names of the symbols."""
    renamed = [ca.SX.sym("x", symbol.numel()) for symbol in symbols]
    results = ca.Function("sc_part", symbols, expressions).call(renamed)
    text: str = ca.Function("sc_part", renamed, results).serialize()
    return text


_MOST_AUGMENTED = 200  # rows: beyond, compiled loops are worth their import


def largest_assignment(weights: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Return the column of every row such that the sum of the weights (n, n) is maximal.

    Shortest augmenting paths with potentials (Kuhn 1955, Edmonds and Karp 1972): O(n^3), in vectors of NumPy. SciPy has
    the same in C, but its import takes ten times longer than the analysis of most systems.
    """
    if len(weights) > _MOST_AUGMENTED:
        import scipy.optimize  # noqa: PLC0415 - kept out of the run time of an FMU, and of most programs

        return np.asarray(scipy.optimize.linear_sum_assignment(weights, maximize=True)[1], dtype=np.intp)
    size = len(weights)
    of_row, of_column = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int64)  # potentials
    row_of = np.full(size, -1)
    for row in range(size):
        _augment(weights, of_row, of_column, row_of, row)
    columns = np.empty(size, dtype=np.intp)
    columns[row_of] = np.arange(size)
    return columns


def _augment(
    weights: npt.NDArray[np.int64],
    of_row: npt.NDArray[np.int64],
    of_column: npt.NDArray[np.int64],
    row_of: npt.NDArray[np.intp],
    row: int,
) -> None:
    """Assign a column to a row along the shortest augmenting path to a free column; all arrays change in place."""
    most = np.iinfo(np.int64).max // 4
    loss, before = np.full(len(row_of), most), np.full(len(row_of), -1)
    seen = np.zeros(len(row_of), dtype=bool)
    here, column = row, -1  # the current row, and the column by which it was reached
    while True:
        reduced = of_row[here] + of_column - weights[here]
        nearer = ~seen & (reduced < loss)
        loss[nearer], before[nearer] = reduced[nearer], column
        column = int(np.where(seen, most, loss).argmin())
        step = loss[column]
        of_row[row_of[seen]] -= step
        of_row[row] -= step
        of_column[seen] += step
        loss[~seen] -= step
        if row_of[column] < 0:
            break
        seen[column] = True
        here = row_of[column]
    while column >= 0:
        previous = int(before[column])
        row_of[column] = row_of[previous] if previous >= 0 else row
        column = previous
