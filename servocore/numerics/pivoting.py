"""Columns of a matrix that determine the others: chosen far from dependent."""

from __future__ import annotations

import itertools
import math

import numpy as np

from servocore.numerics.compiled_calls import Array

_MOST_MINORS = 2000  # beyond that many candidates the columns are chosen greedily
_GOOD_ENOUGH = 0.5  # of the largest minor: among such choices the last columns are taken
_SINGULAR = 1e-9  # a minor of rows whose largest entry is one


def pivot_columns(matrix: Array) -> list[int]:
    """Return as many columns as there are rows, far from dependent: QR with column pivoting."""
    import scipy.linalg  # noqa: PLC0415 - kept out of the run time of an FMU

    return [int(column) for column in scipy.linalg.qr(matrix, mode="r", pivoting=True)[1][: len(matrix)]]


def last_good_columns(matrix: Array) -> list[int] | None:
    """Return as many columns as there are rows, in rising order, the last ones of which the minor is large enough.

    None if the rows are dependent, in whatever units they are.
    """
    m, n = matrix.shape
    largest = np.abs(matrix).max(axis=1, initial=0.0)
    if not largest.all():
        return None
    matrix = matrix / largest[:, None]
    candidates = [tuple(sorted(pivot_columns(matrix)))]
    if math.comb(n, m) <= _MOST_MINORS:
        candidates = list(itertools.combinations(range(n), m))
    minors = np.abs(np.linalg.det(np.stack([matrix[:, columns] for columns in candidates])))
    if not minors.max(initial=0.0) > _SINGULAR:
        return None
    return list(candidates[np.flatnonzero(minors >= _GOOD_ENOUGH * minors.max())[-1]])
