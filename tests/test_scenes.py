"""Every scene and every combination in the registry; then what is special about the cranes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from problems import (
    BACKWARD_EULER,
    FLAT_MODELS,
    FORMULATIONS,
    METHODS,
    MODELS,
    PROBLEMS,
    PROJECTED_MODELS,
    REFUSED,
    SCENES,
    UNSTABLE,
    FormulationCase,
    as_scene,
    driven_pendulum,
    largest_errors,
    polynomial_path,
    problem,
    scene,
    shares_of_peaks,
    solved,
)
from suite import FlatModelSuite, ModelSuite, ProblemSuite, ProjectedModelSuite, SceneSuite

import servocore as sc
from servocore.scenes.cars import MOST_MASSES
from servocore.scenes.heavy_rope import heavy_rope


def exported_implementations(package: str) -> set[str]:
    """Names of the public classes of a package that are named, without protocols and the values they exchange."""
    classes = (getattr(sc, name) for name in sc.__all__)
    return {
        each.__name__
        for each in classes
        if isinstance(each, type)
        and each.__module__.startswith(f"servocore.{package}.")
        and not getattr(each, "_is_protocol", False)
        and hasattr(each, "name")
    }


def test_everything_exported_is_registered_here() -> None:
    """A newcomer must take its line in `problems`, and with it the whole suite."""
    assert set(SCENES) == {*sc.scenes.REGISTRY, "driven_crane"}
    assert {type(each.formulation).__name__ for each in FORMULATIONS} == exported_implementations("formulations")
    assert {type(each.method).__name__ for each in METHODS} == exported_implementations("methods")


def test_only_what_is_shown_to_fail_is_kept_out_of_the_suite() -> None:
    every = {(name, model, each) for name, model in MODELS for each in FORMULATIONS}
    left_out = {(name, model, of) for name, model, of in every if (name, model, of.kind) in UNSTABLE.keys() | REFUSED}
    assert {(p.scene_name, p.model, p.of) for p in PROBLEMS} == every - left_out
    assert {(name, model, of.kind) for name, model, of in left_out} == set(UNSTABLE) | set(REFUSED)
    for name, case in SCENES.items():
        tried = {p.by.method for p in PROBLEMS if p.scene_name == name}
        everything = {each.method for each in METHODS if each.damped and each.steps}
        assert tried == (everything if case.projected_index <= 3 else {BACKWARD_EULER.method})


@pytest.mark.parametrize("scene_name", SCENES)
class TestEveryScene(SceneSuite):
    pass


@pytest.mark.parametrize(("scene_name", "model"), MODELS)
class TestEveryModel(ModelSuite):
    pass


@pytest.mark.parametrize(("scene_name", "model"), PROJECTED_MODELS)
class TestEveryProjectedModel(ProjectedModelSuite):
    pass


@pytest.mark.parametrize(("scene_name", "model"), FLAT_MODELS)
class TestEveryFlatModel(FlatModelSuite):
    pass


@pytest.mark.parametrize("problem", PROBLEMS, ids=str)
class TestEveryProblem(ProblemSuite):
    pass


def left_out(cases: Mapping[tuple[str, str, str], str]) -> list[object]:
    """Return scene, model and formulation of every case that was left out for its kind."""
    return [
        pytest.param(name, model, of, id=f"{name}-{model}-{of.formulation.name}")
        for name, model, kind in cases
        for of in FORMULATIONS
        if of.kind == kind
    ]


@pytest.mark.parametrize(("scene_name", "model", "of"), left_out(UNSTABLE))
@pytest.mark.parametrize("steps", [200, 1000])
def test_no_step_size_saves_the_original_equations_in_generalized_coordinates(
    scene_name: str, model: str, of: FormulationCase, steps: int
) -> None:
    step = scene(scene_name).reference.duration / steps
    with pytest.raises(sc.IntegrationFailed, match=r"the step from t = .* was not solved"):
        sc.solve(scene(scene_name), of.formulation, sc.BackwardEuler(), step=step, model=model)


@pytest.mark.parametrize(("scene_name", "model", "of"), left_out(REFUSED))
def test_models_that_a_formulation_cannot_take_are_refused_with_the_reason(
    scene_name: str, model: str, of: FormulationCase
) -> None:
    with pytest.raises(sc.InvalidModel, match=REFUSED[scene_name, model, of.kind]):
        sc.solve(scene(scene_name), of.formulation, sc.BackwardEuler(), model=model)


# The rotary crane, default manoeuvre, projected backward Euler: the paper's own way ----------------------------------

INPUTS = ("M_b", "F", "M_w")
ROTARY_MODELS = tuple(scene("rotary_crane").models)


def test_at_a_tenth_of_a_second_the_slewing_torque_is_wrong_by_tens_of_per_cent_and_the_rest_by_less_than_two() -> None:
    """What the paper's figures at this step cannot show: configuration exact, torque far from it."""
    for model in ROTARY_MODELS:
        what = problem("rotary_crane", model)
        exact = scene("rotary_crane").exact(solved(what, 200).t)
        share = largest_errors(what, 200, INPUTS) / [np.abs(exact[name]).max() for name in INPUTS]
        assert 0.1 < share[0] < 0.3
        assert (share[1:] < 0.02).all()


def sane_cranes() -> SearchStrategy[dict[str, float]]:
    """Draw parameters within a factor of three of the default."""
    factor = st.floats(0.35, 3.0)
    values = scene("rotary_crane").parameter_values()
    return st.fixed_dictionaries({name: factor.map(value.__mul__) for name, value in values.items()})


