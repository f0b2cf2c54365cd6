"""Feedforward: from a load path and the crane's parameters to its inputs as a table.

What the command line calls, in pieces that are of use without it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

import servocore as sc

COLUMNS = ("M_b", "F", "M_w", "phi", "s", "l", "x", "y", "z", "tension")
"""Columns of the table after `time`: inputs, crane, load, rope tension, in SI units."""

FORMULATIONS: Mapping[str, sc.Formulation] = {
    "reduced": sc.Reduced(),
    "projected": sc.Projected(),
    "original": sc.Original(),
}
"""Formulations that can be asked for by name; the first is the default."""

METHODS: Mapping[str, sc.Method] = {
    "backward-euler": sc.BackwardEuler(),
    **{f"bdf{order}": sc.BDF(order) for order in range(1, 7)},
    **{f"radau{stages}": sc.RadauIIA(stages) for stages in range(1, 6)},
    "trapezoidal": sc.Trapezoidal(),
    **{f"gauss{stages}": sc.Gauss(stages) for stages in range(1, 6)},
    "generalized-alpha": sc.GeneralizedAlpha(),
}
"""Methods that can be asked for by name, BDF by order, Radau and Gauss by stages; the first is the default."""

THREE_PHASE = "three-phase"
PROFILES: Mapping[str, sc.Profile] = {
    "degree9": sc.DEGREE9,
    "degree13": sc.DEGREE13,
    THREE_PHASE: sc.three_phase(),
}
"""Time laws of a straight line from rest to rest; the first is the default."""

PICTURES = (".png", ".svg", ".pdf")
"""Kinds of files that a picture of the result can be."""

MOST_ROWS = 1e7
"""A table with more rows is taken for a mistake: it would fill the memory first."""

LONGEST_DURATION = 1e9
"""In s; beyond it the derivatives of a path vanish in rounding."""

MODELS = tuple(sc.scenes.rotary_crane().models)
"""Models of the crane; the first, and smallest, is the default."""

Choice = TypeVar("Choice")


def choose(table: Mapping[str, Choice], name: str, kind: str) -> Choice:
    """Look a name up; raises `InvalidSetting` with the names there are."""
    if name not in table:
        raise sc.InvalidSetting(f"there is no {kind} {name!r}; there are {', '.join(table)}")
    return table[name]


class PathRequest(Protocol):
    """A description of a load path that can be turned into one."""

    def reference(self) -> sc.Reference:
        """Return the path; raises `InvalidReference` or `InvalidSetting` if there is none."""


@dataclass(frozen=True)
class LineRequest:
    """A straight line from rest to rest.

    Attributes
    ----------
    start, end : tuple of float
        End points (x, y, z) in m.
    duration : float
        Time of the motion in s.
    profile : str
        One of `PROFILES`.
    ramp : float or None
        Time to accelerate in s, for the profile three-phase only.
    """

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    duration: float
    profile: str = "degree9"
    ramp: float | None = None

    def reference(self) -> sc.Reference:
        """Return the line; see `PathRequest`."""
        if self.duration > LONGEST_DURATION:
            raise sc.InvalidReference(
                f"the duration of {self.duration:g} s is longer than {LONGEST_DURATION:g} s: nothing would move"
            )
        law = choose(PROFILES, self.profile, "profile")
        if self.ramp is not None:
            if self.profile != THREE_PHASE:
                raise sc.InvalidSetting(f"a ramp belongs to the profile {THREE_PHASE}, not to {self.profile}")
            law = sc.three_phase(self.ramp)
        return sc.rest_to_rest(self.start, self.end, self.duration, law)


@dataclass(frozen=True)
class FileRequest:
    """A path from a CSV file, as `servocore.from_csv` reads it."""

    path: Path
    tolerance: float | None = None

    def reference(self) -> sc.Reference:
        """Return the path; see `PathRequest`."""
        return sc.from_csv(self.path, self.tolerance)


@dataclass(frozen=True)
class Route:
    """How the inputs are computed: names of `MODELS`, `FORMULATIONS` and `METHODS`, and the step or a tolerance.

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
        """Return what `servocore.solve` takes as its step; raises `InvalidSetting` if the options contradict."""
        if self.rtol is None and self.atol is None:
            if self.output_step is not None:
                raise sc.InvalidSetting("--output-step belongs to --rtol or --atol; without them every step is a row")
            return self.step
        if self.step is not None:
            raise sc.InvalidSetting("accuracy is given either by --step or by --rtol and --atol, not by both")
        return sc.Adaptive(0.0 if self.rtol is None else self.rtol, 0.0 if self.atol is None else self.atol)


def feedforward(
    path: PathRequest,
    parameters: Mapping[str, float],
    route: Route,
    progress: Callable[[int, int], None] | None = None,
) -> sc.Solution:
    """Compute the inputs that move the load of the rotary crane along a path.

    Parameters
    ----------
    path : LineRequest or FileRequest
        Where the load shall go.
    parameters : mapping of str to float
        Parameters of the crane that differ from the defaults.
    route : Route
        Model, formulation, method and step.
    progress : callable, optional
        Called with (steps done, steps in all).

    Returns
    -------
    Solution
        With the trajectories `COLUMNS` at the start of the path, one step later, ..., its end.

    Raises
    ------
    ServocoreError
        If a name, the path, a parameter or the step cannot be used, or a step is not solved.
    """
    scene = sc.scenes.rotary_crane().with_parameters(**parameters)
    choose(scene.models, route.model, "model")
    formulation = choose(FORMULATIONS, route.formulation, "formulation")
    method = choose(METHODS, route.method, "method")
    accuracy = route.accuracy()
    with np.errstate(all="ignore"):  # what is not finite is refused below with a sentence, not warned of
        scene = scene.with_reference(path.reference())
        _require_few_rows(scene.reference.duration, route.step if route.output_step is None else route.output_step)
        return sc.solve(
            scene,
            formulation,
            method,
            step=accuracy,
            output_step=route.output_step,
            model=route.model,
            progress=progress,
        )


def _require_few_rows(duration: float, step: float | None) -> None:
    if step is not None and step > 0.0 and duration / step > MOST_ROWS:
        raise sc.InvalidSetting(
            f"a step of {step:g} s divides {duration:g} s into more than {MOST_ROWS:g} rows: take a larger step"
        )


def csv_text(solution: sc.Solution, columns: Sequence[str] = COLUMNS) -> str:
    """Return the table as the text of a CSV file, in full double precision."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "inputs.csv"
        solution.to_csv(file, columns)
        return file.read_text(encoding="utf-8")
