"""Feedforward: from a load path and the crane's parameters to its inputs as a table.

What the command line calls, in pieces that are of use without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import servocore as sc
from crane_fmu.catalogue import FORMULATIONS, METHODS, MODELS, PROFILES, chosen
from crane_fmu.slave.straight_lines import straight_line
from servocore.files import csv_pieces
from servocore.planning.durations import shortest_duration_told

COLUMNS = ("M_b", "F", "M_w", "phi", "s", "l", "x", "y", "z", "tension")
"""Columns of the table after `time`: inputs, crane, load, rope tension, in SI units."""

MOST_ROWS = 1e7
"""A table with more rows is taken for a mistake: it would fill the memory first."""

LONGEST_DURATION = 1e9
"""In s; beyond it the derivatives of a path vanish in rounding."""


def line(
    start: Sequence[float], end: Sequence[float], duration: float, profile: str | None = None, ramp: float | None = None
) -> sc.Reference:
    """Return a straight line from rest to rest.

    Parameters
    ----------
    start, end : sequence of float
        End points (x, y, z) in m.
    duration : float
        Time of the motion in s.
    profile : str, optional
        One of `PROFILES` of the catalogue; the first unless it is given.
    ramp : float, optional
        Time to accelerate in s, for the profile three-phase only.

    Returns
    -------
    Reference
        The path, from zero to `duration`.

    Raises
    ------
    InvalidReference, InvalidSetting
        If there is no such line.
    """
    if duration > LONGEST_DURATION:
        raise sc.InvalidReference(
            f"the duration of {duration:g} s is longer than {LONGEST_DURATION:g} s: nothing would move"
        )
    name = next(iter(PROFILES)) if profile is None else profile
    chosen(PROFILES, name, "profile")
    return straight_line(start, end, duration, name, ramp)


@dataclass(frozen=True)
class Route:
    """How the inputs are computed: names of the catalogue, and the step or a tolerance.

    Attributes
    ----------
    model, formulation, method : str
        Names.
    step : float or None
        Constant step in s; without it, the duration of the path is divided by 200.
    rtol, atol : float or None
        Error control in place of a step: `servocore.Adaptive`. One of them is enough.
    output_step : float or None
        With error control: time between rows in s; without it, the duration of the path is divided by 200.
    """

    model: str = MODELS[0]
    formulation: str = next(iter(FORMULATIONS))
    method: str = next(iter(METHODS))
    step: float | None = None
    rtol: float | None = None
    atol: float | None = None
    output_step: float | None = None

    def accuracy(self) -> float | sc.Adaptive | None:
        """Return what `servocore.solve` takes as its step.

        Returns
        -------
        float, Adaptive or None
            A step in s, tolerances, or nothing where neither is given.

        Raises
        ------
        InvalidSetting
            If the options contradict each other.
        """
        if self.rtol is None and self.atol is None:
            if self.output_step is not None:
                raise sc.InvalidSetting("--output-step belongs to --rtol or --atol; without them every step is a row")
            return self.step
        if self.step is not None:
            raise sc.InvalidSetting("accuracy is given either by --step or by --rtol and --atol, not by both")
        return sc.Adaptive(self.rtol or 0.0, self.atol or 0.0)


def feedforward(
    path: Callable[[], sc.Reference],
    parameters: Mapping[str, float],
    route: Route,
    progress: Callable[[int, int], None] | None = None,
    limits: Mapping[str, Any] | None = None,
) -> sc.Solution:
    """Compute the inputs that move the load of the rotary crane along a path.

    Parameters
    ----------
    path : callable
        Makes the path on which the load shall go, once all names are known to be right.
    parameters : mapping of str to float
        Parameters of the crane that differ from the defaults.
    route : Route
        Model, formulation, method and step.
    progress : callable, optional
        Called with (steps done, steps in all).
    limits : mapping, optional
        By name of an input, an observable or a rate, as `servocore.Scene.with_limits` takes them.

    Returns
    -------
    Solution
        With the trajectories `COLUMNS` at the start of the path, one step later, ..., its end.

    Raises
    ------
    ServocoreError
        If a name, the path, a parameter, a limit or the step cannot be used, the motion breaks a limit, or a step is
        not solved. Where a limit is broken, the sentence has the shortest duration at which the same law keeps all.
    """
    scene = sc.scenes.rotary_crane().with_parameters(**parameters).with_limits(**(limits or {}))
    chosen(scene.models, route.model, "model")
    formulation = chosen(FORMULATIONS, route.formulation, "formulation")
    method = chosen(METHODS, route.method, "method")
    accuracy = route.accuracy()
    with np.errstate(all="ignore"):  # what is not finite is refused below with a sentence, not warned of
        scene = scene.with_reference(path())
        duration, row = scene.reference.duration, route.step if route.output_step is None else route.output_step
        if row is not None and row > 0.0 and duration / row > MOST_ROWS:
            raise sc.InvalidSetting(
                f"a step of {row:g} s divides {duration:g} s into more than {MOST_ROWS:g} rows: take a larger step"
            )
        with shortest_duration_told(scene, route.model):
            return sc.solve(
                scene,
                formulation,
                method,
                step=accuracy,
                output_step=route.output_step,
                model=route.model,
                progress=progress,
            )


FAR_OFF = 0.5
"""Of its peak: an input that is off by this or more is of no use."""

_UNNOTICED = 1e-3  # of the largest input: what is smaller may be all round-off


def far_off(
    solution: sc.Solution, path: Callable[[], sc.Reference], parameters: Mapping[str, float], route: Route
) -> str | None:
    """Tell which input of a run is off by `FAR_OFF` of its peak or more; None if none is.

    The crane has a closed form, with which every row of a run that was stepped is compared.

    Parameters
    ----------
    solution : Solution
        What `feedforward` returned for the other arguments.
    path : callable
        Makes the path.
    parameters : mapping of str to float
        The crane's in SI units, where they differ from the defaults.
    route : Route
        How the inputs were computed.

    Returns
    -------
    str or None
        One sentence.
    """
    default = next(iter(FORMULATIONS))
    if route.formulation == default:
        return None  # nothing was stepped
    exact = sc.scenes.rotary_crane().with_parameters(**parameters).with_reference(path()).exact(solution.t)
    inputs = COLUMNS[:3]
    peaks = {name: float(np.abs(exact[name]).max()) for name in inputs}
    off = {name: np.nan_to_num(np.abs(solution[name] - exact[name]), nan=np.inf) for name in inputs}
    shares = {name: float(off[name].max()) / max(peaks[name], _UNNOTICED * max(peaks.values())) for name in inputs}
    worst = max(inputs, key=lambda name: shares[name])
    if shares[worst] < FAR_OFF:
        return None
    unit, k = solution.unit(worst), int(off[worst].argmax())
    return (
        f"{solution.route}: these inputs are of no use; {worst} is off by {100.0 * shares[worst]:.3g} % of its peak, at"
        f" t = {solution.t[k]:.6g} s it is {solution[worst][k]:.4g} {unit} and should be {exact[worst][k]:.4g} {unit};"
        f" with --formulation {default} they are exact"
    )


def table(solution: sc.Solution, columns: Sequence[str] = COLUMNS) -> str:
    """Return columns of a solution as the text of a CSV file.

    Parameters
    ----------
    solution : Solution
        What to write.
    columns : sequence of str
        Names of its trajectories, which follow the time.

    Returns
    -------
    str
        A header and a row for each instant, in SI units and full double precision.
    """
    return "".join(table_pieces(solution, columns))


def table_pieces(solution: sc.Solution, columns: Sequence[str] = COLUMNS) -> Iterator[str]:
    """Give the same piece by piece: millions of rows would fill the memory.

    Parameters
    ----------
    solution : Solution
        What to write.
    columns : sequence of str
        Names of its trajectories, which follow the time.

    Returns
    -------
    iterator of str
        Pieces of the text, in order.
    """
    return csv_pieces(["time", *columns], [solution.t, *[solution[name] for name in columns]])
