"""Cross-check files beside an FMU: what it is given along a scene's path, and what it has to answer."""

from __future__ import annotations

from servocore.export.inverse_model import InverseModel
from servocore.files import cross_check_texts
from servocore.model.scene import Scene
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
    path, t, begin = scene.reference, solution.t, model.start_time
    jets = path.jet(t, model.mathematics.orders - 1).reshape(len(t), -1)
    since = {"time": t - path.start_time + begin}
    names = [name for variable in model.of("input") for name in variable.scalar_names]
    inputs = since | dict(zip(names, jets.T, strict=True))
    results = since | {variable.name: solution[variable.name] for variable in model.of("output")}
    return cross_check_texts(stem, inputs, results, (begin, begin + path.duration, float(t[1] - t[0])))
