"""Stores of a sweep's results: in memory, or block by block in a Zarr store that a later run can complete."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from servocore.errors import InvalidSetting, refused_if_missing
from servocore.files import not_written
from servocore.planning.sweep_grid import CASE, DURATION, PATH, Slices
from servocore.planning.sweep_settings import SweepSettings

INSTANT = "instant"
"""The dimension of the inputs over time: the share of the duration that has passed."""

DONE = "blocks/done"
"""Which blocks of a store are complete; no part of the dataset."""

_SETTINGS = "settings"


class Sink(Protocol):
    """What takes the results of blocks."""

    def has(self, number: int, /) -> bool:
        """Whether a block is there."""

    def put(self, number: int, block: Slices, answers: Mapping[str, Any], /) -> None:
        """Take the results of a block."""

    def dataset(self) -> Any:
        """Return all that was taken."""


@dataclass(frozen=True)
class Variable:
    """One variable of the dataset: which result it is, with its unit; instants too where they are kept."""

    name: str
    result: str
    column: int | None
    unit: str
    described: str
    over_time: bool = False


def variables_of(swept: SweepSettings) -> list[Variable]:
    """Return the variables of a sweep's dataset."""
    system, quantities = swept.problem.system, swept.problem.system.inputs
    variables = [
        Variable(f"peak_{e.name}", "peaks", k, e.unit, f"largest magnitude of {e.name}")
        for k, e in enumerate(quantities)
    ]
    swing = next((observable for observable in system.observables if observable.name == "swing"), None)
    if swing is not None:
        variables.append(Variable("swing", "swing", None, swing.unit, "largest swing angle"))
    variables += [
        Variable(f"margin_{e.quantity}", "margins", k, e.unit, f"least distance of {e.quantity} from its limit")
        for k, e in enumerate(swept.limits)
    ]
    if swept.inputs:
        variables += [Variable(e.name, "inputs", k, e.unit, e.description, True) for k, e in enumerate(quantities)]
    return [*variables, Variable("failure", "failure", None, "", "why the case is not solved; empty where it is")]


def units_of(swept: SweepSettings) -> dict[str, str]:
    """Return the units of all that can vary."""
    return {parameter.name: parameter.unit for parameter in swept.problem.system.parameters.declared} | {DURATION: "s"}


def _coordinates(swept: SweepSettings) -> dict[str, tuple[str, Any, dict[str, str]]]:
    units = units_of(swept)
    coordinates: dict[str, tuple[str, Any, dict[str, str]]] = {
        name: (dimension, values, {"units": units[name]}) for name, (dimension, values) in swept.grid.columns.items()
    }
    for name in (PATH, CASE):
        if name in swept.grid.dimensions:
            coordinates[name] = (name, np.arange(swept.grid.dimensions[name]), {})
    if swept.inputs:
        coordinates[INSTANT] = (INSTANT, np.linspace(0.0, 1.0, swept.instants), {"units": "1"})
    return coordinates


def placed(swept: SweepSettings, variable: Variable, answers: Mapping[str, Any], block: Slices) -> Any:
    """Return the values of a variable for a block, in its shape."""
    values = answers[variable.result]
    values = values if variable.column is None else values[..., variable.column]
    shape = tuple(slice_.stop - slice_.start for slice_ in block)
    return values.reshape(*shape, swept.instants) if variable.over_time else values.reshape(shape)


def the_xarray() -> Any:
    """Return the package xarray; raises `InvalidSetting` if it is missing."""
    with refused_if_missing():
        import xarray  # noqa: PLC0415 - an extra
    return xarray


class Memory:
    """Arrays of the whole sweep.

    Parameters
    ----------
    swept : SweepSettings
        What is swept.
    settings : mapping
        Become attributes of the dataset.
    """

    def __init__(self, swept: SweepSettings, settings: Mapping[str, Any]) -> None:
        self._xarray, self._swept, self._settings = the_xarray(), swept, settings
        self._arrays: dict[str, Any] = {}
        for variable in variables_of(swept):
            shape = (*swept.grid.shape, swept.instants) if variable.over_time else swept.grid.shape
            text = variable.result == "failure"
            self._arrays[variable.name] = np.full(shape, "" if text else np.nan, dtype=object if text else np.float64)

    def has(self, _: int) -> bool:
        """Nothing is there before it is put."""
        return False

    def put(self, _: int, block: Slices, answers: Mapping[str, Any]) -> None:
        """Take the results of a block."""
        for variable in variables_of(self._swept):
            self.take(variable, block, placed(self._swept, variable, answers, block))

    def take(self, variable: Variable, block: Slices, values: Any) -> None:
        """Take the values of one variable for a block, in whatever shape."""
        target = self._arrays[variable.name][block]
        target[...] = values.reshape(target.shape)

    def dataset(self) -> Any:
        """Return the dataset."""
        swept, dimensions = self._swept, tuple(self._swept.grid.dimensions)
        data = {}
        for variable in variables_of(swept):
            values = self._arrays[variable.name]
            held = values.astype(str) if variable.result == "failure" else values
            data[variable.name] = (dimensions + (INSTANT,) * variable.over_time, held, _attributes(variable))
        return self._xarray.Dataset(data, _coordinates(swept), {_SETTINGS: json.dumps(self._settings)})


