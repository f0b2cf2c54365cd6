"""Cases and settings of a sweep, checked before it begins.

Cases are values along dimensions, their products in blocks, or rows of a table.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from typing import Any

import numpy as np

from servocore.errors import InvalidSetting, require_count
from servocore.model.limits import Limit
from servocore.model.scene import Scene, require_scene, within_limits
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.timed_path import TimeScaled

CASE = "case"
"""The dimension of cases that are rows of a table."""

PATH = "path"
"""The dimension of paths."""

DURATION = "duration"
"""Name of the dimension along which the duration of a path varies."""

Slices = tuple[slice, ...]


@dataclass(frozen=True, eq=False)
class Grid:
    """Cases, each a value of everything that varies.

    Attributes
    ----------
    dimensions : mapping of str to int
        Lengths by name.
    columns : mapping of str to (str, ndarray)
        Varied quantities: the dimension of each, and its values.
    """

    dimensions: Mapping[str, int]
    columns: Mapping[str, tuple[str, Array]]

    @classmethod
    def of(cls, varied: Any, paths: int) -> Grid:
        """Return the product of arrays by name, or the rows of a table (a data frame, or a sequence of mappings).

        Raises
        ------
        InvalidSetting
            If nothing varies, values are not finite numbers, or rows of a table differ in their names.
        """
        table = _table(varied)
        columns = {name: _numbers(name, values) for name, values in (table or varied or {}).items()}
        along = {name: name if table is None else CASE for name in columns}
        dimensions = {PATH: paths} if paths else {}
        dimensions |= {along[name]: len(values) for name, values in columns.items()}
        if not dimensions:
            raise InvalidSetting("nothing varies: give parameters, durations or references")
        return cls(dimensions, {name: (along[name], values) for name, values in columns.items()})

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the dimensions."""
        return tuple(self.dimensions.values())

    @property
    def size(self) -> int:
        """Number of cases."""
        return prod(self.shape)

    def block(self, most: int) -> tuple[int, ...]:
        """Return the shape of blocks of at most so many cases: whole dimensions from the last one on, as they fit."""
        sizes: list[int] = []
        left = max(most, 1)
        for length in reversed(self.shape):
            sizes.insert(0, max(1, min(length, left)))
            left //= length
        return tuple(sizes)

    def blocks(self, shape: Sequence[int]) -> Iterator[tuple[int, Slices]]:
        """Yield number and place of all blocks of a shape."""
        starts = product(*(range(0, length, part) for length, part in zip(self.shape, shape, strict=True)))
        for k, start in enumerate(starts):
            yield k, tuple(slice(a, min(a + part, n)) for a, part, n in zip(start, shape, self.shape, strict=True))


def drawn(ranges: Mapping[str, tuple[float, float]], count: int, seed: int) -> list[dict[str, float]]:
    """Return rows drawn evenly from ranges by a Latin hypercube, the same for the same seed."""
    draw = np.random.default_rng(seed)
    columns = {
        name: low + (high - low) * (draw.permutation(count) + draw.random(count)) / count
        for name, (low, high) in ranges.items()
    }
    return [{name: float(values[k]) for name, values in columns.items()} for k in range(count)]


def _table(varied: Any) -> dict[str, Any] | None:
    """Return the columns of a table; None if it is none."""
    if hasattr(varied, "columns") and hasattr(varied, "to_dict"):  # a data frame, without importing pandas
        return {str(name): varied[name].to_numpy() for name in varied.columns}
    if isinstance(varied, Mapping) or varied is None:
        return None
    rows = list(varied) if isinstance(varied, Iterable) else []
    if not rows or not all(isinstance(row, Mapping) and set(row) == set(rows[0]) for row in rows):
        raise InvalidSetting("a table of cases is a data frame, or a list of mappings that all have the same names")
    return {name: [row[name] for row in rows] for name in rows[0]}


