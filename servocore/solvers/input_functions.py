"""Inputs that are given to `simulate`, as a function of time that answers within their time only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from servocore.checks.findings import ROUND_OFF
from servocore.errors import IntegrationFailed, InvalidSetting, described
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.references.base import numbers_of
from servocore.solution import Solution

Inputs = Callable[[float], Array]
"""Time in s -> inputs u, shape (m,)."""


def rising_times(t: Any, what: str = "the times at which to report") -> Array:
    """Return times (N,) as an array; `what` names them in messages.

    Raises
    ------
    InvalidSetting
        If there are none, or they are no finite numbers in rising order.
    """
    times = np.atleast_1d(numbers_of(t, what, InvalidSetting))
    if times.ndim != 1 or not len(times) or not np.isfinite(times).all():
        raise InvalidSetting(
            f"{what} must be one row of finite numbers in s, not an array of shape {times.shape}"
            + ("" if np.isfinite(times).all() else f" that holds {times[~np.isfinite(times)][0]}")
        )
    falls = np.flatnonzero(np.diff(times) < 0.0)
    if len(falls):
        k = int(falls[0])
        raise InvalidSetting(f"{what} must rise, but {times[k + 1]:g} s follows {times[k]:g} s")
    return times


@dataclass(frozen=True, eq=False)
class GivenInputs:
    """Inputs as `simulate` evaluates them: at a time, shape (m,), and at times (N,), shape (N, m)."""

    at: Callable[[float], Array]
    many: Callable[[Array], Array]


def interpolated(solution: Solution, system: MechanicalSystem, t: Array) -> GivenInputs:
    """Return the inputs of a solution as a function of time: a cubic spline through its samples.

    A time may lie outside theirs by round-off.

    Parameters
    ----------
    solution : Solution
        With the inputs of the system by name.
    system : MechanicalSystem
        The system that they drive.
    t : ndarray, shape (N,)
        Times that they are to cover, in rising order.

    Raises
    ------
    InvalidSetting
        If an input is missing or not finite, or the times leave those of the solution.
    """
    import scipy.interpolate  # noqa: PLC0415 - kept out of the run time of an FMU

    names = [quantity.name for quantity in system.inputs]
    missing = [name for name in names if name not in solution]
    if missing:
        raise InvalidSetting(
            f"the solution lacks the inputs {', '.join(missing)} of {system.name}; it has {', '.join(solution.names)}"
        )
    known = rising_times(solution.t, "the times of the inputs")
    if (np.diff(known) <= 0.0).any():
        raise InvalidSetting(f"the inputs are given twice at t = {known[int((np.diff(known) <= 0.0).argmax())]:g} s")
    first, last = float(known[0]), float(known[-1])
    # Times that were written to a file and read again may differ in the last digit.
    slack = ROUND_OFF * (last - first)
    if t[0] < first - slack or t[-1] > last + slack:
        raise InvalidSetting(
            f"the inputs are known from t = {first:g} s to {last:g} s, the simulation is to go from {t[0]:g} s to"
            f" {t[-1]:g} s: outside their time they are unknown"
        )
    table = np.column_stack([np.empty((len(solution.t), 0)), *(solution[name] for name in names)])
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        k, j = bad[0]
        raise InvalidSetting(f"the input {names[j]} of the solution is {table[k, j]} at t = {solution.t[k]:g} s")
    if len(known) < 2:
        return GivenInputs(lambda _: table[0], lambda t: np.tile(table[0], (len(t), 1)))
    curve = scipy.interpolate.make_interp_spline(known, table, k=min(3, len(known) - 1))
    return GivenInputs(lambda time: curve(min(max(time, first), last)), lambda t: curve(np.clip(t, first, last)))


def checked(inputs: Callable[[float], Any], system: MechanicalSystem) -> GivenInputs:
    """Return a function of time whose values are checked: as many finite numbers as the system has inputs."""
    names = [quantity.name for quantity in system.inputs]

    def at(time: float) -> Array:
        answer = inputs(time)
        try:
            values = np.asarray(() if answer is None else answer, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError):
            raise InvalidSetting(f"the inputs at t = {time:.6g} s must be numbers, not {described(answer)}") from None
        if len(values) != len(names):
            raise InvalidSetting(
                f"the function of time returns {len(values)} inputs at t = {time:.6g} s, {system.name} has"
                f" {len(names)}: {', '.join(names)}"
            )
        if not np.isfinite(values).all():
            lost = int(np.flatnonzero(~np.isfinite(values))[0])
            raise IntegrationFailed(
                f"{system.name}: the forward simulation stopped at t = {time:.6g} s: the input {names[lost]} is"
                f" {values[lost]}"
            )
        return values

    return GivenInputs(at, lambda t: np.array([at(time) for time in t.tolist()]).reshape(len(t), -1))
