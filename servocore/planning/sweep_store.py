"""The dataset of a sweep, filled in memory, or block by block in a store that a later run can complete."""

from __future__ import annotations

import json
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from servocore.errors import InvalidSetting, extra
from servocore.files import not_written
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array
from servocore.planning.sweep_cases import SWING, peaked
from servocore.planning.sweep_settings import CASE, DURATION, PATH, Slices, SweepSettings

INSTANT = "instant"
"""The dimension of the inputs over time: the share of the duration that has passed."""

FAILURE = "failure"
"""The variable of sentences, empty where a case is solved."""

SUFFIX = ".parquet"
"""How the name of a store ends that is a folder of tables."""

_DONE = "blocks/done"  # which blocks of a store are complete; no part of the dataset
_SETTINGS, _SETTINGS_FILE = "settings", "_settings.json"  # readers of tables pass over names that begin so

_quiet = partial(warnings.catch_warnings, action="ignore")  # Zarr: other libraries may not know its texts yet

Answers = Mapping[str, Any]
"""The results of a block by variable, shape (cases,), or (cases, N) over time."""


def blank_dataset(swept: SweepSettings, settings: Mapping[str, Any]) -> Any:
    """Return the xarray.Dataset of a sweep of which nothing is computed: NaN and empty sentences, in next to no memory.

    Raises
    ------
    InvalidSetting
        If xarray is missing.
    """
    xarray, system, grid = extra("xarray"), swept.problem.system, swept.grid
    dimensions, instants = tuple(grid.dimensions), np.linspace(0.0, 1.0, swept.instants)

    def numbers(described: str, unit: str, *over_time: int) -> Any:
        values = np.broadcast_to(np.nan, (*grid.shape, *over_time))
        return (*dimensions, *[INSTANT] * len(over_time)), values, {"long_name": described, "units": unit}

    variables = {name: numbers(_meaning(name, e), e.unit) for name, e in peaked(system).items()}
    for limit in swept.limits:
        least = f"least distance of {limit.quantity} from its limit"
        variables[f"margin_{limit.quantity}"] = numbers(least, limit.unit)
    if swept.inputs:
        variables |= {e.name: numbers(e.description, e.unit, swept.instants) for e in system.inputs}
    why = {"long_name": "why the case is not solved; empty where it is"}
    variables[FAILURE] = (dimensions, np.broadcast_to(np.array("", dtype=object), grid.shape), why)
    units = {parameter.name: parameter.unit for parameter in system.parameters.declared} | {DURATION: "s"}
    coordinates: dict[str, Any] = {
        name: (dimension, values, {"units": units[name]}) for name, (dimension, values) in grid.columns.items()
    }
    coordinates |= {name: np.arange(grid.dimensions[name]) for name in (PATH, CASE) if name in grid.dimensions}
    coordinates |= {INSTANT: (INSTANT, instants, {"units": "1"})} if swept.inputs else {}
    return xarray.Dataset(variables, coordinates, {_SETTINGS: json.dumps(settings)})


def varied(blank: Any, name: str, block: Slices) -> Array:
    """Return the values of something that varies for all cases of a block, in C order; zeros if it does not."""
    part = blank[FAILURE][block]
    if name not in part.coords:
        return np.zeros(part.size)
    return np.asarray(part.coords[name].broadcast_like(part)).ravel()


def _meaning(name: str, quantity: Quantity) -> str:
    if name == SWING:
        return "largest swing angle"
    return quantity.description if name == quantity.name else f"largest magnitude of {quantity.name}"


def _placed(blank: Any, block: Slices, answers: Answers) -> Iterator[tuple[str, Any]]:
    """Yield the values of all variables of a dataset for a block, in its shape."""
    shape = tuple(slice_.stop - slice_.start for slice_ in block)
    for name in blank:
        yield name, answers[name].reshape(*shape, *blank[name].shape[len(shape) :])


class Memory:
    """Results in memory.

    Parameters
    ----------
    blank : xarray.Dataset
        The dataset of a sweep.
    """

    def __init__(self, blank: Any) -> None:
        copies = {name: (each.dims, np.array(each), each.attrs) for name, each in blank.items()}
        self._filled = blank.assign(copies)

    def known(self) -> set[int]:
        """Return nothing: no block is there before it is put."""
        return set()

    def put(self, _: int, block: Slices, answers: Answers) -> None:
        """Take the results of a block."""
        for name, values in _placed(self._filled, block, answers):
            self._filled[name].values[block] = values

    def dataset(self) -> Any:
        """Return the dataset."""
        return self._filled.assign({FAILURE: self._filled[FAILURE].astype(str)})


class Store(ABC):
    """Results of a sweep in a folder, written block by block: each is there as a whole or not at all.

    Parameters
    ----------
    path : Path
        Of the folder.
    swept : SweepSettings
        The varied quantities.
    blank : xarray.Dataset
        Its dataset, with the settings of this sweep.
    shape : sequence of int
        Of the blocks.
    resume : bool
        Whether one that is there already is completed.

    Raises
    ------
    InvalidSetting
        If there is one already that is not to be resumed, or its settings are other ones, or it cannot be made.
    """

    package: ClassVar[str]

    def __init__(self, path: Path, swept: SweepSettings, blank: Any, shape: Sequence[int], resume: bool) -> None:
        extra(self.package)
        settings = {**json.loads(blank.attrs[_SETTINGS]), "block": list(shape)}
        self._path, self._grid, self._blocks = path, swept.grid, list(swept.grid.blocks(shape))
        self._blank = blank.assign_attrs({_SETTINGS: json.dumps(settings)})
        if path.exists():
            self._require_settings(settings, resume)
            return
        try:
            self._make(shape)
        except OSError as error:
            raise not_written(path, error) from error

    def _require_settings(self, settings: Mapping[str, Any], resume: bool) -> None:
        """Raise `InvalidSetting` unless an existing store has these settings, and is to be resumed."""
        path = self._path
        try:
            stored = json.loads(self._stored_settings())
        except (KeyError, ValueError, OSError) as error:
            raise InvalidSetting(f"cannot write {path}: it is there already, and is no store of a sweep") from error
        if not resume:
            raise InvalidSetting(f"{path} is there already: resume it, or choose another place")
        other = sorted(name for name in {*settings, *stored} if settings.get(name) != stored.get(name))
        if other:
            raise InvalidSetting(f"{path} is of another sweep: {', '.join(other)} differ; nothing was resumed")

    @abstractmethod
    def _make(self, shape: Sequence[int]) -> None:
        """Make a store without results."""

    @abstractmethod
    def _stored_settings(self) -> str:
        """Return the settings of an existing store; raises `KeyError`, `ValueError` or `OSError` if it is none."""


