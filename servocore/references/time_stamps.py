"""Dates and times of ISO 8601 in the first column of a table, turned into seconds since the first of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidReference

EXAMPLE = "2026-01-01T12:00:00.100Z"
_STAMP = re.compile(
    rb'\s*"?(\d{4}-\d\d-\d\d)[Tt ](\d\d:\d\d(?::\d\d(?:[.,]\d{1,9})?)?) ?(?:([Zz])|([+-])(\d\d):?(\d\d)?)?"?\s*'
)
_LONGEST_ROW = 4096


def with_seconds(file: Path, body: bytes, divider: bytes, line: int) -> bytes | None:
    """Return rows whose first cells are seconds since the first; None if the first row has no date and time.

    Parameters
    ----------
    file : Path
        Its name.
    body : bytes
        Its rows.
    divider : bytes
        What divides cells.
    line : int
        Number of the first row.

    Raises
    ------
    InvalidReference
        If a later one has none, one does not exist, or some have a time zone and others have none.
    """
    first = _instant(body[:_LONGEST_ROW].lstrip().partition(b"\n")[0].partition(divider)[0])
    if first is None:
        return None
    rows = [row.partition(divider) for row in body.split(b"\n")]
    used = [k for k, (cell, _, rest) in enumerate(rows) if cell.strip() or rest.strip()]
    stamps, zones = list[str](), list[int | None]()
    for k in used:
        stamp = _instant(rows[k][0])
        if stamp is None or (stamp[1] is None) != (first[1] is None):
            why = f"no date and time such as {EXAMPLE}" if stamp is None else "with a time zone where others have none"
            if stamp is not None and stamp[1] is None:
                why = "without a time zone where others have one"
            raise _refusal(file, line + k, rows[k][0], why)
        stamps.append(stamp[0])
        zones.append(stamp[1])
    nanoseconds = _nanoseconds(file, stamps, [line + k for k in used])
    nanoseconds -= np.array([zone or 0 for zone in zones], np.int64) * 10**9
    rests = b"".join(rest for _, _, rest in rows)
    point = "," if divider != b"," and b"," in rests and b"." not in rests else "."
    for k, seconds in zip(used, ((nanoseconds - nanoseconds[0]) / 1e9).tolist(), strict=True):
        rows[k] = (repr(seconds).replace(".", point).encode(), *rows[k][1:])
    return b"\n".join(b"".join(row) for row in rows)


def _instant(cell: bytes) -> tuple[str, int | None] | None:
    """Return date and time, and the offset of the time zone in s, None without a zone; None if the cell has neither."""
    match = _STAMP.fullmatch(cell)
    if match is None:
        return None
    day, time, universal, sign, hours, minutes = match.groups()
    offset = None if not (universal or sign) else 0
    if sign:
        offset = (-1 if sign == b"-" else 1) * (3600 * int(hours) + 60 * int(minutes or 0))
    return f"{day.decode()}T{time.decode().replace(',', '.')}", offset


def _nanoseconds(file: Path, stamps: Sequence[str], lines: Sequence[int]) -> npt.NDArray[np.int64]:
    try:
        return np.array(stamps, dtype="datetime64[ns]").astype(np.int64)
    except ValueError:
        for stamp, line in zip(stamps, lines, strict=True):
            try:
                np.datetime64(stamp, "ns")
            except ValueError:
                raise _refusal(file, line, stamp.encode(), "no date and time that there is") from None
        raise


def _refusal(file: Path, line: int, cell: bytes, why: str) -> InvalidReference:
    return InvalidReference(f"{file}, line {line}, column time: {cell.decode(errors='replace').strip()!r} is {why}")
