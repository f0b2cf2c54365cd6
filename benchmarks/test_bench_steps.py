"""What a step costs, by pytest-benchmark: `make bench`, or `pytest benchmarks --benchmark-enable`.

The rotary crane's smallest model, 200 steps of 0.1 s. The *bare CasADi loop* is what a user without this library would
write: the undivided residual of one projected backward Euler step in CasADi's ``fast_newton``, called step by step from
Python. Ratios to it and to the vectorized closed form are printed below the table; `conftest.py` does that.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import servocore as sc
from benchmarks.chart.c_cost import functions_of, in_c
from benchmarks.conftest import BARE, CLOSED_FORM
from benchmarks.levels.measurement import compiled_run
from servocore.numerics.compiled_calls import Call
from servocore.numerics.newton import MAX_ITERATIONS, NEWTON_TOLERANCE

CRANE = sc.scenes.rotary_crane()
STEPS = 200
STEP = CRANE.reference.duration / STEPS
PROJECTED: tuple[sc.Method, ...] = (sc.BackwardEuler(), sc.BDF(3), sc.BDF(6), sc.RadauIIA(3), sc.RadauIIA(7))

Record = Callable[[str, int], None]


def bare_loop() -> Callable[[], np.ndarray]:
    """Return the run of a loop in Python over one CasADi function: the whole step as one Newton iteration."""
    stepper = sc.Stepper(CRANE, sc.Projected(), sc.BackwardEuler(), STEP)
    dae = sc.Projected().dae(stepper.system)
    equations = sc.BackwardEuler().discretize(dae).equations
    scaled = ca.SX.sym("scaled", equations.unknowns.numel())
    residual = ca.substitute(equations.residual, equations.unknowns, scaled * equations.unknown_scale)
    root = ca.rootfinder(
        "bare_newton",
        "fast_newton",
        {"x": scaled, "p": equations.givens, "g": residual / equations.residual_scale},
        {"abstol": 0.0, "abstolStep": NEWTON_TOLERANCE, "max_iter": MAX_ITERATIONS},
    )
    scale = np.asarray(ca.Function("s", [equations.givens], [equations.unknown_scale])(
        np.full(equations.givens.numel(), STEP))).ravel()  # fmt: skip
    t = np.linspace(0.0, CRANE.reference.duration, STEPS + 1)
    jets = CRANE.reference.jet(t, dae.reference_order)
    state, _ = stepper.start(CRANE.reference.jet(0.0, stepper.start_order))
    size, p = equations.unknowns.numel(), stepper.parameters

    def run() -> np.ndarray:
        old = new = state[:size]
        for jet in jets[1:]:
            givens = np.concatenate([new, old, jet.ravel(), [STEP], p])
            old, new = new, np.asarray(root(x0=new / scale, p=givens)["x"]).ravel() * scale
        return new

    return run


def test_bare_casadi_loop(benchmark: Any, record: Record) -> None:
    """One CasADi function, called step by step from Python."""
    run = bare_loop()
    stepper = sc.Stepper(CRANE, sc.Projected(), sc.BackwardEuler(), STEP)
    found = benchmark(run)
    solution = sc.solve(CRANE, sc.Projected(), sc.BackwardEuler(), step=STEP)
    values = stepper.values(np.resize(found, stepper.program.state_size), CRANE.reference.jet(20.0, 4))
    assert values["M_w"] == pytest.approx(solution["M_w"][-1], rel=1e-6)
    record(BARE, STEPS)


@pytest.mark.parametrize("method", PROJECTED, ids=lambda method: method.name)
def test_projected_loop(benchmark: Any, record: Record, method: sc.Method) -> None:
    """The compiled loop over the steps alone, as `solve` runs it."""
    run = compiled_run(CRANE, sc.Projected(), method, "points", STEPS)
    assert np.isfinite(benchmark(run)[0]).all()
    record(f"compiled loop, projected, {method.name}", STEPS)


@pytest.mark.parametrize("model", list(CRANE.models))
def test_exact_inversion_loop(benchmark: Any, record: Record, model: str) -> None:
    """The compiled loop of exact inversion alone, as `solve` runs it."""
    run = compiled_run(CRANE, sc.Reduced(), sc.BackwardEuler(), model, STEPS)
    assert np.isfinite(benchmark(run)[0]).all()
    record(f"compiled loop, exact inversion, {model}", STEPS)


@pytest.mark.parametrize("model", list(CRANE.models))
def test_exact_inversion_of_inputs(benchmark: Any, record: Record, model: str) -> None:
    """Inputs alone, prepared once, with the derivatives of the path."""
    inversion, t = sc.ExactInversion(CRANE, model), np.linspace(0.0, CRANE.reference.duration, STEPS)
    assert np.isfinite(benchmark(inversion, t)).all()
    record(f"ExactInversion, {model}", STEPS)


def test_exact_inversion_in_c(benchmark: Any, record: Record) -> None:
    """The functions of the former alone, generated as C by CasADi and compiled by gcc -O3."""
    loop, arguments = functions_of(CRANE, "points", STEPS)
    with tempfile.TemporaryDirectory() as folder:
        external = in_c(loop, Path(folder))
        if external is None:
            pytest.skip("there is no gcc")
        call = Call(external)
        np.testing.assert_allclose(benchmark(call, *arguments)[0], Call(loop)(*arguments)[0], rtol=1e-9, atol=1e-9)
    record("C of its functions, exact inversion, points", STEPS)


@pytest.mark.parametrize("formulation", [sc.Projected(), sc.Reduced()], ids=lambda each: each.name)
def test_stepper(benchmark: Any, record: Record, formulation: sc.Formulation) -> None:
    """`Stepper.advance`, one call from Python."""
    stepper = sc.Stepper(CRANE, formulation, sc.BackwardEuler(), STEP)
    past = CRANE.reference.start_time + STEP * np.array(stepper.start_instants)
    state, _ = stepper.start(CRANE.reference.jet(past, stepper.start_order))
    jet = CRANE.reference.jet(STEP, stepper.start_order)
    _, report = benchmark(stepper.advance, state, jet)
    assert report.converged
    record(f"Stepper.advance, {formulation.name}", 1)


@pytest.mark.parametrize("formulation", [sc.Projected(), sc.Reduced()], ids=lambda each: each.name)
def test_solve(benchmark: Any, record: Record, formulation: sc.Formulation) -> None:
    """The whole of `solve`: checks of the path, start, loop and what it reports."""
    solution = benchmark(sc.solve, CRANE, formulation, sc.BackwardEuler(), step=STEP)
    assert len(solution.t) == STEPS + 1
    record(f"solve, {formulation.name}", STEPS)


def test_closed_form(benchmark: Any, record: Record) -> None:
    """All instants at once, the path included."""
    t, values = np.linspace(0.0, CRANE.reference.duration, STEPS + 1), CRANE.parameter_values()
    closed_form = CRANE.closed_form
    assert closed_form is not None
    found = benchmark(lambda: closed_form(CRANE.reference.jet(t, CRANE.closed_form_order), values))
    assert np.isfinite(found["M_b"]).all()
    record(CLOSED_FORM, STEPS)


def test_fmu_step(benchmark: Any, record: Record) -> None:
    """Set inputs, step and get outputs by the C functions of the FMU; `fmu_cost.py` measures this in more detail."""
    fmpy = pytest.importorskip("fmpy")
    build = pytest.importorskip("crane_fmu.build")
    from benchmarks.fmu_cost import Driven, path  # noqa: PLC0415

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        driven = Driven(Path(str(fmpy.extract(str(build.build_fmu(Path(folder) / "crane.fmu")), folder))), path())
        benchmark.pedantic(driven.cycle, (20,), rounds=50, warmup_rounds=5)
        driven.free()
    record("FMU: set, step, get", 20)
