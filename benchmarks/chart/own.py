"""The library's own routes, and the vectorized closed form: lists of settings, made into candidates."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

import servocore as sc
from benchmarks.chart.candidate import (
    COARSE,
    OUTPUT_INTERVALS,
    Answer,
    Array,
    Candidate,
    Prepared,
    Problem,
    on_output_grid,
)

NAME, CLOSED_FORM = "servocore", "closed-form"

SOLVED, INVERTED, PREPARED = "exact inversion", "ExactInversion", "DynamicInversion"
"""The exact inversion by `solve`, with motion and checks; inputs alone, prepared once; with internal dynamics."""

LONG_STEPS = ", prepared"
"""How methods end that `prepare` has made ready, with the fewest steps for a tolerance."""

COMPILED = ", machine code"
"""How methods end, the library's and the peers', whose functions a compiler has made ready."""

METHODS: tuple[sc.Method, ...] = (
    sc.BackwardEuler(), *(sc.BDF(order) for order in range(2, 7)), *(sc.RadauIIA(stages) for stages in range(2, 8)),
    sc.Trapezoidal(), sc.Gauss(1), sc.Gauss(2), sc.GeneralizedAlpha(),
)  # fmt: skip
"""Every method, on the smallest model of every scene."""

FEW_METHODS: tuple[sc.Method, ...] = (sc.BackwardEuler(), sc.BDF(4), sc.RadauIIA(5))
"""On the other models, which give the same errors at another price, and on the original form."""

DIVISIONS = (1, 2, 4, 8, 16)  # of each output interval
FEW_DIVISIONS = (1, 4, 16)
INTERNAL_DIVISIONS = (1, 4)  # on a reduced form with internal dynamics, which needs no small steps
TOLERANCES = (1e-3, 1e-6, 1e-9)
PREPARED_TOLERANCES = (1e-3, 1e-6, 5e-10)
STAGES, COMPILED_STAGES = (3, 4, 5, 6, 7, 9), (4, 7)
"""Of Radau IIA with long steps; of those as machine code, which takes seconds to compile each."""
ADAPTIVE: tuple[sc.Method, ...] = (sc.BDF(4), sc.RadauIIA(5))
ORDER_STEPS = (25, 50, 100, 200, 400, 800, 1600, 3200, 6400)
ORDER_DURATION = 20.0
"""Duration in s of the run on which orders are fitted."""
LARGEST_ROUND_OFF = 1e-9
"""c of a round-off c/h^2, in s^2; an error that grows faster as the step falls is no round-off."""
MOST_UNKNOWN_STEPS = 1_000_000
"""Steps of a run times unknowns of a step: more would take longer than it tells."""


def candidates(problem: Problem, smoke: bool = False) -> list[Candidate]:
    """List our routes on a problem."""
    if smoke:
        return [*_fixed(problem, None, sc.Projected(), FEW_METHODS[:1], DIVISIONS[:2]),
                _long_steps(problem, None, sc.RadauIIA(5), TOLERANCES[0], native=False),
                *_reduced(problem, None, FEW_METHODS[:1])]  # fmt: skip
    first, *others = problem.scene.models
    found = [*_reduced(problem, first), *_fixed(problem, first, sc.Projected(), METHODS, DIVISIONS)]
    found += [
        _long_steps(problem, first, sc.RadauIIA(stages), tolerance, native)
        for native, counts in ((False, STAGES), (True, COMPILED_STAGES))
        for stages in counts
        for tolerance in TOLERANCES
    ]
    found += _adaptive(problem, first)
    found += _fixed(problem, first, sc.Original(), FEW_METHODS, FEW_DIVISIONS)
    for model in others:
        found += [
            *_reduced(problem, model, FEW_METHODS),
            *_fixed(problem, model, sc.Projected(), FEW_METHODS, FEW_DIVISIONS),
        ]
    return found


def order_candidates(problem: Problem, smoke: bool = False) -> list[Candidate]:
    """List every method on the projected form, for its order of convergence."""
    return [
        _candidate(problem, None, sc.Projected(), method, steps)
        for method in (METHODS[:2] if smoke else METHODS)
        for steps in (ORDER_STEPS[2:5] if smoke else ORDER_STEPS)
    ]


def _reduced(problem: Problem, model: str | None, methods: Sequence[sc.Method] = METHODS) -> list[Candidate]:
    """List the reduced form: one solve an instant, or an integration of the internal dynamics."""
    index = sc.Stepper(problem.scene, sc.Reduced(), sc.BackwardEuler(), 0.1, model).index
    grids, both = (*COARSE, OUTPUT_INTERVALS), (False, True)
    if index == 0:
        how = sc.Reduced(), sc.BackwardEuler()
        found = [_candidate(problem, model, *how, steps, SOLVED, native) for native in both for steps in grids]
        return found + [_inverted(problem, model, steps, native) for native in both for steps in grids]
    first = model in (None, problem.scene.default_model)
    prepared = [_dynamic(problem, model, tolerance, native) for native in both for tolerance in PREPARED_TOLERANCES]
    return [
        *(prepared if first else []),
        *[
            Candidate(
                problem,
                NAME,
                model or problem.scene.default_model,
                sc.Reduced().name,
                "Sundials",
                f"rtol = {rtol:g}",
                partial(_prepare, problem, sc.Reduced(), sc.Sundials(rtol), model, step=None),
            )
            for rtol in (TOLERANCES if first else ())
        ],
        *_fixed(problem, model, sc.Reduced(), methods, INTERNAL_DIVISIONS),
        *_fixed(problem, model, sc.Reduced(), [each for each in methods if each in FEW_METHODS], FEW_DIVISIONS[-1:]),
    ]


def _inverted(problem: Problem, model: str | None, intervals: int, native: bool) -> Candidate:
    """Return the inputs alone, prepared once, by the interpreter or as machine code."""

    def prepare() -> Prepared:
        inversion = sc.ExactInversion(problem.scene, model, native=native)
        t = problem.grid(intervals)

        def read(found: Array) -> Answer:
            return Answer(dict(zip(problem.inputs, found, strict=True)), float("nan"))

        return Prepared(lambda: on_output_grid(inversion(t).T), read)

    method = INVERTED + (COMPILED if native else "")
    return Candidate(problem, NAME, model or problem.scene.default_model, sc.Reduced().name, method,
                     f"{intervals} instants", prepare)  # fmt: skip


def _dynamic(problem: Problem, model: str | None, tolerance: float, native: bool) -> Candidate:
    """Return the inputs of a scene with internal dynamics, prepared once, integrated in every run."""

    def prepare() -> Prepared:
        inversion, t = sc.DynamicInversion(problem.scene, model, tolerance=tolerance, native=native), problem.grid()

        def read(found: Array) -> Answer:
            return Answer(dict(zip(problem.inputs, found.T, strict=True)), float("nan"))

        return Prepared(lambda: inversion(t), read, lambda _: f"{inversion.steps} steps")

    return Candidate(problem, NAME, model or problem.scene.default_model, sc.Reduced().name,
                     PREPARED + (COMPILED if native else ""), f"tolerance = {tolerance:g}", prepare)  # fmt: skip


def _long_steps(problem: Problem, model: str | None, method: sc.Method, tolerance: float, native: bool) -> Candidate:
    """Return runs of the projected form, prepared once with the fewest steps for a tolerance."""

    def prepare() -> Prepared:
        run = sc.prepare(problem.scene, sc.Projected(), method, tolerance=tolerance, model=model, native=native)
        t = problem.grid()

        def read(found: Array) -> Answer:
            return Answer(dict(zip(problem.inputs, found.T, strict=True)), float("nan"))

        return Prepared(lambda: run(t), read, lambda _: f"{run.elements} steps")

    return Candidate(problem, NAME, model or problem.scene.default_model, sc.Projected().name,
                     method.name + LONG_STEPS + (COMPILED if native else ""), f"tolerance = {tolerance:g}",
                     prepare)  # fmt: skip


def _fixed(
    problem: Problem,
    model: str | None,
    formulation: sc.Formulation,
    methods: Sequence[sc.Method],
    divisions: Sequence[int],
) -> list[Candidate]:
    """List methods at constant step."""
    size = len(problem.scene.model(model).coordinates)
    most = MOST_UNKNOWN_STEPS // (OUTPUT_INTERVALS * size)
    return [
        _candidate(problem, model, formulation, method, division * OUTPUT_INTERVALS)
        for method in methods
        for division in divisions
        if division <= most or division == divisions[0]
    ]


def _candidate(
    problem: Problem,
    model: str | None,
    formulation: sc.Formulation,
    method: sc.Method,
    steps: int,
    name: str = "",
    native: bool = False,
) -> Candidate:
    step = problem.scene.reference.duration / steps
    return Candidate(
        problem, NAME, model or problem.scene.default_model, formulation.name,
        (name or method.name) + (COMPILED if native else ""), f"{steps} steps",
        partial(_prepare, problem, formulation, method, model, step=step, native=native),
    )  # fmt: skip


def _adaptive(problem: Problem, model: str) -> list[Candidate]:
    """List error control: by whole runs on the projected form, step by step on a reduced form of index one."""
    index = sc.Stepper(problem.scene, sc.Reduced(), sc.BackwardEuler(), 0.1, model).index
    formulations = (sc.Projected(), *((sc.Reduced(),) if index else ()))
    return [
        Candidate(problem, NAME, model, formulation.name, f"{method.name}, adaptive", f"rtol = {rtol:g}",
                  partial(_prepare, problem, formulation, method, model, step=sc.Adaptive(rtol=rtol)))
        for formulation in formulations
        for method in ADAPTIVE
        for rtol in TOLERANCES
    ]  # fmt: skip


def _prepare(
    problem: Problem,
    formulation: sc.Formulation,
    method: sc.Method | sc.Route,
    model: str | None,
    step: float | sc.Adaptive | None,
    native: bool = False,
) -> Prepared:
    """Compile everything by solving once."""

    def run() -> tuple[sc.Solution, Array]:
        solution = sc.solve(problem.scene, formulation, method, step=step, model=model, native=native)
        return solution, on_output_grid(solution.values[:, : len(problem.inputs)].T)

    first, _ = run()
    if first.names[: len(problem.inputs)] != problem.inputs:
        raise ValueError("the inputs are not the first trajectories of a solution")
    return Prepared(run, partial(_read, problem), _remark)


def _read(problem: Problem, found: tuple[sc.Solution, Array]) -> Answer:
    statistics = found[0].statistics
    inputs = dict(zip(problem.inputs, found[1], strict=True))
    return Answer(inputs, max(statistics.servo_violation, statistics.constraint_violation))


def _remark(answer: tuple[sc.Solution, Array]) -> str:
    found = answer[0].statistics
    return f"{found.steps} steps, {found.newton_iterations} iterations, {found.factorizations} factorizations"


def closed_form(problem: Problem) -> list[Candidate]:
    """Return the formula of the exact answer by vectorized NumPy on the output grid."""
    scene = problem.scene
    if scene.closed_form is None:
        return []

    def prepare() -> Prepared:
        t, values, formula = problem.grid(), scene.parameter_values(), scene.closed_form
        assert formula is not None

        def run() -> dict[str, np.ndarray]:
            return formula(scene.reference.jet(t, scene.closed_form_order), values)

        return Prepared(run, lambda found: Answer({name: found[name] for name in problem.inputs}, 0.0))

    return [Candidate(problem, CLOSED_FORM, "none", "closed form", "vectorized NumPy", f"{OUTPUT_INTERVALS} intervals",
                      prepare)]  # fmt: skip
