"""Paths of a user's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import servocore as sc


@dataclass(frozen=True, kw_only=True, eq=False)
class Steady(sc.Reference):
    """From a start with constant velocity, for ever."""

    start: tuple[float, ...]
    velocity: tuple[float, ...]

    @classmethod
    def of(cls, start: tuple[float, ...], velocity: tuple[float, ...], duration: float) -> Steady:
        return cls(
            start_time=0.0, end_time=duration, dimension=len(start), max_order=99, smoothness=99,
            start=start, velocity=velocity,
        )  # fmt: skip

    def _derivatives(self, t: np.ndarray, order: int) -> np.ndarray:
        found = np.zeros((len(t), order + 1, self.dimension))
        found[:, 0] = np.array(self.start) + t[:, None] * np.array(self.velocity)
        found[:, 1:2] = self.velocity
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Sine(sc.Reference):
    """sin(w t), whose derivatives of order k have the factors that are given."""

    rate: float
    factors: tuple[float, ...]

    @classmethod
    def of(cls, rate: float, factors: tuple[float, ...]) -> Sine:
        return cls(
            start_time=0.0, end_time=4.0, dimension=1, max_order=len(factors) - 1, smoothness=99,
            rate=rate, factors=factors,
        )  # fmt: skip

    def _derivatives(self, t: np.ndarray, order: int) -> np.ndarray:
        columns = [self.factors[k] * np.sin(self.rate * t + k * np.pi / 2) for k in range(order + 1)]
        return np.stack(columns, axis=1)[:, :, None]
