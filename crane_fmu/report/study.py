"""The numbers of the demo: errors against the closed form, differences of the models, tracking, the working cycle.

Two ways to the inputs are shown: the default, and beside it the scheme of the paper.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

import servocore as sc

Array = npt.NDArray[np.float64]

INPUTS = ("M_b", "F", "M_w")
MOTION = ("phi", "s", "l")
STEPS = (0.1, 0.05, 0.025, 0.0125)

DEFAULT = "form reduced, exact inversion at every instant"
PAPER = "form projected, method backward Euler: the scheme of the paper"
"""Names of the two routes to the inputs in tables and figures: the default of the library, and that of the paper."""

Announce = Callable[[str], None]
"""Called with a description of each stage."""

Errors = Mapping[str, float]
"""Of M_b, F, M_w relative to the largest value of each, of phi (rad), s (m), l (m) absolute."""


@dataclass(frozen=True, eq=False)
class LoadRun:
    """A run in which the load may leave its path: a forward simulation, a plant of the user, or connected FMUs.

    Attributes
    ----------
    label : str
        The inputs, or the differences of the run.
    t : ndarray, shape (n,)
        Times in s.
    prescribed, driven : ndarray, shape (n, 3)
        Prescribed and simulated position of the load, in m.
    gust : (begin, end) or None
        Times in s of a gust.
    """

    label: str
    t: Array
    prescribed: Array
    driven: Array
    gust: tuple[float, float] | None = None

    @property
    def error(self) -> Array:
        """Tracking error of the load in m, shape (n,)."""
        distance: Array = np.linalg.norm(self.driven - self.prescribed, axis=1)
        return distance

    @property
    def largest(self) -> float:
        """Largest tracking error in m."""
        return float(self.error.max())


@dataclass(frozen=True, eq=False)
class Cycle:
    """The working cycle of the examples.

    Attributes
    ----------
    waypoints : ndarray, shape (n, 4)
        Times in s and positions in m.
    scene : Scene
        The crane on the path through the waypoints.
    solution : Solution
        Its inputs by the default, every `STEPS[0]`.
    errors : Errors
        Largest ones of these against the closed form.
    paper : Errors
        Those of the scheme of the paper with a step of `STEPS[0]`.
    apart : float
        Largest distance between the path through the waypoints and the one through the samples, in m.
    """

    waypoints: Array
    scene: sc.Scene
    solution: sc.Solution
    errors: Errors
    paper: Errors
    apart: float


@dataclass(frozen=True, eq=False)
class Study:
    """The results in the report.

    Attributes
    ----------
    scene : Scene
        Crane, parameters, default manoeuvre.
    exact : mapping of model to Solution
        By the default: exact inversion, every `steps[0]`.
    errors : mapping of model to Errors
        Largest ones of these against the closed form.
    paper : mapping of (model, step) to Solution
        By the scheme of the paper.
    paper_errors : mapping of (model, step) to Errors
        Largest ones of these against the closed form.
    differences : mapping of (names of two models, step) to Errors
        Largest ones between models by the scheme of the paper.
    tracking : tuple of LoadRun
        Forward simulations under inputs by the default, at any instant and as a table, and by the scheme of the paper
        with the largest step and the smallest.
    certificate : str
        The verdict on the run that the figures show, in one line; empty if it was skipped.
    """

    scene: sc.Scene
    exact: Mapping[str, sc.Solution]
    errors: Mapping[str, Errors]
    paper: Mapping[tuple[str, float], sc.Solution]
    paper_errors: Mapping[tuple[str, float], Errors]
    differences: Mapping[tuple[str, float], Errors]
    tracking: tuple[LoadRun, ...]
    certificate: str = ""

    @property
    def models(self) -> tuple[str, ...]:
        """Names of the models, smallest first."""
        return tuple(self.scene.models)

    @property
    def steps(self) -> tuple[float, ...]:
        """Step sizes in s, largest first."""
        return tuple(dict.fromkeys(step for _, step in self.paper))

    @property
    def base(self) -> sc.Solution:
        """The smallest model by the default: the run that the figures and the table of inputs show."""
        return self.exact[self.models[0]]


def study(scene: sc.Scene, announce: Announce, steps: Sequence[float] = STEPS) -> Study:
    """Compute the default manoeuvre with every model, in both ways, and simulate the crane under the inputs.

    Parameters
    ----------
    scene : Scene
        The rotary crane.
    announce : callable
        Called with a description of each stage.
    steps : sequence of float
        Step sizes in s of the scheme of the paper, largest first.
    """
    exact, paper = {}, {}
    for model in scene.models:
        announce(f"{model} model, exact inversion")
        exact[model] = sc.solve(scene, step=steps[0], model=model)
        for step in steps:
            announce(f"{model} model, scheme of the paper, step {step:g} s")
            paper[model, step] = by_the_paper(scene, step, model)
    differences = {
        (f"{one} and {other}", step): apart(paper[other, step], paper[one, step])
        for one, other in combinations(scene.models, 2)
        for step in steps
    }
    small = scene.default_model
    return Study(
        scene,
        exact,
        {model: error(scene, run) for model, run in exact.items()},
        paper,
        {run: error(scene, solution) for run, solution in paper.items()},
        differences,
        tuple(track(scene, exact[small], [paper[small, step] for step in (steps[0], steps[-1])], announce)),
    )


def by_the_paper(scene: sc.Scene, step: float, model: str | None = None) -> sc.Solution:
    """Solve by the scheme of the paper: the projected form, stepped by backward Euler."""
    with warnings.catch_warnings(action="ignore", category=sc.ServocoreWarning):  # the tables show its errors
        return sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=step, model=model)


def error(scene: sc.Scene, solution: sc.Solution) -> Errors:
    """Compare a run with the closed form."""
    return apart(solution, scene.exact(solution.t))


def apart(run: sc.Solution, judge: sc.Solution | Mapping[str, Array]) -> Errors:
    """Return the largest differences of a run from another that it is judged by."""
    relative = {name: largest(run[name] - judge[name]) / largest(judge[name]) for name in INPUTS}
    return relative | {name: largest(run[name] - judge[name]) for name in MOTION}


def largest(values: Array) -> float:
    """Largest absolute value."""
    return float(np.abs(values).max())


def track(scene: sc.Scene, exact: sc.Solution, paper: Sequence[sc.Solution], announce: Announce) -> list[LoadRun]:
    """Simulate the crane forward under inputs by the default, at any instant and as a table, and by the paper."""
    under: list[tuple[str, sc.Solution | sc.ExactInversion]] = [
        ("exact inversion", sc.ExactInversion(scene)),
        (f"exact inversion, a row every {exact.t[1] - exact.t[0]:g} s", exact),
        *((f"scheme of the paper, step {run.t[1] - run.t[0]:g} s", run) for run in paper),
    ]
    found = []
    for label, inputs in under:
        announce(f"forward simulation, {label}")
        t = inputs.t if isinstance(inputs, sc.Solution) else paper[-1].t
        simulated = sc.simulate(scene, inputs, t=t)
        driven = np.column_stack([simulated[name] for name in "xyz"])
        found.append(LoadRun(label, simulated.t, scene.reference.jet(simulated.t, 0)[:, 0], driven))
    return found


def working_cycle(scene: sc.Scene, through: sc.Reference, samples: sc.Reference, waypoints: Array) -> Cycle:
    """Compute the inputs of the working cycle.

    Parameters
    ----------
    scene : Scene
        The crane.
    through, samples : Reference
        The path through the waypoints and the path from the sampled file.
    waypoints : ndarray, shape (n, 4)
        Times and positions.
    """
    t = np.linspace(through.start_time, through.end_time, 2001)
    off = largest(np.linalg.norm(through.jet(t, 0)[:, 0] - samples.jet(t, 0)[:, 0], axis=1))
    on_path = scene.with_reference(through)
    solution = sc.solve(on_path, step=STEPS[0])
    paper = error(on_path, by_the_paper(on_path, STEPS[0]))
    return Cycle(waypoints, on_path, solution, error(on_path, solution), paper, off)
