"""What is measured: a solver made ready for a problem, and the answer that it gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline

import servocore as sc

Array = npt.NDArray[np.float64]

OUTPUT_INTERVALS = 200
"""All solvers report on this many intervals of the run, or on a whole multiple of them."""

COARSE = (40, 100)
"""Intervals of coarser grids, for solvers that pay by the instant; a spline brings their inputs to the output grid."""
SPLINE_DEGREE = 7


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene under the name that charts use."""

    name: str
    scene: sc.Scene
    _exact: dict[int, dict[str, Array]] = field(default_factory=dict)

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(each.name for each in self.scene.model().inputs)

    def grid(self, intervals: int = OUTPUT_INTERVALS) -> Array:
        """Return the instants of a run with so many intervals."""
        reference = self.scene.reference
        t = reference.start_time + np.arange(intervals + 1, dtype=np.float64) * (reference.duration / intervals)
        t[-1] = reference.end_time
        return t

    def exact(self, intervals: int) -> dict[str, Array]:
        """Return the exact answer on a grid, computed once."""
        if intervals not in self._exact:
            self._exact[intervals] = self.scene.exact(self.grid(intervals))
        return self._exact[intervals]

    def errors(self, inputs: dict[str, Array]) -> dict[str, float]:
        """Return the largest error of each input relative to its peak."""
        found = {}
        for name in self.inputs:
            values = np.asarray(inputs[name])
            exact = self.exact(len(values) - 1)[name]
            found[name] = float(np.abs(values - exact).max() / np.abs(exact).max())
        return found


def on_output_grid(values: Array) -> Array:
    """Return trajectories (m, N) on the output grid: as they are, or by a spline through a coarser grid's."""
    intervals = values.shape[1] - 1
    if intervals >= OUTPUT_INTERVALS:
        return values
    found: Array = values @ _spline(intervals)
    return found


@cache
def _spline(intervals: int) -> Array:
    """Return the matrix from values on an even grid to those of the spline through them on the output grid."""
    nodes, t = np.linspace(0.0, 1.0, intervals + 1), np.linspace(0.0, 1.0, OUTPUT_INTERVALS + 1)
    matrix: Array = make_interp_spline(nodes, np.eye(intervals + 1), k=SPLINE_DEGREE)(t).T
    return matrix


@dataclass(frozen=True, eq=False)
class Answer:
    """Inputs on a grid of the problem, and the largest constraint violation (NaN if the solver does not tell it)."""

    inputs: dict[str, Array]
    violation: float


@dataclass(frozen=True, eq=False)
class Prepared:
    """A solver made ready.

    Attributes
    ----------
    run : callable
        The solve that is timed: integration, and inputs on the output grid.
    read : callable
        Turns what `run` returns into an `Answer`; not timed.
    remark : callable, optional
        Says more of what `run` returned.
    before : callable, optional
        Builds anew what a run uses up; not timed.
    """

    run: Callable[[], object]
    read: Callable[..., Answer]
    remark: Callable[..., str] | None = None
    before: Callable[[], None] | None = None


@dataclass(frozen=True, eq=False)
class Candidate:
    """A solver with its settings, not yet made ready.

    Attributes
    ----------
    prepare : callable
        Everything that is done once: modelling, code generation, compilation.
    limit : float
        Seconds after which a first run is given up.
    """

    problem: Problem
    solver: str
    model: str
    formulation: str
    method: str
    setting: str
    prepare: Callable[[], Prepared]
    limit: float = 20.0
