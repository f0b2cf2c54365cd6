"""The command ``servocore drives``: the duty of every motor along a path, and its margins."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from servocore.cli.console import PatientProgress, table_console
from servocore.cli.options import GivenPath, Rows, Subject
from servocore.effects.report import aligned
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
    head = ("drive", "quantity", "value", "at", "limit", "margin")
    rows_ = [(name, *row) for name, drive in scene.drives.items() for row in duty(solution, name, drive)]
    table_console().print(aligned([head, *rows_]), markup=False, highlight=False, soft_wrap=True)


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
    speed, most = (max(column) for column in zip(*drive.corners, strict=True)) if drive.corners else (None, 1.0)
    limits = {"motor_torque": None, "motor_speed": speed, "power": drive.rated_power, "current": None}
    for kind, limit in {**limits, "rms_torque": drive.rated_torque, "energy": None, "torque_reserve": 0.0}.items():
        if (full := f"{name}.{kind}") not in solution:
            continue
        values, unit, text, k = solution[full], solution.unit(full), kind.replace("_", " "), -1
        if kind == "torque_reserve":
            k, text = int(values.argmin()), f"{text}, least"
        elif kind in limits:
            k, text, values = int(np.abs(values).argmax()), f"{text}, peak", np.abs(values)
        left = values[k] / most if kind == "torque_reserve" else 1.0 - values[k] / float(limit or np.inf)
        bound = ("", "") if limit is None else (f"{limit:.4g} {unit}", f"{100.0 * left:.0f} %")
        yield text, f"{values[k]:.4g} {unit}", "" if k < 0 else f"{solution.t[k]:.4g} s", *bound