def load_points() -> SearchStrategy[tuple[float, float, float]]:
    """Draw points at 2.5 to 8 m from the axis and 1.5 to 8 m below the girder, whole millimetres."""
    return st.tuples(st.floats(2.5, 8.0), st.floats(-np.pi, np.pi), st.floats(-8.0, -1.5)).map(
        lambda c: (round(c[0] * np.cos(c[1]), 3), round(c[0] * np.sin(c[1]), 3), round(c[2], 3))
    )


def smallest_radius(start: tuple[float, float, float], end: tuple[float, float, float]) -> float:
    """Distance of the straight line between two points from the slewing axis."""
    a, b = np.array(start[:2]), np.array(end[:2])
    way = b - a
    along = np.clip(-(a @ way) / max(way @ way, 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(a + along * way))


@settings(max_examples=12)
@given(parameters=sane_cranes(), start=load_points(), end=load_points(), duration=st.floats(15.0, 40.0))
def test_every_sane_crane_and_manoeuvre_is_solved_to_first_order_with_exact_configuration(
    parameters: dict[str, float], start: tuple[float, float, float], end: tuple[float, float, float], duration: float
) -> None:
    assume(smallest_radius(start, end) > 2.0)
    assume(np.linalg.norm(np.subtract(start, end)) > 1.0)
    crane = scene("rotary_crane").with_parameters(**parameters).with_reference(sc.rest_to_rest(start, end, duration))
    errors = []
    for steps in (400, 800):
        found = sc.solve(crane, sc.Projected(), sc.BackwardEuler(), step=duration / steps)
        exact = crane.exact(found.t)
        for name in ("phi", "s", "l", "swing"):
            np.testing.assert_allclose(found[name], exact[name], rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(found["tension"], exact["tension"], rtol=1e-11)
        # Some inputs vanish on some paths (M_b on a radial one), so they are judged together, as forces on the load.
        arms = {"M_b": max(exact["s"]), "F": 1.0, "M_w": parameters["winch_radius"]}
        errors.append(max(np.abs(found[name] - exact[name]).max() / arm for name, arm in arms.items()))
    assert 1.8 < errors[0] / errors[1] < 2.2


# Closed forms against what they do not know --------------------------------------------------------------------------


def test_overhead_crane_s_closed_form_gives_the_published_instant() -> None:
    """Independently computed values for (0, -4) m to (5, -1) m in 3 s, at t = 0.75 s: docs/scenes.md."""
    found = scene("overhead_crane").exact(np.array([0.75]))
    expected = {"s": 1.6581329241, "l": 4.1042979426, "F": 417.51828439, "M_w": -139.21837745}
    for name, value in expected.items():
        assert found[name][0] == pytest.approx(value, abs=2e-8)


@pytest.mark.parametrize("scene_name", ["rotary_crane", "overhead_crane", "gantry_crane"])
def test_at_rest_only_the_winch_holds_the_load(scene_name: str) -> None:
    crane = scene(scene_name)
    p = crane.parameter_values()
    found = crane.exact(np.array([crane.reference.start_time, crane.reference.end_time]))
    np.testing.assert_allclose(found["M_w"], -p["load_mass"] * p["gravity"] * p["winch_radius"], rtol=1e-12)
    for name in {each.name for each in crane.model().inputs} - {"M_w"}:
        np.testing.assert_allclose(found[name], 0.0, atol=1e-9)
    np.testing.assert_allclose(found["tension"], p["load_mass"] * p["gravity"], rtol=1e-12)
    np.testing.assert_allclose(found["swing"], 0.0, atol=1e-12)


def test_a_scene_makes_each_of_its_models_once_whatever_makes_them() -> None:
    made = []

    def pendulum() -> sc.MechanicalSystem:
        made.append(driven_pendulum())
        return made[-1]

    one = sc.Scene(name="pendulum", models={"only": pendulum}, reference=polynomial_path([[0.0], [1.0]]))
    other = one.with_reference(polynomial_path([[0.0], [2.0]]))
    assert one.model() is other.model("only")
    assert len(made) == 1


@pytest.mark.parametrize("chain", [sc.scenes.cars, sc.scenes.elastic_bar])
def test_chains_of_equal_length_share_a_model_and_others_do_not(chain: Callable[..., sc.Scene]) -> None:
    assert chain(4).model() is chain(4).model()
    assert chain(4).model() is not chain(3).model()
    assert sc.scenes.cars(4).model() is not sc.scenes.elastic_bar(4).model()


CHAINS = [
    *((sc.scenes.cars, (count,)) for count in (2, 3, 4, 7, MOST_MASSES)),
    *((sc.scenes.elastic_bar, (count,)) for count in (2, 3, 6, 12)),
    *((heavy_rope, (elements, 3)) for elements in (1, 2)),
]


@pytest.mark.parametrize(("chain", "size"), CHAINS)
def test_chains_of_any_length_return_the_closed_form_at_any_step(
    chain: Callable[..., sc.Scene], size: tuple[int, ...]
) -> None:
    """Of their own data, and of others."""
    random, own = np.random.default_rng(size), chain(*size)
    other = {name: random.uniform(0.5, 2.0) * value for name, value in own.parameter_values().items()}
    for this in (own, own.with_parameters(**other)):
        solution = sc.solve(this, sc.Reduced(), step=this.reference.duration / 20)
        moving = [name for name, values in this.exact(solution.t).items() if np.abs(values).max() > 1e-9]
        assert shares_of_peaks(this, solution, moving).max() < 1e-11


def test_closed_form_needs_a_scene_that_has_one() -> None:
    bare = as_scene(driven_pendulum(), polynomial_path([[0.0], [1.0]]))
    with pytest.raises(sc.InvalidModel, match="pendulum has no closed form"):
        bare.exact(np.array([0.0]))
