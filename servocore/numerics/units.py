"""Conversion of units given as texts: ``deg`` to ``rad``, ``km/h`` to ``m/s``."""

from __future__ import annotations

import math
import re
from collections import Counter

from servocore.errors import InvalidSetting

_SIZES = {"": 1.0, "c": 1e-2, "m": 1e-3, "k": 1e3, "M": 1e6}
_PREFIXED: dict[str, tuple[tuple[str, ...], dict[str, int]]] = {
    "m": (("", "c", "m", "k"), {"m": 1}),
    "s": (("", "m"), {"s": 1}),
    "N": (("", "k", "M"), {"kg": 1, "m": 1, "s": -2}),
    "Nm": (("", "k"), {"kg": 1, "m": 2, "s": -2}),
    "J": (("", "k"), {"kg": 1, "m": 2, "s": -2}),
    "W": (("", "k"), {"kg": 1, "m": 2, "s": -3}),
    "A": (("", "m"), {"A": 1}),
    "rad": (("", "m"), {"rad": 1}),
    "Pa": (("", "k", "M"), {"kg": 1, "m": -1, "s": -2}),
    "V": (("", "m", "k"), {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "Hz": (("", "k"), {"s": -1}),
    **{base: (("",), {base: 1}) for base in ("K", "mol", "cd")},
}
_UNITS: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "%": (0.01, {}),
    **{f"{each}{unit}": (_SIZES[each], of) for unit, (listed, of) in _PREFIXED.items() for each in listed},
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "kg": (1.0, {"kg": 1}),
    "g": (1e-3, {"kg": 1}),
    "t": (1e3, {"kg": 1}),
    "deg": (math.pi / 180.0, {"rad": 1}),
    "°": (math.pi / 180.0, {"rad": 1}),
    "rev": (2.0 * math.pi, {"rad": 1}),
    "rpm": (2.0 * math.pi / 60.0, {"rad": 1, "s": -1}),
}
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\d,].*)?")
_FACTOR = re.compile(r"(1|[^\d^]+)\^?(-?\d)?")  # one digit: powers of units stay within numbers


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
        form = "number, such as 0.5" if unit == "1" else f"number with a unit, such as '2 {unit}'"
        raise InvalidSetting(f"{what} is given as {text!r}, which is no {form}")
    number, own_unit = float(match[1]), (match[2] or unit).strip()
    (factor, kind), (own_factor, own_kind) = dimension(own_unit, what), dimension(unit, what)
    if kind != own_kind:
        own = "it has no unit" if unit == "1" else f"its unit is {unit}"
        raise InvalidSetting(f"{what} is given in {own_unit}, but {own}")
    return number * factor / own_factor


def behind(unit: str) -> str:
    """Return a unit as it follows a number in a sentence: nothing where it is 1."""
    return "" if unit == "1" else f" {unit}"


def unit_of(text: str) -> str:
    """Return the unit that a text such as ``5 deg`` has; empty if it has none."""
    match = _QUANTITY.fullmatch(text)
    return "" if match is None else (match[2] or "").strip()


def dimension(unit: str, what: str) -> tuple[float, dict[str, int]]:
    """Return factor and powers of a unit in SI base units, the radian among them.

    Parameters
    ----------
    unit : str
        Such as ``kN.m/s2``; all factors after a slash are divisors.
    what : str
        Name of the quantity in messages.

    Raises
    ------
    InvalidSetting
        If a part of it is unknown.
    """
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
