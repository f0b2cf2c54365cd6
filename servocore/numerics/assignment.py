"""The assignment of rows to columns with the largest sum of weights, for matrices that are small.

Shortest augmenting paths with potentials (Kuhn 1955, Edmonds and Karp 1972): O(n^3), in vectors of NumPy. SciPy has the
same in C, but its import takes ten times longer than the analysis of most systems.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_SMALL = 200  # rows: beyond, compiled loops are worth their import


def largest_assignment(weights: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Return the column of every row such that the sum of the weights (n, n) is as large as it can be."""
    if len(weights) > _SMALL:
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
    """Give a row its column: along the path of least loss to a column that is free, all arrays in place."""
    most = np.iinfo(np.int64).max // 4
    loss, before = np.full(len(row_of), most), np.full(len(row_of), -1)
    seen = np.zeros(len(row_of), dtype=bool)
    here, column = row, -1  # the row that is looked at, and the column by which it was reached
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
