"""`Solution`: what a run returns, arrays by name with units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from servocore.files import write_together
from servocore.model.quantity import Quantity
from servocore.numerics.calls import Array


@dataclass(frozen=True)
class Statistics:
    """What a run took and how well it kept the equations.

    Attributes
    ----------
    steps, newton_iterations, factorisations : int
        Totals of the run; iterations are those of the slowest block of each step.
    worst_residual : float
        Largest residual of any equation, scaled by the step size to the level of accelerations.
    servo_violation, servo_rate_violation : float
        Largest |c| in the unit of the outputs, and largest |dc/dt|.
    constraint_violation, constraint_rate_violation : float
        Largest |g| and |dg/dt|.
    rejected : int
        Steps that error control took back.
    error_estimate : float or None
        With error control: its estimate of the largest error of the inputs, relative to their peaks.
    choices_of_states : int
        How often the states of internal dynamics were chosen, the first time included.
    input_noise : float or None
        Round-off floor of the inputs, relative to their peaks, as seen in the result: what in them alternates from
        instant to instant. An upper bound, close where the step is small; None for runs too short to tell.
    branch : str
        Of exact inversions: that the answers belong to one branch of the equations, and how that is known.
    """

    steps: int
    newton_iterations: int
    factorisations: int
    worst_residual: float
    servo_violation: float
    servo_rate_violation: float
    constraint_violation: float
    constraint_rate_violation: float
    rejected: int = 0
    error_estimate: float | None = None
    choices_of_states: int = 1
    input_noise: float | None = None
    branch: str = ""


NO_STATISTICS = Statistics(0, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Solution:
    """Trajectories by name.

    ``solution["M_b"]`` is an array over ``solution.t``; ``solution.unit("M_b")`` its unit.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times in s.
    channels : tuple of Quantity
        Names and units of the columns of `values`.
    values : ndarray, shape (N, number of channels)
        One row a time.
    statistics : Statistics
        `NO_STATISTICS` for results that no run of this library produced.
    route : str
        Model, formulation and method that produced it.
    fit_error : float or None
        The reference's own estimate of its distance from the sampled positions it was fitted to, in m.
    advice : str
        What the analysis said when it chose the formulation; empty when the caller chose.
    """

    t: Array
    channels: tuple[Quantity, ...]
    values: Array
    route: str
    statistics: Statistics = NO_STATISTICS
    fit_error: float | None = None
    advice: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all trajectories."""
        return tuple(channel.name for channel in self.channels)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> Array:
        column: Array = self.values[:, self._index(name)]
        return column

    def unit(self, name: str) -> str:
        """Return the unit of a trajectory; raises KeyError if there is none of that name."""
        return self.channels[self._index(name)].unit

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise KeyError(f"{name}; there are {', '.join(self.names)}")
        return self.names.index(name)

    def to_csv(self, path: str | Path, names: Sequence[str] | None = None) -> None:
        """Write time and trajectories as CSV in full double precision; all of them unless `names` are given."""
        names = self.names if names is None else names
        table = np.column_stack([self.t, *[self[name] for name in names]])
        lines = [",".join(("time", *names))]
        lines += [",".join(repr(float(value)) for value in row) for row in table]
        write_together({Path(path): "\n".join(lines) + "\n"})
