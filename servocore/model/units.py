"""Conversion of units given as texts: ``deg`` to ``rad``, ``km/h`` to ``m/s``."""

from __future__ import annotations

import math
import re
from collections import Counter

from servocore.errors import InvalidSetting

_NEWTON, _METRE = {"kg": 1, "m": 1, "s": -2}, {"m": 1}
_UNITS: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "%": (0.01, {}),
    "m": (1.0, _METRE),
    "cm": (1e-2, _METRE),
    "mm": (1e-3, _METRE),
    "km": (1e3, _METRE),
    "s": (1.0, {"s": 1}),
    "ms": (1e-3, {"s": 1}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "kg": (1.0, {"kg": 1}),
    "g": (1e-3, {"kg": 1}),
    "t": (1e3, {"kg": 1}),
    "N": (1.0, _NEWTON),
    "kN": (1e3, _NEWTON),
    "MN": (1e6, _NEWTON),
    "Nm": (1.0, {**_NEWTON, "m": 2}),
    "kNm": (1e3, {**_NEWTON, "m": 2}),
    "J": (1.0, {**_NEWTON, "m": 2}),
    "kJ": (1e3, {**_NEWTON, "m": 2}),
    "W": (1.0, {**_NEWTON, "m": 2, "s": -3}),
    "kW": (1e3, {**_NEWTON, "m": 2, "s": -3}),
    "A": (1.0, {"A": 1}),
    "mA": (1e-3, {"A": 1}),
    "rad": (1.0, {"rad": 1}),
    "mrad": (1e-3, {"rad": 1}),
    "deg": (math.pi / 180.0, {"rad": 1}),
    "°": (math.pi / 180.0, {"rad": 1}),
    "rev": (2.0 * math.pi, {"rad": 1}),
    "rpm": (2.0 * math.pi / 60.0, {"rad": 1, "s": -1}),
}
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\D.*)?")
_FACTOR = re.compile(r"(1|[^\d^]+)\^?(-?\d+)?")


def in_unit(text: str, unit: str, what: str) -> float:
    """Return a text such as ``5 deg`` as a number in a unit.

    Parameters
    ----------
    text : str
        A number, and its unit unless that is `unit`.
    unit : str
        As FMI spells it: ``N.m``, ``rad``, ``m/s``.
    what : str
        Name of the quantity in messages.

    Raises
    ------
    InvalidSetting
        If it is not a number with a unit, or its unit has another dimension.
    """
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise InvalidSetting(f"{what} is given as {text!r}, which is no number with a unit, such as '2 {unit}'")
    number, own_unit = float(match[1]), (match[2] or unit).strip()
    (factor, kind), (own_factor, own_kind) = _dimension(own_unit, what), _dimension(unit, what)
    if kind != own_kind:
        raise InvalidSetting(f"{what} is given in {own_unit}, but its unit is {unit}")
    return number * factor / own_factor


def unit_of(text: str) -> str:
    """Return the unit that a text such as ``5 deg`` has; empty if it has none."""
    match = _QUANTITY.fullmatch(text)
    return "" if match is None else (match[2] or "").strip()


def _dimension(unit: str, what: str) -> tuple[float, dict[str, int]]:
    """Return factor and powers of a unit in SI units."""
    factor, powers = 1.0, Counter[str]()
    numerators, *denominators = unit.replace("²", "2").replace("³", "3").split("/")
    for text, sign in ((numerators, 1), *((denominator, -1) for denominator in denominators)):
        for label in re.split(r"[.·*\s]+", text.strip().strip("()")):
            match = _FACTOR.fullmatch(label)
            if match is None or match[1] not in _UNITS:
                raise InvalidSetting(f"{what} is given in {unit}, which is no unit known here: {', '.join(_UNITS)}")
            size, of = _UNITS[match[1]]
            power = sign * int(match[2] or 1)
            factor *= size**power
            for name, exponent in of.items():
                powers[name] += power * exponent
    return factor, {name: power for name, power in powers.items() if power}
