"""Inputs of scenes with internal dynamics, prepared once, and by SUNDIALS: those that small steps give."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from problems import scene

import servocore as sc
from servocore.stepping.explicit_steps import Between, compile_explicit_steps

SCENES = ("mass_on_car", "passive_joint_arm")


def exact(name: str, model: str | None = None, **how: Any) -> sc.Solution:
    """Return what 800 steps of Radau's method with seven stages give, to 1e-12."""
    problem = scene(name)
    return sc.solve(problem, sc.Reduced(), sc.RadauIIA(7), step=problem.reference.duration / 800, model=model, **how)


def error(found: np.ndarray, known: sc.Solution, names: tuple[str, ...]) -> float:
    """Return the largest error relative to the peak of each input; every fourth instant of `known` is compared."""
    table = np.column_stack([known[name] for name in names])[::4]
    return float((np.abs(found - table).max(axis=0) / np.abs(table).max(axis=0)).max())


@pytest.mark.parametrize("name", SCENES)
def test_the_tolerance_is_kept_by_few_steps(name: str) -> None:
    known, counts = exact(name), []
    for tolerance in (1e-3, 1e-6, 1e-9):
        inputs = sc.DynamicInversion(scene(name), tolerance=tolerance)
        assert error(inputs(known.t[::4]), known, inputs.inputs) <= 2.0 * tolerance
        counts.append(inputs.steps)
    assert counts == sorted(counts)
    assert counts[-1] <= 80


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.usefixtures("compiler")
def test_machine_code_gives_the_same_bits(name: str) -> None:
    t = np.linspace(0.0, scene(name).reference.end_time, 100)
    interpreted, compiled = (sc.DynamicInversion(scene(name), native=native)(t) for native in (False, True))
    np.testing.assert_array_equal(compiled, interpreted)


def test_redundant_coordinates_give_the_same_inputs() -> None:
    known = exact("passive_joint_arm")
    inputs = sc.DynamicInversion(scene("passive_joint_arm"), "points", tolerance=1e-8)
    assert error(inputs(known.t[::4]), known, inputs.inputs) <= 1e-6


def test_a_start_and_another_path_are_taken() -> None:
    start = {"s": 0.1, "s_dot": -0.2}
    known = exact("mass_on_car", start=start)
    inputs = sc.DynamicInversion(scene("mass_on_car"), tolerance=1e-8, start=start)
    assert error(inputs(known.t[::4]), known, inputs.inputs) <= 1e-7
    table = scene("mass_on_car").reference
    t = np.linspace(0.0, table.end_time, 200)
    sampled = scene("mass_on_car").with_reference(sc.sampled(t, table.jet(t, 0)[:, 0]))
    of_table = sc.DynamicInversion(sampled, tolerance=1e-6)(t)
    by_steps = sc.solve(sampled, sc.Reduced(), sc.RadauIIA(5), step=table.duration / 1990)
    peak = np.abs(by_steps.values[:, 0]).max()
    assert np.abs(np.interp(t, by_steps.t, by_steps.values[:, 0]) - of_table[:, 0]).max() < 1e-4 * peak


def test_one_instant_gives_one_row_and_instants_may_come_in_any_order() -> None:
    inputs = sc.DynamicInversion(scene("mass_on_car"))
    t = np.linspace(0.0, 4.0, 7)
    np.testing.assert_allclose(inputs(t[::-1])[::-1], inputs(t), rtol=1e-12)
    np.testing.assert_allclose(inputs(t[3]), inputs(t)[3], rtol=1e-9)


def test_steps_have_order_eight_and_polynomials_of_degree_seven_are_met() -> None:
    problem = sc.Problem.of(scene("mass_on_car"))
    steps = problem.resolved.once(compile_explicit_steps, problem.reference.formula, False)
    known = [steps.along(problem.reference, np.zeros(1), count) for count in (20, 40, 400)]
    ends = [steps.run(each, problem.p, np.zeros(2))[0][:, -1] for each in known]
    ratio = np.abs(ends[0] - ends[2]).max() / np.abs(ends[1] - ends[2]).max()
    assert 7.0 < np.log2(ratio) < 9.5
    x, place = np.arange(11.0), np.linspace(0.0, 10.0, 101)
    between = Between.of(place, 10)
    np.testing.assert_allclose(between.states(x[None] ** 7, 7.0 * x[None] ** 6, 1.0)[0], place**7, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", SCENES)
def test_sundials_comes_nearer_with_its_tolerance(name: str) -> None:
    known = exact(name)
    errors = [
        error(sc.solve(scene(name), sc.Reduced(), sc.Sundials(tolerance)).values[:, :1], known, known.names[:1])
        for tolerance in (1e-3, 1e-6, 1e-9)
    ]
    assert errors[0] < 1e-2
    assert errors[1] < 1e-5
    assert errors[2] < 1e-8


# Refusals ------------------------------------------------------------------------------------------------------------


def test_scenes_without_internal_dynamics_and_unstable_ones_are_sent_elsewhere() -> None:
    with pytest.raises(sc.InvalidModel, match="has no internal dynamics: ExactInversion computes its inputs"):
        sc.DynamicInversion(scene("overhead_crane"))
    with pytest.raises(sc.InvalidModel, match="has no internal dynamics: there is nothing to integrate"):
        sc.solve(scene("overhead_crane"), sc.Reduced(), sc.Sundials())


def test_stiff_dynamics_are_sent_elsewhere() -> None:
    stiff = scene("mass_on_car").with_parameters(stiffness=1e9, damping=1e7)
    with pytest.raises(sc.IntegrationFailed, match="stiff, and solve with RadauIIA steps them"):
        sc.DynamicInversion(stiff)


def test_times_outside_the_path_are_refused() -> None:
    inputs = sc.DynamicInversion(scene("mass_on_car"))
    with pytest.raises(sc.InvalidReference, match=r"times lie between 0 s and 4 s, not from -1 s to 5 s"):
        inputs([-1.0, 5.0])


def test_a_path_that_is_a_table_is_no_path_for_sundials() -> None:
    path = scene("mass_on_car").reference
    t = np.linspace(0.0, path.end_time, 50)
    sampled = scene("mass_on_car").with_reference(sc.sampled(t, path.jet(t, 0)[:, 0]))
    with pytest.raises(sc.InvalidReference, match="SUNDIALS needs a path that is a formula"):
        sc.solve(sampled, sc.Reduced(), sc.Sundials())


@pytest.mark.parametrize("wrong", [0.0, 1.0, -1e-3])
def test_tolerances_lie_between_zero_and_one(wrong: float) -> None:
    with pytest.raises(sc.InvalidSetting, match="between 0 and 1"):
        sc.Sundials(wrong)
    with pytest.raises(sc.InvalidSetting, match="between 0 and 1"):
        sc.DynamicInversion(replace(scene("mass_on_car")), tolerance=wrong)
