"""Instants along a path: those at which limits are looked at, and even ones."""

from __future__ import annotations

import numpy as np

from servocore.errors import InvalidSetting
from servocore.references.base import FloatArray, Reference

_FEWEST, _MOST = 400, 20_000
_DEFAULT_STEPS = 200
_MOST_STEPS = 10**8
_EACH = 16  # on a stretch of the path


def survey(reference: Reference) -> FloatArray:
    """Return instants evenly on every stretch of the path, in all not too few and not too many."""
    ends = reference.stretches
    pieces = len(ends) - 1
    each = max(_EACH, -(-_FEWEST // pieces))
    each = max(1, min(each, _MOST // pieces))
    fractions = np.arange(each) / each
    return np.append((ends[:-1, None] + np.diff(ends)[:, None] * fractions).ravel(), ends[-1])


def time_grid(reference: Reference, step: float | None) -> FloatArray:
    """Return the instants from start to end, a whole number of equal steps.

    Raises
    ------
    InvalidSetting
        If the step is not positive, exceeds the duration or does not divide it.
    """
    duration = reference.duration
    if step is None:
        step = duration / _DEFAULT_STEPS
    if not 0.0 < step < float("inf"):
        raise InvalidSetting(f"the step must be positive and finite, not {step} s")
    if step > duration * (1 + 1e-9):
        raise InvalidSetting(f"the step of {step:g} s is larger than the duration of {duration:g} s")
    count = round(duration / step)
    if count > _MOST_STEPS:
        raise InvalidSetting(
            f"the step of {step:g} s divides the duration of {duration:g} s into {count:.2g} steps, more than"
            f" {_MOST_STEPS:.0e}"
        )
    if abs(count * step - duration) > 1e-6 * step:
        below, above = duration / np.ceil(duration / step), duration / max(1, np.floor(duration / step))
        raise InvalidSetting(
            f"the step of {step:g} s does not divide the duration of {duration:g} s;"
            f" the nearest that do are {below:.10g} s and {above:.10g} s"
        )
    # k * step rather than a running sum; the last instant is the end of the path to the last bit.
    t: FloatArray = reference.start_time + np.arange(count + 1, dtype=np.float64) * (duration / count)
    t[-1] = reference.end_time
    return t
