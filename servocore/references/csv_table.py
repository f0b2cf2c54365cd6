"""Tables of numbers from CSV files of spreadsheets and other programs; every error names file, line and column.

Unambiguous variants are read, with a note of the conversion: UTF-16, semicolons or tabs between cells, decimal
commas, units and capitals in the header, times since 1970, dates with times. Doubtful values, such as times that
look like milliseconds, are refused with the remedy.
"""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Callable, Container, Mapping, Sequence
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np

from servocore.errors import InvalidReference, InvalidSetting, ServocoreWarning, require_kind
from servocore.numerics.units import in_unit
from servocore.references.base import LONGEST_TIME, FloatArray
from servocore.references.csv_header import EXAMPLE, Header, clock_from, header_of, without_stamps
from servocore.references.likely_units import UndeclaredUnits, doubtful_units

PREFIXES = ("", "v", "a", "j", "s")
"""Prefix of a column of positions, velocities, accelerations, jerks and snaps."""

STOP = "stop"
"""The column of waypoints that says where the path comes to rest."""

_TIMES = {"s": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "ns": 1e9, "min": 1.0 / 60.0, "h": 1.0 / 3600.0}
_LENGTHS = {"m": 1.0, "mm": 1e3, "cm": 1e2, "km": 1e-3}
_ANGLES = {"rad": 1.0, "deg": 180.0 / np.pi, "°": 180.0 / np.pi}
_EPOCHS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
_SINCE_1970 = 1e9, 4e9  # s: the years 2001 to 2096
_CLOCK = re.compile(r"\d[:/.-]\d+[:/.-]\d|\d:\d\d")
_RATE = re.compile(r"/s(?:\^?(\d)|([²³⁴]))?")
_POWERS = {"²": 2, "³": 3, "⁴": 4}
_SHOWN = 80  # letters of a header that is none
_YES, _NO = ("1", "1.0", "yes", "true", "x", "stop"), ("", "0", "0.0", "no", "false")


class Table(NamedTuple):
    """A file that was read.

    Attributes
    ----------
    path : Path
        Its name.
    columns : tuple of str
        Names of the position columns.
    lines : sequence of int
        Numbers of the lines.
    t : ndarray, shape (n,)
        Times in s.
    derivatives : ndarray, shape (n, groups, columns)
        Positions and their derivatives in SI units; NaN where a cell of waypoints is empty.
    stops : ndarray of bool, shape (n,), or None
        Where the path comes to rest; None without that column.
    undeclared : UndeclaredUnits, optional
        Units that the header does not declare.
    """

    path: Path
    columns: tuple[str, ...]
    lines: Sequence[int]
    t: FloatArray
    derivatives: FloatArray
    stops: np.ndarray | None
    undeclared: UndeclaredUnits | None = None


def read_table(
    path: str | PathLike[str],
    columns: Sequence[str],
    groups: int,
    waypoints: bool = False,
    units: Sequence[str] | None = None,
) -> Table:
    """Read and check a table with up to `groups` groups of columns.

    Parameters
    ----------
    path : path-like
        The file.
    columns : sequence of str
        Names of the position columns.
    groups : int
        How many groups there may be: positions, velocities, ...
    waypoints : bool
        Whether a column `STOP` may be the last, and cells of derivatives empty.
    units : sequence of str, optional
        Units of the position columns; those of x, y and z are metres, of others nothing is known if it is not given.

    Raises
    ------
    InvalidReference
        If the file cannot be read or is not such a table, its times do not increase, or its units are in doubt.

    Warns
    -----
    ServocoreWarning
        If something had to be converted.
    """
    require_kind(path, (str, PathLike), "the file of a path", "its name", InvalidReference)
    file, components = Path(path), tuple(columns)
    if not components or len({"time", *components}) <= len(components):
        raise InvalidReference(f"a path needs position columns with names of their own, not {', '.join(components)}")
    known = units or (("m",) * 3 if components == ("x", "y", "z") else ("",) * len(components))
    layout, data = _layout(file, dict(zip(components, known, strict=True)), groups, waypoints)
    lines, numbers, stops = _rows(file, data, layout)
    far = int(np.abs(numbers[:, 0]).argmax())
    if abs(numbers[far, 0]) > LONGEST_TIME:
        raise InvalidReference(
            f"{file}, line {lines[far]}, column time: {_digits(numbers[far, 0])} s is more than {LONGEST_TIME:g} s from"
            " zero: let times begin near it, or write their unit into the header, as time [ns]"
        )
    derivatives = numbers[:, 1:].reshape(len(numbers), -1, len(components))
    table = Table(file, components, lines, numbers[:, 0], derivatives, stops)
    table = table._replace(undeclared=_undeclared_units(table, layout))
    _warn_of_conversions(file, layout)
    return table


