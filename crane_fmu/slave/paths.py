"""The load path between the instants at which the host tells it: Taylor's and Hermite's polynomials.

A *jet* is an array of shape (5, 3): position, velocity, acceleration, jerk and snap at one instant.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
LoadPath = Callable[[float], Array]
"""(time after the start of the communication step) -> jet."""

ROWS = 5
"""Rows of a jet: derivatives up to the fourth."""

_COLUMNS = 2 * ROWS
_INVERSE_FACTORIALS = np.array([1.0 / factorial(k) for k in range(_COLUMNS)])
_FALLING = np.array(
    [[factorial(j) / factorial(j - k) if j >= k else 0.0 for j in range(_COLUMNS)] for k in range(ROWS)]
)
_EXPONENTS = np.maximum(np.arange(_COLUMNS)[None, :] - np.arange(ROWS)[:, None], 0)
_END_CONDITIONS = np.linalg.inv(_FALLING[:, ROWS:])


def taylor(jet: Array, tau: float) -> Array:
    """Continue a path by its Taylor polynomial: the error of derivative k is O(tau^(5 - k))."""
    powers = (tau ** np.arange(ROWS)) * _INVERSE_FACTORIALS[:ROWS]
    moved = np.empty_like(jet)
    for k in range(ROWS):
        moved[k] = powers[: ROWS - k] @ jet[k:]
    return moved


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
    low = first * scales * _INVERSE_FACTORIALS[:ROWS, None]
    high = _END_CONDITIONS @ (last * scales - _FALLING[:, :ROWS] @ low)
    coefficients = np.vstack([low, high])

    def at(tau: float) -> Array:
        jet: Array = (_FALLING * (tau / h) ** _EXPONENTS) @ coefficients / scales
        return jet

    return at
