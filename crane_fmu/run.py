"""Run FMUs in a simulation tool, FMPy, and check that they reach the end."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fmpy
import numpy as np
import numpy.typing as npt
from fmpy.ssp.simulation import simulate_ssp
from fmpy.validation import validate_fmu

import servocore as sc

Array = npt.NDArray[np.float64]

_CHECK_STEP, _CHECK_STOP = 0.1, 0.5  # s


def run_fmu(fmu: Path, reference: sc.Reference, step: float, **start_values: float | str) -> dict[str, Array]:
    """Move the crane of an FMU along a path.

    Parameters
    ----------
    fmu : Path
        The FMU's file.
    reference : Reference
        Path of the load, at least four times differentiable.
    step : float
        Communication step in s; must divide the duration.
    **start_values : float or str
        Parameters of the FMU that differ from their defaults.

    Returns
    -------
    dict of str to ndarray
        The outputs by name, and ``time``, at the start of the path, one step later, ..., its end.

    Raises
    ------
    IntegrationFailed
        If the FMU does not reach the end of the path, with the message of the FMU.
    """
    return simulated(fmu, input_rows(reference, step), step, numbered(fmu, start_values))


def simulated(
    fmu: Path,
    rows: npt.NDArray[np.void],
    step: float,
    start_values: Mapping[str, float | int],
    outputs: Sequence[str] | None = None,
) -> dict[str, Array]:
    """Run an FMU under inputs from their first instant to their last.

    Parameters
    ----------
    fmu : Path
        The file of any FMU.
    rows : structured ndarray, shape (n,)
        Inputs by the names of the variables, ``time`` first; with times alone nothing is connected.
    step : float
        Communication step in s; must divide the duration.
    start_values : mapping of str to float or int
        Values of variables that differ from their defaults.
    outputs : sequence of str, optional
        Recorded outputs; all by default.

    Returns
    -------
    dict of str to ndarray
        The recorded outputs by name, and ``time``.

    Raises
    ------
    IntegrationFailed
        If the FMU does not reach the end, with the message of the FMU.
    """
    begin, end, messages = float(rows["time"][0]), float(rows["time"][-1]), list[str]()
    given = rows if len(rows.dtype.fields or ()) > 1 else None  # FMPy prints a warning of each input without a column

    def listen(*arguments: Any) -> None:
        _component, _instance, status, _category, message = arguments
        if status > 0:  # not OK
            messages.append(message.decode(errors="replace"))

    try:
        with nothing_left():
            found = fmpy.simulate_fmu(
                str(fmu), start_time=begin, stop_time=end, output_interval=step, step_size=step, input=given,
                output=outputs, start_values=dict(start_values), validate=False, debug_logging=True, logger=listen,
            )  # fmt: skip
    except Exception as error:  # a user's FMU may fail in any way
        raise sc.IntegrationFailed(f"{fmu.name} stopped: {messages[-1] if messages else error}") from error
    last, count = float(found["time"][-1]) if len(found) else begin, round((end - begin) / step) + 1
    if last < end - 0.5 * step:  # FMPy ends silently at a discarded step
        raise sc.IntegrationFailed(
            f"{fmu.name} stopped at t = {last:.6g} s of {end:.6g} s after {len(found)} of {count} rows:"
            f" {messages[-1] if messages else 'it did not say why'}"
        )
    return {name: found[name] for name in found.dtype.names}


def check(fmu: str, runs: str) -> None:
    """Exit with a sentence unless an FMU is valid and takes a few steps of each run with nothing connected.

    Parameters
    ----------
    fmu : str
        The FMU's file.
    runs : str
        Start values of each run, as JSON.
    """
    if problems := validate_fmu(fmu):
        sys.exit("; ".join(problems))
    rows = np.array([(0.0,), (_CHECK_STOP,)], dtype=[("time", np.float64)])
    for settings in json.loads(runs):
        try:
            simulated(Path(fmu), rows, _CHECK_STEP, numbered(Path(fmu), settings))
        except sc.IntegrationFailed as error:
            sys.exit(f"{', '.join(map(str, settings.values())) or 'defaults'}: {error}")


def numbered(fmu: Path, values: Mapping[str, float | str]) -> dict[str, float | int]:
    """Return start values with the names of enumerations' items replaced by their numbers.

    Parameters
    ----------
    fmu : Path
        The FMU that declares the enumerations.
    values : mapping of str to float or str
        Start values in the units of its variables, choices by the name of their item.

    Returns
    -------
    dict of str to float or int
        The same values as numbers.

    Raises
    ------
    InvalidSetting
        If a choice has no such item.
    """
    items = {
        variable.name: {item.name: int(item.value) for item in variable.declaredType.items}
        for variable in fmpy.read_model_description(str(fmu), validate=False).modelVariables
        if variable.type == "Enumeration"
    }
    found: dict[str, float | int] = {}
    for name, value in values.items():
        if isinstance(value, str) and value not in items.get(name, {}):
            raise sc.InvalidSetting(f"{name} = {value!r} is unknown; it may be {', '.join(items.get(name, {}))}")
        found[name] = items[name][value] if isinstance(value, str) else value
    return found


def run_ssp(
    system: Path, duration: float, step: float, parameters: Mapping[str, float] | None = None
) -> dict[str, Array]:
    """Run connected FMUs with the master that comes with FMPy.

    Parameters
    ----------
    system : Path
        The file of the system.
    duration, step : float
        Time to simulate and communication step in s.
    parameters : mapping of str to float, optional
        Values by ``component.name``.

    Returns
    -------
    dict of str to ndarray
        Values of all connectors as ``component.name``, and ``time``, the end of each step.

    Raises
    ------
    IntegrationFailed
        If an FMU refuses a step; its message is not available, since that master has no logger.
    """
    values = [SimpleNamespace(name=name, value=value) for name, value in (parameters or {}).items()]
    try:
        with nothing_left():
            rows = simulate_ssp(
                str(system), stop_time=duration, step_size=step, parameter_set=SimpleNamespace(parameters=values)
            )
    except fmpy.fmi1.FMICallException as error:
        raise sc.IntegrationFailed(f"{system.name} stopped: {error}") from error
    # The master writes the time at which a step begins beside the values at its end.
    return {name: rows[name] for name in rows.dtype.names} | {"time": rows["time"] + step}


@contextmanager
def nothing_left() -> Iterator[None]:
    """Remove the unpacked folders of FMUs that run inside, and the modules imported from there.

    FMPy deletes those folders after successful runs only. In a Python process our FMUs import modules from their
    folders: the next FMU of the same name would use those that are left, also while this process builds one.

    Yields
    ------
    None
        While FMUs may be run.
    """
    before, search_path, scratch = set(sys.modules), list(sys.path), tempfile.tempdir
    try:
        with tempfile.TemporaryDirectory(prefix="crane_fmu_", ignore_cleanup_errors=True) as folder:
            tempfile.tempdir = folder
            yield
    finally:
        sys.path[:], tempfile.tempdir = search_path, scratch
        for name in set(sys.modules) - before:
            file = getattr(sys.modules[name], "__file__", None)
            if file is not None and not Path(file).exists():
                del sys.modules[name]


def input_rows(reference: sc.Reference, step: float) -> npt.NDArray[np.void]:
    """Return the path and its derivatives on a grid as FMPy reads inputs: one column a variable.

    Measured values are zero, which means that there is no feedback.

    Parameters
    ----------
    reference : Reference
        The path of the load.
    step : float
        Time between rows in s.

    Returns
    -------
    structured ndarray, shape (n,)
        Columns by the names of the variables, in SI units, ``time`` first.
    """
    from crane_fmu.catalogue import FEEDBACK_INPUTS, ORDERS, PATH_INPUTS  # noqa: PLC0415 - the check needs no scenes

    t = np.linspace(reference.start_time, reference.end_time, round(reference.duration / step) + 1)
    path = reference.jet(t, len(ORDERS) - 1).reshape(len(t), -1).T
    nothing = np.zeros((len(FEEDBACK_INPUTS), len(t)))
    names = "time", *PATH_INPUTS, *FEEDBACK_INPUTS
    return np.rec.fromarrays([t, *path, *nothing], dtype=[(name, np.float64) for name in names])
