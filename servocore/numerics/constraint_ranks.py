"""Ranks of constraints at configurations that satisfy them, and choices of dependent columns.

Away from its assembled configurations a linkage can have more independent rows than its motion allows: a Bricard
linkage of six hinges has rank 30 of 30 joint rows almost everywhere and 29 where it is closed. So configurations are
assembled first, by Levenberg and Marquardt with a damping that vanishes with the residual: that converges
quadratically to a set of solutions of any dimension, also where rows are dependent (Yamashita and Fukushima, 2001).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.components import LARGE, gram_solver, singular_values

ROUND_OFF = 1e-9
"""Singular values of scaled rows below this fraction of the largest count as zero; assembly leaves some 1e-13."""

_ASSEMBLED, _CLOSED = 1e-11, 1e-13  # residual of scaled rows: accepted, and end of the iteration
_IMPLIED = 1e-8  # residual of the rows left out where the others hold
_DAMPING_FLOOR = 1e-14
_ITERATIONS = 60
_APART, _NEIGHBOURS = 0.1, 3  # of the nominal magnitudes; home may be singular, its neighbours are not
_LARGE_ENOUGH = 0.1  # of the largest part in a dependence: among such rows the last is left out

_MOST_MINORS = 2000  # beyond that many candidates the columns are chosen greedily
_GOOD_ENOUGH = 0.5  # of the largest minor: among such choices the last columns are taken
_SINGULAR = 1e-9  # a minor of rows whose largest entry is one

Rows = Callable[[Array], tuple[Array, Array]]
"""x (n,) -> (residual (m,), Jacobian (m, n))."""


@dataclass(frozen=True)
class ConstraintRank:
    """Rank of constraints and redundant rows.

    Attributes
    ----------
    rows, rank : int
        Number of constraints and of independent ones; equal if no configuration could be assembled.
    redundant : tuple of int
        Rows that follow from the others, also around the configuration: rows - rank of them, or none.
    assembled : bool
        Whether a configuration that satisfies all rows was found.
    """

    rows: int
    rank: int
    redundant: tuple[int, ...] = ()
    assembled: bool = True


def constraint_rank(
    constraints: ca.SX, q: ca.SX, p: ca.SX, starts: Sequence[Array], values: Array, nominal: Sequence[float]
) -> ConstraintRank:
    """Find the rank of the constraints, and rows that follow from the others.

    Parameters
    ----------
    constraints, q, p : casadi.SX
        g(q, p), shape (m,), and its symbols.
    starts : sequence of ndarray, shape (n,)
        Starts of the search for an assembled configuration; the first that leads to one counts.
    values : ndarray
        Parameter values.
    nominal : sequence of float, shape (n,)
        Typical magnitudes of the coordinates.

    Returns
    -------
    ConstraintRank
        The largest rank at an assembled configuration and its neighbours: at a singular configuration the rank is
        lower than elsewhere. Rows are redundant if the others imply them at neighbours.
    """
    count = constraints.numel()
    if not count:
        return ConstraintRank(0, 0)
    scale = np.asarray(nominal, dtype=np.float64)
    rows = _balanced(scaled_rows(constraints, q, p, values, scale), [np.asarray(start) / scale for start in starts])
    for start in starts:
        configurations = _neighbours(rows, np.asarray(start) / scale, _APART)
        if configurations:
            break
    else:
        return ConstraintRank(count, count, assembled=False)
    ranks = [_rank(rows(x)[1]) for x in configurations]
    rank = max(ranks)
    x = configurations[ranks.index(rank)]
    redundant = _dependent(rows(x)[1], rank)
    kept = [k for k in range(count) if k not in redundant]
    if redundant and not _implied(rows, kept, x):
        return ConstraintRank(count, count)
    return ConstraintRank(count, rank, redundant)


def scaled_rows(constraints: ca.SX, q: ca.SX, p: ca.SX, values: Array, scale: Array) -> Rows:
    """Return residual and Jacobian as functions of q / scale."""
    evaluate = Call(ca.Function("sc_rows", [q, p], [ca.densify(constraints), ca.densify(ca.jacobian(constraints, q))]))

    def rows(x: Array) -> tuple[Array, Array]:
        residual, jacobian = evaluate(x * scale, values)
        return residual.ravel(), jacobian.reshape(residual.size, x.size) * scale

    return rows


def _balanced(rows: Rows, places: Sequence[Array]) -> Rows:
    """Divide rows by the lengths of their gradients near some points, so that thresholds do not depend on units."""
    points = [point for place in places for point in (place, *_around(place, _APART))]
    with np.errstate(invalid="ignore"):
        lengths = np.nan_to_num(
            np.max([np.linalg.norm(rows(point)[1], axis=1) for point in points], axis=0), posinf=0.0
        )
    lengths = np.where(lengths > 0.0, lengths, 1.0)

    def balanced(x: Array) -> tuple[Array, Array]:
        residual, jacobian = rows(x)
        return residual / lengths, jacobian / lengths[:, None]

    return balanced


def assembled(rows: Rows, x: Array) -> Array | None:
    """Return a configuration near `x` at which all rows vanish, or None if none is found."""
    residual, jacobian = rows(x)
    if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
        return None
    lengths = np.linalg.norm(jacobian, axis=1)
    lengths[lengths < ROUND_OFF] = 1.0
    residual, damping = residual / lengths, 1.0
    for _ in range(_ITERATIONS):
        worst = np.abs(residual).max(initial=0.0)
        if worst <= _CLOSED:
            break
        size = float(np.linalg.norm(residual))
        trial = x - _damped_step(jacobian / lengths[:, None], residual, max(damping * size**2, _DAMPING_FLOOR))
        new, at_trial = rows(trial)
        new = new / lengths
        if np.isfinite(at_trial).all() and np.linalg.norm(new) < size:  # NaN is not less
            x, residual, jacobian, damping = trial, new, at_trial, max(damping / 4, 1.0)
        elif worst <= _ASSEMBLED:
            break
        else:
            damping *= 10.0
    return x if np.abs(residual).max(initial=0.0) <= _ASSEMBLED else None


def _damped_step(jacobian: Array, residual: Array, damping: float) -> Array:
    """Return J^T (J J^T + damping)^-1 residual; of many rows by sparse factors, where these are accurate."""
    solve = gram_solver(jacobian, damping) if len(jacobian) >= LARGE else None
    if solve is not None:
        step: Array = jacobian.T @ solve(residual)
        return step
    left, values, right = np.linalg.svd(jacobian, full_matrices=False)
    shortest: Array = right.T @ (values / (values**2 + damping) * (left.T @ residual))
    return shortest


def _neighbours(rows: Rows, x: Array, distance: float) -> list[Array]:
    """Return assembled configurations near `x`: the nearest first, then from starts some `distance` off it."""
    return [place for place in (assembled(rows, start) for start in (x, *_around(x, distance))) if place is not None]


def _around(x: Array, distance: float) -> list[Array]:
    angles = 1.0 + np.arange(x.size)
    return [x + distance * np.sin(k * angles + k) for k in range(1, _NEIGHBOURS + 1)]


def unit_rows(jacobian: Array) -> Array:
    """Scale rows to length one; rows of zeros stay."""
    lengths = np.linalg.norm(jacobian, axis=1, keepdims=True)
    unit: Array = jacobian / np.where(lengths > ROUND_OFF, lengths, 1.0)
    return unit


def _rank(jacobian: Array) -> int:
    unit = unit_rows(jacobian)
    if len(unit) >= LARGE and gram_solver(unit) is not None:  # far from dependent
        return len(unit)
    values = singular_values(unit)
    return int((values > ROUND_OFF * max(1.0, values[0])).sum())


def _dependent(jacobian: Array, rank: int) -> tuple[int, ...]:
    """Return the redundant rows: the last ones with a large enough part in the dependences."""
    if rank == len(jacobian):
        return ()
    left, _, _ = np.linalg.svd(unit_rows(jacobian))
    null, chosen = left[:, rank:], []
    while null.shape[1]:
        parts = np.linalg.norm(null, axis=1)
        chosen.append(int(np.flatnonzero(parts >= _LARGE_ENOUGH * parts.max())[-1]))
        # The dependences in which the chosen row has no part remain.
        null = null @ np.linalg.svd(null[chosen[-1:]])[2][1:].T
    return tuple(sorted(chosen))


def _implied(rows: Rows, kept: list[int], x: Array) -> bool:
    """Whether all rows hold at configurations near `x` that only the kept rows assemble."""

    def fewer(x: Array) -> tuple[Array, Array]:
        residual, jacobian = rows(x)
        return residual[kept], jacobian[kept]

    lengths = np.maximum(np.linalg.norm(rows(x)[1], axis=1), 1.0)
    configurations = _neighbours(fewer, x, _APART / 5)
    return all(float(np.abs(rows(configuration)[0] / lengths).max()) <= _IMPLIED for configuration in configurations)


def pivot_columns(matrix: Array) -> list[int]:
    """Return as many columns as there are rows, far from dependent: QR with column pivoting."""
    import scipy.linalg  # noqa: PLC0415 - kept out of the run time of an FMU

    return [int(column) for column in scipy.linalg.qr(matrix, mode="r", pivoting=True)[1][: len(matrix)]]


def last_good_columns(matrix: Array) -> list[int] | None:
    """Return as many columns as there are rows, in rising order: the last ones whose minor is large enough.

    None if the rows are dependent; units do not matter.
    """
    largest = np.abs(matrix).max(axis=1, initial=0.0)
    if not largest.all():
        return None
    present = np.flatnonzero(np.abs(matrix).max(axis=0))  # of a selection of coordinates, no other minor exists
    matrix = matrix[:, present] / largest[:, None]
    many = math.comb(len(present), len(matrix)) > _MOST_MINORS
    candidates = (
        [sorted(pivot_columns(matrix))] if many else list(itertools.combinations(range(len(present)), len(matrix)))
    )
    minors = np.abs(np.linalg.det(np.stack([matrix[:, columns] for columns in candidates])))
    if not minors.max(initial=0.0) > _SINGULAR:
        return None
    chosen = candidates[np.flatnonzero(minors >= _GOOD_ENOUGH * minors.max())[-1]]
    return [int(column) for column in present[list(chosen)]]
