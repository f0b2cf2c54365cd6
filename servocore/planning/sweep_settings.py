"""Settings of a sweep, checked before it begins."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from servocore.checks.motion_limits import motion_limits
from servocore.errors import InvalidSetting, require_count
from servocore.model.limits import Limit
from servocore.model.scene import Scene, require_scene, within_limits
from servocore.planning.sweep_grid import DURATION, Grid
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.time_scaled import TimeScaled

_LOOKED_AT = 7  # instants, to tell whether a law is the same in another time


@dataclass(frozen=True, eq=False)
class SweepSettings:
    """What a sweep does, settled before it begins.

    Attributes
    ----------
    scene : Scene
        With its limits.
    model : str or None
        Of the scene.
    problem : Problem
        The scene's.
    limits : tuple of Limit
        Limits whose margins are reported.
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
    """Return what is swept; raises what `sweep` says."""
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
        bounded.with_reference(path)  # refuses what is no path of this scene
    paths = paths or (bounded.reference,)  # that of the problem has the time beside it where equations hold it
    return SweepSettings(bounded, model, problem, motion_limits(problem), grid, paths, int(instants), bool(inputs))


def settings_of(swept: SweepSettings) -> dict[str, Any]:
    """Return what makes two sweeps the same, as JSON can hold it."""
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
    return same if np.allclose(same.jet(t, 1), stretched.jet(t, 1)) else stretched  # a ramp of its own time
