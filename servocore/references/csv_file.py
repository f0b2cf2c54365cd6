"""Paths from CSV files, SI units throughout; every error names file, line and column."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike

import numpy as np

from servocore.errors import InvalidReference, require_kind
from servocore.files import csv_text
from servocore.references.base import FloatArray, Reference
from servocore.references.bspline import REST_ORDER, require_order
from servocore.references.csv_table import PREFIXES, Table, read_table
from servocore.references.likely_units import doubtful_units
from servocore.references.piecewise import Disagreement, PiecewisePolynomial, disagreement, hermite
from servocore.references.splines import fewest_samples, joined_legs, sampled

COLUMNS = ("x", "y", "z")
"""Position columns if no others are named: of a load in space."""

SPLINE_AGREEMENT = 0.01
"""A derivative column may differ from the spline through the positions by this fraction of its peak."""

HERMITE_AGREEMENT = 0.5
"""A row may differ from the path through every second row or fewer, or its highest derivative from the one that follows
from the others, by this fraction of its peak."""

RETURNS = 1e-6
"""Derivatives of a path that was written come back to this fraction of their peaks."""

_FEWEST_EACH, _MOST_EACH = 2, 64
_NO_STRETCH, _APART = 1e-12, 1e3  # of the duration, and in units of the last digit of a time
_BETWEEN = (0.06, 0.2, 0.5, 0.8, 0.94)  # of the way from row to row: where a path is compared with the path read back


def from_csv(
    path: str | PathLike[str],
    tolerance: float | None = None,
    columns: Sequence[str] = COLUMNS,
    *,
    rest_order: int = REST_ORDER,
    units: Sequence[str] | None = None,
) -> PiecewisePolynomial:
    """Path from a file with times, positions and, if known, their derivatives.

    Commas, semicolons or tabs divide the cells; the encoding is UTF-8 or UTF-16. Units are those of SI unless the
    header names others, as `time [ms],x [mm]`; times may also be dates, as 2026-01-01T12:00:00.100Z. Conversions
    are reported by a warning.

    The header is `time,x,y,z`, optionally followed by `vx,vy,vz`, then `ax,ay,az`, then `jx,jy,jz`, then
    `sx,sy,sz` (velocity, acceleration, jerk, snap); with other columns, their names in place of x, y and z. With
    derivatives up to `rest_order` the path is the Hermite polynomial between rows, which takes up every number given.
    With fewer groups, or with a tolerance, it is `sampled(time, positions, tolerance)`: Hermite pieces of fewer data
    would not be smooth enough. The derivatives given are then only compared with the spline's.

    Parameters
    ----------
    path : path-like
        A CSV file.
    tolerance : float, optional
        How far the path may stay away from a position, in m: for rounded or noisy files; see `sampled`.
    columns : sequence of str
        Names of the position columns, one for each component of the path. Those of a scene's servo output are
        `columns=[each.name for each in scene.model().outputs]`.
    rest_order : int
        How many derivatives are continuous, and vanish at an end that rests; see `sampled`.
    units : sequence of str, optional
        Units of the position columns: where they are given, a header must not name an angle for a length.

    Returns
    -------
    PiecewisePolynomial
        The path, rest outside where it starts or ends at rest. With the default order its `max_order` is 9, its
        `smoothness` 4 or 8.

    Raises
    ------
    InvalidReference
        If the file cannot be read, is not such a table, has too few rows or times that do not increase, if
        the path is too rough, its columns contradict one another, or its numbers look like milliseconds or
        millimetres where no header says so.

    Warns
    -----
    ServocoreWarning
        If something had to be converted.
    """
    require_order(rest_order)
    return _path_of(read_table(path, columns, len(PREFIXES), units=units), tolerance, rest_order)


def samples_or_waypoints(
    path: str | PathLike[str],
    columns: Sequence[str],
    tolerance: float | None,
    rest_order: int,
    units: Sequence[str] | None = None,
) -> tuple[PiecewisePolynomial, int | None]:
    """Return the path of a file, and of how many waypoints it is; None where it is sampled.

    Positions alone in fewer rows than samples need are waypoints, as of `waypoints_from_csv`; without a tolerance. So
    are rows with a column `stop`, or with velocities of some rows only.

    Raises
    ------
    InvalidReference
        As `from_csv`.
    """
    require_order(rest_order)
    table = read_table(path, columns, len(PREFIXES), waypoints=True, units=units)
    rows, positions_alone = len(table.t), table.derivatives.shape[1] == 1
    few = positions_alone and tolerance is None and rows < fewest_samples(rest_order)
    if few or table.stops is not None or not np.isfinite(table.derivatives).all():
        return _path_through(table, rest_order), rows
    return _path_of(table, tolerance, rest_order), None


def path_to_csv(path: Reference, columns: Sequence[str] = COLUMNS, each: int | None = None) -> str:
    """Return a path as the text of a file that `from_csv` reads: positions and four derivatives.

    Of a path with fewer continuous derivatives it has those alone, for no row holds two values at a jump; `from_csv`
    then reads it with as many as its `rest_order`. The path that is read has these values between start and end.

    Parameters
    ----------
    path : Reference
        Any.
    columns : sequence of str
        Names of the position columns, one for each component of the path.
    each : int, optional
        Rows for every stretch of the path, of which fewer than two may be too few to be read. Without it as many, 2 to
        64, as it takes for every derivative to come back to a millionth of its peak, or as near as round-off lets:
        polynomials of degree 9 or less take two, and more rows amplify their round-off.

    Returns
    -------
    str
        Every number in as many digits as it takes to read back the same one.

    Raises
    ------
    InvalidReference
        If there are more or fewer names than components, two are the same, or `each` is not a whole number of one or
        more.
    """
    require_kind(path, Reference, "the argument of path_to_csv", "a Reference", InvalidReference)
    if len(columns) != path.dimension:
        raise InvalidReference(f"a path with {path.dimension} components needs as many columns, not {len(columns)}")
    if len({"time", *columns}) <= len(columns):
        raise InvalidReference(f"a path needs position columns with names of their own, not {', '.join(columns)}")
    if each is not None and not (isinstance(each, int) and each >= 1):
        raise InvalidReference(f"every stretch of a path has one or more whole rows, not {each}")
    t, jets = _rows_enough(path) if each is None else _rows_of(path, each)
    slow, far = doubtful_units(t, jets[:, 0])  # then the header declares the unit, for the reader would refuse it
    names = [f"{prefix}{name}" for prefix in PREFIXES[: jets.shape[1]] for name in columns]
    if far and tuple(columns) == COLUMNS:
        names[: len(columns)] = [f"{name} [m]" for name in columns]
    return csv_text(["time [s]" if slow else "time", *names], [t, jets.reshape(len(t), -1)])


def _rows_of(path: Reference, each: int) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) and derivatives (n, orders, dimension): those that do not jump where pieces of a path meet."""
    ends = path.stretches
    shortest = max(_NO_STRETCH * path.duration, _APART * np.spacing(max(abs(path.start_time), abs(path.end_time))))
    long = np.diff(ends) > shortest  # ramps of half a duration, but for round-off, leave none between them
    ends = np.array([path.start_time, *ends[1:-1][long[:-1] & (path.end_time - ends[1:-1] > shortest)], path.end_time])
    t = np.append((ends[:-1, None] + np.diff(ends)[:, None] * np.arange(each) / each).ravel(), ends[-1])
    return t, path.jet(t, min(len(PREFIXES) - 1, path.smoothness, path.max_order))


