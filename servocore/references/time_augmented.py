"""`TimeAugmented`: a path with the time as its last component, for systems whose equations depend on time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from servocore.references.base import FloatArray, Reference


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeAugmented(Reference):
    """(gamma(t), t): a path with the time below it, whose derivatives are 1, 0, 0, ...

    Attributes
    ----------
    path : Reference
        The path without the time.
    """

    path: Reference

    @classmethod
    def of(cls, path: Reference) -> TimeAugmented:
        """Append the time to a path."""
        return cls(**{**path.common, "dimension": path.dimension + 1}, path=path)

    @property
    def stretches(self) -> FloatArray:
        """Those of the path."""
        return self.path.stretches

    @property
    def joints(self) -> FloatArray:
        """Those of the path."""
        return self.path.joints

    def _bounds(self, a: FloatArray, b: FloatArray, order: int) -> FloatArray:
        """Bound derivatives by those of the path, the time by its ends."""
        clock = np.zeros((len(a), order + 1, 1))
        clock[:, 0, 0], clock[:, 1:2] = np.maximum(np.abs(a), np.abs(b)), 1.0
        return np.concatenate([self.path._bounds(a, b, order), clock], axis=2)

    def _derivatives(self, t: FloatArray, order: int) -> FloatArray:
        clock = np.zeros((len(t), order + 1, 1))
        clock[:, 0, 0] = t
        clock[:, 1:2] = 1.0
        return np.concatenate([self.path.jet(t, order), clock], axis=2)
