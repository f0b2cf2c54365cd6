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
    where,
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
        first, last = np.array(self.start), np.array(self.end)
        derivatives = _on_line(self.profile, t[:, None], (first, last, last - first), numbers, order)
        return np.stack(derivatives, axis=1) + 0.0  # turns -0.0 into 0.0

    @property
    def formula(self) -> Formula:
        """The same as an expression."""
        profile, size = self.profile, self.dimension
        ends = [*self.start, *self.end, *(np.array(self.end) - np.array(self.start)).tolist()]

        def numbers(order: int) -> list[float]:
            return [*ends, self.start_time, self.end_time, *profile.numbers(self.duration, order)]

        def jet(t: ca.SX, arguments: list[ca.SX], order: int) -> list[ca.SX]:
            line = [ca.vertcat(*arguments[k * size : (k + 1) * size]) for k in range(3)]
            return _on_line(profile, t, line, arguments[3 * size :], order)

        return Formula((type(self), profile, size), numbers, jet)


def _on_line(profile: Profile, t: Values, line: Sequence[Values], numbers: list[Values], order: int) -> list[Values]:
    """Return the place and its derivatives: `line` are its ends and the way, `numbers` the times and the profile's."""
    (first, last, way), (start, end, *of_law) = line, numbers
    elapsed, remaining = (least(most(elapsed, 0.0), end - start) for elapsed in (t - start, end - t))
    s, *rates = profile.law(elapsed, remaining, of_law, order)
    outside = either(t < start, t >= end)
    place = where(s > 0.5, last - (1.0 - s) * way, s * way + first)
    return [place, *(where(outside, 0.0, rate) * way for rate in rates)]


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
