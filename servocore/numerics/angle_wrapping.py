"""Angles modulo full turns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def wrapped_angle(angle: Array) -> Array:
    """Return angles (rad) modulo full turns, in [-pi, pi)."""
    wrapped: Array = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return wrapped
