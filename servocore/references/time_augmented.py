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

    def enclosure(
        self, a: FloatArray, b: FloatArray, order: int, degree: int = 10
    ) -> tuple[FloatArray, FloatArray]:
        """Enclose the path and the time, which is linear; see `Reference.enclosure`.

        Parameters
        ----------
        a, b : ndarray, shape (N,)
            Begin and end of intervals in s.
        order : int
            Highest derivative wanted.
        degree : int
            Of the polynomials.

        Returns
        -------
        coefficients : ndarray, shape (N, order + 1, dimension, degree + 1)
            Of Chebyshev polynomials.
        radii : ndarray, shape (N, order + 1, dimension)
            Largest distance of a derivative from its polynomial.
        """
        coefficients, radii = self.path.enclosure(a, b, order, degree)
        clock, error = np.zeros((len(a), order + 1, 1, degree + 1)), np.zeros((len(a), order + 1, 1))
        clock[:, 0, 0, 0], clock[:, 0, 0, 1] = (a + b) / 2.0, (b - a) / 2.0
        clock[:, 1:2, 0, 0] = 1.0
        error[:, 0, 0] = 1e-15 * np.maximum(np.abs(a), np.abs(b))
        return np.concatenate([coefficients, clock], axis=2), np.concatenate([radii, error], axis=2)

    def _derivatives(self, t: FloatArray, order: int) -> FloatArray:
        clock = np.zeros((len(t), order + 1, 1))
        clock[:, 0, 0] = t
        clock[:, 1:2] = 1.0
        return np.concatenate([self.path.jet(t, order), clock], axis=2)
