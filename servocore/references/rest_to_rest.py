"""The straight line from one point to another, eq. (32), starting and ending at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from servocore.errors import InvalidReference, require_kind, require_real
from servocore.references.base import (
    ANALYTIC_ORDER,
    FloatArray,
    Formula,
    Reference,
    Values,
    either,
    least,
    most,
    points,
    positive_time,
)
from servocore.references.profiles import DEGREE9, Profile


@dataclass(frozen=True, kw_only=True)
class RestToRest(Reference):
    """Eq. (32): gamma(t) = start + s(t) (end - start), evaluated about the nearer end.

    Before `start_time` it rests at `start`, after `end_time` at `end`, all derivatives exactly zero. At the
    two times themselves a derivative above `smoothness` has its value just after.

    Attributes
    ----------
    start, end : tuple of float
        End points in m.
    profile : Profile
        The time law s.
    """

    start: tuple[float, ...]
    end: tuple[float, ...]
    profile: Profile

    @cached_property
    def stretches(self) -> FloatArray:
        """Start, end, and where the pieces of the time law meet."""
        inner = [self.start_time + junction for junction in self.profile.junctions(self.duration)]
        return np.unique([self.start_time, *inner, self.end_time])

    @property
    def degree(self) -> int | None:
        """Degree of the time law."""
        return self.profile.highest_power

    def _derivatives(self, t: FloatArray, order: int) -> FloatArray:
        numbers = [self.start_time, self.end_time, *self.profile.numbers(self.duration, order)]
        law, outside = _law(self.profile, t, numbers, order)
        s = np.stack(law, axis=1)
        s[outside, 1:] = 0.0
        first, last = np.array(self.start), np.array(self.end)
        way = last - first
        gamma: FloatArray = s[:, :, None] * way
        gamma += 0.0  # turns -0.0 into 0.0
        late = s[:, 0] > 0.5
        gamma[~late, 0] += first
        gamma[late, 0] = last - (1.0 - s[late, :1]) * way
        return gamma

    @property
    def formula(self) -> Formula:
        """The same as an expression."""
        profile, size = self.profile, self.dimension
        ends = [*self.start, *self.end, *(np.array(self.end) - np.array(self.start)).tolist()]

        def numbers(order: int) -> list[float]:
            return [*ends, self.start_time, self.end_time, *profile.numbers(self.duration, order)]

        def jet(t: ca.SX, arguments: list[ca.SX], order: int) -> list[ca.SX]:
            first, last, way = (ca.vertcat(*arguments[k * size : (k + 1) * size]) for k in range(3))
            s, outside = _law(profile, t, arguments[3 * size :], order)
            place = ca.if_else(s[0] > 0.5, last - (1.0 - s[0]) * way, s[0] * way + first)
            return [place, *(ca.if_else(outside, 0.0, derivative) * way for derivative in s[1:])]

        return Formula((type(self), profile, size), numbers, jet)


def _law(profile: Profile, t: Values, numbers: list[Values], order: int) -> tuple[list[Values], Values]:
    """Return s and its derivatives, and where the path rests; `numbers` are start, end and those of the profile."""
    start, end, *law_numbers = numbers
    duration = end - start
    elapsed, remaining = (least(most(elapsed, 0.0), duration) for elapsed in (t - start, end - t))
    return profile.law(elapsed, remaining, law_numbers, order), either(t < start, t >= end)


def rest_to_rest(
    start: Sequence[float],
    end: Sequence[float],
    duration: float,
    profile: Profile = DEGREE9,
    start_time: float = 0.0,
) -> RestToRest:
    """Straight line from `start` to `end`, at rest at both.

    Parameters
    ----------
    start, end : sequence of float, shape (dimension,)
        End points in m, any dimension.
    duration : float
        Time of the motion in s, positive.
    profile : Profile
        Time law; degree 2 k + 1 is smooth enough for inputs that contain k derivatives, degree 9 for four.
    start_time : float
        When the motion starts, in s.

    Returns
    -------
    RestToRest
        The path; its jets are exact at every order.

    Raises
    ------
    InvalidReference
        If the points are not finite or differ in dimension, the duration is not positive, or the profile
        does not fit into it.
    """
    first, last = points([start], "start point")[0], points([end], "end point")[0]
    if len(first) != len(last):
        raise InvalidReference(f"start has {len(first)} components and end has {len(last)}: they must agree")
    require_kind(profile, Profile, "the profile of a path", "one such as DEGREE9", InvalidReference)
    require_real(start_time, "the start of a path", "a time in s", InvalidReference)
    positive_time(duration, "duration")
    if duration < profile.shortest_duration:
        raise InvalidReference(
            f"a {profile.name} path with these settings takes at least {profile.shortest_duration} s, "
            f"but its duration is {duration} s"
        )
    return RestToRest(
        start_time=float(start_time),
        end_time=float(start_time + duration),
        dimension=first.size,
        max_order=ANALYTIC_ORDER,
        smoothness=profile.smoothness,
        start=tuple(first.tolist()),
        end=tuple(last.tolist()),
        profile=profile,
    )
