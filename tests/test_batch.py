"""A batch gives for every case what an inversion of that case gives."""

from dataclasses import replace

import numpy as np
import pytest
from problems import scene

import servocore as sc
from servocore.numerics.compiled_calls import Array

CRANE, CAR = scene("rotary_crane"), scene("mass_on_car")
T, INSTANTS = np.linspace(0.0, 20.0, 41), np.linspace(0.0, 4.0, 33)
MASSES = np.linspace(50.0, 150.0, 7)
STIFFNESS = CAR.model().parameters.values({})[2] * np.array([0.8, 1.0, 1.3])


def paths(of: sc.Scene, count: int) -> list[sc.Reference]:
    path = of.reference
    start, end = path.jet(np.array([path.start_time, path.end_time]), 0)[:, 0]
    return [sc.rest_to_rest(start, start + (end - start) * (0.5 + k / 20), path.duration) for k in range(count)]


def alone(of: sc.Scene, tolerance: float = 1e-6) -> Array:
    if of.name == CAR.name:
        return sc.DynamicInversion(of, native=False, tolerance=tolerance)(INSTANTS)
    return sc.ExactInversion(of, native=False)(T)


@pytest.mark.parametrize("native", [False, True])
@pytest.mark.parametrize(
    ("of", "t", "name", "values"),
    [(CRANE, T, "load_mass", MASSES), (CAR, INSTANTS, "stiffness", STIFFNESS)],
    ids=["exact", "internal dynamics"],
)
@pytest.mark.usefixtures("compiler")
def test_every_case_has_the_bits_of_its_own_inversion(
    of: sc.Scene, t: Array, name: str, values: Array, native: bool
) -> None:
    batch, ways = sc.Batch(of, native=native), paths(of, len(values))
    changed = [of.with_parameters(**{name: each}) for each in values]
    np.testing.assert_array_equal(batch(t, {name: values}), [alone(each) for each in changed])
    moved = [alone(of.with_reference(each)) for each in ways]
    np.testing.assert_array_equal(batch(t, paths=ways), moved)
    both = [alone(each.with_reference(path)) for each, path in zip(changed, ways, strict=True)]
    np.testing.assert_array_equal(batch(t, {name: values}, ways), both)
    np.testing.assert_array_equal(batch(t)[0], alone(of))


def test_quantities_are_those_that_solve_reports() -> None:
    batch = sc.Batch(CRANE, ("l", "M_b"))
    solution = sc.solve(CRANE.with_parameters(load_mass=80.0), step=0.5)
    (found,) = batch(T, {"load_mass": [80.0]})
    np.testing.assert_array_equal(found, np.column_stack([solution["l"], solution["M_b"]]))


def test_paths_that_are_tables_will_do_and_one_case_is_a_case() -> None:
    t = np.linspace(0.0, 20.0, 60)
    sampled = sc.sampled(t, CRANE.reference.jet(t, 0)[:, 0])
    batch = sc.Batch(CRANE)
    np.testing.assert_array_equal(batch(T, paths=[sampled])[0], sc.ExactInversion(CRANE.with_reference(sampled))(T))
    assert batch(T).shape == (1, 41, 3)


def test_what_the_quick_function_leaves_open_is_searched() -> None:
    system = CRANE.model("points")
    astray = replace(system, guess=system.guess + 0.05 * (system.guess != 0))
    crane = replace(CRANE, models={"points": lambda: astray})
    found = sc.Batch(crane)(T, {"load_mass": MASSES[:2]})
    np.testing.assert_allclose(found, sc.Batch(CRANE)(T, {"load_mass": MASSES[:2]}), rtol=1e-9, atol=1e-9)


def test_another_branch_gives_no_numbers() -> None:
    jerked = sc.rest_to_rest((5.0, 0.0, -1.0), (5.0, 1.0, -0.2), 0.4)
    found = sc.Batch(CRANE)([0.0, 0.3], paths=[jerked])
    assert np.isfinite(found[0, 0]).all()
    assert np.isnan(found[0, 1]).all()


def test_what_is_wrong_is_named() -> None:
    batch = sc.Batch(CRANE)
    with pytest.raises(sc.InvalidModel, match="has no parameter weight; it has"):
        batch(T, {"weight": MASSES})
    with pytest.raises(sc.InvalidSetting, match="a batch of 7 sets of parameters has one path a set, not 3"):
        batch(T, {"load_mass": MASSES}, paths(CRANE, 3))
    with pytest.raises(sc.InvalidModel, match="rotary_crane reports no colour; it has"):
        sc.Batch(CRANE, ("colour",))
    with pytest.raises(sc.InvalidModel, match="follows a branch: its cases are solved one by one"):
        sc.Batch(replace(CRANE, follow_branch=True))


# Internal dynamics ---------------------------------------------------------------------------------------------------


def test_paths_of_several_kinds_and_durations_go_together() -> None:
    longer = sc.rest_to_rest((0.0,), (1.0,), 5.0)
    t = np.linspace(0.0, 4.0, 80)
    table = sc.sampled(t, CAR.reference.jet(t, 0)[:, 0])
    own = [CAR.reference, longer, table, paths(CAR, 2)[1]]
    found = sc.Batch(CAR, tolerance=1e-8)(INSTANTS, paths=own)
    for each, values in zip(own, found, strict=True):
        known = alone(CAR.with_reference(each), tolerance=1e-8)
        np.testing.assert_allclose(values, known, atol=1e-7 * np.abs(known).max())


