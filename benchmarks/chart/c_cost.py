"""What the exact inversion costs beside C: the same functions, evaluated by CasADi and generated as C by it."""

from __future__ import annotations

import cProfile
import pstats
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np

import servocore as sc
from benchmarks.chart.candidate import OUTPUT_INTERVALS, Array
from benchmarks.chart.timing import processor_time
from servocore.numerics.compiled_calls import Call, side_by_side
from servocore.solvers.exact_inversion import input_evaluation

_INSIDE = ("run", "_run", "_checked", "solution_of")  # looked into, rather than named
_SMALLEST_SHARE = 0.02

FLAGS = ("-O3", "-fPIC", "-shared")


@dataclass(frozen=True)
class Cost:
    """Microseconds per instant for one model: `solve`, `ExactInversion`, the bare C function (None without gcc)."""

    model: str
    solve: float
    inversion: float
    compiled: float | None
    seconds_to_compile: float = 0.0


def measure_costs(problem_scene: sc.Scene, models: Sequence[str], repeats: int = 15) -> list[Cost]:
    """Measure models of a scene, the runs in turn; none of a scene with internal dynamics, which has no inversion."""
    if problem_scene.closed_form is None:
        return []
    with tempfile.TemporaryDirectory() as folder:
        runs: dict[tuple[str, str], Callable[[], object]] = {}
        compiling = {}
        for model in models:
            functions, arguments = functions_of(problem_scene, model)
            step = problem_scene.reference.duration / OUTPUT_INTERVALS
            inversion, t = (
                sc.ExactInversion(problem_scene, model, native=False),
                np.arange(1, OUTPUT_INTERVALS + 1) * step,
            )
            runs[model, "solve"] = partial(sc.solve, problem_scene, sc.Reduced(), step=step, model=model, native=False)
            runs[model, "inversion"] = partial(inversion, t + problem_scene.reference.start_time)
            begin = processor_time()
            external = in_c(functions, Path(folder))
            compiling[model] = processor_time() - begin
            if external is not None:
                runs[model, "c"] = partial(Call(external), *arguments)
                require_same(partial(Call(functions), *arguments), runs[model, "c"])
        medians = _medians(runs, repeats)
    return [
        Cost(model, medians[model, "solve"], medians[model, "inversion"], medians.get((model, "c")), compiling[model])
        for model in models
    ]


def functions_of(scene: sc.Scene, model: str, steps: int = OUTPUT_INTERVALS) -> tuple[ca.Function, tuple[Array, Array]]:
    """Return the functions of the exact inversion for all instants, and their arguments."""
    problem = sc.Problem.of(scene, model)
    t = np.linspace(scene.reference.start_time, scene.reference.end_time, steps + 1)[1:]
    jets = scene.reference.jet(t, problem.array.reference_order)
    functions = input_evaluation(problem, False).by_expression.function.map(
        f"sc_{model}_inputs", "serial", steps, [], []
    )
    return functions, (side_by_side(jets), np.tile(problem.p[:, None], steps))


def in_c(function: ca.Function, folder: Path) -> ca.Function | None:
    """Generate C, compile it and load it; None without a compiler."""
    if shutil.which("gcc") is None:
        return None
    name = function.name()
    generator = ca.CodeGenerator(f"{name}.c")
    generator.add(function)
    generator.generate(f"{folder}/")
    library = folder / f"{name}.so"
    subprocess.run(["gcc", *FLAGS, str(folder / f"{name}.c"), "-o", str(library), "-lm"], check=True)
    return ca.external(name, str(library))


def require_same(one: Callable[[], object], other: Callable[[], object]) -> None:
    """Raise ArithmeticError if two evaluations differ."""
    a, b = (np.asarray(_first(run())) for run in (one, other))
    if not np.allclose(a, b, rtol=1e-9, atol=1e-9):
        raise ArithmeticError("C gives other inputs")


def _first(results: object) -> Array:
    assert isinstance(results, tuple)
    found: Array = results[0]
    return found


def _medians(runs: dict[tuple[str, str], Callable[[], object]], repeats: int) -> dict[tuple[str, str], float]:
    seconds: dict[tuple[str, str], list[float]] = {key: [] for key in runs}
    for repeat in range(repeats + 1):
        for key, run in runs.items():
            begin = processor_time()
            run()
            if repeat:
                seconds[key].append(processor_time() - begin)
    return {key: 1e6 * float(np.median(each)) / OUTPUT_INTERVALS for key, each in seconds.items()}


def shares_of_solve(scene: sc.Scene, repeats: int = 40) -> list[tuple[str, float]]:
    """Return what a solve by exact inversion is spent on, by the functions that `solve` calls, largest first.

    Shares are those of a profiler, which makes many short calls look dearer than few long ones.
    """
    step = scene.reference.duration / OUTPUT_INTERVALS
    sc.solve(scene, sc.Reduced(), step=step, native=False)
    profile = cProfile.Profile()
    profile.enable()
    for _ in range(repeats):
        sc.solve(scene, sc.Reduced(), step=step, native=False)
    profile.disable()
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]  # documented, not in typeshed
    (whole,) = (each for each in stats if each[2] == "solve" and each[0].endswith("solve.py"))
    total = stats[whole][3]
    found: dict[str, float] = {}
    parents = [whole]
    while parents:
        parent = parents.pop()
        for function, (_, _, _, _, callers) in stats.items():
            if parent in callers:
                if function[2] in _INSIDE:
                    parents.append(function)
                else:
                    found[function[2]] = found.get(function[2], 0.0) + callers[parent][3] / total
    listed = sorted(found.items(), key=lambda each: -each[1])
    return [(name, share) for name, share in listed if share >= _SMALLEST_SHARE]
