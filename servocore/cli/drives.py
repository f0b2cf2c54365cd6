"""The command ``servocore drives``: the duty of every motor along a path, and its margins."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import rich.box
import rich.table

from servocore.cli.console import PatientProgress, table_console
from servocore.cli.options import GivenPath, Rows, Subject
from servocore.errors import InvalidSetting
from servocore.model.drives import Drive
from servocore.solution import Solution
from servocore.solvers.solve import solve

EXAMPLES = (
    "rotary_crane --drives drives.toml",
    "overhead_crane --drives drives.toml --from 0 -6 --to 6 -4 --duration 45",
)


def show_drives(subject: Subject, path: GivenPath, rows: Rows) -> None:
    """Print the duty of every drive along a path: peak, effective (rms) value, limit of the data sheet, margin.

    The effective torque counts from the first to the last row, pauses of a cycle included if the path has them. A
    negative margin means that the motor is too small for this motion (exit code 0).
    """
    scene = path.along(subject.chosen(), subject.model)
    if not scene.drives:
        raise InvalidSetting(f"{scene.name} has no drives: name the file of their data with --drives FILE.toml")
    rows.require(scene.reference.duration)
    with PatientProgress("solving"):
        solution = solve(scene, step=rows.step, model=subject.model)
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("drive", "quantity", "value", "at", "limit", "margin"):
        table.add_column(heading, justify="left" if heading in ("drive", "quantity") else "right")
    for name, drive in scene.drives.items():
        for k, row in enumerate(duty(solution, name, drive)):
            table.add_row("" if k else name, *row)
    table_console().print(table)


def duty(solution: Solution, name: str, drive: Drive) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield the rows of a drive: quantity, value, time, limit, margin in per cent of the limit.

    Parameters
    ----------
    solution : Solution
        Of a scene with drives.
    name : str
        Of the input.
    drive : Drive
        Its drive.
    """
    t, rated = solution.t, drive.rated
    corners = drive.corners or ((0.0, math.nan), (math.nan, math.nan))
    limits = {"motor_torque": math.nan, "motor_speed": corners[-1][0], "power": rated.get("rated_power", math.nan)}
    for quantity, limit in {**limits, "current": math.nan}.items():
        if f"{name}.{quantity}" in solution:
            values, unit = np.abs(solution[f"{name}.{quantity}"]), solution.unit(f"{name}.{quantity}")
            yield _row(
                f"{quantity.replace('_', ' ')}, peak", float(values.max()), float(t[values.argmax()]), limit, unit
            )
    effective = float(solution[f"{name}.rms_torque"][-1])
    yield _row("motor torque, rms", effective, math.nan, rated.get("rated_torque", math.nan), "N.m")
    if drive.corners:
        reserve = solution[f"{name}.torque_reserve"]
        k, most = int(reserve.argmin()), max(torque for _, torque in corners)
        share = f"{100.0 * reserve[k] / most:.0f} %"
        yield "torque reserve, least", _shown(float(reserve[k]), "N.m"), f"{t[k]:.4g} s", _shown(0.0, "N.m"), share
    yield _row("energy", float(solution[f"{name}.energy"][-1]), math.nan, math.nan, "J")


def _row(quantity: str, value: float, time: float, limit: float, unit: str) -> tuple[str, str, str, str, str]:
    at = "" if math.isnan(time) else f"{time:.4g} s"
    margin = "" if math.isnan(limit) else f"{100.0 * (1.0 - value / limit):.0f} %"
    return quantity, _shown(value, unit), at, "" if math.isnan(limit) else _shown(limit, unit), margin


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}"
