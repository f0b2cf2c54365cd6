"""Bytes and header of a CSV file: encodings, delimiters, units in brackets, and dates and times of ISO 8601."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from servocore.errors import InvalidReference

_WITH_UNIT = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]")
_SEPARATOR = re.compile(r"sep=.", re.IGNORECASE)  # spreadsheets write it above a header


EXAMPLE = "2026-01-01T12:00:00.100Z"
_STAMP = re.compile(
    r"(\d{4}-\d\d-\d\d)[Tt ](\d\d:\d\d(?::\d\d(?:[.,]\d{1,9})?)?) ?(?:([Zz])|([+-])(\d\d):?(\d\d)?)?", re.ASCII
)


def _bytes_of(file: Path) -> tuple[bytes, list[str]]:
    """Return a file as UTF-8 with LF at ends of lines, and notes of conversions."""
    try:
        data = file.read_bytes()
        notes = []
        if data.startswith(codecs.BOM_UTF8):
            data = data.removeprefix(codecs.BOM_UTF8)
        elif data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) or b"\0" in data[:2]:
            encoding = "utf-16" if data[:1] in b"\xff\xfe" else "utf-16-be" if data[:1] == b"\0" else "utf-16-le"
            data, notes = data.decode(encoding).encode(), ["UTF-16 as its encoding"]
        data[:100_000].decode(errors="strict" if len(data) <= 100_000 else "ignore")
    except OSError as error:
        raise InvalidReference(f"{file} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise InvalidReference(f"{file} cannot be read as a table: {error}; save it as CSV in UTF-8") from None
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n"), notes


class Header(NamedTuple):
    """The header of a file: its text, names and units of its columns, delimiter, its line, and notes of conversions."""

    text: str
    names: list[str]
    units: list[str | None]
    delimiter: str
    line: int
    notes: list[str]


def header_of(file: Path, expected: str) -> tuple[Header, bytes]:
    """Read the header of a file, and the rows below it; `expected` is the header that a refusal names."""
    data, notes = _bytes_of(file)
    first, line, header = 0, 0, ""
    while first < len(data) and (not header or _SEPARATOR.fullmatch(header)):
        end = data.find(b"\n", first) % (len(data) + 1)
        header, first, line = data[first:end].decode(errors="replace").strip(), end + 1, line + 1
    if not header:
        raise InvalidReference(f"{file}, line 1: the file is empty, but a header {expected} was expected")
    delimiter = next((mark for mark in ";\t" if mark in header), ",")
    cells = [cell.strip() for cell in next(csv.reader([header], delimiter=delimiter))]
    parts = [match.groups() if (match := _WITH_UNIT.fullmatch(cell)) else (cell, None) for cell in cells]
    units = [unit and unit.replace("\u03bc", "µ") for _, unit in parts]
    return Header(header, [name for name, _ in parts], units, delimiter, line, notes), data[first:]


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
