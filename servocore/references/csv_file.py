"""Paths from CSV files, SI units throughout; every complaint names file, line and column."""

from __future__ import annotations

import csv
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from servocore.errors import InvalidReference, require_kind
from servocore.files import csv_text
from servocore.references.bspline import REST_ORDER, require_order
from servocore.references.hermite import Disagreement, disagreement, hermite
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.splines import fewest_samples, sampled, through

if TYPE_CHECKING:
    from collections.abc import Sequence

    from servocore.references.base import FloatArray, Reference

COLUMNS = ("x", "y", "z")
"""Position columns if no others are named: of a load in space."""

PREFIXES = ("", "v", "a", "j", "s")
"""What stands before the name of a position column: nothing, or the order of its derivative by time."""

SPLINE_AGREEMENT = 0.01
"""A derivative column may differ from the spline through the positions by this fraction of its peak."""

HERMITE_AGREEMENT = 0.5
"""A row may differ from the path through every second row or fewer by this fraction of its peak."""


class _Table(NamedTuple):
    """A file that was read: its position columns, line numbers and times (n,), derivatives (n, groups, columns)."""

    path: Path
    columns: tuple[str, ...]
    lines: list[int]
    t: FloatArray
    derivatives: FloatArray


def from_csv(
    path: str | PathLike[str],
    tolerance: float | None = None,
    columns: Sequence[str] = COLUMNS,
    *,
    rest_order: int = REST_ORDER,
) -> PiecewisePolynomial:
    """Path from a file with times, positions and, if known, their derivatives.

    The header is `time,x,y,z`, optionally followed by `vx,vy,vz`, then `ax,ay,az`, then `jx,jy,jz`, then
    `sx,sy,sz` (velocity, acceleration, jerk, snap); with other columns, their names in place of x, y and z. With
    derivatives up to `rest_order` the path is the Hermite polynomial between rows, which takes up every number given.
    With fewer groups, or with a tolerance, it is `sampled(time, positions, tolerance)`: Hermite pieces of fewer data
    would not be smooth enough. The derivatives given are then only compared with the spline's.

    Parameters
    ----------
    path : path-like
        A comma-separated UTF-8 file.
    tolerance : float, optional
        How far the path may stay away from a position, in m: for rounded or noisy files; see `sampled`.
    columns : sequence of str
        Names of the position columns, one for each component of the path. Those of a scene's servo output are
        `columns=[each.name for each in scene.model().outputs]`.
    rest_order : int
        How many derivatives are continuous, and vanish at an end that rests; see `sampled`.

    Returns
    -------
    PiecewisePolynomial
        The path, rest outside where it starts or ends at rest. With the default order its `max_order` is 9, its
        `smoothness` 4 or 8.

    Raises
    ------
    InvalidReference
        If the file cannot be read, is not such a table, has too few rows or times that do not increase, if
        the path is too rough, or if its columns contradict one another.
    """
    require_order(rest_order)
    return _path_of(_read(path, columns, len(PREFIXES)), tolerance, rest_order)


def samples_or_waypoints(
    path: str | PathLike[str], columns: Sequence[str], tolerance: float | None, rest_order: int
) -> tuple[PiecewisePolynomial, int | None]:
    """Return the path of a file, and of how many waypoints it is; None where it is sampled.

    Positions alone in fewer rows than samples need are waypoints, as of `waypoints_from_csv`; without a tolerance.

    Raises
    ------
    InvalidReference
        As `from_csv`.
    """
    require_order(rest_order)
    table = _read(path, columns, len(PREFIXES))
    rows, positions_alone = len(table.t), table.derivatives.shape[1] == 1
    if positions_alone and tolerance is None and rows < fewest_samples(rest_order):
        return _path_through(table, rest_order), rows
    return _path_of(table, tolerance, rest_order), None


def csv_of(path: Reference, columns: Sequence[str] = COLUMNS, each: int = 2) -> str:
    """Return a path as the text of a file that `from_csv` reads: positions and four derivatives.

    Parameters
    ----------
    path : Reference
        With four derivatives or more.
    columns : sequence of str
        Names of the position columns.
    each : int
        Rows for every stretch of the path. A polynomial of degree 9 or less comes back but for round-off, which many
        rows amplify.

    Returns
    -------
    str
        Every number in as many digits as it takes to read back the same one.
    """
    ends = path.stretches
    t = np.append((ends[:-1, None] + np.diff(ends)[:, None] * np.arange(each) / each).ravel(), ends[-1])
    jets = path.jet(t, len(PREFIXES) - 1)
    names = ["time", *(f"{prefix}{name}" for prefix in PREFIXES for name in columns)]
    return csv_text(names, [t, jets.reshape(len(t), -1)])


def waypoints_from_csv(
    path: str | PathLike[str], columns: Sequence[str] = COLUMNS, *, rest_order: int = REST_ORDER
) -> PiecewisePolynomial:
    """Smooth path from rest to rest through the waypoints of a file with the header `time,x,y,z`.

    Parameters
    ----------
    path : path-like
        A comma-separated UTF-8 file, at least two rows; s and m.
    columns : sequence of str
        Names of the position columns, as in `from_csv`.
    rest_order : int
        How many derivatives vanish at start and end; see `through`.

    Returns
    -------
    PiecewisePolynomial
        `through(positions, time)`.

    Raises
    ------
    InvalidReference
        If the file cannot be read or is not such a table, or its times do not increase.
    """
    return _path_through(_read(path, columns, 1), rest_order)