def _rows_enough(path: Reference) -> tuple[FloatArray, FloatArray]:
    """Return the fewest rows that give a path back; the best where round-off grows before they do."""
    best, least, each, turn = None, np.inf, _FEWEST_EACH, path.start_time
    while each <= _MOST_EACH:
        t, jets = rows = _rows_of(path, each)
        each *= 2
        order = jets.shape[1] - 1
        if order < 1:  # a table of positions alone, which nothing but its density makes better
            best = rows
            continue
        read, doubt = hermite(t, jets)
        if doubt is not None and doubt.fraction > HERMITE_AGREEMENT:
            turn = t[doubt.row]
            continue
        between = np.concatenate([t[:-1] + part * np.diff(t) for part in _BETWEEN])
        worst = disagreement(path.jet(between, order), read.jet(between, order), path.duration).fraction
        if worst >= least:  # round-off
            break
        best, least = rows, worst
        if worst <= RETURNS:
            break
    if best is None:
        raise InvalidReference(
            f"no table holds the path: with {_MOST_EACH} rows for each of its {len(path.stretches) - 1} stretches a"
            f" derivative still jumps or turns between them, near t = {turn:.6g} s"
        )
    return best


def waypoints_from_csv(
    path: str | PathLike[str],
    columns: Sequence[str] = COLUMNS,
    *,
    rest_order: int = REST_ORDER,
    units: Sequence[str] | None = None,
) -> PiecewisePolynomial:
    """Smooth path from rest to rest through the waypoints of a file.

    The header is `time,x,y,z`, optionally followed by `vx,vy,vz`, velocities to be met, in which cells may be empty
    where any is right, and by `stop`, which is 1 (or yes, true, x, stop) where the path comes to rest in
    between, and 0 (or no, false, nothing) elsewhere.

    Parameters
    ----------
    path : path-like
        A CSV file, at least two rows; s and m, unless the header names other units, as in `from_csv`.
    columns : sequence of str
        Names of the position columns, as in `from_csv`.
    rest_order : int
        How many derivatives vanish at start and end; see `through`.
    units : sequence of str, optional
        Units of the position columns: where they are given, a header must not name an angle for a length.

    Returns
    -------
    PiecewisePolynomial
        `through(positions, time, velocities=..., stops=...)`.

    Raises
    ------
    InvalidReference
        If the file cannot be read or is not such a table, or its times do not increase.
    """
    return _path_through(read_table(path, columns, 2, waypoints=True, units=units), rest_order)


