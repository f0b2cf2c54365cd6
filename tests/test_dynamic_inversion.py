"""Inputs of scenes with internal dynamics, prepared once, and by SUNDIALS: those that small steps give."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import present
from problems import scene

import servocore as sc

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
    sampled, t = sampled_car(), np.linspace(0.0, 4.0, 200)
    of_table = sc.DynamicInversion(sampled, tolerance=1e-6)(t)
    by_steps = sc.solve(sampled, sc.Reduced(), sc.RadauIIA(5), step=4.0 / 1990)
    peak = np.abs(by_steps.values[:, 0]).max()
    assert np.abs(np.interp(t, by_steps.t, by_steps.values[:, 0]) - of_table[:, 0]).max() < 1e-4 * peak


def test_one_instant_gives_one_row_and_instants_may_come_in_any_order() -> None:
    inputs = sc.DynamicInversion(scene("mass_on_car"))
    t = np.linspace(0.0, 4.0, 7)
    np.testing.assert_allclose(inputs(t[::-1])[::-1], inputs(t), rtol=1e-12)
    np.testing.assert_allclose(inputs(t[3]), inputs(t)[3], rtol=1e-9)


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


# Counts --------------------------------------------------------------------------------------------------------------


def sampled_car() -> sc.Scene:
    """Return the mass on a car on a path that is a table."""
    car = scene("mass_on_car")
    t = np.linspace(0.0, car.reference.end_time, 200)
    return car.with_reference(sc.sampled(t, car.reference.jet(t, 0)[:, 0]))


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("of_a_table", [False, True])
def test_a_call_is_one_of_machine_code_at_instants_that_are_new_too(
    of_a_table: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs = sc.DynamicInversion(sampled_car() if of_a_table else scene("mass_on_car"), native=True)
    runs, asked = inputs._steps.runs, list[object]()
    compiled = present(runs._code.best(1))

    def counted(*given: object) -> object:
        asked.append(given)
        return compiled(*given)

    monkeypatch.setattr(runs._code, "_loaded", counted)
    monkeypatch.setattr(runs, "_interpreted", None)
    for last in (4.0, 4.0, 3.0, 2.0):
        inputs(np.linspace(0.0, last, 201))
    assert len(asked) == 4


def test_a_path_is_evaluated_at_the_steps_once_and_at_instants_that_are_new_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    car = sampled_car()
    inputs = sc.DynamicInversion(car, native=False)
    asked, evaluate = list[int](), type(car.reference)._derivatives

    def counted(path: sc.Reference, t: np.ndarray, order: int) -> np.ndarray:
        asked.append(len(t))
        return evaluate(path, t, order)

    monkeypatch.setattr(type(car.reference), "_derivatives", counted)
    for last, instants in ((4.0, 180), (4.0, 180), (3.0, 150), (4.0, 180)):
        inputs(np.linspace(0.0, last, instants))
    assert asked == [180, 150, 180]


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("native", [False, True])
def test_instants_that_are_changed_afterwards_and_threads_that_ask_at_once_mix_nothing_up(native: bool) -> None:
    inputs = sc.DynamicInversion(scene("mass_on_car"), native=native)
    t = np.linspace(0.0, 4.0, 201)
    first = inputs(t).copy()
    t *= 0.5
    halved = inputs(t).copy()
    t *= 2.0
    np.testing.assert_array_equal(inputs(t), first)
    with ThreadPoolExecutor(4) as pool:
        for k, found in enumerate(pool.map(inputs, [t, 0.5 * t] * 50)):
            np.testing.assert_array_equal(found, halved if k % 2 else first)


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
    for car, native in ((scene("mass_on_car"), False), (scene("mass_on_car"), None), (sampled_car(), False)):
        inputs = sc.DynamicInversion(car, native=native)
        with pytest.raises(sc.InvalidReference, match=r"times lie between 0 s and 4 s, not from -1 s to 5 s"):
            inputs([-1.0, 5.0])
        with pytest.raises(sc.InvalidReference, match="not from nan s to nan s"):
            inputs([[0.0, 1.0], [np.nan, 2.0]])
        with pytest.raises(sc.InvalidReference, match="the times of inputs must be numbers"):
            inputs("soon")
        assert inputs([]).shape == (0, 1)


def test_a_path_that_is_a_table_is_no_path_for_sundials() -> None:
    with pytest.raises(sc.InvalidReference, match="SUNDIALS needs a path that is a formula"):
        sc.solve(sampled_car(), sc.Reduced(), sc.Sundials())


@pytest.mark.parametrize("wrong", [0.0, 1.0, -1e-3])
def test_tolerances_lie_between_zero_and_one(wrong: float) -> None:
    with pytest.raises(sc.InvalidSetting, match="between 0 and 1"):
        sc.Sundials(wrong)
    with pytest.raises(sc.InvalidSetting, match="between 0 and 1"):
        sc.DynamicInversion(replace(scene("mass_on_car")), tolerance=wrong)
