"""`TimeScaled`: the same curve in another duration, by uniform time scaling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from servocore.references.base import FloatArray, Reference


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeScaled(Reference):
    """gamma(t) = path(t0 + (t - t0)/factor): `factor` times as long.

    Attributes
    ----------
    path : Reference
        The original path.
    factor : float
        New duration divided by the original one; positive.
    """

    path: Reference
    factor: float

    @classmethod
    def to(cls, path: Reference, duration: float) -> TimeScaled:
        """Return a path scaled to a duration in s."""
        return cls(
            start_time=path.start_time,
            end_time=path.start_time + duration,
            dimension=path.dimension,
            max_order=path.max_order,
            smoothness=path.smoothness,
            fit_error=path.fit_error,
            path=path,
            factor=duration / path.duration,
        )

    @property
    def stretches(self) -> FloatArray:
        """Those of the path."""
        inner = self.start_time + (self.path.stretches[1:-1] - self.start_time) * self.factor
        return np.array([self.start_time, *inner, self.end_time])

    def _derivatives(self, t: FloatArray, order: int) -> FloatArray:
        original = self.start_time + (t - self.start_time) / self.factor
        original = np.where(t >= self.end_time, np.maximum(original, self.path.end_time), original)
        return self.path.jet(original, order) / self.factor ** np.arange(order + 1)[:, None]