class Zarr:
    """A store in a folder, written block by block: a block of it is a chunk of every array.

    Parameters
    ----------
    path : Path
        Of the store.
    swept : SweepSettings
        What is swept.
    """

    def __init__(self, path: Path, swept: SweepSettings) -> None:
        self._path, self._swept, self._xarray = path, swept, the_xarray()
        self._group = _zarr().open_group(path, mode="r+")
        self._arrays = {variable.name: self._group[variable.name] for variable in variables_of(swept)}
        self._done = self._group[DONE]
        self._known = np.asarray(self._done[:], dtype=bool)

    @classmethod
    def opened(
        cls, path: Path, swept: SweepSettings, settings: Mapping[str, Any], shape: Sequence[int], resume: bool
    ) -> Zarr:
        """Make a store, or open the one that is to be completed.

        Raises
        ------
        InvalidSetting
            If there is one already that is not to be resumed, or its settings are other ones.
        """
        held = {**settings, "block": list(shape)}
        the_xarray()
        if not path.exists():
            _made(path, swept, held)
            return cls(path, swept)
        require_settings(path, held, lambda: _settings_of(path), resume)
        return cls(path, swept)

    def has(self, number: int) -> bool:
        """Whether a block is complete."""
        return bool(self._known[number])

    def put(self, number: int, block: Slices, answers: Mapping[str, Any]) -> None:
        """Write a block, and then that it is there."""
        with _quiet():
            for variable in variables_of(self._swept):
                if variable.result != "failure" or answers["failure"].any():  # a store has empty sentences by itself
                    self._arrays[variable.name][block] = placed(self._swept, variable, answers, block)
        self._done[number] = 1

    def dataset(self) -> Any:
        """Return the dataset, of which nothing is read before it is used."""
        with _quiet():  # without chunks of Dask, whose import takes seconds
            return self._xarray.open_zarr(self._path, chunks=None)


def require_settings(path: Path, settings: Mapping[str, Any], read: Callable[[], str], resume: bool) -> None:
    """Raise `InvalidSetting` unless what is there already is a store of these settings, and to be resumed."""
    try:
        stored = json.loads(read())
    except (KeyError, ValueError, OSError) as error:
        raise InvalidSetting(f"cannot write {path}: it is there already, and is no store of a sweep") from error
    if not resume:
        raise InvalidSetting(f"{path} is there already: resume it, or choose another place")
    other = sorted(name for name in {*settings, *stored} if settings.get(name) != stored.get(name))
    if other:
        raise InvalidSetting(f"{path} is of another sweep, whose {', '.join(other)} differ; nothing was resumed")


def _made(path: Path, swept: SweepSettings, settings: Mapping[str, Any]) -> None:
    """Make a store without results."""
    zarr, dimensions = _zarr(), tuple(swept.grid.dimensions)
    block = tuple(settings["block"])
    blocks = int(np.prod([-(-n // part) for n, part in zip(swept.grid.shape, block, strict=True)]))
    try:
        with _quiet():
            group = zarr.open_group(path, mode="w-")
            for variable in variables_of(swept):
                over_time = (swept.instants,) if variable.over_time else ()
                text = variable.result == "failure"
                group.create_array(
                    variable.name, shape=(*swept.grid.shape, *over_time), chunks=(*block, *over_time),
                    dtype=str if text else np.float64, fill_value="" if text else np.nan,
                    dimension_names=(*dimensions, *([INSTANT] if variable.over_time else [])),
                    attributes=_attributes(variable),
                )  # fmt: skip
            coordinates = _coordinates(swept)
            for name, (dimension, values, attributes) in coordinates.items():
                group.create_array(name, data=np.asarray(values), dimension_names=(dimension,), attributes=attributes)
            group.create_array(DONE, shape=(blocks,), chunks=(1,), dtype=np.uint8, dimension_names=("block",))
            # xarray takes a column of a table, such as load_mass over `CASE`, for a result unless it is told otherwise.
            group.attrs.update({_SETTINGS: json.dumps(settings), "coordinates": " ".join(coordinates)})
            # What describes the store is complete here and stays: xarray opens it by its name alone, without a warning.
            zarr.consolidate_metadata(group.store)
    except OSError as error:
        raise not_written(path, error) from error


def _settings_of(path: Path) -> str:
    """Return the settings of a store; raises `KeyError` if it lacks them, or the marks of its blocks."""
    group = _zarr().open_group(path, mode="r")
    group[DONE]
    return str(group.attrs[_SETTINGS])


def _attributes(variable: Variable) -> dict[str, str]:
    attributes = {"long_name": variable.described}
    return attributes if variable.result == "failure" else {**attributes, "units": variable.unit}


def _zarr() -> Any:
    with refused_if_missing():
        import zarr  # noqa: PLC0415 - an extra
    return zarr


@contextmanager
def _quiet() -> Iterator[None]:
    """Hold back Zarr's remark that other libraries may not know its texts yet."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