def _digits(value: float) -> str:
    """Return the fewest digits of a number that are read back as the same number."""
    return repr(float(value)).removesuffix(".0")


class _Layout(NamedTuple):
    """The format of a file: names of its columns, delimiter, factors to SI units, start of the rows."""

    names: list[str]
    delimiter: str
    factors: FloatArray  # for time and each number: file units per s, m, ...
    units: dict[str, str]  # those that the header names
    line: int  # number of the one after the header
    stops: bool
    free: int  # the first column whose cells may be empty
    notes: list[str]  # of conversions
    clock: Callable[[str], float] | None = None  # from dates to seconds, where times are dates
    ignored: Container[int] = ()  # columns that may hold texts


def read_columns(
    path: str | PathLike[str], known: Mapping[str, str]
) -> tuple[FloatArray, dict[str, FloatArray], set[str]]:
    """Read the time and the columns with known names, in any order, from a table; empty cells are NaN.

    Parameters
    ----------
    path : path-like
        The file; the time is its first column.
    known : mapping of str to str
        Names of columns and their SI units; other columns are left out.

    Returns
    -------
    t : ndarray, shape (N,)
        Times in s, increasing.
    columns : dict of str to ndarray, shape (N,)
        By name, in SI units.
    declared : set of str
        Names of the columns whose unit is in the header.

    Raises
    ------
    InvalidReference
        As `read_table`.
    """
    file = Path(path)
    header, names, units, data = _named(file, f"time,{','.join(known)}", ["time", *known])
    if names[0] != "time" or len(set(names)) < len(names):
        raise InvalidReference(f"{file}, line {header.line}: its first column must be time, and no name may repeat")
    factors = np.ones(len(names))
    for k, name in enumerate(names):
        try:
            if k == 0:
                factors[k] = _factor(file, header.line, name, units.get(name), 0, ["s"])
            elif name in units and name in known:
                factors[k] = 1.0 / in_unit(f"1 {units[name]}", known[name], "it")
        except InvalidSetting as error:
            raise InvalidReference(f"{file}, line {header.line}, column {name}: {error}") from None
    declared = set(units)
    layout = _Layout(names, header.delimiter, factors, units, header.line + 1, False, 1, header.notes)
    layout = layout._replace(ignored={k for k, name in enumerate(names) if k and name not in known})
    _, numbers, _ = _rows(file, data, layout)
    _warn_of_conversions(file, layout)
    return numbers[:, 0], {name: numbers[:, k] for k, name in enumerate(names) if name in known}, declared


def _warn_of_conversions(file: Path, layout: _Layout) -> None:
    if layout.notes:
        warnings.warn(f"{file} is read with {', '.join(layout.notes)}", ServocoreWarning, stacklevel=3)


def _named(file: Path, expected: str, wanted: Sequence[str]) -> tuple[Header, list[str], dict[str, str], bytes]:
    """Return the header of a file, names of its columns as they are wanted, their units by name, and the rows."""
    header, data = header_of(file, expected)
    first, *others = header.names
    if first.casefold() == "t" and "t" not in wanted:
        first = "time"
    names = _without_capitals([first, *others], wanted)
    return header, names, {name: unit for name, unit in zip(names, header.units, strict=True) if unit is not None}, data


