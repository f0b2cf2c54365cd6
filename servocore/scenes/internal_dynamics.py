"""Differential equations of internal dynamics, integrated by SciPy: the independent answer of a scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from servocore.symbols import Array

Rate = Callable[[float, Array], Array]
"""(time in s, state (n,)) -> its rate (n,)."""

_RTOL, _ATOL = 1e-13, 1e-14
_LONGEST_STEP = 1 / 100  # of the whole time, so that interpolation within a step is as accurate as the step


def forward(rate: Rate, t: Array, start: float, size: int) -> Array:
    """Solve x' = rate(t, x), x = 0 until `start`, by DOP853 close to round-off.

    Parameters
    ----------
    rate : callable
        Right-hand side; it vanishes for x = 0 before `start`.
    t : ndarray, shape (N,)
        Where the solution is wanted, in s, increasing.
    start : float
        In s.
    size : int
        Number n of states.

    Returns
    -------
    ndarray, shape (n, N)
    """
    import scipy.integrate  # noqa: PLC0415 - kept out of the run time of an FMU

    found = np.zeros((size, len(t)))
    later = t > start
    if later.any():
        span = (start, float(t[-1]))
        solution = scipy.integrate.solve_ivp(
            rate, span, np.zeros(size), method="DOP853", t_eval=t[later], rtol=_RTOL, atol=_ATOL,
            max_step=(span[1] - span[0]) * _LONGEST_STEP,
        )  # fmt: skip
        found[:, later] = solution.y
    return found


def backward(rate: Rate, t: Array, end: float, size: int) -> Array:
    """Solve x' = rate(t, x), x = 0 from `end` on, towards earlier times; otherwise as `forward`."""
    return forward(lambda reversed_time, x: -rate(-reversed_time, x), -t[::-1], -end, size)[:, ::-1]
