"""The numbers of the demo: errors against the closed form, differences of the models, tracking, the working cycle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy.interpolate

import servocore as sc
from crane_fmu.report.style import Array, Trajectories

INPUTS = ("M_b", "F", "M_w")
MOTION = ("phi", "s", "l")
STEPS = (0.1, 0.05, 0.025, 0.0125)

Announce = Callable[[str], None]
"""Called with what is going on now."""

Errors = Mapping[str, float]
"""Of M_b, F, M_w relative to the largest value of each, of phi (rad), s (m), l (m) absolute."""


@dataclass(frozen=True, eq=False)
class LoadRun:
    """A run in which the load may leave its path: a forward simulation, or connected FMUs.

    Attributes
    ----------
    label : str
        Whose inputs, or what was different in it.
    t : ndarray, shape (n,)
        Times in s.
    wanted, driven : ndarray, shape (n, 3)
        Where the load should be and where it is, in m.
    """

    label: str
    t: Array
    wanted: Array
    driven: Array

    @property
    def error(self) -> Array:
        """Distance of the load from where it should be, in m, shape (n,)."""
        distance: Array = np.linalg.norm(self.driven - self.wanted, axis=1)
        return distance

    @property
    def largest(self) -> float:
        """Largest distance, in m."""
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
        Its inputs, with a step of `STEPS[0]`.
    errors : Errors
        Largest ones against the closed form.
    apart : float
        Largest distance between the path through the waypoints and the one through the samples, in m.
    """

    waypoints: Array
    scene: sc.Scene
    solution: sc.Solution
    errors: Errors
    apart: float


@dataclass(frozen=True, eq=False)
class Study:
    """Everything that the report shows.

    Attributes
    ----------
    scene : Scene
        Crane, parameters, default manoeuvre.
    solutions : mapping of (model, step) to Solution
        Projected formulation, backward Euler.
    errors : mapping of (model, step) to Errors
        Largest ones of each solution against the closed form.
    differences : mapping of (names of two models, step) to Errors
        Largest ones between their solutions.
    reduced : Errors
        Those of the reduced formulation, exact inversion at every instant, at the largest step.
    tracking : tuple of LoadRun
        Forward simulations under inputs of the coarsest step, the finest one and the closed form.
    """

    scene: sc.Scene
    solutions: Mapping[tuple[str, float], sc.Solution]
    errors: Mapping[tuple[str, float], Errors]
    differences: Mapping[tuple[str, float], Errors]
    reduced: Errors
    tracking: tuple[LoadRun, ...]

    @property
    def models(self) -> tuple[str, ...]:
        """Names of the models, smallest first."""
        return tuple(self.scene.models)

    @property
    def steps(self) -> tuple[float, ...]:
        """Step sizes in s, largest first."""
        return tuple(dict.fromkeys(step for _, step in self.solutions))

    @property
    def base(self) -> sc.Solution:
        """The smallest model at the largest step: the run that the figures and the table of inputs show."""
        return self.solutions[self.models[0], self.steps[0]]


def study(scene: sc.Scene, announce: Announce, steps: Sequence[float] = STEPS) -> Study:
    """Compute the default manoeuvre with every model and every step, and simulate the crane under the inputs.

    Parameters
    ----------
    scene : Scene
        The rotary crane.
    announce : callable
        Is told what is going on.
    steps : sequence of float
        Step sizes in s, largest first.
    """
    solutions = {}
    for model in scene.models:
        for step in steps:
            announce(f"{model} model, step {step:g} s")
            solutions[model, step] = sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=step, model=model)
    errors = {run: error(scene, solution) for run, solution in solutions.items()}
    differences = {
        (f"{one} and {other}", step): apart(solutions[other, step], solutions[one, step])
        for one, other in combinations(scene.models, 2)
        for step in steps
    }
    reduced = error(scene, sc.solve(scene, sc.Reduced(), step=steps[0]))
    small = scene.default_model
    runs = track(scene, [solutions[small, step] for step in (steps[0], steps[-1])], announce)
    return Study(scene, solutions, errors, differences, reduced, tuple(runs))


def error(scene: sc.Scene, solution: sc.Solution) -> Errors:
    """Compare a run with the closed form."""
    return apart(solution, scene.exact(solution.t))


def apart(run: Trajectories, judge: Trajectories) -> Errors:
    """Return the largest differences of a run from another that it is judged by."""
    relative = {name: largest(run[name] - judge[name]) / largest(judge[name]) for name in INPUTS}
    return relative | {name: largest(run[name] - judge[name]) for name in MOTION}


def largest(values: Array) -> float:
    """Largest absolute value."""
    return float(np.abs(values).max())


def track(scene: sc.Scene, solutions: Sequence[sc.Solution], announce: Announce) -> list[LoadRun]:
    """Simulate the crane forward under the inputs of several runs, and under those of the closed form."""
    under: list[tuple[str, sc.Solution | Callable[[float], Array]]] = [
        (f"inputs computed with a step of {run.t[1] - run.t[0]:g} s", run) for run in solutions
    ]
    found = []
    for label, inputs in [*under, ("inputs of the closed form", exact_inputs(scene))]:
        announce(f"forward simulation, {label}")
        t = inputs.t if isinstance(inputs, sc.Solution) else solutions[-1].t
        simulated = sc.simulate(scene, inputs, t=t)
        driven = np.column_stack([simulated[name] for name in "xyz"])
        found.append(LoadRun(label, simulated.t, scene.reference.jet(simulated.t, 0)[:, 0], driven))
    return found


def exact_inputs(scene: sc.Scene) -> Callable[[float], Array]:
    """Return the inputs of the closed form as a function of time: a spline through so many values that it is exact."""
    t = np.linspace(scene.reference.start_time, scene.reference.end_time, 4001)
    exact = scene.exact(t)
    spline = scipy.interpolate.make_interp_spline(t, np.column_stack([exact[name] for name in INPUTS]), k=5)
    return lambda time: np.asarray(spline(time), dtype=np.float64)


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
    solution = sc.solve(on_path, sc.Projected(), sc.BackwardEuler(), step=STEPS[0])
    return Cycle(waypoints, on_path, solution, error(on_path, solution), off)