def test_a_start_and_quantities_by_name_are_those_of_solve() -> None:
    start = {"s": 0.1, "s_dot": -0.2}
    known = sc.solve(CAR, sc.Reduced(), sc.RadauIIA(7), step=0.0125, start=start)
    (found,) = sc.Batch(CAR, ("x", "s", "u"), tolerance=1e-9, start=start)(known.t)
    for column, name in zip(found.T, ("x", "s", "u"), strict=True):
        np.testing.assert_allclose(column, known[name], atol=1e-7 * np.abs(known[name]).max())


def test_a_case_takes_smaller_steps_where_it_needs_them_and_gives_no_numbers_where_they_do_not_help() -> None:
    found = sc.Batch(CAR)(INSTANTS, {"stiffness": [*STIFFNESS, 300 * STIFFNESS[1], 1e9]})
    np.testing.assert_array_equal(found[:3], sc.Batch(CAR)(INSTANTS, {"stiffness": STIFFNESS}))
    known = alone(CAR.with_parameters(stiffness=300 * STIFFNESS[1]))
    np.testing.assert_allclose(found[3], known, atol=3e-6 * np.abs(known).max())
    assert np.isnan(found[4]).all()


def test_what_is_wrong_with_internal_dynamics_is_named() -> None:
    with pytest.raises(sc.InvalidReference, match=r"case 1 of a batch: its path runs from 0 s to 2 s, and the times"):
        sc.Batch(CAR)(INSTANTS, paths=[CAR.reference, sc.rest_to_rest((0.0,), (1.0,), 2.0)])
    with pytest.raises(sc.InvalidSetting, match="without a start"):
        sc.Batch(CRANE, start={"s": 0.1})
    with pytest.raises(sc.InvalidSetting, match="between 0 and 1"):
        sc.Batch(CAR, tolerance=2.0)


# solve ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["rotary_crane", "overhead_crane", "gantry_crane", "cars", "mass_on_car"])
def test_a_batch_solves_random_cases_as_each_is_solved_alone(name: str) -> None:
    random, case = np.random.default_rng(13), scene(name)
    system, path = case.model(), case.reference
    values = system.parameters.values(case.parameters)
    rows = {parameter: value * random.uniform(0.95, 1.05, 3)
            for parameter, value in zip(system.parameters.names, values, strict=True)}  # fmt: skip
    ends = path.jet(np.array([path.start_time, path.end_time]), 0)[:, 0]
    ways = [sc.rest_to_rest(ends[0], ends[0] + share * (ends[1] - ends[0]), path.duration * longer, sc.DEGREE13)
            for share, longer in random.uniform([0.7, 1.0], [1.0, 1.3], (3, 2))]  # fmt: skip
    quantities = (system.inputs[0].name, system.coordinates.names[0])
    found = sc.Batch(case, quantities).solve(rows, ways, steps=60)
    for number, way in enumerate(ways):
        own = case.with_parameters(**{each: row[number] for each, row in rows.items()}).with_reference(way)
        solution = sc.solve(own, step=way.duration / 60)
        np.testing.assert_allclose(
            found[number], np.column_stack([solution[each] for each in quantities]), rtol=1e-13, atol=1e-12
        )


def test_a_batch_refuses_what_solve_refuses_with_the_number_of_the_first_bad_case() -> None:
    batch, good = sc.Batch(CRANE), CRANE.reference
    for bad in (
        sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, 1.0), 20.0),  # above the girder
        sc.rest_to_rest((5.0, 0.0, -5.0), (-5.0, 0.0, -5.0), 20.0),  # through the axis
        sc.rest_to_rest((5.0, 0.0, -1.0), (5.0, 1.0, -0.2), 0.4),  # too fast: the rope would push
        sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 20.0, sc.DEGREE3),
    ):
        with pytest.raises(sc.ServocoreError) as alone:
            sc.solve(CRANE.with_reference(bad), step=bad.duration / 40)
        with pytest.raises(type(alone.value)) as together:
            batch.solve(paths=[good, good, bad, bad], steps=40)
        assert str(together.value) == f"case 2 of a batch: {alone.value}"


def test_a_batch_keeps_the_limits_of_the_scene_between_instants_too() -> None:
    limited = CRANE.with_limits(F=(None, 2.0))
    at_instants = sc.Batch(limited)(T[::10], {"load_mass": [50.0, 150.0]})  # which does not look
    assert (at_instants[:, :, 1] < 2.0).all()
    with pytest.raises(sc.LimitBroken, match=r"^case 1 of a batch: .* F "):
        sc.Batch(limited).solve({"load_mass": [50.0, 150.0]}, steps=4)
    assert sc.Batch(limited).solve({"load_mass": [50.0]}, steps=4).shape == (1, 5, 3)


def test_no_times_give_no_rows_for_every_case_and_no_cases_none() -> None:
    batch = sc.Batch(sc.scenes.overhead_crane())
    assert batch([], {"load_mass": [50.0, 60.0]}).shape == (2, 0, 2)
    assert batch(T, {"load_mass": []}).shape == (0, len(T), 2)


def test_a_value_out_of_bounds_is_told_with_the_number_of_its_case() -> None:
    batch = sc.Batch(CRANE)
    for bad in (-1.0, np.nan):
        with pytest.raises(sc.InvalidModel, match=r"^case 2 of a batch: .*load_mass"):
            batch.solve({"load_mass": [50.0, 60.0, bad, -2.0]})
    with pytest.raises(sc.InvalidSetting, match="a path is divided into one step or more, not 0"):
        batch.solve(steps=0)