def _layout(file: Path, components: Mapping[str, str], groups: int, waypoints: bool) -> tuple[_Layout, bytes]:
    """Read the header; return the format of the file and the rows."""
    blocks = [[prefix + name for name in components] for prefix in PREFIXES[:groups]]
    wanted = [["time", *chain(*blocks[: count + 1])] for count in range(groups)]
    shortest = ",".join(wanted[0])
    header, names, units, data = _named(file, shortest, [*wanted[-1], *([STOP] if waypoints else [])])
    stops = waypoints and names[-1] == STOP
    if (names[:-1] if stops else names) not in wanted:
        more = ", optionally followed by " + ", then ".join(map(",".join, blocks[1:])) if groups > 1 else ""
        more += f", then {STOP}" if waypoints else ""
        shown = header.text if len(header.text) <= _SHOWN else f"{header.text[:_SHOWN]}..."
        raise InvalidReference(
            f"{file}, line {header.line}: the header {shortest}{more} was expected, but {shown!r} was found"
        )
    measured = list(components.values())
    factors = [_factor(file, header.line, name, units.get(name), k, measured) for k, name in enumerate(names)]
    marks = {";": ["semicolons between cells"], "\t": ["tabs between cells"]}
    notes = header.notes + marks.get(header.delimiter, [])
    notes += [f"{','.join(header.names)} as {','.join(names)}"] if header.names != names else []
    notes += [
        f"{', '.join(same)} in {unit}"
        for unit in dict.fromkeys(units.values())
        if (same := [name for name in units if units[name] == unit and factors[names.index(name)] != 1.0])
    ]
    numbers, free = factors[:-1] if stops else factors, 1 + len(components) if waypoints else len(names)
    return _Layout(names, header.delimiter, np.array(numbers), units, header.line + 1, stops, free, notes), data


def _without_capitals(names: list[str], wanted: Sequence[str]) -> list[str]:
    """Return names of columns in the case of the expected ones, where that is unambiguous."""
    meant = {name.casefold(): name for name in wanted}
    return names if len(meant) < len(wanted) else [meant.get(name.casefold(), name) for name in names]


def _factor(file: Path, line: int, name: str, unit: str | None, column: int, measured: Sequence[str]) -> float:
    """Return how many of a column's unit make one of SI; `measured` are the units of the positions."""
    if unit is None or name == STOP:
        return 1.0
    order, component = divmod(column - 1, len(measured))
    kinds = {"m": _LENGTHS, "rad": _ANGLES}.get(measured[component], _LENGTHS | _ANGLES)
    base, slash, _ = unit.partition("/")
    rate = _RATE.fullmatch(unit.removeprefix(base)) if slash else None
    power = int(rate[1] or _POWERS.get(rate[2], 1)) if rate else -1 if slash else 0
    factor = _TIMES.get(unit) if column == 0 else kinds.get(base) if power == order else None
    if factor is None:
        per = {0: "", 1: "/s"}.get(order, f"/s^{order}")
        known = _TIMES if column == 0 else [f"{kind}{per}" for kind in kinds]
        raise InvalidReference(
            f"{file}, line {line}, column {name}: its unit must be one of {', '.join(known)}, not {unit!r}"
        )
    return factor


def _rows(file: Path, data: bytes, layout: _Layout) -> tuple[Sequence[int], FloatArray, np.ndarray | None]:
    """Return lines, numbers (n, columns) in SI units, and stops; add to the notes of conversions."""
    body = data.rstrip(b" \n")  # tabs at the end divide cells that are empty
    if not body.strip():
        raise InvalidReference(f"{file}, line {layout.line - 1}: there is a header but no rows of data below it")
    first = body.lstrip().partition(b"\n")[0].decode(errors="replace").partition(layout.delimiter)[0]
    clock = clock_from(first.strip().strip('"'))
    if clock is not None:
        if "time" in layout.units:
            raise InvalidReference(
                f"{file}, line {layout.line - 1}: its times are dates, which have no unit in the header"
            )
        layout.units["time"] = "s"
        layout.notes.append("dates as times, of which the first becomes 0")
        layout = layout._replace(clock=clock)
    lines, numbers, stops = _numbers_of(file, body, layout)
    _begin_after_1970(numbers, layout)
    numbers /= layout.factors
    stuck = np.flatnonzero(np.diff(numbers[:, 0]) <= 0.0)
    if stuck.size:
        late = stuck[0] + 1
        raise InvalidReference(
            f"{file}, line {lines[late]}, column time: {_digits(numbers[late, 0])} s does not come after "
            f"{_digits(numbers[late - 1, 0])} s of the row before"
        )
    return lines, numbers, stops


def _numbers_of(file: Path, body: bytes, layout: _Layout) -> tuple[Sequence[int], FloatArray, np.ndarray | None]:
    """Return lines, numbers (n, columns) and stops."""
    cells = body if layout.clock is None else without_stamps(body.decode(errors="replace")).encode()
    if layout.delimiter != "," and b"," in cells and b"." not in cells:
        body = body.replace(b",", b".")
        layout.notes.append("decimal commas")
    if not layout.stops and (numbers := _quickly(body, layout)) is not None:
        return range(layout.line, layout.line + len(numbers)), numbers, None
    try:
        reader = csv.reader(io.StringIO(body.decode()), delimiter=layout.delimiter)
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidReference(f"{file} cannot be read as a table: {error}") from None
    rows = [(line + layout.line - 1, cells) for line, cells in rows if any(cells)]
    read = [_numbers(file, line, cells, layout) for line, cells in rows]
    stops = np.array([_stop(file, line, cells[-1]) for line, cells in rows]) if layout.stops else None
    return [line for line, _ in rows], np.array(read), stops


