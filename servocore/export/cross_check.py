"""Cross-check files beside an FMU: its inputs along a scene's path, and its expected results."""

from __future__ import annotations

from servocore.export.native_model import NativeModel
from servocore.export.variables import listed
from servocore.files import cross_check_texts
from servocore.model.scene import Scene
from servocore.solution import Solution

STEPS = 1000
"""Communication steps of the run."""


def cross_check_files(scene: Scene, model: NativeModel, solution: Solution, stem: str, fmi: int) -> dict[str, str]:
    """Return inputs along a scene's path, the results of a solution, and the options of a run, by file name.

    Inputs have the times of their instants: a run with `input_time` = start extrapolates them over each step, and
    differs from the reference by that.

    Parameters
    ----------
    scene : Scene
        The scene of the path.
    model : NativeModel
        Its exported model.
    solution : Solution
        The reference in `STEPS` steps, computed without the FMU.
    stem : str
        Prefix of the names of the files.
    fmi : int
        Version of FMI, which determines the names of variables: in the third a vector is one of them.
    """
    path, t, begin = scene.reference, solution.t, model.start_time
    jets = path.jet(t, model.own["orders"] - 1).reshape(len(t), -1)
    since = {"time": t - path.start_time + begin}
    inputs = since | {each.name: jets[:, each.places] for each in listed(model.of("input"), fmi)}
    results = since | {variable.name: solution[variable.name] for variable in model.of("output")}
    return cross_check_texts(stem, inputs, results, (begin, begin + path.duration, float(t[1] - t[0])))
