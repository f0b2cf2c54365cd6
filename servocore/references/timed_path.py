"""The same curve by another law of time: in another duration, or with any law along it.

`TimedPath` is gamma(t) = P(s(t)), with exact derivatives by the rule of Faa di Bruno; `TimeScaled` scales uniformly.
`TimeAugmented` holds the time beside the path, for systems whose equations depend on time.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np

from servocore.references.base import FloatArray, Reference, times_of
from servocore.references.piecewise import PiecewisePolynomial


@dataclass(frozen=True, kw_only=True, eq=False)
class TimedPath(Reference):
    """A curve P(s), 0 <= s <= 1, that is passed through by a law s(t) from rest to rest.

    Attributes
    ----------
    curve : PiecewisePolynomial
        P, in m, by s in the place of a time.
    law : PiecewisePolynomial
        s(t), with one component.
    """

    curve: PiecewisePolynomial
    law: PiecewisePolynomial

    @classmethod
    def of(cls, curve: PiecewisePolynomial, law: PiecewisePolynomial) -> TimedPath:
        """Pass through a curve by a law; as smooth as the rougher of both."""
        smoothness = min(law.smoothness, curve.smoothness)
        of_curve = {"dimension": curve.dimension, "smoothness": smoothness, "fit_error": curve.fit_error}
        return cls(**{**law.common, **of_curve}, curve=curve, law=law)

    @property
    def stretches(self) -> FloatArray:
        """Those of the law: pieces of the curve meet more smoothly, and often too near to these for rows at both."""
        return self.law.stretches

    @property
    def joints(self) -> FloatArray:
        """Those of the law, and the times at which a rising law comes to a joint of the curve, to round-off."""
        knots = self.curve.knots[1:-1]
        passed = times_of(lambda t: self.law.jet(t, 0)[:, 0, 0], knots, self.start_time, self.end_time)
        return np.unique([*self.law.joints, *passed])

    def _bounds(self, a: FloatArray, b: FloatArray, order: int) -> FloatArray:
        """Bound derivatives by the rule of Faa di Bruno: all its factors are positive."""
        law = self.law._bounds(a, b, order)
        s, reach = self.law.jet((a + b) / 2.0, 0)[:, 0, 0], law[:, 1, 0] * (b - a) / 2.0
        s = np.clip(s, 0.0, 1.0)
        # On the piece of the curve that the middle is on: beyond its ends by round-off that polynomial goes on.
        piece = np.clip(np.searchsorted(self.curve.knots, s) - 1, 0, len(self.curve.knots) - 2)
        begin = np.maximum(s - reach, self.curve.knots[piece])
        end = np.minimum(s + reach, self.curve.knots[piece + 1])
        slopes = self.curve._bounds(begin, end, order)
        return np.stack(chained(list(np.moveaxis(slopes, 1, 0)), list(np.moveaxis(law, 1, 0))), axis=1)

    def _derivatives(self, t: FloatArray, order: int) -> FloatArray:
        s = self.law.jet(t, order)[:, :, 0]
        known = min(order, self.curve.max_order)
        along = self.curve.jet(np.clip(s[:, 0], 0.0, 1.0), known)
        slopes = [along[:, k] if k <= known else np.zeros_like(along[:, 0]) for k in range(order + 1)]
        return np.stack(chained(slopes, [s[:, k, None] for k in range(order + 1)]), axis=1)


def chained(slopes: list[Any], inner: list[Any]) -> list[Any]:
    """Return f(s(t)) and its derivatives by t: arrays and expressions of CasADi alike.

    Parameters
    ----------
    slopes : list
        f and its derivatives by s, at s(t).
    inner : list
        s and its derivatives by t, as many.
    """
    # partial[n][k] is the Bell polynomial B_nk of s', s'', ...: the factor of the k-th slope in the n-th derivative.
    partial: list[list[Any]] = [[1.0]]
    for n in range(1, len(inner)):
        row: list[Any] = [0.0]
        for k in range(1, n + 1):
            terms = [comb(n - 1, i - 1) * inner[i] * partial[n - i][k - 1] for i in range(1, n - k + 2)]
            row.append(sum(terms[1:], terms[0]))
        partial.append(row)
    derivatives = [slopes[0]]
    for n in range(1, len(inner)):
        terms = [slopes[k] * partial[n][k] for k in range(1, n + 1)]
        derivatives.append(sum(terms[1:], terms[0]))
    return derivatives


@dataclass(frozen=True, kw_only=True, eq=False)
class _MadeOf(Reference):
    """A path made of another one, whose pieces it has."""

    path: Reference

    @property
    def stretches(self) -> FloatArray:
        """Those of the path."""
        return self._own_times(self.path.stretches)

    @property
    def joints(self) -> FloatArray:
        """Those of the path."""
        return self._own_times(self.path.joints)

    def _own_times(self, t: FloatArray) -> FloatArray:
        return t


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeScaled(_MadeOf):
    """gamma(t) = path(t0 + (t - t0)/factor): `factor` times as long.

    Attributes
    ----------
    path : Reference
        The original path.
    factor : float
        New duration divided by the original one; positive.
    """

    factor: float

    @classmethod
    def to(cls, path: Reference, duration: float) -> TimeScaled:
        """Return a path scaled to a duration in s."""
        longer = {**path.common, "end_time": path.start_time + duration}
        return cls(**longer, path=path, factor=duration / path.duration)

    def _own_times(self, t: FloatArray) -> FloatArray:
        inner = self.start_time + (t[1:-1] - self.start_time) * self.factor
        return np.array([self.start_time, *inner, self.end_time])

    def _bounds(self, a: FloatArray, b: FloatArray, order: int) -> FloatArray:
        """Bound derivatives by those of the path, on intervals enlarged by the rounding of times."""
        begin, end = (self.start_time + (t - self.start_time) / self.factor for t in (a, b))
        return self.path._bounds(begin, end, order) / self.factor ** np.arange(order + 1)[:, None]

    def _derivatives(self, t: FloatArray, order: int) -> FloatArray:
        original = self.start_time + (t - self.start_time) / self.factor
        original = np.where(t >= self.end_time, np.maximum(original, self.path.end_time), original)
        return self.path.jet(original, order) / self.factor ** np.arange(order + 1)[:, None]


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeAugmented(_MadeOf):
    """(gamma(t), t): a path with the time below it, whose derivatives are 1, 0, 0, ...

    Attributes
    ----------
    path : Reference
        The path without the time.
    """

    @classmethod
    def of(cls, path: Reference) -> TimeAugmented:
        """Append the time to a path."""
        return cls(**{**path.common, "dimension": path.dimension + 1}, path=path)

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
