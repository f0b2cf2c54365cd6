"""Logs of drives: from files or arrays, checked, with one sentence for what cannot be used, and averaged over blocks.

Averages of blocks carry as much information on slow motion as the samples, at a fraction of the cost, and their noise
can be judged: by its quanta where an encoder quantizes, by third differences elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidReference, InvalidSetting, described
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array, Mask
from servocore.references.csv_table import read_columns

Log = str | PathLike[str] | Mapping[str, npt.ArrayLike]
"""A CSV file, or arrays by name."""

BLOCK = 0.01
"""Shortest block, in s."""

MOVES = 1e-3
"""Range of a position in m or rad below which its drive rests."""

_GAP = 0.3  # s without samples: the motion before and after it is treated apart
_WHOLE = 1.0  # s of a stretch between gaps
_NEIGHBOURS = 7  # samples in the median with which an outlier is compared
_OUTLIER = 6.0  # standard deviations
_STILL = 1e-5  # noise of a position that never changes, whose quantum is unknown

_SHORTEST, _FEWEST = 2.0, 100  # s and samples of a log
_SLOWEST = 0.05  # s between samples: the swing of a load, its friction and its spline need more
_TURNS = 12.6  # rad: an angle that goes farther without a unit is probably in degrees
_FAR = 30.0  # times the reach of the scene: probably millimetres
_TYPICAL = 0.95  # of the samples are nearer to the median: others may be outliers
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
    contents = [b"".join(each.tobytes() for each in (record.t, *record.columns.values())) for record in found]
    for k, record in enumerate(found):
        if (same := contents.index(contents[k])) < k:
            both = f"{found[same].name} and {record.name} hold the same samples"
            raise InvalidReference(f"{both}: leave one out, or they would count twice")
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
        t, columns, declared = read_columns(log, known)
    elif isinstance(log, Mapping) and _TIME in log:
        t, columns = _arrays(name, {key: log[key] for key in log if key == _TIME or key in known})
    else:
        raise InvalidSetting(f"{name} must be a CSV file or a mapping of arrays with time, not {described(log)}")
    names = [own if (own := renamed.get(key, key)) not in columns else key for key in columns]
    columns = dict(zip(names, columns.values(), strict=True))
    for label in inputs:
        if label not in columns:
            raise InvalidReference(
                f"{name} has no column of the input {label}; it has {', '.join(columns) or 'none'}, and needs"
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


def _require_sampling(record: Record) -> None:
    t = record.t
    if len(t) < _FEWEST or t[-1] - t[0] < _SHORTEST:
        span = t[-1] - t[0] if len(t) else 0.0
        raise InvalidReference(
            f"{record.name} is too short: {len(t)} samples over {span:.3g} s, where {_FEWEST} over {_SHORTEST:g} s are"
            " needed"
        )
    spacing = float(np.median(np.diff(t)))
    if spacing > _SLOWEST * (1.0 + 1e-9):
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
            unit, size = positions[label].unit, float(np.quantile(np.abs(known - np.median(known)), _TYPICAL))
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
            raise InvalidReference(f"{record.name}: the input {label} is {known[0] + 0.0:g} throughout: not measured")
        for extreme in (known.max(), known.min()):
            share = float(np.mean(known == extreme))
            if share > _SATURATED:
                raise InvalidReference(
                    f"{record.name}: {label} stays at {extreme:g} {units[label]} in {share:.0%} of its rows: it is"
                    " saturated, and the real one may be larger; log a slower motion"
                )
    if not moving:
        raise InvalidReference(f"{record.name}: no position changes by a millimetre or a milliradian: nothing moves")


@dataclass(frozen=True, eq=False)
class Blocks:
    """Averages over blocks of one stretch of a log, shapes (N,) and (N, channels); inputs come first.

    Attributes
    ----------
    t : ndarray
        Mean times in s.
    values : ndarray
        Averages.
    noise : ndarray
        Their standard deviations; infinite where all samples are missing.
    log : int
        Number of the log that the stretch belongs to: its biases and delays are shared.
    """

    t: Array
    values: Array
    noise: Array
    log: int = 0


def stretches(t: Array, values: Array, inputs: int, log: int = 0) -> list[Blocks]:
    """Divide a log at its gaps, and average over blocks.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in s, increasing.
    values : ndarray, shape (N, channels)
        NaN where a sample is missing.
    inputs : int
        How many channels are inputs.
    log : int
        Number of the log.
    """
    cuts = np.flatnonzero(np.diff(t) > max(_GAP, 5 * float(np.median(np.diff(t))))) + 1
    parts = zip(np.split(t, cuts), np.split(values, cuts), strict=True)
    return [_blocks(time, rows, inputs, log) for time, rows in parts if time[-1] - time[0] >= _WHOLE]


def _blocks(t: Array, values: Array, inputs: int, log: int) -> Blocks:
    cleaned = np.where(np.column_stack([_outliers(column) for column in values.T]), np.nan, values)
    sizes = [_sample_noise(column) for column in cleaned.T]
    length = max(BLOCK, float(np.median(np.diff(t))))
    _, first = np.unique(np.floor((t - t[0]) / length + 1e-6), return_index=True)
    count = np.diff(np.append(first, len(t)))
    known = np.isfinite(cleaned)
    present = np.add.reduceat(known.astype(float), first)
    filled = np.column_stack([np.interp(t, t[known[:, k]], cleaned[known[:, k], k]) for k in range(values.shape[1])])
    means = np.add.reduceat(filled, first) / count[:, None]
    independent = present.copy()
    for k in range(inputs, values.shape[1]):
        if quantum := _quantum(cleaned[:, k]):
            # Within one quantum all samples have the same error: no more are independent than quanta are passed.
            passed = np.abs(np.gradient(means[:, k])) / quantum
            independent[:, k] = np.minimum(present[:, k], np.maximum(passed, 1.0))
    noise = np.array(sizes) / np.sqrt(np.maximum(independent, 1.0))
    return Blocks(np.add.reduceat(t, first) / count, means, np.where(present > 0, noise, np.inf), log)


def _outliers(x: Array) -> Mask:
    """Return which samples are far from the median of their neighbours (Hampel's identifier)."""
    known = np.flatnonzero(np.isfinite(x))
    if len(known) <= _NEIGHBOURS:
        return np.zeros(len(x), dtype=bool)
    padded = np.pad(x[known], _NEIGHBOURS // 2, mode="edge")
    away = np.abs(x[known] - np.median(np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS), axis=1))
    usual = 1.4826 * float(np.median(away)) + 2.0 * _quantum(x) + 1e-12 * float(np.abs(x[known]).max())
    found = np.zeros(len(x), dtype=bool)
    found[known] = away > _OUTLIER * max(usual, float(np.sqrt(np.mean(np.sort(away)[: int(0.95 * len(away))] ** 2))))
    return found


def _quantum(x: Array) -> float:
    """Return the step of a quantized signal; 0 for one that is not quantized."""
    known = x[np.isfinite(x)]
    steps = np.abs(np.diff(known))
    if len(known):
        steps = steps[steps > 1e-9 * np.quantile(np.abs(known), _TYPICAL)]
    if len(steps) < 10:
        return 0.0
    least = float(np.quantile(steps, 0.01))
    off = np.abs(steps / least - np.round(steps / least))
    return least if float(np.quantile(off, 0.9)) < 0.02 else 0.0


def _sample_noise(x: Array) -> float:
    """Return the standard deviation of a sample's noise, by third differences; at least that of a quantum."""
    known = x[np.isfinite(x)]
    rough = float(np.sqrt(np.mean(np.diff(known, 3) ** 2) / 20.0)) if len(known) > 3 else 0.0
    least = 1e-9 * float(np.abs(known).max(initial=0.0)) if np.ptp(known) > 0.0 else _STILL
    return float(max(rough, _quantum(x) / 12.0**0.5, least))
