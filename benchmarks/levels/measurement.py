"""What the models of a scene cost and how exact they are: measured, for tables and machines.

Every model is run along the reference of its scene by two routes: the derivative array as `Reduced` (the exact
inversion where there are no internal dynamics), and backward Euler on the projected equations. Times are processor
times of warm runs, taken in turn so that disturbances meet them alike. Trust the ratios: machines are busy.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from benchmarks.levels.costs import Cost, Level, Spread
from servocore.analysis import analyse
from servocore.checks.before_run import NON_MINIMUM_PHASE
from servocore.errors import InvalidModel, InvalidReference, InvalidSetting, ServocoreError
from servocore.formulations.base import Formulation
from servocore.formulations.projected import Projected
from servocore.formulations.reduced import Reduced
from servocore.methods.backward_euler import BackwardEuler
from servocore.methods.base import Method
from servocore.methods.collocation import RadauIIA
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array, chained, side_by_side
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.solvers.solve import solve
from servocore.stepping.program import program_of

ROUTES: dict[str, tuple[Formulation, Method]] = {
    "exact": (Reduced(), RadauIIA(3)),
    "projected": (Projected(), BackwardEuler()),
}
"""What is compared; the method of the first is of use only where there are internal dynamics to integrate."""

Key = TypeVar("Key")

_CLOCK = time.process_time if time.get_clock_info("process_time").resolution <= 1e-6 else time.perf_counter
"""Processor time where it is fine enough: other work on the machine then counts little."""

Describe = Callable[[str], None]
"""Called with what is going on."""


def measure_levels(
    scene: Scene, *, instants: int = 1000, repeats: int = 15, describe: Describe = lambda _: None
) -> tuple[Level, ...]:
    """Measure every model of a scene, smallest first.

    Parameters
    ----------
    scene : Scene
        With the reference and parameters to use.
    instants : int
        Steps of a run; the error of the projected route depends on it.
    repeats : int
        Timed runs of each route and model, after one to warm up.
    describe : callable, optional
        Told what is going on.

    Raises
    ------
    InvalidSetting
        If `instants` or `repeats` is less than one.
    InvalidReference
        If the problem is singular somewhere along the path.
    """
    for least_one, number in (("instant", instants), ("repeat", repeats)):
        if number < 1:
            raise InvalidSetting(f"at least one {least_one} is needed, not {number}")
    levels: list[Level] = []
    runs: dict[tuple[int, str], Callable[[], object]] = {}
    for model in scene.models:
        describe(f"preparing {scene.name}, {model}")
        level, refusal = _unmeasured(scene, model)
        for route, (formulation, method) in ROUTES.items():
            if refusal:
                level.costs[route] = Cost(refusal=refusal)
                continue
            try:
                level.costs[route] = _size_and_error(scene, formulation, method, model, instants)
                runs[len(levels), route] = compiled_run(scene, formulation, method, model, instants)
            except ServocoreError as error:
                level.costs[route] = Cost(refusal=str(error))
        levels.append(level)
    describe(f"measuring {scene.name}")
    for (k, route), seconds in timed_in_turn(runs, repeats).items():
        microseconds = Spread.of([1e6 * duration / instants for duration in seconds])
        levels[k].costs[route] = replace(levels[k].costs[route], microseconds=microseconds)
    return tuple(levels)


def _unmeasured(scene: Scene, model: str) -> tuple[Level, str]:
    """Return the level without its costs, and why there can be none if the analysis says so."""
    report = analyse(scene, model=model)
    if report.index is None or report.internal_degrees_of_freedom is None or report.reason:
        raise InvalidReference(f"{scene.name}, {model}: {report.reason}")
    size, needed = len(scene.model(model).coordinates), model == scene.default_model
    level = Level(scene.name, model, needed, size, report.index, report.internal_degrees_of_freedom, {})
    return level, report.advice if report.classification == NON_MINIMUM_PHASE else ""


def _size_and_error(scene: Scene, formulation: Formulation, method: Method, model: str, instants: int) -> Cost:
    step = scene.reference.duration / instants
    solution = solve(scene, formulation, method, step=step, model=model)
    dae = Problem.of(scene, model).dae(formulation)
    return Cost(unknowns=len(dae.unknowns), error=input_error(scene, solution), method=method.name)


def input_error(scene: Scene, solution: Solution) -> float | None:
    """Largest error of any input relative to its largest exact value; None for a scene without an exact answer."""
    try:
        exact = scene.exact(solution.t)
    except InvalidModel:
        return None
    names = [quantity.name for quantity in scene.model().inputs]
    return max(float(np.abs(solution[k] - exact[k]).max() / (np.abs(exact[k]).max() or 1.0)) for k in names)


def compiled_run(
    scene: Scene, formulation: Formulation, method: Method, model: str, instants: int
) -> Callable[[], tuple[Array, ...]]:
    """Return a whole run as a function without arguments: the compiled loop, everything else computed before."""
    problem, reference = Problem.of(scene, model), scene.reference
    program, step, p = program_of(problem, formulation, method), reference.duration / instants, problem.p
    past = reference.start_time + step * np.array(program.start_instants)
    state, _ = program.begin(reference.jet(past, program.start_order), p, step)
    ends = np.linspace(reference.start_time, reference.end_time, instants + 1)[1:]
    gamma = np.concatenate([reference.jet(ends - (1.0 - c) * step, program.order) for c in program.nodes], axis=1)
    loop = chained(program.step, instants)
    arguments = state, side_by_side(gamma), np.full(instants, step), np.tile(p[:, None], instants)
    return lambda: loop(*arguments)


def timed_in_turn(runs: dict[Key, Callable[[], object]], repeats: int) -> dict[Key, list[float]]:
    """Take the processor time of every run in s, `repeats` times round in turn, after a round to warm up."""
    seconds: dict[Key, list[float]] = {key: [] for key in runs}
    for repeat in range(repeats + 1):
        for key, run in runs.items():
            begin = _CLOCK()
            run()
            if repeat:
                seconds[key].append(_CLOCK() - begin)
    return seconds
