"""The numbers of the demo: errors against the closed form, differences of the models, tracking, the working cycle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy.interpolate

import servocore as sc
from crane_fmu.report.style import Array

INPUTS = ("M_b", "F", "M_w")
MOTION = ("phi", "s", "l")
STEPS = (0.1, 0.05, 0.025, 0.0125)
PAPER_STEP = STEPS[0]

Announce = Callable[[str], None]
"""Called with what is going on now."""


@dataclass(frozen=True)
class ErrorRow:
    """Largest errors of one run against the closed form.

    Attributes
    ----------
    model : str
        Model of the crane.
    step : float
        Step size in s.
    inputs : mapping of str to float
        Error of M_b, F, M_w relative to the largest value of each.
    motion : mapping of str to float
        Error of phi (rad), s (m), l (m).
    """

    model: str
    step: float
    inputs: Mapping[str, float]
    motion: Mapping[str, float]


@dataclass(frozen=True)
class DifferenceRow:
    """Largest difference between the inputs of two models at one step, relative to the largest value of each input."""

    models: tuple[str, str]
    step: float
    inputs: Mapping[str, float]


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
        Its inputs.
    row : ErrorRow
        Their errors.
    apart : float
        Largest distance between the path through the waypoints and the one through the samples, in m.
    """

    waypoints: Array
    scene: sc.Scene
    solution: sc.Solution
    row: ErrorRow
    apart: float


@dataclass(frozen=True)
class FmuRun:
    """A run of the FMU along the default manoeuvre.

    Attributes
    ----------
    step, last_time : float
        Communication step and time of the last row, in s.
    rows : int
        Number of rows.
    differences, errors : mapping of str to float
        Largest differences of M_b, F, M_w, phi, s, l from the library's run of the same step and from the closed
        form, in SI units.
    """

    step: float
    last_time: float
    rows: int
    differences: Mapping[str, float]
    errors: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Study:
    """Everything that the report shows.

    Attributes
    ----------
    scene : Scene
        Crane, parameters, default manoeuvre.
    solutions : mapping of (model, step) to Solution
        Projected formulation, backward Euler.
    errors, differences : tuple
        See `ErrorRow`, `DifferenceRow`.
    reduced : ErrorRow
        The reduced formulation: exact inversion at every instant.
    tracking : tuple of LoadRun
        Forward simulations under inputs of the coarsest step, the finest one and the closed form.
    """

    scene: sc.Scene
    solutions: Mapping[tuple[str, float], sc.Solution]
    errors: tuple[ErrorRow, ...]
    differences: tuple[DifferenceRow, ...]
    reduced: ErrorRow
    tracking: tuple[LoadRun, ...]

    @property
    def models(self) -> tuple[str, ...]:
        """Names of the models, smallest first."""
        return tuple(dict.fromkeys(model for model, _ in self.solutions))

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
    errors = [error_row(scene, solution, model, step) for (model, step), solution in solutions.items()]
    small = scene.default_model
    reduced = error_row(scene, sc.solve(scene, sc.Reduced(), step=steps[0]), small, steps[0])
    runs = track(scene, [solutions[small, step] for step in (steps[0], steps[-1])], announce)
    return Study(scene, solutions, tuple(errors), tuple(differences(solutions)), reduced, tuple(runs))


def error_row(scene: sc.Scene, solution: sc.Solution, model: str, step: float) -> ErrorRow:
    """Compare one run with the closed form."""
    exact = scene.exact(solution.t)
    return ErrorRow(
        model,
        step,
        {name: largest(solution[name] - exact[name]) / largest(exact[name]) for name in INPUTS},
        {name: largest(solution[name] - exact[name]) for name in MOTION},
    )


def fmu_run(scene: sc.Scene, outputs: Mapping[str, Array], library: sc.Solution) -> FmuRun:
    """Compare the outputs of the FMU with the library's run and with the closed form at the same times."""
    t, names = outputs["time"], (*INPUTS, *MOTION)
    exact = scene.exact(t)
    return FmuRun(
        float(t[1] - t[0]),
        float(t[-1]),
        len(t),
        {name: largest(outputs[name] - library[name]) for name in names},
        {name: largest(outputs[name] - exact[name]) for name in names},
    )


def largest(values: Array) -> float:
    """Largest absolute value."""
    return float(np.abs(values).max())


def differences(solutions: Mapping[tuple[str, float], sc.Solution]) -> list[DifferenceRow]:
    """Compare the models' inputs with one another, pair by pair, at every step."""
    models = dict.fromkeys(model for model, _ in solutions)
    steps = dict.fromkeys(step for _, step in solutions)
    rows = []
    for first, second in combinations(models, 2):
        for step in steps:
            one, other = solutions[first, step], solutions[second, step]
            apart = {name: largest(one[name] - other[name]) / largest(one[name]) for name in INPUTS}
            rows.append(DifferenceRow((first, second), step, apart))
    return rows


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

    def evaluate(time: float) -> Array:
        return np.asarray(spline(time), dtype=np.float64)

    return evaluate


def working_cycle(
    scene: sc.Scene, through: sc.Reference, samples: sc.Reference, waypoints: Array, step: float = PAPER_STEP
) -> Cycle:
    """Compute the inputs of the working cycle.

    Parameters
    ----------
    scene : Scene
        The crane.
    through, samples : Reference
        The path through the waypoints and the path from the sampled file.
    waypoints : ndarray, shape (n, 4)
        Times and positions.
    step : float
        Step size in s.
    """
    t = np.linspace(through.start_time, through.end_time, 2001)
    apart = largest(np.linalg.norm(through.jet(t, 0)[:, 0] - samples.jet(t, 0)[:, 0], axis=1))
    on_path = scene.with_reference(through)
    solution = sc.solve(on_path, sc.Projected(), sc.BackwardEuler(), step=step)
    return Cycle(waypoints, on_path, solution, error_row(on_path, solution, scene.default_model, step), apart)
