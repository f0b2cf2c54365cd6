"""Logs of drives: from files or arrays, checked, with one sentence for what cannot be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidReference, InvalidSetting, described
from servocore.identification.blocks import MOVES
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.units import in_unit
from servocore.numerics.compiled_calls import Array
from servocore.references.csv_table import read_columns

Log = str | PathLike[str] | Mapping[str, npt.ArrayLike]
"""A CSV file, or arrays by name."""

_SHORTEST, _FEWEST = 2.0, 100  # s and samples of a log
_SLOWEST = 0.05  # s between samples: the swing of a load, its friction and its spline need more
_TURNS = 12.6  # rad: an angle that goes farther without a unit is probably in degrees
_FAR = 30.0  # times the reach of the scene: probably millimetres
_SATURATED = 0.05  # of the samples at the same extreme
_TIME = "time"


class Record(NamedTuple):
    """A log that was checked.

    Attributes
    ----------
    name : str
        Of its file, for messages.
    t : ndarray, shape (N,)
        Times in s.
    columns : mapping of str to ndarray, shape (N,)
        In SI units; NaN where a value is missing.
    declared : set of str
        Names of the columns whose unit is known.
    """

    name: str
    t: Array
    columns: Mapping[str, Array]
    declared: set[str]


def records(logs: Log | Sequence[Log], scene: Scene, positions: Mapping[str, Quantity]) -> list[Record]:
    """Read and check logs.

    Parameters
    ----------
    logs : path, mapping or sequence
        One or several.
    scene : Scene
        Whose inputs the columns are.
    positions : mapping of str to Quantity
        Quantities that a column may measure.

    Raises
    ------
    InvalidReference
        If a log cannot be read, or is not one.
    InvalidSetting
        If a log is something else.
    """
    several = isinstance(logs, Sequence) and not isinstance(logs, str)
    given: list[Log] = list(logs) if several else [logs]  # type: ignore[arg-type, list-item]  # `several` says which
    if not given:
        raise InvalidSetting("a log is needed: a CSV file, arrays by name, or a list of these")
    found = [_record(each, f"log {k + 1}" if several else "the log", scene, positions) for k, each in enumerate(given)]
    for record in found:
        _require_sampling(record)
        _require_signals(record, scene, positions)
    return found


def _record(log: Log, name: str, scene: Scene, positions: Mapping[str, Quantity]) -> Record:
    inputs = {quantity.name: quantity.unit for quantity in scene.model().inputs}
    # A drive before a flexible part measures its own side, under the name of the whole.
    renamed = dict(zip(scene.effects.drives, scene.effects.measured, strict=True))
    known = inputs | {label: quantity.unit for label, quantity in positions.items()}
    known |= {label: known[own] for label, own in renamed.items()}
    declared = set(known)
    if isinstance(log, str | PathLike):
        name = str(Path(log))
        t, columns, declared = read_columns(log, known, _factor)
    elif isinstance(log, Mapping) and _TIME in log:
        t, columns = _arrays(name, {key: log[key] for key in log if key == _TIME or key in known})
    else:
        raise InvalidSetting(f"{name} must be a CSV file or a mapping of arrays with time, not {described(log)}")
    columns = {renamed[key] if renamed.get(key, key) not in columns and key in renamed else key: column
               for key, column in columns.items()}  # fmt: skip
    for label in inputs:
        if label not in columns:
            raise InvalidReference(
                f"{name} has no column of the input {label}; it has {', '.join(columns)}, and needs"
                f" {', '.join(inputs)} and measured positions, such as {', '.join(renamed) or ', '.join(positions)}"
            )
    measured = [label for label in columns if label not in inputs]
    if len(measured) < len(inputs):
        raise InvalidReference(
            f"{name} measures {', '.join(measured) or 'no position'}: as many positions as inputs are needed, of"
            f" {', '.join(positions)}"
        )
    return Record(name, t, columns, declared)


def _arrays(name: str, given: Mapping[str, npt.ArrayLike]) -> tuple[Array, dict[str, Array]]:
    """Return the time and the other columns as arrays of one length."""
    try:
        columns = {key: np.array(column, dtype=float) for key, column in given.items()}
    except (TypeError, ValueError):
        raise InvalidReference(f"{name} has a column that is not made of numbers") from None
    t = columns.pop(_TIME)
    if any(each.ndim != 1 or len(each) != len(t) for each in (t, *columns.values())):
        raise InvalidReference(f"{name} needs one-dimensional columns of one length")
    bad = np.flatnonzero(~np.isfinite(t) | (np.diff(t, prepend=-np.inf) <= 0.0))
    if len(bad):
        at = f"{name}, row {bad[0]}: its time {t[bad[0]]:g} s"
        raise InvalidReference(f"{at} is not finite, or not later than the one before")
    return t, columns


def _factor(unit: str, si: str) -> float:
    """Return how many of a unit make one of SI; raises `ValueError` where they do not fit."""
    try:
        return 1.0 / in_unit(f"1 {unit}", si, "it")
    except InvalidSetting as error:
        raise ValueError(str(error)) from None


def _require_sampling(record: Record) -> None:
    t = record.t
    if len(t) < _FEWEST or t[-1] - t[0] < _SHORTEST:
        span = t[-1] - t[0] if len(t) else 0.0
        raise InvalidReference(
            f"{record.name} is too short: {len(t)} samples over {span:.3g} s, where {_FEWEST} over {_SHORTEST:g} s are"
            " needed"
        )
    spacing = float(np.median(np.diff(t)))
    if spacing > _SLOWEST:
        raise InvalidReference(
            f"{record.name} has a sample every {spacing:.3g} s, where at most {_SLOWEST:g} s are needed; if its times"
            " are milliseconds, write time [ms] into the header"
        )


def _require_signals(record: Record, scene: Scene, positions: Mapping[str, Quantity]) -> None:
    """Raise `InvalidReference` for columns that are empty, constant, saturated, or in degrees or millimetres."""
    reach = float(np.abs(scene.reference.jet(scene.reference.start_time, 0)).max()) + np.abs(scene.model().home).max()
    usual = {"rad": ("deg", _TURNS), "m": ("mm", _FAR * reach)}
    moving, units = False, {quantity.name: quantity.unit for quantity in scene.model().inputs}
    for label, column in record.columns.items():
        known = column[np.isfinite(column)]
        if len(known) < len(column) / 2:
            raise InvalidReference(f"{record.name}: {label} has no value in {1 - len(known) / len(column):.0%} of rows")
        span = float(np.ptp(known))
        if label in positions:
            unit, size = positions[label].unit, float(np.abs(known - np.median(known)).max())
            likely, most = usual.get(unit, ("", np.inf))
            if size > most:
                hint = f"; write {label} [{likely}] into the header if that is meant"
                raise InvalidReference(
                    f"{record.name}: {label} changes by {size:.3g} {unit}, which looks like {likely}"
                    + (hint if label not in record.declared else "")
                )
            moving |= span > MOVES
            continue
        if span == 0.0:
            raise InvalidReference(
                f"{record.name}: the input {label} is {known[0] + 0.0:g} throughout: it was not measured"
            )
        for extreme in (known.max(), known.min()):
            share = float(np.mean(known == extreme))
            if share > _SATURATED:
                raise InvalidReference(
                    f"{record.name}: {label} stays at {extreme:g} {units[label]} in {share:.0%} of its rows: it is"
                    " saturated, and the real one may be larger; log a slower motion"
                )
    if not moving:
        raise InvalidReference(f"{record.name}: no position changes by a millimetre or a milliradian: nothing moves")