def _path_through(table: _Table, rest_order: int) -> PiecewisePolynomial:
    _need_rows(table, 2)
    return through(table.derivatives[:, 0], table.t, rest_order=rest_order)


def _path_of(table: _Table, tolerance: float | None, rest_order: int) -> PiecewisePolynomial:
    if table.derivatives.shape[1] <= rest_order or tolerance is not None:
        return _sampled_path(table, tolerance, rest_order)
    _need_rows(table, 2)
    found, worst = hermite(table.t, table.derivatives)
    if worst is not None:
        _refuse_contradiction(table, worst, HERMITE_AGREEMENT, "the path through its neighbours")
    return found


def _sampled_path(table: _Table, tolerance: float | None, rest_order: int) -> PiecewisePolynomial:
    _need_rows(table, fewest_samples(rest_order))
    try:
        path = sampled(table.t, table.derivatives[:, 0], tolerance, rest_order=rest_order)
    except InvalidReference as error:
        raise InvalidReference(f"{table.path}: {error}") from None
    given = table.derivatives[:, : path.max_order + 1]
    found = path.jet(table.t, given.shape[1] - 1)
    found[:, 0] = given[:, 0]  # positions were judged by `sampled`
    worst = disagreement(given, found, path.duration)
    _refuse_contradiction(table, worst, SPLINE_AGREEMENT, "the spline through the positions")
    return path


def _refuse_contradiction(table: _Table, worst: Disagreement, limit: float, judge: str) -> None:
    if worst.fraction <= limit:
        return
    given = table.derivatives[worst.row, worst.order, worst.component]
    raise InvalidReference(
        f"{table.path}, line {table.lines[worst.row]} (time {table.t[worst.row]:.6g} s), column "
        f"{PREFIXES[worst.order]}{table.columns[worst.component]}: {given:.6g} differs from {judge} by "
        f"{worst.fraction:.1%} of the column's peak (limit {limit:.0%}), so the columns contradict one "
        "another, are rounded too much, or the rows are too far apart"
    )


def _need_rows(table: _Table, fewest: int) -> None:
    if len(table.t) < fewest:
        raise InvalidReference(
            f"{table.path}, line {table.lines[-1]}: the file ends after {len(table.t)} rows of data, but "
            f"such a path needs at least {fewest}"
        )


def _read(path: str | PathLike[str], columns: Sequence[str], groups: int) -> _Table:
    """Read and check a table with up to `groups` groups of columns."""
    require_kind(path, (str, PathLike), "the file of a path", "its name", InvalidReference)
    file, components = Path(path), tuple(columns)
    if not components or len({"time", *components}) <= len(components):
        raise InvalidReference(f"a path needs position columns with names of their own, not {', '.join(components)}")
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidReference(f"{file} cannot be read as a table: {error}") from None
    rows = [(line, cells) for line, cells in rows if any(cells)]
    blocks = [[prefix + name for name in components] for prefix in PREFIXES[:groups]]
    shortest = ",".join(["time", *components])
    if not rows:
        raise InvalidReference(f"{file}, line 1: the file is empty, but a header {shortest} was expected")
    (first, names), *rows = rows
    if names not in [["time", *chain(*blocks[: count + 1])] for count in range(groups)]:
        more = ", optionally followed by " + ", then ".join(map(",".join, blocks[1:])) if groups > 1 else ""
        found = ",".join(names)
        raise InvalidReference(
            f"{file}, line {first}: the header {shortest}{more} was expected, but {found!r} was found"
        )
    if not rows:
        raise InvalidReference(f"{file}, line {first}: there is a header but no rows of data below it")
    lines = [line for line, _ in rows]
    numbers = np.array([_numbers(file, line, cells, names) for line, cells in rows])
    stuck = np.flatnonzero(np.diff(numbers[:, 0]) <= 0.0)
    if stuck.size:
        late = stuck[0] + 1
        raise InvalidReference(
            f"{file}, line {lines[late]}, column time: {numbers[late, 0]:.17g} s does not come after "
            f"{numbers[late - 1, 0]:.17g} s of the row before"
        )
    return _Table(file, components, lines, numbers[:, 0], numbers[:, 1:].reshape(len(lines), -1, len(components)))


def _numbers(file: Path, line: int, cells: Sequence[str], names: Sequence[str]) -> list[float]:
    if len(cells) != len(names):
        raise InvalidReference(
            f"{file}, line {line}: {len(cells)} cells were found, but the header has {len(names)} columns, "
            f"up to {names[-1]}"
        )
    values = []
    for cell, name in zip(cells, names, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = float("nan")
        if not np.isfinite(value):
            raise InvalidReference(f"{file}, line {line}, column {name}: {cell!r} is not a finite number")
        values.append(value)
    return values