def _quickly(body: bytes, layout: _Layout) -> FloatArray | None:
    """Read rows of plain finite numbers at once; None where there is anything else, for a closer look."""
    try:
        first: Mapping[int | str, Callable[[str], float]] | None = {0: layout.clock} if layout.clock else None
        numbers = np.loadtxt(
            io.BytesIO(body), delimiter=layout.delimiter, comments=None, converters=first, encoding="utf-8", ndmin=2
        )
    except ValueError:
        return None
    # Lines without cells are passed over, and later ones would have the wrong number.
    whole = numbers.shape == (body.count(b"\n") + 1, len(layout.names))
    return numbers if whole and np.isfinite(numbers).all() else None


def _numbers(file: Path, line: int, cells: Sequence[str], layout: _Layout) -> list[float]:
    names = layout.names
    if len(cells) != len(names):
        doubled = layout.delimiter == "," and len(cells) == 2 * len(names)
        hint = "; decimal commas need semicolons between cells" if doubled else ""
        raise InvalidReference(
            f"{file}, line {line}: {len(cells)} cells were found, but the header has {len(names)} columns, "
            f"up to {names[-1]}{hint}"
        )
    values = []
    for k, (cell, name) in enumerate(zip(cells[: len(layout.factors)], names, strict=False)):
        if k == 0 and layout.clock:
            try:
                values.append(layout.clock(cell))
            except ValueError as why:
                raise InvalidReference(f"{file}, line {line}, column {name}: {cell!r} is {why}") from None
            continue
        try:
            value = float(cell) if "_" not in cell else float("nan")  # only Python reads underscores
        except ValueError:
            value = float("nan")
        if not np.isfinite(value) and (cell or k < layout.free) and k not in layout.ignored:
            hint = "; digits are not grouped, and decimals follow a point" if "," in cell or "'" in cell else ""
            if k == 0 and _CLOCK.search(cell):
                hint = f"; times are numbers of seconds, or dates such as {EXAMPLE}"
            raise InvalidReference(f"{file}, line {line}, column {name}: {cell!r} is not a finite number{hint}")
        values.append(value)
    return values


def _stop(file: Path, line: int, cell: str) -> bool:
    if cell.lower() not in (*_YES, *_NO):
        raise InvalidReference(f"{file}, line {line}, column {STOP}: {cell!r} is neither 1 nor 0")
    return cell.lower() in _YES


def _begin_after_1970(numbers: FloatArray, layout: _Layout) -> None:
    """Let times since 1970, which are so large that nothing else is meant, begin at 0."""
    named, first = layout.units.get("time"), numbers[0, 0]
    for unit, factor in _EPOCHS.items() if named is None else [(named, layout.factors[0])]:
        if _SINCE_1970[0] <= first / factor <= _SINCE_1970[1]:
            # Before any division; doubles as large as these hold microseconds, and fractions of these are round-off.
            microseconds = np.round((numbers[:, 0] - first) * (1e6 / factor))
            numbers[:, 0] = microseconds / (1e6 if named is None else 1e6 / factor)
            layout.notes.append(f"times in {unit} since 1970, of which the first becomes 0")
            return


def _undeclared_units(table: Table, layout: _Layout) -> UndeclaredUnits:
    """Return which units the header leaves open; refuse those that look like milliseconds or millimetres."""
    t, positions = table.t, table.derivatives[:, 0]
    unnamed = [k for k, name in enumerate(table.columns) if name not in layout.units]
    timed = "time" in layout.units
    spacing = 0.0 if timed or len(t) < 2 else float(np.diff(t).min())
    column = table.columns[unnamed[0]] if unnamed else ""
    found = UndeclaredUnits(str(table.path), column, tuple(unnamed), spacing)
    slow = doubtful_units(t, positions)[0] and not timed
    far = doubtful_units(t, positions[:, unnamed])[1] if unnamed else False
    found.require_likely(t, positions[:, unnamed] if far else positions, slow, far, "")
    return found
