"""Results of a sweep as a folder of Parquet files: a file a block, a row a case."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from servocore.errors import refused_if_missing
from servocore.files import not_written
from servocore.planning.sweep_grid import PATH, Slices
from servocore.planning.sweep_settings import SweepSettings
from servocore.planning.sweep_store import Memory, Variable, placed, require_settings, units_of, variables_of

SUFFIX = ".parquet"
"""How the name of a store ends that is such a folder."""

_SETTINGS = "_settings.json"  # readers of such folders pass over names that begin so


class Parquet:
    """A folder of Parquet files, in each of which are the settings and, of every column, the unit.

    Columns are what varies, then the variables; inputs over time are lists.

    Parameters
    ----------
    path : Path
        Of the folder.
    swept : SweepSettings
        What is swept.
    settings : mapping
        Of this sweep.
    shape : sequence of int
        Of the blocks.
    """

    def __init__(self, path: Path, swept: SweepSettings, settings: Mapping[str, Any], shape: Sequence[int]) -> None:
        self._pyarrow, self._path, self._swept, self._settings = _pyarrow(), path, swept, settings
        self._empty = Memory(swept, settings)
        self._blocks = list(swept.grid.blocks(shape))
        self._known = {number for number, _ in self._blocks if self._part(number).exists()}

    @classmethod
    def opened(
        cls, path: Path, swept: SweepSettings, settings: Mapping[str, Any], shape: Sequence[int], resume: bool
    ) -> Parquet:
        """Make a folder, or open the one that is to be completed.

        Raises
        ------
        InvalidSetting
            If there is one already that is not to be resumed, or its settings are other ones.
        """
        held, file = {**settings, "block": list(shape)}, path / _SETTINGS
        table = cls(path, swept, held, shape)
        if path.exists():
            require_settings(path, held, lambda: file.read_text(encoding="utf-8"), resume)
            return table
        try:
            path.mkdir(parents=True)
            file.write_text(json.dumps(held), encoding="utf-8")
        except OSError as error:
            raise not_written(path, error) from error
        return table

    def has(self, number: int) -> bool:
        """Whether a block is complete."""
        return number in self._known

    def put(self, number: int, block: Slices, answers: Mapping[str, Any]) -> None:
        """Write a block beside its place, and then put it there."""
        grid, arrow = self._swept.grid, self._pyarrow
        columns: dict[str, Any] = {PATH: grid.paths(block)} if PATH in grid.dimensions else {}
        columns |= {name: grid.values(name, block) for name in grid.columns}
        for variable in variables_of(self._swept):
            values = placed(self._swept, variable, answers, block).reshape(len(answers["failure"]), -1)
            columns[variable.name] = list(values) if variable.over_time else values[:, 0]
        units = {**units_of(self._swept), **{variable.name: variable.unit for variable in variables_of(self._swept)}}
        fields = [
            arrow.field(name, arrow.array(values).type, metadata={"units": units.get(name, "")})
            for name, values in columns.items()
        ]
        schema = arrow.schema(fields, metadata={"settings": json.dumps(self._settings)})
        part = self._part(number)
        beside = part.with_name(f"_{part.name}")
        self._parquet().write_table(arrow.table(columns, schema=schema), beside)
        beside.replace(part)

    def dataset(self) -> Any:
        """Return all that was written, read into memory."""
        for number, block in self._blocks:
            table = self._parquet().read_table(self._part(number))
            for variable in variables_of(self._swept):
                self._empty.take(variable, block, _values(table, variable))
        return self._empty.dataset()

    def _part(self, number: int) -> Path:
        return self._path / f"part-{number:06d}{SUFFIX}"

    def _parquet(self) -> Any:
        from pyarrow import parquet  # noqa: PLC0415 - an extra

        return parquet


def _values(table: Any, variable: Variable) -> Any:
    values = table.column(variable.name).to_numpy()
    return np.stack(values) if variable.over_time else values


def _pyarrow() -> Any:
    with refused_if_missing():
        import pyarrow  # noqa: PLC0415 - an extra
    return pyarrow
