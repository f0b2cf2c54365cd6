"""Routes, and the values they start from: told of progress, shared by threads, brought along by users."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from problems import Rest, scene

import servocore as sc
from servocore.numerics.memoization import made_once
from servocore.solvers.exact_inversion import Pointwise
from servocore.solvers.fixed_step import FixedStep, ToTolerance
from servocore.solvers.solve import chosen_route
from servocore.solvers.stable_inversion import StableInversion

CAR, CRANE = scene("mass_on_car"), scene("overhead_crane")


@pytest.mark.parametrize(
    ("of", "formulation", "method", "step", "route"),
    [
        (CRANE, sc.Reduced(), sc.RadauIIA(3), None, Pointwise),
        (CRANE, sc.Reduced(), sc.RadauIIA(3), sc.Adaptive(), Pointwise),
        (CRANE, sc.Projected(), sc.BackwardEuler(), None, FixedStep),
        (CRANE, sc.Projected(), sc.BDF(3), sc.Adaptive(1e-3), ToTolerance),
        (CAR, sc.Reduced(), sc.RadauIIA(3), None, FixedStep),
        (CAR, sc.Reduced(), sc.RadauIIA(3), sc.Adaptive(1e-3), ToTolerance),
        (CAR, sc.Reduced(), StableInversion(), None, StableInversion),
        (CAR, sc.Reduced(), Rest(), None, Rest),
    ],
)
def test_the_form_and_the_control_of_steps_decide_about_the_route(
    of: sc.Scene, formulation: sc.Formulation, method: sc.Method, step: sc.Adaptive | None, route: type
) -> None:
    chosen = chosen_route(sc.Problem.of(of), formulation, method, step, native=False, checks=True)
    assert isinstance(chosen, route)
    assert isinstance(chosen, sc.Route)


def test_solve_takes_a_route_of_one_s_own() -> None:
    found = sc.solve(CAR, method=Rest())
    assert found.route == "rest"
    assert not found["u"].any()


@pytest.mark.parametrize("step", [None, sc.Adaptive(1e-3)])
@pytest.mark.parametrize("formulation", [sc.Reduced(), sc.Projected()], ids=lambda form: form.name)
def test_every_run_tells_how_far_it_is(formulation: sc.Formulation, step: sc.Adaptive | None) -> None:
    told = []
    sc.solve(CAR, formulation, sc.RadauIIA(2), step=step, progress=lambda done, of: told.append((done, of)))
    assert told
    assert told[-1][0] == told[-1][1]


def test_threads_may_share_a_scene() -> None:
    times, push = np.linspace(0.0, 4.0, 41), (lambda time: np.array([np.sin(3.0 * time)]))
    heavier = [CAR.with_parameters(mass=1.0 + k) for k in range(4)]
    alone = [sc.simulate(each, push, t=times).values for each in heavier]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as threads:
            together = list(threads.map(lambda each: sc.simulate(each, push, t=times).values, heavier))
    finally:
        sys.setswitchinterval(interval)
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)


def test_problems_of_one_system_share_what_was_compiled_and_nothing_else() -> None:
    other = CRANE.with_reference(sc.rest_to_rest((1.0, -3.0), (2.0, -2.0), 5.0)).with_parameters(load_mass=42.0)
    first, second = sc.Problem.of(CRANE), sc.Problem.of(other)
    assert first.resolved is second.resolved
    assert first.reference is not second.reference
    assert first.p[list(CRANE.parameter_values()).index("load_mass")] != 42.0
    exact = other.exact(sc.solve(other).t)["F"]
    np.testing.assert_allclose(sc.solve(other)["F"], exact, atol=1e-9 * np.abs(exact).max())


def test_what_is_made_once_is_kept_until_many_others_are_made() -> None:
    made = made_once(lambda _: object())
    first = made(0)
    assert made(0) is first
    for k in range(1, 300):
        made(k)
    assert made(0) is not first


def test_the_error_of_a_structure_without_an_answer_is_a_new_one_every_time() -> None:
    system = CRANE.model("points")
    loose = replace(system, input_matrix=0 * system.input_matrix, name="loose")
    problem = sc.Problem.of(loose)
    errors = []
    for _ in range(2):
        with pytest.raises(sc.InvalidModel) as caught:
            _ = problem.array
        errors.append(caught.value)
    assert errors[0] is not errors[1]
    assert str(errors[0]) == str(errors[1])
