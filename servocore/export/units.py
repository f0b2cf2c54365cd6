"""Units in the notation of FMI: their derivatives by time, and their exponents of SI base units."""

from __future__ import annotations

import re
from collections.abc import Mapping

_SYMBOLS: Mapping[str, Mapping[str, int]] = {
    "1": {},
    "m": {"m": 1},
    "s": {"s": 1},
    "kg": {"kg": 1},
    "rad": {"rad": 1},
    "A": {"A": 1},
    "K": {"K": 1},
    "mol": {"mol": 1},
    "cd": {"cd": 1},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
}
_FACTOR = re.compile(r"([A-Za-z]+|1)(-?\d+)?")


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
    """Return the exponents of SI base units; None for a unit with unknown parts.

    All factors after the slash are divisors: ``N/m.s`` is N/(m s).
    """
    exponents: dict[str, int] = {}
    above, _, below = unit.partition("/")
    for part, sign in ((above, 1), (below, -1)):
        for factor in filter(None, part.split(".")):
            match = _FACTOR.fullmatch(factor)
            if match is None or match[1] not in _SYMBOLS:
                return None
            times = sign * int(match[2] or 1)
            for base, exponent in _SYMBOLS[match[1]].items():
                exponents[base] = exponents.get(base, 0) + times * exponent
    return {base: exponent for base, exponent in exponents.items() if exponent}
