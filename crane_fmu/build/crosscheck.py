"""Cross-check files beside an FMU, as the FMI project keeps them: ``_in.csv``, ``_ref.csv`` and ``_ref.opt``."""

from __future__ import annotations

from math import floor
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import numpy.typing as npt

import servocore as sc
from crane_fmu.catalogue import NO_STARTS, Starts, at_rest
from crane_fmu.files import put
from crane_fmu.run import input_rows, nothing_left
from servocore.files import csv_text

STEP = 0.01
"""Communication step in s that suits each FMU, and the system of all."""

_DRIVES = ("M_b", "F", "M_w")

STOP = {"RotaryCrane": 20.0, "LoadTrajectory": 20.0, "CranePlant": 2.0}


def cross_check(fmu: Path, path: sc.Reference | None = None, starts: Starts = NO_STARTS) -> None:
    """Run an FMU and write its inputs, its results and the options of the run beside it.

    Parameters
    ----------
    fmu : Path
        One of the FMUs.
    path : Reference, optional
        What the load shall follow in place of the default manoeuvre.
    starts : mapping of str to float or str
        Start values that the FMU has in place of defaults.
    """
    stop = STOP[fmu.stem]
    if path is not None and path.jet(path.end_time, 4)[1:].any():  # later there is no path
        stop = min(stop, STEP * floor(path.end_time / STEP))
    given = _inputs(fmu.stem, stop, path, starts)
    with nothing_left():
        found = fmpy.simulate_fmu(str(fmu), stop_time=stop, output_interval=STEP, input=given)
    settings = {"StartTime": 0.0, "StopTime": stop, "StepSize": STEP, "RelTol": 0.0, "OutputIntervalLength": STEP}
    options = "".join(f"{name},{value}\n" for name, value in settings.items())
    files = {f"{fmu.stem}_ref.csv": _csv(found), f"{fmu.stem}_ref.opt": options}
    if given is not None:
        files[f"{fmu.stem}_in.csv"] = _csv(given)
    put(fmu.parent, files)


def _inputs(name: str, stop: float, path: sc.Reference | None, starts: Starts) -> npt.NDArray[Any] | None:
    """Return inputs as FMPy reads them: a manoeuvre, or those that push from rest or go on with a motion."""
    if name == "RotaryCrane":
        return input_rows(path or sc.scenes.rotary_crane().reference, STEP)
    if name != "CranePlant":
        return None
    t = np.linspace(0.0, stop, round(stop / STEP) + 1)
    push = [50.0 * np.sin(np.pi * t) ** 2, -5.0 * np.sin(np.pi * t) ** 2, np.full_like(t, at_rest(starts)["M_w"])]
    if path is not None and _DRIVES[0] in starts:
        crane = sc.scenes.rotary_crane()
        own = {key: float(value) for key, value in starts.items() if key in crane.parameter_values()}
        push = list(sc.ExactInversion(crane.with_parameters(**own).with_reference(path), native=False)(t).T)
    return np.rec.fromarrays([t, *push], dtype=[(each, np.float64) for each in ("time", *_DRIVES)])


def _csv(rows: npt.NDArray[Any]) -> str:
    names = rows.dtype.names or ()
    return csv_text([f'"{name}"' for name in names], [rows[name] for name in names])
