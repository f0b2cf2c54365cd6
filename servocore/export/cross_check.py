"""Cross-check files beside an FMU, as the FMI project keeps them: ``_in.csv``, ``_ref.csv`` and ``_ref.opt``."""

from __future__ import annotations

import numpy as np

from servocore.export.inverse_model import InverseModel
from servocore.files import csv_text
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array
from servocore.solution import Solution

STEPS = 1000
"""Communication steps of the run."""


def cross_check_files(scene: Scene, model: InverseModel, solution: Solution, stem: str) -> dict[str, str]:
    """Return inputs along a scene's path, what a solution says of it, and the options of a run, by file name.

    The inputs stand at the times that they belong to: a run with `input_time` = start continues them over each step,
    and differs from the reference by that.

    Parameters
    ----------
    scene : Scene
        Whose path it is.
    model : InverseModel
        What was exported of it.
    solution : Solution
        In `STEPS` steps, computed without the FMU.
    stem : str
        What the names of the files begin with.
    """
    path, t = scene.reference, solution.t
    step = float(t[1] - t[0])
    jets = path.jet(t, model.mathematics.orders - 1).reshape(len(t), -1)
    outputs = [variable.name for variable in model.of("output")]
    names = [name for variable in model.of("input") for name in variable.scalar_names]
    begin = model.start_time
    options = {"StartTime": begin, "StopTime": begin + path.duration, "StepSize": step, "RelTol": 0.0}
    options["OutputIntervalLength"] = step
    since = t - path.start_time + begin
    return {
        f"{stem}_in.csv": _csv(names, since, jets),
        f"{stem}_ref.csv": _csv(outputs, since, np.column_stack([solution[name] for name in outputs])),
        f"{stem}_ref.opt": "".join(f"{name},{value!r}\n" for name, value in options.items()),
    }


def _csv(names: list[str], t: Array, columns: Array) -> str:
    return csv_text([f'"{name}"' for name in ("time", *names)], [t, columns])
