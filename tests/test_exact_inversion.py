"""`ExactInversion` gives the closed form's inputs at any instants, and refuses what it cannot answer."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from present import present
from problems import FLAT_MODELS, scene

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.structure.inversion import inversion

CRANE = scene("rotary_crane")
POINTWISE = [(name, model) for name, model in FLAT_MODELS if scene(name).closed_form is not None]


def assert_exact(found: Array, exact: dict[str, Array], names: tuple[str, ...]) -> None:
    for k, name in enumerate(names):
        assert np.abs(found[:, k] - exact[name]).max() <= 1e-11 * np.abs(exact[name]).max()


@pytest.mark.parametrize(("name", "model"), POINTWISE)
def test_the_inputs_are_those_of_the_closed_form(name: str, model: str) -> None:
    problem = scene(name)
    t = np.linspace(problem.reference.start_time, problem.reference.end_time, 101)
    inputs = sc.ExactInversion(problem, model)
    assert inputs.inputs == tuple(each.name for each in problem.model(model).inputs)
    assert_exact(inputs(t), problem.exact(t), inputs.inputs)


def test_all_cranes_are_among_the_scenes_with_one_expression() -> None:
    for name in ("rotary_crane", "overhead_crane", "gantry_crane"):
        found = inversion(sc.Problem.of(scene(name), "points").array).expression
        assert found is not None
        assert found.n_instructions() < 1000


@pytest.mark.parametrize("name", ["boom_crane", "quadrotor_with_load"])
def test_forces_of_which_the_guess_knows_only_their_size_at_rest_take_no_iterations(name: str) -> None:
    """The rope's direction is unknown in space as its force is: a nonlinear block with a force in it."""
    problem = sc.Problem.of(scene(name))
    array = problem.array
    expression = inversion(array).expression
    t = np.linspace(problem.reference.start_time, problem.reference.end_time, 101)
    for jet in problem.reference.jet(t, array.reference_order):
        assert expression is not None
        _, _, residual = expression(jet.T, problem.p)
        assert float(residual) < 1e-10


@given(st.permutations(range(12)))
def test_instants_stand_alone_in_any_order(order: Array) -> None:
    t = np.linspace(0.0, 20.0, 12)
    inputs = sc.ExactInversion(CRANE)
    np.testing.assert_array_equal(inputs(t[list(order)]), inputs(t)[list(order)])


def test_one_instant_gives_one_row_and_none_gives_none() -> None:
    inputs = sc.ExactInversion(CRANE)
    np.testing.assert_array_equal(inputs(7.3), inputs([7.3])[0])
    assert inputs([]).shape == (0, 3)


def test_before_and_after_the_path_the_crane_is_held_at_rest() -> None:
    weight = CRANE.parameter_values()
    np.testing.assert_allclose(
        sc.ExactInversion(CRANE)([-5.0, 25.0]),
        np.tile([0.0, 0.0, -weight["load_mass"] * weight["gravity"] * weight["winch_radius"]], (2, 1)),
        atol=1e-9,
    )


def test_a_guess_that_is_not_exact_costs_time_and_nothing_else() -> None:
    system = CRANE.model("points")
    astray = replace(system, guess=system.guess + 0.05 * (system.guess != 0))
    crane = replace(CRANE, models={"points": lambda: astray})
    t = np.linspace(0.0, 20.0, 51)
    array = sc.Problem.of(crane).array
    jet = CRANE.reference.jet(7.0, array.reference_order)
    quick = present(inversion(array).expression)(jet.T, astray.parameters.values({}))[0]
    assert np.isnan(np.asarray(quick)).any()
    assert_exact(sc.ExactInversion(crane)(t), CRANE.exact(t), ("M_b", "F", "M_w"))
    assert_exact(sc.solve(crane, sc.Reduced(), step=0.4).values, CRANE.exact(t), ("M_b", "F", "M_w"))


# Refusals ------------------------------------------------------------------------------------------------------------


def test_internal_dynamics_are_refused() -> None:
    with pytest.raises(sc.InvalidModel, match=r"passive_joint_arm has internal dynamics: .* path; use solve"):
        sc.ExactInversion(scene("passive_joint_arm"))


def test_a_scene_that_follows_a_branch_is_refused() -> None:
    with pytest.raises(sc.InvalidModel, match="rotary_crane follows a branch"):
        sc.ExactInversion(replace(CRANE, follow_branch=True))


def test_a_path_without_enough_derivatives_is_refused() -> None:
    rough = replace(CRANE.reference, max_order=3)
    with pytest.raises(sc.InvalidReference, match="derivatives up to order 3, the inputs of rotary_crane need order 4"):
        sc.ExactInversion(CRANE.with_reference(rough))


@pytest.mark.parametrize("name", ["rotary_crane", "overhead_crane"])
def test_few_instants_and_many_calls_give_the_same_bits(name: str) -> None:
    """From the second call on few instants are evaluated together with the path, without NumPy."""
    some = scene(name)
    t = np.linspace(-1.0, some.reference.end_time + 1.0, 37)
    inputs = sc.ExactInversion(some, native=False)
    first = inputs(t)
    np.testing.assert_array_equal(inputs(t), first)
    np.testing.assert_array_equal(inputs(np.repeat(t, 10))[::10], first)
