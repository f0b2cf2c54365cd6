"""Derivatives of the load path that are not connected, estimated from the samples of the highest one that is.

Model: near its newest sample the k-th derivative of the path is a polynomial of degree 6 - k plus errors of the
samples, rounding included, that are independent and of one size. Polynomials are fitted by least squares to the last
7 - k samples (an interpolation), and to more and more of them. The longer the window the less of the errors comes
through, and the more the path differs from a polynomial: the longest window is taken whose snap agrees, to what the
errors explain, with those of all shorter ones (Lepski's rule). Their size is learnt from residuals of the shortest
window that has some. Where samples are exact the shortest window wins: derivative j then has an error of order
h^(7 - j), snap one of h^3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import factorial

import numpy as np

from crane_fmu.slave.interface import DIMENSION, ORDERS
from crane_fmu.slave.paths import ROWS, Array
from crane_fmu.slave.state import PlainState

SAMPLES = ROWS + 2
"""Samples that it takes to know the derivatives above a position; one less for each derivative that is connected."""

_WINDOWS = (0, 2, 6, 12, 20, 32, 48, 72, 104, 150)  # samples more than an interpolation takes
_MOST = _WINDOWS[-1] + SAMPLES
_SLIGHT = 1e-9  # of the size of a position: smaller changes are rounding
_ROUNDING = 2e-16
_EVEN = 1e-11  # of a step: spacings that differ by less count as equal
_RISE, _FALL = 1.0 / 4.0, 1.0 / 64.0  # shares of the newest residual in the estimated noise
_ABSURD = 20.0  # m/s4: a larger snap is taken for an error of the samples
_AGREE = 3.5  # standard deviations
_STANDSTILL = 3e-6  # a first change of the samples up to this, in SI units, is no motion


@dataclass(frozen=True, eq=False)
class Samples(PlainState):
    """What is remembered of the path.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Of the samples in s, the newest 0.
    values : ndarray, shape (n, 3)
        The highest connected derivative then.
    age : float
        Time since the newest sample in s.
    variance : float
        Estimated variance of a sample's error; negative before the first estimate.
    """

    times: Array
    values: Array
    age: float
    variance: float


@dataclass(frozen=True)
class Estimate:
    """Derivatives that are estimated.

    Attributes
    ----------
    rows : ndarray, shape (4 - k, 3)
        Derivatives k + 1 to 4 of the path.
    snap_error : float
        Estimated error of the last row in m/s4.
    is_known : bool
        False while there are too few samples.
    """

    rows: Array
    snap_error: float
    is_known: bool


def first_sample(value: Sequence[float]) -> Samples:
    """Return the samples after the first, which is told for the start."""
    return Samples(np.zeros(1), np.array([value], dtype=float), 0.0, -1.0)


def with_sample(samples: Samples, value: Sequence[float], elapsed: float, order: int) -> Samples:
    """Return the samples with one more.

    Parameters
    ----------
    samples : Samples
        The others.
    value : sequence of 3 floats
        The new one; if it is told for the instant of the newest it replaces it.
    elapsed : float
        Time since the newest in s.
    order : int
        Highest derivative that is connected.
    """
    row = np.array([value], dtype=float)
    if elapsed <= 0.0:
        return replace(samples, values=np.concatenate([samples.values[:-1], row]))
    times, values = samples.times - elapsed, samples.values
    if len(times) == 1 and np.abs(row - values).max() <= _STANDSTILL + elapsed ** (ROWS - 1 - order):
        times = -elapsed * np.arange(_MOST - 1, 0, -1.0)  # a load at rest has rested before
        values = np.repeat(values, _MOST - 1, axis=0)
    times, values = np.append(times, 0.0)[-_MOST:], np.concatenate([values, row])[-_MOST:]
    return Samples(times, values, 0.0, samples.variance)


def estimated(samples: Samples, order: int) -> tuple[Estimate, Samples]:
    """Estimate derivatives at the newest sample.

    Parameters
    ----------
    samples : Samples
        The newest is that for which derivatives are wanted.
    order : int
        Highest derivative that is connected.

    Returns
    -------
    Estimate
        What is found; derivatives that so few samples do not tell are zero.
    Samples
        The samples with what has been learnt of their errors.
    """
    degree, wanted = SAMPLES - 1 - order, ROWS - 1 - order
    if len(samples.times) <= degree:
        few = np.zeros((wanted, DIMENSION))
        known = min(len(samples.times) - 1, wanted)
        if not known:  # one sample tells nothing of a motion
            return Estimate(few, 0.0, is_known=True), samples
        few[:known] = _Fit(samples, len(samples.times), len(samples.times) - 1).derivatives(known)
        return Estimate(few, math.inf, is_known=False), samples
    counts = [degree + 1 + more for more in _WINDOWS if degree + 1 + more <= len(samples.times)]
    fits = [_Fit(samples, count, degree) for count in counts[:2]]
    found = [fit.derivatives(wanted) for fit in fits]
    if len(fits) > 1:
        absurd = max(0.0, float(np.abs(found[0][-1]).max()) - _ABSURD) / fits[0].newest(wanted)
        samples = replace(samples, variance=max(_learnt(samples.variance, fits[1].variance()), absurd**2))
    size = math.sqrt(max(samples.variance, 0.0)) + _ROUNDING * float(np.abs(samples.values[-1]).max())
    spreads = [fit.spread(wanted) * size for fit in fits]
    chosen = 0
    for k in range(1, len(counts)):
        if k == len(fits):
            fits.append(_Fit(samples, counts[k], degree))
            found.append(fits[k].derivatives(wanted))
            spreads.append(fits[k].spread(wanted) * size)
        apart = [float(np.linalg.norm(found[k][-1] - found[j][-1])) for j in range(k)]
        if any(apart[j] > _AGREE * (spreads[k] + spreads[j]) for j in range(k)):
            break
        chosen = k
    error = _AGREE * spreads[chosen]
    if chosen == 0 and len(found) > 1:
        error += float(np.linalg.norm(found[1][-1] - found[0][-1]))
    return Estimate(found[chosen], error, is_known=True), samples


def _learnt(variance: float, newest: float) -> float:
    """Return the variance after a new residual: it rises fast and falls slowly."""
    if variance < 0.0:
        return newest
    return variance + (_RISE if newest > variance else _FALL) * (newest - variance)


class _Fit:
    """A polynomial fitted to the last samples by least squares."""

    def __init__(self, samples: Samples, count: int, degree: int) -> None:
        times = samples.times[-count:]
        self._span = -float(times[0])
        nodes = times / self._span
        even = np.abs(nodes - _even_nodes(count)).max() * (count - 1) <= _EVEN
        self._gains, self._basis = _even_design(count, degree) if even else _design(nodes, degree)
        self._values = samples.values[-count:] - samples.values[-1]
        self._freedom = count - degree - 1

    def derivatives(self, highest: int) -> Array:
        """Return derivatives 1 to `highest` of the samples."""
        scales = self._span ** np.arange(1.0, highest + 1)
        found: Array = self._gains[1 : highest + 1] @ self._values / scales[:, None]
        return found

    def spread(self, order: int) -> float:
        """Return the standard deviation of a derivative's component for errors of size one."""
        return float(np.linalg.norm(self._gains[order]) / self._span**order)

    def newest(self, order: int) -> float:
        """Return by how much an error of the newest sample comes out in a derivative."""
        return abs(float(self._gains[order, -1])) / float(self._span**order)

    def variance(self) -> float:
        """Return the mean variance of the samples' errors that the residuals tell."""
        residual = self._values - self._basis @ (self._basis.T @ self._values)
        return float(np.square(residual).sum()) / (self._freedom * DIMENSION)


