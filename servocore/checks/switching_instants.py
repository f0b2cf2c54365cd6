"""When along a motion the operations of a model switch: `sign` changes, `floor` steps, a branch of `if_else` ends.

Between two switches that lie close together a model may differ from what it is at all instants that are asked for.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from servocore.numerics.compiled_calls import Array

_MOST = 500  # switches that are looked for: of a model that rattles, not all
_HALVINGS = 40
_NARROWINGS = 12
_APEX = 0.1  # of an argument beside it: an extremum nearer to zero is looked into


def with_switching_instants(t: Array, arguments: Callable[[Array], Array]) -> Array:
    """Return instants with those on both sides of every switch between them.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Instants in rising order.
    arguments : callable
        Times (N,) -> arguments (k, N), each of which switches where it passes a whole number; NaN where not known.
    """
    t, values = _with_extrema(t, arguments(t), arguments)
    which, interval = np.nonzero(_levels(values[:, 1:]) != _levels(values[:, :-1]))
    which, interval = which[:_MOST], interval[:_MOST]
    if not len(which):
        return t
    rows, before = np.arange(len(which)), _levels(values[which, interval])
    left, right = t[interval], t[interval + 1]
    for _ in range(_HALVINGS):
        middle = (left + right) / 2.0
        same = _levels(arguments(middle)[which, rows]) == before
        left, right = np.where(same, middle, left), np.where(same, right, middle)
    return np.unique(np.concatenate([t, left, right]))


def _levels(arguments: Array) -> Array:
    """Return what switches: the steps that arguments are on. What is not known is on none."""
    levels: Array = np.nan_to_num(np.floor(arguments), nan=-np.inf)
    return levels


def _with_extrema(t: Array, values: Array, at: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Add instants at which an argument turns back close to where it would switch."""
    if len(t) < 3:
        return t, values
    steps = np.abs(np.diff(values, axis=1))
    reach = np.maximum(steps[:, :-1], steps[:, 1:])
    turning = np.diff(values[:, :-1], axis=1) * np.diff(values[:, 1:], axis=1) <= 0.0
    here = values[:, 1:-1]
    near = np.abs(here - np.round(here)) <= (1.0 + _APEX) * reach
    which, k = np.nonzero(turning & near & (reach > 0.0))
    which, k = which[:_MOST], k[:_MOST] + 1
    if not len(which):
        return t, values
    rows, side = np.arange(len(which)), np.sign(values[which, k] - values[which, k - 1])
    left, middle, right = t[k - 1], t[k], t[k + 1]
    best = side * values[which, k]
    for _ in range(_NARROWINGS):
        for other in ((left + middle) / 2.0, (middle + right) / 2.0):
            found = side * at(other)[which, rows]
            better, later = found > best, other > middle
            left = np.where(better & later, middle, np.where(~better & ~later, other, left))
            right = np.where(better & ~later, middle, np.where(~better & later, other, right))
            middle, best = np.where(better, other, middle), np.where(better, found, best)
    t = np.unique(np.concatenate([t, middle]))
    return t, at(t)
