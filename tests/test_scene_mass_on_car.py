"""The mass on a car: one scene whose data decide about index and internal dynamics."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import servocore as sc
from servocore.numerics.compiled_calls import Array

LEVEL = {"inclination": 0.0}
FLAT = {"inclination": 0.0, "damping": 0.0}
UNSTABLE = {"stiffness": -5.0}
DURATION = 4.0
MODELS = ("generalized", "points")


@cache
def scene(**changed: float) -> sc.Scene:
    return sc.scenes.mass_on_car().with_parameters(**changed)


@cache
def scene_of(kind: str) -> sc.Scene:
    changed = {"inclined": {}, "level": LEVEL, "flat": FLAT, "undamped": {"damping": 0.0}, "unstable": UNSTABLE}[kind]
    return sc.scenes.mass_on_car().with_parameters(**changed)


@cache
def exact_on_grid(kind: str, steps: int) -> dict[str, Array]:
    return scene_of(kind).exact(np.linspace(0.0, DURATION, steps + 1))


def errors(
    kind: str, formulation: sc.Formulation, steps: int, model: str, names: tuple[str, ...] = ("u", "x", "s")
) -> Array:
    """Largest errors of backward Euler, as fractions of the largest exact values."""
    solution = sc.solve(scene_of(kind), formulation, sc.BackwardEuler(), step=DURATION / steps, model=model)
    exact = exact_on_grid(kind, steps)
    return np.array([np.abs(solution[name] - exact[name]).max() / np.abs(exact[name]).max() for name in names])


@pytest.mark.parametrize("model", MODELS)
def test_without_internal_dynamics_the_reduced_form_is_exact_at_any_step(model: str) -> None:
    for steps in (10, 100):
        assert errors("flat", sc.Reduced(), steps, model, ("u", "x", "s", "y")).max() < 1e-12


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("kind", ["inclined", "level", "undamped"])
@pytest.mark.parametrize("formulation", [sc.Reduced(), sc.Projected()], ids=lambda each: each.name)
def test_with_internal_dynamics_backward_euler_converges_at_first_order(
    model: str, kind: str, formulation: sc.Formulation
) -> None:
    coarse, fine = (errors(kind, formulation, steps, model) for steps in (800, 1600))
    np.testing.assert_allclose(coarse / fine, 2.0, atol=0.1)
    assert fine[0] < 0.01


@pytest.mark.parametrize("kind", ["inclined", "level"])
def test_radau_of_order_five_meets_the_independent_solution_close_to_round_off(kind: str) -> None:
    this = scene_of(kind)
    solution = sc.solve(this, sc.Reduced(), sc.RadauIIA(3), step=DURATION / 400)
    exact = exact_on_grid(kind, 400)
    for name in ("u", "x", "s"):
        np.testing.assert_allclose(solution[name], exact[name], rtol=0.0, atol=1e-10 * np.abs(exact[name]).max())


def test_the_bounded_solution_of_the_unstable_variant_moves_before_the_path_and_fades_on_both_sides() -> None:
    this = scene_of("unstable")
    exact = this.exact(np.array([-15.0, -1.0, 0.0, 4.0, 5.0, 19.0]))
    far = np.abs(exact["s"][[0, -1]])
    assert (far < 1e-10).all()
    assert (np.abs(exact["s"][1:-1]) > 1e-3).all()
    assert abs(exact["u"][1]) > 1e-3
    level = scene(**LEVEL, **UNSTABLE).exact(np.array([-1.0, 0.0, 4.0, 5.0]))
    assert (np.abs(level["s"][:2]) > 1e-4).all()
    np.testing.assert_array_equal(level["s"][2:], 0.0)


def test_a_mass_on_a_vertical_support_is_carried_along_and_its_spring_stays_at_rest() -> None:
    exact = scene(inclination=np.pi / 2).exact(np.linspace(0.0, 4.0, 9))
    np.testing.assert_allclose(exact["s"], 0.0, atol=1e-15)
    np.testing.assert_allclose(exact["x"], exact["y"], atol=1e-15)


@pytest.mark.parametrize("kind", ["inclined", "level", "flat"])
def test_under_the_exact_force_the_mass_returns_to_its_path(kind: str) -> None:
    this = scene_of(kind)
    t = np.linspace(0.0, DURATION, 401)
    spline = make_interp_spline(t, this.exact(t)["u"], k=5)
    for model in MODELS if kind == "inclined" else MODELS[:1]:
        plant = sc.simulate(this, lambda time: spline([time])[0:1], t=t, model=model)
        assert plant["tracking_error"].max() < 1e-7


def test_without_inclination_spring_and_damper_nothing_determines_the_mass() -> None:
    loose = scene(**FLAT, stiffness=0.0)
    with pytest.raises(sc.InvalidModel, match="the path does not determine s"):
        loose.exact(np.zeros(1))
    assert sc.analyse(loose).classification == "singular here"
