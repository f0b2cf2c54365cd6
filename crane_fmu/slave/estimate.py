"""Derivatives of the load path that are not connected, estimated from the samples of the highest one that is.

The last n = 7 - k samples of the k-th derivative lie on one polynomial of degree n - 1; its derivatives at the newest
sample are the estimates. For samples h apart, derivative j of the path has an error of order h^(7 - j), snap one of
h^3. An error e of the samples, rounding included, comes out as up to `amplification(k) e / h^(4 - k)` in the snap.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import factorial

import numpy as np

from crane_fmu.slave.interface import ORDERS
from crane_fmu.slave.paths import ROWS, Array

Sample = tuple[float, tuple[float, ...]]
"""Time in s, and the highest connected derivative then."""

_LONGEST = ROWS + 2
_SLIGHT = 1e-9  # of the size of a position: smaller changes are rounding


def kept_samples(samples: Sequence[Sample], time: float, value: Sequence[float], order: int) -> tuple[Sample, ...]:
    """Return the samples to keep with a new one; one that is told again for its instant replaces the older."""
    older = [each for each in samples if each[0] < time]
    return (*older, (time, tuple(value)))[-(_LONGEST - order) :]


def completed(samples: Sequence[Sample], jet: Array, order: int, step: float) -> Array:
    """Return a jet whose derivatives above `order` are estimated.

    Parameters
    ----------
    samples : sequence of Sample
        The newest last. Before the first one the path is taken to have been constant, a step apart.
    jet : ndarray, shape (5, 3)
        What is connected, at the time of the newest sample.
    order : int
        Highest derivative that is connected.
    step : float
        Time between the samples that are assumed before the first one, in s.
    """
    count = _LONGEST - order
    first = samples[0]
    missing = count - len(samples)
    whole = [(first[0] - (missing - k) * step, first[1]) for k in range(missing)] + list(samples)
    now = whole[-1][0]
    spacing = now - whole[-2][0]
    nodes = tuple(round((each[0] - now) / spacing, 6) for each in whole)
    factors = _weights(nodes) @ np.array([each[1] for each in whole])
    full = jet.copy()
    for j in range(order + 1, ROWS):
        full[j] = factors[j - order] * factorial(j - order) / spacing ** (j - order)
    return full


@lru_cache(maxsize=256)  # steps have nearly always the same few patterns, and an inverse costs as much as a step
def _weights(nodes: tuple[float, ...]) -> Array:
    """Return the matrix from values at the nodes to the coefficients of their polynomial."""
    weights: Array = np.linalg.inv(np.vander(nodes, increasing=True))
    return weights


def amplification(order: int) -> float:
    """Return by how much an error of equidistant samples is at most amplified in the snap, in units of h^(order-4)."""
    degree = ROWS - 1 - order
    nodes = tuple(float(k) for k in range(order - _LONGEST + 1, 1))
    return float(np.abs(_weights(nodes)[degree]).sum() * factorial(degree))


def contradiction(before: Sequence[float], now: Sequence[float], order: int) -> str:
    """Say which derivative changes while all connected ones above it stay exactly zero; empty if none does.

    Parameters
    ----------
    before, now : sequence of 15 floats
        What was told for two instants.
    order : int
        Highest derivative that is connected.
    """
    top = slice(3 * order, 3 * order + 3)
    if any(now[top]) or any(before[top]):  # as nearly always in motion: nothing below can be a contradiction
        return ""
    size = max(1.0, *map(abs, now[:3]))
    for k in range(order):
        changed = max(abs(now[j] - before[j]) for j in range(3 * k, 3 * k + 3)) > _SLIGHT * size
        above = range(3 * k + 3, 3 * order + 3)
        if changed and not any(before[j] or now[j] for j in above):
            return (
                f"the load's {ORDERS[k]} changes, but its {' and '.join(ORDERS[k + 1 : order + 1])} stay zero: connect"
                f" what is missing, or set connected = {ORDERS[k]} to have it estimated; the outputs are those of a"
                f" load whose {ORDERS[k]} stands still"
            )
    return ""
