"""The command ``servocore drives``: the duty of every motor along a path, and its margins."""

from __future__ import annotations

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
    speeds, torques = zip(*drive.corners, strict=True) if drive.corners else ((None,), ())
    shown = [
        ("motor torque, peak", "motor_torque", None),
        ("motor speed, peak", "motor_speed", speeds[-1]),
        ("power, peak", "power", drive.rated_power),
        ("current, peak", "current", None),
        ("motor torque, rms", "rms_torque", drive.rated_torque),
        ("torque reserve, least", "torque_reserve", 0.0),
        ("energy", "energy", None),
    ]
    for text, quantity, limit in shown:
        if (full := f"{name}.{quantity}") not in solution:
            continue
        values, unit = solution[full], solution.unit(full)
        at = int(values.argmin()) if quantity == "torque_reserve" else int(np.abs(values).argmax())
        if whole := quantity in ("rms_torque", "energy"):  # of the run, at its end
            at = -1
        value = float(values[at] if whole or limit == 0.0 else abs(values[at]))
        margin = value / max(torques) if limit == 0.0 else 1.0 - value / float(limit or np.inf)
        yield (
            text, f"{value:.4g} {unit}", "" if whole else f"{solution.t[at]:.4g} s",
            "" if limit is None else f"{limit:.4g} {unit}", "" if limit is None else f"{100.0 * margin:.0f} %",
        )  # fmt: skip
