"""Simulate a plant, an FMU of the user, under feedforward inputs, and compute the tracking error of its load."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import fmpy
import numpy as np

import servocore as sc
from crane_fmu.catalogue import components
from crane_fmu.report.study import LoadRun
from crane_fmu.run import simulated
from servocore.files import csv_text
from servocore.planning.durations import shortest_duration_told

GIVEN, SEEN = ("M_b", "F", "M_w"), ("x", "y", "z")
"""Inputs of the plant, and its outputs: the position of the load."""

STEP = 0.01
"""Largest default communication step in s."""

_OWN = dict(zip(SEEN, components("load.position"), strict=True))  # names in CranePlant.fmu


def sentences(run: LoadRun) -> list[str]:
    """Return the tracking error as sentences.

    Parameters
    ----------
    run : LoadRun
        The simulation of the plant.

    Returns
    -------
    list of str
        One sentence; a second one if the load does not start on the path.
    """
    off, worst = run.error, int(run.error.argmax())
    messages = [
        f"The tracking error of the load is {1e3 * off[worst]:.3g} mm at most, at t = {run.t[worst]:.6g} s,"
        f" and {1e3 * off[-1]:.3g} mm at the end."
    ]
    if off[0] > 1e-3:
        place = ", ".join(f"{coordinate:.6g}" for coordinate in run.prescribed[0])
        text = f"It starts {off[0]:.3g} m off its path: set the plant's start so that the load is at ({place}) m."
        messages.append(text)
    return messages


def table(run: LoadRun) -> str:
    """Return simulated and prescribed positions and tracking errors as the text of a CSV file.

    Parameters
    ----------
    run : LoadRun
        The simulation of the plant.

    Returns
    -------
    str
        A header and a row for each instant, in s and m.
    """
    names = ["time", *(column for name in SEEN for column in (name, f"{name}_wanted")), "distance"]
    both = np.stack([run.driven, run.prescribed], axis=2).reshape(len(run.t), -1)
    return csv_text(names, [run.t, both, run.error])


def drive(
    plant: Path,
    crane: sc.Scene,
    names: Mapping[str, str],
    starts: Mapping[str, float],
    step: float | None = None,
) -> LoadRun:
    """Simulate a plant under the feedforward inputs of exact inversion for a path.

    Parameters
    ----------
    plant : Path
        An FMU with inputs M_b, F, M_w and the position of the load as outputs.
    crane : Scene
        With its path, parameters and limits.
    names : mapping of str to str
        Variables of the plant by M_b, F, M_w, x, y, z; default: the same name, or that in CranePlant.fmu.
    starts : mapping of str to float
        The plant's start values.
    step : float, optional
        Communication step in s; must divide the duration.

    Returns
    -------
    LoadRun
        Prescribed and simulated positions of the load.

    Raises
    ------
    InvalidSetting
        If a name is unknown, or the FMU cannot be read or lacks a variable.
    IntegrationFailed
        If it does not reach the end of the path.
    """
    for name, variable in names.items():
        if name not in (*GIVEN, *SEEN):
            raise sc.InvalidSetting(f"there is no signal {name!r} to map; there are {', '.join((*GIVEN, *SEEN))}")
        if not isinstance(variable, str):
            raise sc.InvalidSetting(f"{name} must be the name of a variable, in quotes, not {variable!r}")
    try:
        described = fmpy.read_model_description(str(plant), validate=False)
    except Exception as error:  # FMPy raises exceptions of many kinds
        reason = getattr(error, "strerror", None) or error  # without the error number
        raise sc.InvalidSetting(f"cannot read {plant} as an FMU: {reason}") from error
    known = {variable.name: variable.causality for variable in described.modelVariables}
    theirs = {name: _found(plant, known, name, names) for name in (*GIVEN, *SEEN)}
    for name in starts:
        if name not in known:
            raise sc.InvalidSetting(f"{plant.name} has no variable {name!r} to set")
    reference = crane.reference
    step = reference.duration / np.ceil(reference.duration / STEP) if step is None else step
    with shortest_duration_told(crane):
        inputs = sc.solve(crane, step=step)
    rows = np.rec.fromarrays(
        [inputs.t, *(inputs[name] for name in GIVEN)],
        dtype=[("time", float), *((theirs[name], float) for name in GIVEN)],
    )
    outputs = [theirs[name] for name in SEEN]
    found = simulated(plant, rows, step, starts, outputs)
    wanted = reference.jet(np.clip(found["time"], reference.start_time, reference.end_time), 0)[:, 0]
    return LoadRun(plant.name, found["time"], wanted, np.stack([found[name] for name in outputs], axis=1))


def _found(plant: Path, known: Mapping[str, str], name: str, names: Mapping[str, str]) -> str:
    """Return the name of a signal in the plant."""
    wanted = ("input",) if name in GIVEN else ("output", "local")
    candidates = [names[name]] if name in names else [name, _OWN.get(name, name)]
    for candidate in candidates:
        if known.get(candidate) in wanted:
            return candidate
    there = ", ".join(each for each, causality in known.items() if causality == wanted[0]) or "none"
    what = f"no {wanted[0]} {candidates[0]!r}" + ("" if name in names else f"; map one with --map {name}=NAME")
    raise sc.InvalidSetting(f"{plant.name} has {what}; its {wanted[0]}s are {there}")
