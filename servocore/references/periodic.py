"""Paths that repeat themselves: sums of harmonics, known exactly at every order and after any number of cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidReference, require_real
from servocore.numerics.compiled_calls import lock_arrays
from servocore.references.base import ANALYTIC_ORDER, FloatArray, Reference, points, positive_time

MOST_STRETCHES = 1000
"""In longer runs a stretch holds several turns, which repeat those that were checked."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Periodic(Reference):
    """Trigonometric polynomial gamma(t) = centre + sum_k (cosines_k cos(k w t) + sines_k sin(k w t)), w = 2 pi/period.

    The time since `start_time` is first reduced to one period, exactly: the thousandth cycle is as accurate as the
    first. Before `start_time` and after `end_time` the motion goes on.

    Attributes
    ----------
    period : float
        In s.
    centre : ndarray, shape (dimension,)
        Mean position in m.
    cosines, sines : ndarray, shape (harmonics, dimension)
        Amplitudes of the harmonics k = 1, 2, ... in m.
    """

    period: float
    centre: FloatArray
    cosines: FloatArray
    sines: FloatArray

    def __post_init__(self) -> None:
        super().__post_init__()
        lock_arrays(self, "centre", "cosines", "sines")

    @property
    def stretches(self) -> FloatArray:
        """Half periods of the highest harmonic: that is how often it turns."""
        halves = np.ceil(2.0 * len(self.cosines) * self.duration / self.period)
        return np.linspace(self.start_time, self.end_time, int(np.clip(halves, 1, MOST_STRETCHES)) + 1)

    def _bounds(self, a: FloatArray, b: FloatArray, order: int) -> FloatArray:  # noqa: ARG002 - alike on all intervals
        """Bound derivatives by the amplitudes of all harmonics."""
        rates = 2.0 * np.pi / self.period * np.arange(1.0, len(self.cosines) + 1.0)
        bounds = np.vander(rates, order + 1, increasing=True).T @ np.hypot(self.cosines, self.sines)
        bounds[0] += np.abs(self.centre)
        return np.tile(1.001 * bounds, (len(a), 1, 1))

    def _derivatives(self, t: FloatArray, order: int) -> FloatArray:
        turn = np.fmod(t - self.start_time, self.period) / self.period
        harmonics = np.arange(1.0, len(self.cosines) + 1.0)
        # a cos + b sin is the real part of (a - i b) e^(i angle), of which every derivative is i rate times the last
        waves = np.exp(2j * np.pi * np.fmod(turn[:, None] * harmonics, 1.0))
        factors = np.vander(2j * np.pi * harmonics / self.period, order + 1, increasing=True)
        gamma: FloatArray = np.einsum("nk,kj,kd->njd", waves, factors, self.cosines - 1j * self.sines).real
        gamma[:, 0] += self.centre
        return gamma


def periodic(
    centre: Sequence[float],
    cosines: npt.ArrayLike,
    sines: npt.ArrayLike,
    period: float,
    cycles: int = 1,
    start_time: float = 0.0,
) -> Periodic:
    """Return a path that repeats itself, from its harmonics.

    It is in motion at its start and end, and before and after: a load that is to follow it has to move already.

    Parameters
    ----------
    centre : sequence of float, shape (dimension,)
        Mean position in m.
    cosines, sines : array_like, shape (harmonics, dimension)
        Amplitudes of cos(k w t) and sin(k w t), k = 1, 2, ..., in m, with t counted from `start_time`.
    period : float
        Time of one cycle in s, positive.
    cycles : int
        How many cycles the path has, one or more.
    start_time : float
        When the first begins, in s.

    Returns
    -------
    Periodic
        The path; its jets are exact at every order.

    Raises
    ------
    InvalidReference
        If a number is not finite, the tables do not fit one another, or the period or the cycles are not positive.
    """
    middle, first, second = points([centre], "centre")[0], points(cosines, "cosine"), points(sines, "sine")
    if first.shape != second.shape or first.shape[1] != middle.size:
        raise InvalidReference(
            f"a centre with {middle.size} components needs cosines and sines with as many columns and equally many"
            f" rows, not tables of shapes {first.shape} and {second.shape}"
        )
    positive_time(period, "period")
    require_real(start_time, "the start of a path", "a time in s", InvalidReference)
    if not (isinstance(cycles, int) and cycles >= 1):
        raise InvalidReference(f"a periodic path has one or more whole cycles, not {cycles}")
    return Periodic(
        start_time=float(start_time),
        end_time=float(start_time + cycles * period),
        dimension=middle.size,
        max_order=ANALYTIC_ORDER,
        smoothness=ANALYTIC_ORDER,
        period=float(period),
        centre=middle,
        cosines=first,
        sines=second,
    )


def figure_of_eight(
    centre: Sequence[float],
    along: Sequence[float],
    across: Sequence[float],
    period: float,
    cycles: int = 1,
    start_time: float = 0.0,
) -> Periodic:
    """Return the figure of eight centre + along sin(w t) + across sin(2 w t), w = 2 pi/period.

    Parameters
    ----------
    centre : sequence of float, shape (dimension,)
        Where it crosses itself, in m; also its start.
    along, across : sequence of float, shape (dimension,)
        Half of its length and half of its width, as vectors in m.
    period : float
        Time of one round in s, positive.
    cycles : int
        Number of rounds, one or more.
    start_time : float
        When the first begins, in s.

    Returns
    -------
    Periodic
        The path; its jets are exact at every order.

    Raises
    ------
    InvalidReference
        As `periodic`.
    """
    return periodic(
        centre, np.zeros((2, points([centre], "centre").shape[1])), [along, across], period, cycles, start_time
    )
