"""Paths from CSV files, SI units throughout; every complaint names file, line and column."""

from __future__ import annotations

import csv
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from servocore.errors import InvalidReference
from servocore.references.hermite import Disagreement, disagreement, hermite
from servocore.references.piecewise import REST_ORDER, PiecewisePolynomial
from servocore.references.splines import FEWEST_SAMPLES, sampled, through

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from servocore.references.base import FloatArray

GROUPS = tuple(tuple(prefix + axis for axis in "xyz") for prefix in ("", "v", "a", "j", "s"))
"""Columns after `time`: position (m) and its derivatives by time up to the fourth (m/s^k)."""

SPLINE_AGREEMENT = 0.01
"""A derivative column may differ from the spline through the positions by this fraction of its peak."""

HERMITE_AGREEMENT = 0.5
"""A row may differ from the path through every second row or fewer by this fraction of its peak."""


class _Table(NamedTuple):
    """A file that was read: line numbers and times (n,), derivatives (n, groups, 3)."""

    path: Path
    lines: list[int]
    t: FloatArray
    derivatives: FloatArray


def from_csv(path: str | PathLike[str], tolerance: float | None = None) -> PiecewisePolynomial:
    """Path from a file with times, positions and, if known, their derivatives.

    The header is `time,x,y,z`, optionally followed by `vx,vy,vz`, then `ax,ay,az`, then `jx,jy,jz`, then
    `sx,sy,sz` (velocity, acceleration, jerk, snap). With all five groups the path is the Hermite polynomial
    of degree 9 between rows, which takes up every number given. With fewer groups, or with a tolerance, it
    is `sampled(time, positions, tolerance)`: Hermite pieces of the fewer data would not be smooth enough for
    the inputs of a crane. The derivatives given are then only compared with the spline's.

    Parameters
    ----------
    path : path-like
        A comma-separated UTF-8 file.
    tolerance : float, optional
        How far the path may stay away from a position, in m: for rounded or noisy files; see `sampled`.

    Returns
    -------
    PiecewisePolynomial
        The path; `max_order` 9, `smoothness` 4 or 8, rest outside where it starts or ends at rest.

    Raises
    ------
    InvalidReference
        If the file cannot be read, is not such a table, has too few rows or times that do not increase, if
        the path is too rough, or if its columns contradict one another.
    """
    table = _read(path, len(GROUPS))
    if table.derivatives.shape[1] > REST_ORDER and tolerance is None:
        return _hermite_path(table)
    return _sampled_path(table, tolerance)


def waypoints_from_csv(path: str | PathLike[str]) -> PiecewisePolynomial:
    """Smooth path from rest to rest through the waypoints of a file with the header `time,x,y,z`.

    Parameters
    ----------
    path : path-like
        A comma-separated UTF-8 file, at least two rows; s and m.

    Returns
    -------
    PiecewisePolynomial
        `through(positions, time)`.

    Raises
    ------
    InvalidReference
        If the file cannot be read or is not such a table, or its times do not increase.
    """
    table = _read(path, 1)
    _need_rows(table, 2)
    return through(table.derivatives[:, 0], table.t)


def _hermite_path(table: _Table) -> PiecewisePolynomial:
    _need_rows(table, 2)
    path, worst = hermite(table.t, table.derivatives)
    if worst is not None:
        _refuse_contradiction(table, worst, HERMITE_AGREEMENT, "the path through its neighbours")
    return path


def _sampled_path(table: _Table, tolerance: float | None) -> PiecewisePolynomial:
    _need_rows(table, FEWEST_SAMPLES)
    try:
        path = sampled(table.t, table.derivatives[:, 0], tolerance)
    except InvalidReference as error:
        raise InvalidReference(f"{table.path}: {error}") from None
    found = path.jet(table.t, table.derivatives.shape[1] - 1)
    found[:, 0] = table.derivatives[:, 0]  # positions were judged by `sampled`
    worst = disagreement(table.derivatives, found, path.duration)
    _refuse_contradiction(table, worst, SPLINE_AGREEMENT, "the spline through the positions")
    return path


def _refuse_contradiction(table: _Table, worst: Disagreement, limit: float, judge: str) -> None:
    if worst.fraction <= limit:
        return
    given = table.derivatives[worst.row, worst.order, worst.component]
    raise InvalidReference(
        f"{table.path}, line {table.lines[worst.row]} (time {table.t[worst.row]:.6g} s), column "
        f"{GROUPS[worst.order][worst.component]}: {given:.6g} differs from {judge} by "
        f"{worst.fraction:.1%} of the column's peak (limit {limit:.0%}), so the columns contradict one "
        "another, are rounded too much, or the rows are too far apart"
    )


def _need_rows(table: _Table, fewest: int) -> None:
    if len(table.t) < fewest:
        raise InvalidReference(
            f"{table.path}, line {table.lines[-1]}: the file ends after {len(table.t)} rows of data, but "
            f"such a path needs at least {fewest}"
        )


def _read(path: str | PathLike[str], groups: int) -> _Table:
    """Read and check a table with up to `groups` groups of columns."""
    file = Path(path)
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidReference(f"{file} cannot be read as a table: {error}") from None
    rows = [(line, cells) for line, cells in rows if any(cells)]
    if not rows:
        raise InvalidReference(f"{file}, line 1: the file is empty, but a header {_header(1)} was expected")
    names = _checked_header(file, *rows[0], groups)
    if len(rows) == 1:
        raise InvalidReference(f"{file}, line {rows[0][0]}: there is a header but no rows of data below it")
    lines = [line for line, _ in rows[1:]]
    numbers = np.array([_numbers(file, line, cells, names) for line, cells in rows[1:]])
    stuck = np.flatnonzero(np.diff(numbers[:, 0]) <= 0.0)
    if stuck.size:
        late = stuck[0] + 1
        raise InvalidReference(
            f"{file}, line {lines[late]}, column time: {numbers[late, 0]:.17g} s does not come after "
            f"{numbers[late - 1, 0]:.17g} s of the row before"
        )
    return _Table(file, lines, numbers[:, 0], numbers[:, 1:].reshape(len(lines), -1, 3))


def _header(groups: int) -> str:
    return ",".join(["time", *chain(*GROUPS[:groups])])


def _checked_header(file: Path, line: int, cells: Sequence[str], groups: int) -> Sequence[str]:
    found = ",".join(cells)
    allowed = [_header(count) for count in range(1, groups + 1)]
    if found not in allowed:
        more = ", optionally followed by " + ", then ".join(",".join(names) for names in GROUPS[1:groups])
        raise InvalidReference(
            f"{file}, line {line}: the header {allowed[0]}{more if groups > 1 else ''} was expected, but "
            f"{found!r} was found"
        )
    return cells


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
