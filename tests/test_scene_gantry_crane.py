"""The gantry crane: exact inversion, first order of the projected form, and the overhead crane as its plane case."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import servocore as sc
from servocore.numerics.compiled_calls import Array

INPUTS = ("F_x", "F_y", "M_w")


@cache
def scene() -> sc.Scene:
    return sc.scenes.gantry_crane()


def errors(solution: sc.Solution, names: tuple[str, ...] = INPUTS) -> Array:
    """Largest errors, as fractions of the largest exact values."""
    exact = scene().exact(solution.t)
    return np.array([np.abs(solution[name] - exact[name]).max() / np.abs(exact[name]).max() for name in names])


@pytest.mark.parametrize("model", scene().models)
def test_the_reduced_form_returns_the_closed_form_at_any_step(model: str) -> None:
    exact = scene().exact(np.zeros(1))
    for step in (0.5, 0.1):
        solution = sc.solve(scene(), sc.Reduced(), step=step, model=model)
        assert set(exact) <= set(solution.names)
        assert errors(solution, tuple(exact)).max() < 1e-12


@pytest.mark.parametrize("model", scene().models)
def test_the_projected_form_gives_the_motion_exactly_and_the_inputs_to_first_order(model: str) -> None:
    coarse, fine = (sc.solve(scene(), sc.Projected(), sc.BackwardEuler(), step=h, model=model) for h in (0.01, 0.005))
    assert errors(fine, ("s_x", "s_y", "l", "tension", "swing")).max() < 1e-12
    np.testing.assert_allclose(errors(coarse) / errors(fine), 2.0, atol=0.1)
    assert errors(fine).max() < 0.01


def test_under_the_exact_inputs_the_load_returns_to_its_path() -> None:
    inputs = sc.solve(scene(), sc.Reduced(), step=0.01)
    for model in scene().models:
        assert sc.simulate(scene(), inputs, model=model)["tracking_error"].max() < 1e-7


def test_at_rest_the_winch_holds_the_load_and_the_axes_are_free_of_force() -> None:
    weight = 70.0 * 9.81
    exact = scene().with_parameters(load_mass=70.0, winch_radius=0.2).exact(np.array([0.0, 6.0]))
    np.testing.assert_allclose(exact["M_w"], -0.2 * weight, rtol=1e-14)
    np.testing.assert_allclose(exact["tension"], weight, rtol=1e-14)
    np.testing.assert_allclose([exact["F_x"], exact["F_y"], exact["swing"]], 0.0, atol=1e-12)


@pytest.mark.parametrize("along_x", [True, False])
def test_in_a_vertical_plane_it_is_the_overhead_crane(along_x: bool) -> None:
    overhead = sc.scenes.overhead_crane()
    start, end = ((0.0, 2.0, -4.0), (5.0, 2.0, -1.0)) if along_x else ((2.0, 0.0, -4.0), (2.0, 5.0, -1.0))
    gantry = scene().with_parameters(bridge_mass=0.0).with_reference(sc.rest_to_rest(start, end, 3.0))
    found, expected = sc.solve(gantry, sc.Reduced(), step=0.1), overhead.exact(np.linspace(0.0, 3.0, 31))
    used, idle = ("x", "y") if along_x else ("y", "x")
    np.testing.assert_allclose(found[f"F_{used}"], expected["F"], rtol=0.0, atol=1e-10 * np.abs(expected["F"]).max())
    np.testing.assert_allclose(found["M_w"], expected["M_w"], rtol=1e-10)
    np.testing.assert_allclose(found[f"F_{idle}"], 0.0, atol=1e-10)
    np.testing.assert_allclose(found["swing"], np.abs(expected["swing"]), atol=1e-10)


def test_the_bridge_is_accelerated_by_f_x_alone() -> None:
    t = np.linspace(0.0, 6.0, 13)
    light, heavy = (scene().with_parameters(bridge_mass=mass).exact(t) for mass in (0.0, 30.0))
    accelerations = (heavy["F_x"] - light["F_x"]) / 30.0
    h = 1e-3
    before, at, after = (scene().exact(t[1:-1] + shift)["s_x"] for shift in (-h, 0.0, h))
    np.testing.assert_allclose(accelerations[1:-1], (before - 2 * at + after) / h**2, atol=1e-5)
    np.testing.assert_array_equal(heavy["F_y"], light["F_y"])


@pytest.mark.parametrize(
    ("end", "duration", "sentence"),
    [((0.0, 0.0, -9.0), 1.0, "the rope goes slack"), ((1.0, 1.0, 0.5), 9.0, "the load is not below the trolley")],
)
def test_a_path_that_it_cannot_follow_is_refused_with_the_reason(
    end: tuple[float, float, float], duration: float, sentence: str
) -> None:
    steep = scene().with_reference(sc.rest_to_rest((0.0, 0.0, -5.0), end, duration))
    with pytest.raises(sc.InvalidReference, match=sentence):
        sc.solve(steep)
