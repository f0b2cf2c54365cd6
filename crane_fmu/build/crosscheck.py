"""Cross-check files beside an FMU: a run of it, whose inputs and results they hold."""

from __future__ import annotations

from math import floor
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import numpy.typing as npt

import servocore as sc
from crane_fmu.catalogue import CRANE_PLANT, NO_STARTS, ROTARY_CRANE, Starts, at_rest
from crane_fmu.files import put
from crane_fmu.run import input_rows, nothing_left
from servocore.files import cross_check_texts

STEP = 0.01
"""Communication step in s that suits each FMU, and the system of all."""

_DRIVES = ("M_b", "F", "M_w")
_STOP, _SHORT_STOP = 20.0, 2.0  # s; a plant that is pushed goes far


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
    stop = _SHORT_STOP if fmu.stem == CRANE_PLANT.name else _STOP
    if path is not None and path.jet(path.end_time, 4)[1:].any():  # later there is no path
        stop = min(stop, STEP * floor(path.end_time / STEP))
    given = None
    if fmu.stem == ROTARY_CRANE.name:
        given = input_rows(path or sc.scenes.rotary_crane().reference, STEP)
    elif fmu.stem == CRANE_PLANT.name:
        given = _pushes(stop, path, starts)
    with nothing_left():
        found = fmpy.simulate_fmu(str(fmu), stop_time=stop, output_interval=STEP, input=given)
    put(fmu.parent, cross_check_texts(fmu.stem, _columns(given), _columns(found), (0.0, stop, STEP)))


def _columns(rows: npt.NDArray[Any] | None) -> dict[str, npt.NDArray[np.float64]] | None:
    return None if rows is None else {name: rows[name] for name in rows.dtype.names or ()}


def _pushes(stop: float, path: sc.Reference | None, starts: Starts) -> npt.NDArray[Any]:
    """Return inputs that push a plant from rest, or those that go on with the motion in which it starts."""
    t = np.linspace(0.0, stop, round(stop / STEP) + 1)
    push = [50.0 * np.sin(np.pi * t) ** 2, -5.0 * np.sin(np.pi * t) ** 2, np.full_like(t, at_rest(starts)["M_w"])]
    if path is not None and _DRIVES[0] in starts:
        crane = sc.scenes.rotary_crane()
        own = {key: float(value) for key, value in starts.items() if key in crane.parameter_values()}
        push = list(sc.ExactInversion(crane.with_parameters(**own).with_reference(path), native=False)(t).T)
    return np.rec.fromarrays([t, *push], dtype=[(each, np.float64) for each in ("time", *_DRIVES)])