def _design(nodes: Array, degree: int) -> tuple[Array, Array]:
    """Return the matrix from values at nodes in [-1, 0] to derivatives of their polynomial at 0, and its basis."""
    basis, triangle = np.linalg.qr(np.polynomial.legendre.legvander(2.0 * nodes + 1.0, degree))
    at_end = [
        [factorial(n + j) / (factorial(j) * factorial(n - j)) if n >= j else 0.0 for n in range(degree + 1)]
        for j in range(degree + 1)
    ]
    return np.array(at_end) @ np.linalg.solve(triangle, basis.T), basis


@lru_cache(maxsize=256)  # by numbers that decide everything: nothing is rounded
def _even_design(count: int, degree: int) -> tuple[Array, Array]:
    return _design(_even_nodes(count), degree)


def _even_nodes(count: int) -> Array:
    nodes: Array = np.arange(1.0 - count, 1.0) / (count - 1)
    return nodes


def amplification(order: int) -> float:
    """Return by how much an error of equidistant samples is at most amplified in the snap, in units of h^(order-4).

    That is the shortest window's: what comes through while samples are few, or while the path allows no longer one.
    """
    count, wanted = SAMPLES - order, ROWS - 1 - order
    weights = _even_design(count, count - 1)[0][wanted]
    return float(np.abs(weights).sum()) / float((count - 1) ** wanted)


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
                f" what is missing, or set connected = {ORDERS[k]} to have it estimated"
            )
    return ""
