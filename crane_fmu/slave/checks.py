"""What a host may ask of a step: each function raises one sentence with the time and the limit, or returns."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

from crane_fmu.slave.interface import Variable
from servocore import InvalidReference, InvalidSetting

LONGEST_STEP = 3600.0
"""A longer communication step, in s, is taken for a mistake of the host."""

_ROUND_OFF = 16.0  # units in the last place of a time, by which the host's clock may differ from the FMU's
_SUMMED = 1e-3  # of a step: what is lost by adding up millions of steps; the last may go as far beyond the stop time

MOST_INTERNAL_STEPS = 100_000
"""A communication step may be divided into this many steps at most."""


def require_duration(start: float, stop: float) -> None:
    """Raise `InvalidSetting` if an experiment ends before it starts."""
    if not stop >= start:
        raise InvalidSetting(f"the experiment from {start:g} s to {stop:g} s has no duration")


def require_step(present: float, time: float, h: float, stop: float = math.inf) -> None:
    """Raise `InvalidSetting` unless a communication step of h seconds at `time` continues from `present`, until `stop`.

    The clock is the host's: one that multiplies a step differs by round-off from one that adds steps up.
    """
    if time == present and 0.0 < h <= LONGEST_STEP and time < time + h <= stop:
        return  # as nearly always; NaN is equal to nothing
    if not math.isfinite(time):
        raise InvalidSetting(f"the communication point must be a finite number, not {time} s")
    if not 0.0 < h <= LONGEST_STEP:
        raise InvalidSetting(
            f"at t = {time:.6g} s the communication step is {h:g} s,"
            f" it must be above 0 s and at most {LONGEST_STEP:g} s"
        )
    if time + h <= time:
        raise InvalidSetting(f"at t = {time:.17g} s a communication step of {h:g} s is lost in round-off")
    if abs(time - present) > 1e-6 * h + _ROUND_OFF * math.ulp(max(abs(time), abs(present))):
        direction = "behind" if time < present else "ahead of"
        raise InvalidSetting(
            f"the communication point t = {time:.16g} s lies {direction} the FMU's time {present:.16g} s;"
            f" to repeat a step restore the FMU's state first"
        )
    if time + h > stop + max(_SUMMED * h, _ROUND_OFF * sys.float_info.epsilon * abs(stop)):
        raise InvalidSetting(
            f"at t = {time:.16g} s a communication step of {h:g} s goes beyond the stop time of {stop:.16g} s"
        )


def internal_steps(wanted: float, h: float) -> int:
    """Into how many steps of about `wanted` seconds a communication step is divided; raises `InvalidSetting`."""
    if wanted == 0.0:
        return 1
    if h > wanted * (MOST_INTERNAL_STEPS + 0.5):
        raise InvalidSetting(
            f"an internal_step of {wanted:g} s divides the communication step of {h:g} s into more than"
            f" {MOST_INTERNAL_STEPS} steps"
        )
    return max(1, round(h / wanted))


def require_finite(inputs: Sequence[float], variables: Sequence[Variable], time: float) -> None:
    """Raise `InvalidReference` naming the first input that is NaN or infinite."""
    if math.isfinite(sum(inputs)):
        return
    for value, variable in zip(inputs, variables, strict=False):  # the inputs are the first in the table
        if not math.isfinite(value):
            raise InvalidReference(f"at t = {time:.6g} s the input {variable.name} is {value}, not a finite number")


def chosen_item(variable: Variable, number: int) -> str:
    """Return the name of an enumeration's item; raises `InvalidSetting` if there is none of that number."""
    if not 1 <= number <= len(variable.choices):
        *most, last = (f"{k} ({name})" for k, name in enumerate(variable.choices, start=1))
        raise InvalidSetting(f"{variable.name} = {number} is unknown; it may be {', '.join(most)} or {last}")
    return variable.choices[number - 1]


def require_legal(variable: Variable, number: float) -> None:
    """Raise `InvalidSetting` if a parameter's value is not finite or outside its range."""
    low = -math.inf if variable.minimum is None else variable.minimum
    high = math.inf if variable.maximum is None else variable.maximum
    unit = "" if variable.unit == "1" else f" {variable.unit}"
    if not math.isfinite(number):
        raise InvalidSetting(f"{variable.name} = {number:g}{unit} is not a finite number")
    if not low <= number <= high:
        raise InvalidSetting(f"{variable.name} = {number:g}{unit} is outside its range [{low:g}, {high:g}]{unit}")
