"""Right or refused, on systems that are no scenes of ours: compared with answers by other means."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import casadi as ca
import numpy as np
import pytest
from outside import hanging, linkages, moving, timed
from outside.slider_crank import slider_crank_from_rest
from outside.systems import aircraft
from outside.writing import Case

import servocore as sc

CASES = {
    make.__name__: make
    for make in (
        hanging.quadrotor_with_a_load,
        hanging.double_pendulum_crane,
        hanging.boom_crane,
        hanging.tower_crane,
        hanging.rope_robot,
        linkages.arm_with_flexible_joints,
        linkages.four_bars_driven_at_the_rocker,
        linkages.five_bars_pinned_twice,
        linkages.platform_on_three_legs,
        linkages.elastic_slider_crank,
        moving.two_cars_with_a_cubic_spring,
        moving.three_cars_with_cubic_springs,
        moving.two_cars_with_a_damper,
        moving.spring_and_damper_in_series,
        moving.cart_with_a_pendulum,
        moving.cart_pole,
        moving.container_crane,
        moving.block_on_a_wedge,
        moving.satellite,
        timed.load_below_a_ship,
        timed.pendulum_in_the_wind,
        slider_crank_from_rest,
    )
} | {
    "quadrotor_with_zeros_in_its_input_matrix": partial(hanging.quadrotor_with_a_load, generalized=True, zeros=True),
    "quadrotor_in_generalized_coordinates": partial(hanging.quadrotor_with_a_load, generalized=True),
    "elastic_slider_crank_in_two_coordinates": partial(linkages.elastic_slider_crank, generalized=True),
    "slider_crank_with_small_deflections": partial(slider_crank_from_rest, nominal=1e-5),
    "cars_of_a_micrometre_said_to_be_a_metre": partial(moving.chain_of_cars, (1.0, 1.0), unit=1e-6),
    **{
        f"{name}_of_{size}": partial(make, unit=unit, nominal=unit)
        for name, make, sizes in (
            ("quadrotor", hanging.quadrotor_with_a_load, {"a_micrometre": 1e-6, "a_megametre": 1e6}),
            (
                "cars",
                partial(moving.chain_of_cars, (1.0, 1.0)),
                {"a_nanometre": 1e-9, "a_micrometre": 1e-6, "a_kilometre": 1e3},
            ),
        )
        for size, unit in sizes.items()
    },
}


@cache
def case(name: str) -> Case:
    return CASES[name]()


def every_case() -> pytest.MarkDecorator:
    return pytest.mark.parametrize("name", CASES)


def error(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.abs(found - exact).max() / np.abs(exact).max())


def errors(of: Case) -> dict[str, float]:
    solution = of.solution()
    return {name: error(solution[name], each) for name, each in of.exact(solution.t, of.scene.reference).items()}


@every_case()
def test_the_analysis_finds_its_index_and_what_is_left_to_integrate(name: str) -> None:
    report = sc.analyse(case(name).scene)
    assert (report.index, report.internal_degrees_of_freedom) == (case(name).index, case(name).internal)
    assert (report.classification == "flat") == (case(name).internal == 0)


@every_case()
def test_its_solution_is_the_answer_by_other_means(name: str) -> None:
    found = errors(case(name))
    assert max(found.values()) <= case(name).tolerance, found


@pytest.mark.parametrize("name", [each for each in CASES if each != "cart_pole"])
def test_its_inputs_at_random_instants_are_exact_where_it_is_flat(name: str) -> None:
    if case(name).internal:
        with pytest.raises(sc.InvalidModel, match="internal dynamics"):
            sc.ExactInversion(case(name).scene)
        return
    reference = case(name).scene.reference
    times = np.random.default_rng(11).uniform(reference.start_time, reference.end_time, 40)
    exact, inputs = case(name).exact(times, reference), sc.ExactInversion(case(name).scene)(times)
    for k, each in enumerate(case(name).scene.model().inputs):
        assert error(inputs[:, k], exact[each.name]) <= case(name).tolerance


@pytest.mark.parametrize("steps", [50, 100, 200, 1000])
def test_a_pole_of_an_input_is_not_stepped_over(steps: int) -> None:
    """The force is -m x''/sin(roll), and the roll passes zero on the way."""
    upright = aircraft(0.0)
    reference, q = upright.gamma, upright.coordinates
    rolling = replace(
        upright, output=ca.vertcat(q["x"], q["theta"]), guess=ca.vertcat(reference[0, 0], 0.0, reference[1, 0]),
        home=(0.0, 0.3),
    )  # fmt: skip
    path = sc.rest_to_rest((0.0, -0.2), (1.0, 0.3), 2.0)
    with pytest.raises(sc.ServocoreError, match=r"singular|no relative degree|pole"):
        sc.solve(sc.Scene("roll", {"aircraft": lambda: rolling}, path), step=2.0 / steps)
