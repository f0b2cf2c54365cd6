"""The summary of a run on the error stream, and the columns of its table; shared by the project's command lines."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterator, Sequence
from importlib import metadata

import numpy as np

from servocore.errors import InvalidSetting
from servocore.files import csv_pieces
from servocore.model.limits import run_quantities
from servocore.model.scene import Scene
from servocore.numerics.units import behind
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.solution import Solution

_REST = 1e-6  # of the largest speed, acceleration, ...: less is round-off of a path at rest
_MANY = 100_000  # rows; an error estimate solves again, which takes gigabytes for a million
_RATES = {0: "speed", 1: "acceleration", 2: "jerk"}

COLUMNS = {"rotary_crane": ("M_b", "F", "M_w", "phi", "s", "l", "x", "y", "z", "tension")}
"""Columns after the time of scenes whose tables do not have all inputs, observables and outputs."""


def chosen_columns(wanted: str | None, scene: Scene, model: str | None, more: bool = False) -> list[str]:
    """Return the columns of a table after the time, from names separated by commas.

    Without names they are those of the scene, with `more` all observables as well. `InvalidSetting` is raised if a name
    is unknown or given twice.
    """
    system = scene.model(model)
    reported = [*system.inputs, *system.observables, *system.outputs]
    own = list(dict.fromkeys(quantity.name for quantity in [*reported, *run_quantities(reported)]))
    if wanted is None:
        of_drives = [name for name in own if name.startswith(tuple(f"{each}." for each in scene.drives))]
        first = [*COLUMNS[scene.name], *of_drives] if scene.name in COLUMNS else own
        return list(dict.fromkeys([*first, *own])) if more else first
    known = list(dict.fromkeys([*own, *system.coordinates.names]))
    names = [name.strip() for name in wanted.split(",")]
    for name in names:
        if name not in known:
            raise InvalidSetting(f"--columns: there is no {name!r}; there are {', '.join(known)}")
        if names.count(name) > 1:
            raise InvalidSetting(f"--columns names {name} twice: write it once, as in --columns {','.join(known[:2])}")
    return names


def table_pieces(solution: Solution, names: Sequence[str]) -> Iterator[str]:
    """Return time and columns of a solution as the text of a CSV file, piece by piece."""
    return csv_pieces(["time", *names], [solution.t, *[solution[name] for name in names]])


def summary(solution: Solution) -> list[str]:
    """Return the summary of a run, a line each: peaks, swing, rest at the ends, fit, numerical error of the inputs."""
    problem: Problem = solution.origin
    system, path = problem.system, problem.reference
    lines = [f"{solution.route}: {len(solution.t)} rows, {path.duration:.6g} s"]
    digits = 6 + max(0, round(math.log10(np.abs(solution.t).max() / path.duration)))  # of a path that starts late
    for name in [quantity.name for quantity in system.inputs] + (["swing"] if "swing" in solution else []):
        k = int(np.abs(solution[name]).argmax())
        value, unit = float(solution[name][k]), solution.unit(name)
        shown = f"{math.degrees(value):.4g} deg" if unit == "rad" else f"{value:.6g}{behind(unit)}"
        lines.append(f"  {name}: peak {shown} at t = {solution.t[k]:.{digits}g} s")
    for name in solution.names:
        gaps = np.flatnonzero(np.isnan(solution[name]))
        if gaps.size:
            first = f"first at t = {solution.t[gaps[0]]:.6g} s"
            lines.append(f"  {name}: undefined in {len(gaps)} of {len(solution.t)} rows, {first}")
    units = [quantity.unit for quantity in system.outputs]
    lines.append(f"  ends: {_rest(path, problem.array.reference_order, units)}")
    if solution.fit_error is not None:
        lines.append(f"  fit: the path is at most {solution.fit_error:.3g} m from the samples")
    if len(solution.t) > _MANY:
        return [*lines, f"  inputs: their error is not estimated for more than {_MANY} rows"]
    error = solution.error
    if error.largest is not None:
        lines.append(
            f"  inputs: numerical error at most {error.largest:.1e} of their peaks, by {error.basis.rstrip(',')} (data,"
            " path fitting and unmodelled effects not included)"
        )
    fitting = solution.fit_effect
    if fitting is not None and fitting.largest is not None:
        lines.append(f"  inputs: from path fitting about {fitting.largest:.1e} of their peaks, by {fitting.basis}")
    return lines


def details(solution: Solution, seconds: Sequence[float]) -> list[str]:
    """Return the lines of --verbose: counts, violations, times, versions."""
    counts = solution.statistics
    versions = [f"{name} {metadata.version(name)}" for name in ("servocore", "casadi", "numpy")]
    return [
        f"  run: {counts.steps} steps, {counts.newton_iterations} Newton iterations, {counts.factorizations}"
        f" factorizations; worst residual {counts.worst_residual:.1e}",
        f"  residuals: servo constraints {counts.servo_violation:.1e}, geometric constraints"
        f" {counts.constraint_violation:.1e}",
        *([f"  branch: {counts.branch}"] if counts.branch else []),
        f"  time: {seconds[0]:.3g} s of processor time, {seconds[1]:.3g} s of wall time",
        f"  versions: {', '.join(versions)}, Python {platform.python_version()}, {platform.system()}",
    ]


def _rest(path: Reference, order: int, units: Sequence[str]) -> str:
    """Return at which ends a path rests, up to a derivative, and the speed or higher derivative at the others."""
    order = min(order, path.max_order)
    jets = np.linalg.norm(path.jet(np.linspace(path.start_time, path.end_time, 101), order)[:, 1:], axis=-1)
    moving = []
    for end, jet in (("start", jets[0]), ("end", jets[-1])):
        found = [k for k in range(order) if jet[k] > _REST * jets[:, k].max()]
        if found:
            k = found[0]
            unit = f"{units[0] if len(set(units)) == 1 else '(unit)'}/s{f'^{k + 1}' if k else ''}"
            moving.append(f"at the {end} its {_RATES.get(k, f'derivative {k + 1}')} is {jet[k]:.3g} {unit}")
    if not moving:
        return "at rest at start and end"
    return (
        f"not at rest: {' and '.join(moving)}, so that the inputs jump there; add rows at rest at both ends of the"
        " file, or use --waypoints"
    )