class Zarr(Store):
    """A Zarr store: a block is a chunk of every array."""

    package = "zarr"

    def _make(self, shape: Sequence[int]) -> None:
        zarr = extra("zarr")
        with _quiet():
            group = zarr.open_group(self._path, mode="w-")
            for name, each in self._blank.items():
                text = name == FAILURE
                group.create_array(
                    name, shape=each.shape, chunks=(*shape, *each.shape[len(shape) :]),
                    dtype=str if text else np.float64, fill_value="" if text else np.nan,
                    dimension_names=each.dims, attributes=each.attrs,
                )  # fmt: skip
            for name, each in self._blank.coords.items():
                group.create_array(name, data=each.to_numpy(), dimension_names=each.dims, attributes=each.attrs)
            blocks = len(self._blocks)
            group.create_array(_DONE, shape=(blocks,), chunks=(1,), dtype=np.uint8, dimension_names=("block",))
            # xarray takes a column of a table, such as load_mass over `CASE`, for a result unless it is a coordinate.
            group.attrs.update({**self._blank.attrs, "coordinates": " ".join(self._blank.coords)})
            # The metadata of the store are complete here: xarray opens it by its name alone, without a warning.
            zarr.consolidate_metadata(group.store)

    def _stored_settings(self) -> str:
        group = extra("zarr").open_group(self._path, mode="r")
        group[_DONE]
        return str(group.attrs[_SETTINGS])

    @cached_property  # every block writes into all of them
    def _arrays(self) -> Mapping[str, Any]:
        group = extra("zarr").open_group(self._path, mode="r+")
        return {name: group[name] for name in (*self._blank, _DONE)}

    def known(self) -> set[int]:
        """Return the numbers of the blocks that are complete."""
        return set(np.flatnonzero(self._arrays[_DONE][:]).tolist())

    def put(self, number: int, block: Slices, answers: Answers) -> None:
        """Write a block, and then that it is there."""
        with _quiet():
            for name, values in _placed(self._blank, block, answers):
                if name != FAILURE or values.any():  # empty messages are the store's default
                    self._arrays[name][block] = values
        self._arrays[_DONE][number] = 1

    def dataset(self) -> Any:
        """Return the dataset, of which nothing is read before it is used."""
        with _quiet():  # without chunks of Dask, whose import takes seconds
            return extra("xarray").open_zarr(self._path, chunks=None)


class Parquet(Store):
    """A folder of Parquet files: a file a block, a row a case, inputs over time as lists.

    Columns are the varied quantities, then the variables; a file holds the settings and, of every column, the unit.
    """

    package = "pyarrow"

    def _make(self, shape: Sequence[int]) -> None:  # noqa: ARG002 - files are as long as blocks are
        self._path.mkdir(parents=True)
        (self._path / _SETTINGS_FILE).write_text(self._blank.attrs[_SETTINGS], encoding="utf-8")

    def _stored_settings(self) -> str:
        return (self._path / _SETTINGS_FILE).read_text(encoding="utf-8")

    def known(self) -> set[int]:
        """Return the numbers of the blocks that are complete."""
        return {number for number, _ in self._blocks if self._part(number).exists()}

    def put(self, number: int, block: Slices, answers: Answers) -> None:
        """Write a block beside its place, and then put it there."""
        arrow, grid = extra("pyarrow"), self._grid
        columns: dict[str, Any] = {PATH: varied(self._blank, PATH, block)} if PATH in grid.dimensions else {}
        columns |= {name: varied(self._blank, name, block) for name in grid.columns}
        columns |= {name: list(answers[name]) if self._is_over_time(name) else answers[name] for name in self._blank}
        fields = [
            arrow.field(name, arrow.array(values).type, metadata={"units": self._blank[name].attrs.get("units", "")})
            for name, values in columns.items()
        ]
        part = self._part(number)
        beside = part.with_name(f"_{part.name}")
        table = arrow.table(columns, schema=arrow.schema(fields, metadata=self._blank.attrs))
        extra("pyarrow.parquet").write_table(table, beside)
        beside.replace(part)

    def dataset(self) -> Any:
        """Return all that was written, read into memory."""
        memory, read_table = Memory(self._blank), extra("pyarrow.parquet").read_table
        for number, block in self._blocks:
            table = read_table(self._part(number))
            columns = {name: table.column(name).to_numpy() for name in self._blank}
            answers = {name: np.stack(each) if self._is_over_time(name) else each for name, each in columns.items()}
            memory.put(number, block, answers)
        return memory.dataset()

    def _is_over_time(self, name: str) -> bool:
        return INSTANT in self._blank[name].dims

    def _part(self, number: int) -> Path:
        return self._path / f"part-{number:06d}{SUFFIX}"
