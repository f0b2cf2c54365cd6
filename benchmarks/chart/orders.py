"""Orders of convergence, fitted to errors of runs with falling step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LARGEST = 0.1
"""Errors above this fraction of the peak say nothing of the order."""
ABOVE_FLOOR = 20.0
"""An error counts while it is so many times the round-off that belongs to its step."""


@dataclass(frozen=True)
class Fit:
    """A fitted order.

    Attributes
    ----------
    order : float or None
        Slope of log(error) against log(h) by least squares; None where too few points are left.
    used : tuple of int
        Which points were used.
    """

    order: float | None
    used: tuple[int, ...]


def round_off_constant(steps: Sequence[float], errors: Sequence[float]) -> float:
    """Estimate c of the round-off c/h^2 from the points where the error grows as the step falls.

    Returns zero if it grows nowhere.
    """
    h, e = np.asarray(steps), np.asarray(errors)
    lowest = int(e.argmin())
    beyond = [k for k in range(len(h)) if k > lowest and e[k] > 1.5 * e[k - 1]]
    return float(np.median([e[k] * h[k] ** 2 for k in beyond])) if beyond else 0.0


def fit_order(steps: Sequence[float], errors: Sequence[float], constant: float) -> Fit:
    """Fit an order to the last points, at most three, that lie between `LARGEST` and the round-off.

    Parameters
    ----------
    steps : sequence of float
        Step sizes, falling.
    errors : sequence of float
        Their errors.
    constant : float
        c of the round-off c/h^2.
    """
    h, e = np.asarray(steps, dtype=float), np.asarray(errors, dtype=float)
    lowest = int(np.nanargmin(e))
    good = [k for k in range(lowest + (lowest == len(h) - 1)) if ABOVE_FLOOR * constant / h[k] ** 2 < e[k] < LARGEST]
    used = tuple(good[-3:])
    if len(used) < 2:
        return Fit(None, used)
    slope = np.polyfit(np.log(h[list(used)]), np.log(e[list(used)]), 1)[0]
    return Fit(float(slope), used)
