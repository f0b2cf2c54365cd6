"""Chains of integrators: laws whose highest derivative, the snap, is continuous and piecewise linear.

A chain of length K holds a coordinate and its derivatives below K; the K-th is u, given at the knots of an even grid.
Within an interval everything else is a Taylor polynomial, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np

from servocore.numerics.compiled_calls import Array
from servocore.references.piecewise import PiecewisePolynomial


def advanced(states: list[Any], u: Any, change: Any, part: Any, h: Any) -> list[Any]:
    """Return a chain's derivatives 0 to K + 1 at a part of an interval: of arrays and of CasADi's expressions.

    Parameters
    ----------
    states : list
        The K derivatives at the interval's begin.
    u, change
        The K-th derivative there, and by how much it is more at the interval's end.
    part, h
        Where, between 0 and 1, and how long the interval is.
    """
    K, tau = len(states), part * h
    after = []
    for d in range(K + 1):
        q = K - d
        terms = [states[d + j] * (tau**j / factorial(j)) for j in range(q)]
        terms += [u * (tau**q / factorial(q)), change * (part * tau**q / factorial(q + 1))]
        after.append(sum(terms[1:], terms[0]))
    return [*after, change / h]


@dataclass(frozen=True, eq=False)
class Law:
    """Motions of chains between two states of rest.

    Attributes
    ----------
    duration : float
        In s.
    start, end : ndarray, shape (C,)
        Where each chain rests before and after.
    snaps : ndarray, shape (N + 1, C)
        The highest derivative at the knots, zero at the first and the last.
    length : int
        K, of the chains.
    """

    duration: float
    start: Array
    end: Array
    snaps: Array
    length: int

    @property
    def intervals(self) -> int:
        """N."""
        return len(self.snaps) - 1

    def states(self) -> Array:
        """Return the derivatives below K at the knots, shape (K, N + 1, C)."""
        return _states(self.start, self.snaps, self.length, self.duration)

    def jets(self, parts: Array) -> Array:
        """Return derivatives 0 to K + 1 at parts (n,) of all intervals, one after another, shape (C, K + 2, N n)."""
        states, u = self.states(), self.snaps
        h = self.duration / self.intervals
        columns = [state[:-1, None, :] for state in states]
        derivatives = advanced(columns, u[:-1, None, :], np.diff(u, axis=0)[:, None, :], parts[None, :, None], h)
        shape = (self.intervals, len(parts), len(self.start))
        return np.stack(
            [np.broadcast_to(derivative, shape).reshape(-1, shape[2]) for derivative in derivatives]
        ).transpose(2, 0, 1)

    def resting(self) -> Law:
        """Return the law with the smallest change of snaps after which it ends where it shall, at rest."""
        K, N = self.length, self.intervals
        scale = (self.duration ** np.arange(K))[:, None]
        units = _states(np.zeros(N - 1), np.eye(N + 1)[:, 1:-1], K, self.duration)[:, -1] * scale
        left = self.states()[:, -1].copy()
        left[0] -= self.end
        change, *_ = np.linalg.lstsq(units, -left * scale, rcond=None)
        snaps = self.snaps.copy()
        snaps[[0, -1]] = 0.0
        snaps[1:-1] += change
        return Law(self.duration, self.start, self.end, snaps, K)

    def refined(self) -> Law:
        """Return the same law on twice as many intervals."""
        middles = (self.snaps[:-1] + self.snaps[1:]) / 2.0
        snaps = np.empty((2 * self.intervals + 1, self.snaps.shape[1]))
        snaps[::2], snaps[1::2] = self.snaps, middles
        return Law(self.duration, self.start, self.end, snaps, self.length)

    def path(self) -> PiecewisePolynomial:
        """Return the law as a path, at rest before and after."""
        K, N = self.length, self.intervals
        knots = np.linspace(0.0, self.duration, N + 1)
        h = self.duration / N
        middle = self.jets(np.array([0.5]))  # (C, K + 2, N)
        factors = np.array([h**k / factorial(k) for k in range(K + 2)])
        coefficients = (middle * factors[:, None]).transpose(2, 1, 0)
        return PiecewisePolynomial.of(knots, coefficients, K, np.stack([self.start, self.end]), (True, True))


def _states(start: Array, snaps: Array, length: int, duration: float) -> Array:
    h = duration / (len(snaps) - 1)
    here = [np.array(start, dtype=np.float64), *(np.zeros(len(start)) for _ in range(length - 1))]
    columns = [here]
    for u, change in zip(snaps[:-1], np.diff(snaps, axis=0), strict=True):
        here = advanced(here, u, change, 1.0, h)[:length]
        columns.append(here)
    return np.array(columns).transpose(1, 0, 2)


def sampled_law(jets: Array, duration: float, length: int) -> Law:
    """Return a law whose snaps are those of derivatives (orders, N + 1, C) at even instants."""
    return Law(duration, jets[0, 0], jets[0, -1], jets[length].copy(), length).resting()