def _numbers(name: str, values: Any) -> Array:
    try:
        numbers = np.atleast_1d(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if numbers.ndim != 1 or not numbers.size or not np.isfinite(numbers).all():
        raise InvalidSetting(f"the values of {name} in a sweep must be a row of finite numbers")
    return numbers


_LOOKED_AT = 7  # instants, to decide whether a law is the same in another time


@dataclass(frozen=True, eq=False)
class SweepSettings:
    """The settings of a sweep.

    Attributes
    ----------
    scene : Scene
        With its limits.
    model : str or None
        Of the scene.
    problem : Problem
        The scene's.
    limits : tuple of Limit
        Limits with their margins reported.
    grid : Grid
        The cases.
    references : tuple of Reference
        The paths.
    instants : int
        How many instants of a case are evaluated.
    inputs : bool
        Whether the inputs themselves are kept.
    """

    scene: Scene
    model: str | None
    problem: Problem
    limits: tuple[Limit, ...]
    grid: Grid
    references: tuple[Reference, ...]
    instants: int
    inputs: bool


def checked_settings(
    scene: Scene, parameters: Any, references: Any, limits: Any, instants: int, inputs: bool, model: str | None
) -> SweepSettings:
    """Return the cases of a sweep; raises as `sweep`."""
    require_scene(scene, "sweep")
    require_count(instants, 2, "instants", InvalidSetting)
    if isinstance(references, Reference) or not isinstance(references, Iterable | None):
        raise InvalidSetting("references must be a list of paths, one or more")
    paths = tuple(references or ())
    bounded = within_limits(scene, limits)
    problem = Problem.of(bounded.with_reference(paths[0]) if paths else bounded, model)
    grid = Grid.of(parameters, len(paths))
    declared = {parameter.name: parameter for parameter in problem.system.parameters.declared}
    for name, (_, values) in grid.columns.items():
        if name == DURATION:
            if not (values > 0.0).all():
                raise InvalidSetting(f"durations must be positive, not {values.min():g} s")
        elif name not in declared:
            raise InvalidSetting(
                f"{scene.name} has no parameter {name}; there are {', '.join(declared)}, and {DURATION}"
            )
        else:
            declared[name].check(float(values.min()))
            declared[name].check(float(values.max()))
    for path in paths:
        bounded.with_reference(path)  # refuses a path that does not fit the scene
    paths = paths or (bounded.reference,)  # that of the problem has the time beside it where equations hold it
    watched = tuple(limit for limit in problem.limits if not limit.of_path)
    return SweepSettings(bounded, model, problem, watched, grid, paths, int(instants), bool(inputs))


def settings_of(swept: SweepSettings) -> dict[str, Any]:
    """Return the identity of a sweep in terms of JSON: equal settings, equal identity."""
    problem, grid = swept.problem, swept.grid
    sampled = [
        reference.jet(np.linspace(reference.start_time, reference.end_time, 17), 2).ravel().tolist()
        for reference in swept.references
    ]
    return {
        "scene": problem.name,
        "model": problem.system.name,
        "parameters": dict(zip(problem.system.parameters.names, problem.p.tolist(), strict=True)),
        "limits": {limit.quantity: [limit.bound, limit.upper] for limit in swept.limits},
        "varied": {name: [dimension, values.tolist()] for name, (dimension, values) in grid.columns.items()},
        "dimensions": dict(grid.dimensions),
        "paths": sampled,
        "quantities": [quantity.name for quantity in problem.system.inputs],
        "instants": swept.instants,
        "inputs": swept.inputs,
    }


def in_time(path: Reference, duration: float) -> Reference:
    """Return the same path with the same law in another time."""
    stretched = TimeScaled.to(path, duration)
    if path.formula is None:
        return stretched
    same: Reference = replace(path, end_time=stretched.end_time)
    t = np.linspace(same.start_time, same.end_time, _LOOKED_AT)
    return same if np.allclose(same.jet(t, 1), stretched.jet(t, 1)) else stretched  # a ramp with a separate time
