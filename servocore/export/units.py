"""Units in the notation of FMI: their derivatives by time, and their exponents of SI base units."""

from __future__ import annotations

import re

from servocore.errors import InvalidSetting
from servocore.numerics.units import dimension


def per_time(unit: str, order: int) -> str:
    """Return the unit of a derivative by time: ``m`` becomes ``m/s``, ``m/s2``; ``N.m/s`` becomes ``N.m/s2``."""
    if order == 0:
        return unit
    match = re.fullmatch(r"(.*)/s(\d*)", unit)
    if match:
        unit, order = match[1], order + int(match[2] or 1)
    if "/" in unit:  # N/m becomes N/(m.s), in FMI with a negative exponent
        return f"{unit}.s{order if order > 1 else ''}"
    return f"{unit}/s{order if order > 1 else ''}"


def base_units(unit: str) -> dict[str, int] | None:
    """Return the exponents of SI base units; None for a unit with unknown parts, or one that is a multiple of these.

    All factors after the slash are divisors: ``N/m.s`` is N/(m s).
    """
    try:
        factor, exponents = dimension(unit or "1", "a unit")
    except InvalidSetting:
        return None
    return exponents if factor == 1.0 else None
