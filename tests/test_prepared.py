"""Runs that are prepared once: as accurate as is asked, between their steps too, and as `solve` at their ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from problems import along_its_line, scene

import servocore as sc

CRANE = along_its_line(sc.scenes.rotary_crane(), 20.0, sc.DEGREE13)
CAR, ARM, CARS = scene("mass_on_car"), sc.scenes.passive_joint_arm(), sc.scenes.cars(3)
SLOW = sc.rest_to_rest((0.0, -4.0), (5.0, -1.0), 6.0)


def off(run: sc.PreparedInversion, subject: sc.Scene, instants: int = 331) -> float:
    """Largest error of the inputs relative to their peaks, between the steps and at instants that no trial saw."""
    path = subject.reference
    t = np.linspace(path.start_time, path.end_time, instants)
    exact = np.column_stack([subject.exact(t)[name] for name in run.inputs])
    return float((np.abs(run(t) - exact).max(axis=0) / np.abs(exact).max(axis=0)).max())


# The polynomial of s + 1 values has an order more than the stages where the ends of steps have.
@pytest.mark.parametrize(
    ("subject", "formulation", "method", "order"),
    [
        (CRANE, sc.Projected(), sc.BackwardEuler(), 1),
        (CRANE, sc.Projected(), sc.BDF(3), 3),
        (CRANE, sc.Projected(), sc.RadauIIA(3), 2),
        (CRANE, sc.Projected(), sc.RadauIIA(5), 4),
        (ARM, sc.Projected(), sc.RadauIIA(3), 3),
        (CAR, sc.Projected(), sc.RadauIIA(4), 4),
        (ARM, sc.Projected(), sc.GeneralizedAlpha(), 2),
        (CAR, sc.Reduced(), sc.RadauIIA(2), 3),
        (CAR, sc.Reduced(), sc.RadauIIA(4), 5),
        (CAR, sc.Reduced(), sc.Gauss(3), 4),
    ],
    ids=lambda each: getattr(each, "name", each),
)
def test_dense_output_of_the_inputs_has_their_order(
    subject: sc.Scene, formulation: sc.Formulation, method: sc.Method, order: int
) -> None:
    counts = (100, 200) if subject is CRANE else (16, 32)
    coarse, fine = (off(sc.prepare(subject, formulation, method, elements=n), subject) for n in counts)
    assert np.log2(coarse / fine) > order - 0.25


@pytest.mark.parametrize("method", [sc.BackwardEuler(), sc.BDF(4), sc.RadauIIA(5), sc.GeneralizedAlpha()])
@pytest.mark.parametrize("subject", [CRANE, ARM], ids=lambda each: each.name)
def test_at_the_ends_of_its_steps_a_run_is_what_solve_gives(subject: sc.Scene, method: sc.Method) -> None:
    solved = sc.solve(subject, sc.Projected(), method, step=subject.reference.duration / 40, checks=False)
    run = sc.prepare(subject, sc.Projected(), method, elements=40, native=False)
    for k, name in enumerate(run.inputs):
        np.testing.assert_allclose(run(solved.t)[:, k], solved[name], atol=1e-12 * np.abs(solved[name]).max())


@pytest.mark.parametrize(
    ("subject", "formulation", "stages", "tolerance", "most"),
    [
        (CRANE, sc.Projected(), 7, 1e-6, 100),
        (CARS, sc.Projected(), 9, 1e-6, 30),  # index 5: with seven stages round-off comes first
        (ARM, sc.Projected(), 5, 1e-6, 20),
        (CAR, sc.Projected(), 7, 1e-9, 20),
        (CAR, sc.Reduced(), 5, 1e-6, 25),
    ],
    ids=lambda each: getattr(each, "name", each),
)
def test_a_tolerance_is_kept_with_few_steps(
    subject: sc.Scene, formulation: sc.Formulation, stages: int, tolerance: float, most: int
) -> None:
    run = sc.prepare(subject, formulation, sc.RadauIIA(stages), tolerance=tolerance)
    assert off(run, subject) < 1.2 * tolerance
    assert run.error <= tolerance
    assert run.elements <= most


def test_calls_take_other_parameters_and_paths() -> None:
    crane = scene("overhead_crane")
    run = sc.prepare(crane, sc.Projected(), sc.RadauIIA(5), elements=30)
    changed = crane.with_reference(SLOW).with_parameters(load_mass=130.0)
    fresh, t = sc.prepare(changed, sc.Projected(), sc.RadauIIA(5), elements=30), np.array([0.1, 4.0, 2.0])
    before = run(2.0)
    np.testing.assert_allclose(run(t, {"load_mass": 130.0}, SLOW), fresh(t), rtol=1e-9)
    np.testing.assert_array_equal(run(2.0), before)
    assert run(()).shape == (0, 2)


@pytest.mark.usefixtures("compiler")
def test_machine_code_gives_the_same_digits() -> None:
    runs = [sc.prepare(CAR, sc.Projected(), sc.BDF(2), elements=50, native=native) for native in (False, True)]
    t = np.linspace(0.0, CAR.reference.end_time, 99)
    np.testing.assert_array_equal(runs[0](t), runs[1](t))


@pytest.mark.parametrize(
    ("subject", "changes", "error", "words"),
    [
        (CAR, {"elements": 3, "tolerance": 1e-3}, sc.InvalidSetting, "a tolerance, or 1 to 2000 elements"),
        (CAR, {"elements": 0}, sc.InvalidSetting, "1 to 2000 elements"),
        (CAR, {"elements": 2.5}, sc.InvalidSetting, "a whole number"),
        (CAR, {"tolerance": 2.0}, sc.InvalidSetting, "between 0 and 1"),
        (CAR, {"method": sc.Sundials()}, sc.InvalidSetting, "method"),
        (CRANE, {"formulation": sc.Reduced()}, sc.InvalidModel, "nothing to integrate .* ExactInversion"),
        (CARS, {"tolerance": 1e-9}, sc.IntegrationFailed, "no number of elements keeps .* with more stages"),
        (sc.scenes.passive_joint_arm(tip=True), {}, sc.InvalidModel, "unstable internal dynamics"),
    ],
)  # fmt: skip
def test_what_cannot_be_prepared_is_refused(
    subject: sc.Scene, changes: dict[str, Any], error: type[Exception], words: str
) -> None:
    given = {"formulation": sc.Projected(), "method": sc.RadauIIA(3), **changes}
    with pytest.raises(error, match=words):
        sc.prepare(subject, **given)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ((9.0,), sc.InvalidReference, "times lie between 0 s and 3 s, not from 9 s"),
        (("now",), sc.InvalidReference, "numbers in s"),
        ((1.0, {"mass": 3.0}), sc.InvalidModel, "mass"),
        ((1.0, {"load_mass": -3.0}), sc.InvalidModel, "load_mass"),
        ((1.0, None, 3.0), sc.InvalidReference, "a Reference"),
        ((1.0, None, sc.rest_to_rest((0.0,), (1.0,), 1.0)), sc.InvalidReference, "2 components, not 1"),
        ((0.4, None, sc.rest_to_rest((0.0, -4.0), (5.0, -1.0), 0.4)), sc.IntegrationFailed, "at t = .* l is -"),
    ],
)  # fmt: skip
def test_a_call_that_cannot_be_answered_is_refused(
    arguments: tuple[Any, ...], error: type[Exception], words: str
) -> None:
    run = sc.prepare(scene("overhead_crane"), sc.Projected(), sc.RadauIIA(3), elements=20)
    with pytest.raises(error, match=words):
        run(*arguments)
