"""Dates and times of ISO 8601 in the first column of a table, turned into seconds since the first of them."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

EXAMPLE = "2026-01-01T12:00:00.100Z"
_STAMP = re.compile(
    r"(\d{4}-\d\d-\d\d)[Tt ](\d\d:\d\d(?::\d\d(?:[.,]\d{1,9})?)?) ?(?:([Zz])|([+-])(\d\d):?(\d\d)?)?", re.ASCII
)


def without_stamps(rows: str) -> str:
    """Return rows without the dates and times in them."""
    return _STAMP.sub("", rows)


def clock_from(first: str) -> Callable[[str], float] | None:
    """Return the function from cells to seconds since the first cell, itself included; None if it is no date and time.

    Raises
    ------
    ValueError
        When it is called: if a cell has no date and time, or one that there is not, or one cell has a time zone and the
        first has none, or the other way round.
    """
    start = _STAMP.fullmatch(first)
    if start is None:
        return None
    origin, zoned = np.nan, bool(start[3] or start[4])

    def seconds(cell: str) -> float:
        nonlocal origin
        match = _STAMP.fullmatch(cell.strip())
        if match is None:
            raise ValueError(f"no date and time such as {EXAMPLE}")
        day, time, universal, sign, hours, minutes = match.groups()
        if bool(universal or sign) != zoned:
            kinds = ("without", "one") if zoned else ("with", "none")
            raise ValueError("{} a time zone where others have {}".format(*kinds))
        offset = int(f"{sign}1") * (3600 * int(hours) + 60 * int(minutes or 0)) if sign else 0
        try:
            instant = int(np.datetime64(f"{day}T{time.replace(',', '.')}", "ns").astype(np.int64)) - offset * 10**9
        except ValueError:
            raise ValueError("no date and time that there is") from None
        origin = instant if np.isnan(origin) else origin
        return (instant - origin) / 1e9

    return seconds
