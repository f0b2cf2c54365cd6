"""Straight lines from rest to rest, and the time laws that they follow, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from servocore import TIME_LAWS, InvalidReference, InvalidSetting, Profile, Reference, rest_to_rest, three_phase

THREE_PHASE = "three-phase"
"""The time law that has a parameter, its ramp."""

PROFILES: Mapping[str, Profile] = TIME_LAWS
"""Time laws; the first is the default."""


def straight_line(
    start: Sequence[float],
    end: Sequence[float],
    duration: float,
    profile: str,
    ramp: float | None = None,
    start_time: float = 0.0,
) -> Reference:
    """Return a line from rest to rest.

    Parameters
    ----------
    start, end : sequence of float
        Where it starts and ends, in m.
    duration : float
        Time of the motion in s.
    profile : str
        One of `PROFILES`.
    ramp : float, optional
        Time to accelerate in s, for the profile three-phase only.
    start_time : float
        When the motion starts, in s.

    Raises
    ------
    InvalidSetting
        If a ramp is given for another profile.
    InvalidReference
        If there is no such line.
    """
    law = PROFILES[profile]
    if ramp is not None:
        if profile != THREE_PHASE:
            raise _no_ramp(profile)
        if ramp > duration / 2.0:
            raise InvalidReference(
                f"a path with a ramp of {ramp:g} s takes at least {2.0 * ramp:g} s, but its duration is {duration:g} s"
            )
        law = three_phase(ramp)
    return rest_to_rest(start, end, duration, law, start_time)


def require_no_ramp(profile: str, ramp: float) -> None:
    """Raise `InvalidSetting` if a ramp, in s, is given for a profile that has none; 0 is none."""
    if ramp:
        raise _no_ramp(profile)


def _no_ramp(profile: str) -> InvalidSetting:
    return InvalidSetting(f"a ramp belongs to the profile {THREE_PHASE}, not to {profile}")