def _path_through(table: Table, rest_order: int) -> PiecewisePolynomial:
    _need_rows(table, 2)
    if table.derivatives.shape[1] > 2:
        raise InvalidReference(f"{table.path}: waypoints have velocities at most, no accelerations")
    speeds = table.derivatives[:, 1] if table.derivatives.shape[1] > 1 else None
    try:
        path = joined_legs(
            table.derivatives[:, 0], table.t, None, rest_order, speeds, table.stops, lambda k: f"line {table.lines[k]}"
        )
    except InvalidReference as error:
        raise InvalidReference(f"{table.path}: {error}") from None
    return replace(path, undeclared=table.undeclared)


def _path_of(table: Table, tolerance: float | None, rest_order: int) -> PiecewisePolynomial:
    if table.derivatives.shape[1] <= rest_order or tolerance is not None:
        return _sampled_path(table, tolerance, rest_order)
    _need_rows(table, 2)
    found, worst = hermite(table.t, table.derivatives)
    if worst is not None:
        _refuse_contradiction(table, worst, HERMITE_AGREEMENT, "the path through its neighbours")
    return replace(found, undeclared=table.undeclared)


def _sampled_path(table: Table, tolerance: float | None, rest_order: int) -> PiecewisePolynomial:
    held, why = table.derivatives.shape[1] - 1, ", for fewer are waypoints, which waypoints_from_csv reads"
    if held > 1 and tolerance is None:
        why = f", for its columns hold {held} of the {rest_order} derivatives with which fewer would do"
    _need_rows(table, fewest_samples(rest_order), why)
    try:
        path = sampled(table.t, table.derivatives[:, 0], tolerance, rest_order=rest_order)
    except InvalidReference as error:
        raise InvalidReference(f"{table.path}: {error}") from None
    given = table.derivatives[:, : path.max_order + 1]
    found = path.jet(table.t, given.shape[1] - 1)
    found[:, 0] = given[:, 0]  # positions were judged by `sampled`
    worst = disagreement(given, found, path.duration)
    _refuse_contradiction(table, worst, SPLINE_AGREEMENT, "the spline through the positions")
    return replace(path, undeclared=table.undeclared)


def _refuse_contradiction(table: Table, worst: Disagreement, limit: float, judge: str) -> None:
    if worst.fraction <= limit:
        return
    given = table.derivatives[worst.row, worst.order, worst.component]
    raise InvalidReference(
        f"{table.path}, line {table.lines[worst.row]} (time {table.t[worst.row]:.6g} s), column "
        f"{PREFIXES[worst.order]}{table.columns[worst.component]}: {given:.6g} differs from {judge} by "
        f"{worst.fraction:.1%} of the column's peak (limit {limit:.0%}), so the columns contradict one "
        "another, are rounded too much, or the rows are too far apart"
    )


def _need_rows(table: Table, fewest: int, why: str = "") -> None:
    if len(table.t) < fewest:
        raise InvalidReference(
            f"{table.path}, line {table.lines[-1]}: the file ends after {len(table.t)} rows of data, but "
            f"such a path needs at least {fewest}{why}"
        )
