"""The load path between the instants at which the host tells it: Taylor's and Hermite's polynomials.

A *jet* is an array of shape (5, 3): position, velocity, acceleration, jerk and snap at one instant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import factorial
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
LoadPath = Callable[[float], Array]
"""(time after the start of the communication step) -> jet."""

ROWS = 5
"""Rows of a jet: derivatives up to the fourth."""

_COLUMNS = 2 * ROWS
_INVERSE_FACTORIALS = np.array([1.0 / factorial(k) for k in range(ROWS)])
_FALLING = np.array(
    [[factorial(j) / factorial(j - k) if j >= k else 0.0 for j in range(_COLUMNS)] for k in range(ROWS)]
)
_EXPONENTS = np.maximum(np.arange(_COLUMNS)[None, :] - np.arange(ROWS)[:, None], 0)
_END_CONDITIONS = np.linalg.inv(_FALLING[:, ROWS:])


def continued(jet: Sequence[Any] | Array, tau: Any) -> list[Any]:
    """Continue a path by its Taylor polynomial: the error of derivative k is O(tau^(5 - k)).

    Parameters
    ----------
    jet : sequence of ndarray or casadi.SX
        Position and derivatives: rows of a jet, or symbols for them.
    tau : float or casadi.SX
        For how many seconds.
    """
    moved = []
    for k in range(ROWS):
        value = jet[ROWS - 1]
        for j in reversed(range(k, ROWS - 1)):  # Horner: value becomes jet_j + tau / (j - k + 1) value
            value = jet[j] + tau / (j - k + 1) * value
        moved.append(value)
    return moved


def taylor(jet: Array, tau: float) -> Array:
    """Return a jet `continued`."""
    return np.stack(continued(jet, tau))


def hermite(first: Array, last: Array, h: float) -> LoadPath:
    """Join two jets, h apart, by the polynomial of degree nine that has both.

    Parameters
    ----------
    first, last : ndarray, shape (5, 3)
        Jets at the times 0 and h.
    h : float
        Distance in s.

    Returns
    -------
    callable
        (time after the first jet) -> jet; the error of the position is O(h^10) for a smooth path.
    """
    scales = (h ** np.arange(ROWS))[:, None]
    low = first * scales * _INVERSE_FACTORIALS[:, None]
    high = _END_CONDITIONS @ (last * scales - _FALLING[:, :ROWS] @ low)
    coefficients = np.vstack([low, high])

    def at(tau: float) -> Array:
        jet: Array = (_FALLING * (tau / h) ** _EXPONENTS) @ coefficients / scales
        return jet

    return at
