"""Formulations: all describe the same motion; C and D are what the paper says; refusals; exact special cases."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from problems import (
    METHODS,
    WRITTEN,
    MethodCase,
    actuated_chain,
    as_scene,
    car_chain,
    car_chain_exact,
    changed,
    driven_pendulum,
    polynomial_path,
    redundant_pendulum,
    scene,
)
from suite import FormulationSuite

import servocore as sc
from servocore.formulations.projected import project
from servocore.model.system import DERIVED
from servocore.numerics.compiled_calls import Array


@pytest.mark.parametrize(
    ("scene_name", "model", "of"),
    [pytest.param(*each, id=f"{each[0]}-{each[1]}-{each[2].formulation.name}") for each in WRITTEN],
)
class TestEveryFormulation(FormulationSuite):
    pass


def test_rows_of_newton_s_system_neither_grow_nor_vanish_as_the_step_falls() -> None:
    """The levels of equations are those of their largest terms; rows of accelerations may lack inputs."""
    h = ca.SX.sym("h")
    for formulation in (sc.Original(), sc.Projected()):
        dae = formulation.dae(scene("rotary_crane").model("points"))
        unknowns, rows = dae.scales(h)
        w = ca.vertcat(dae.x, dae.z)
        residual = ca.vertcat(ca.mtimes(dae.H, dae.x / h) - dae.f, dae.h) / rows
        sizes = ca.Function("rows", [w, dae.gamma, dae.p, h], [ca.mtimes(ca.jacobian(residual, w), ca.diag(unknowns))])
        coarse, fine = (np.abs(np.asarray(sizes(1.5, 1.0, 1.0, step))).max(axis=1) for step in (1e-4, 1e-6))
        assert (fine < 2 * coarse).all()
        assert (fine > coarse / 2)[: dae.f.numel()].all()


# The matrices C and D, equations (23) to (28) ------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["points", "bodies"])
def test_C_and_D_are_boolean_where_the_load_s_position_is_among_the_coordinates(model: str) -> None:  # noqa: N802
    """C picks the load's three coordinates, D all others, each once: together they are a permutation."""
    system = scene("rotary_crane").model(model)
    C, D = (np.asarray(ca.DM(matrix)) for matrix in (system.C, project(system)[0]))
    n = len(system.coordinates)
    assert C.shape == (3, n)
    assert D.shape == (n, n - 3)
    permutation = np.vstack([C, D.T])
    assert set(np.unique(permutation)) == {0.0, 1.0}
    np.testing.assert_array_equal(permutation @ permutation.T, np.eye(n))


def test_generalized_coordinates_have_a_D_that_turns_with_the_configuration() -> None:  # noqa: N802
    D, _ = project(scene("rotary_crane").model("generalized"))
    assert not D.is_constant()


def with_output(*rows: tuple[float, ...]) -> sc.MechanicalSystem:
    """Return two coupled masses whose servo output is a linear combination of positions."""
    chain = actuated_chain()
    return changed(
        chain,
        output=ca.mtimes(ca.SX(np.array(rows)), chain.q),
        outputs=chain.outputs[: len(rows)],
        inputs=chain.inputs[: len(rows)],
        gamma=DERIVED,
        home=(),
        input_matrix=chain.input_matrix[: len(rows), :],
    )


@pytest.mark.parametrize("row", [(1.0, 1.0), (2.0, 0.0), (-1.0, 0.0), (1.0, -3.0)])
def test_a_constant_C_that_selects_nothing_is_not_taken_for_boolean(row: tuple[float, float]) -> None:  # noqa: N802
    system = with_output(row)
    C, D, W = (np.asarray(ca.DM(each)) for each in (system.C, *project(system)))
    np.testing.assert_array_equal(C, [row])
    np.testing.assert_allclose(C @ D, 0.0, atol=1e-15)
    assert np.linalg.norm(D) > 0.5
    np.testing.assert_allclose(np.array([[3.0, 0.5], [0.5, 2.0]]) @ W, C.T, atol=1e-14)


def test_dependent_servo_outputs_are_refused() -> None:
    with pytest.raises(sc.InvalidModel, match="actuated chain: the servo outputs are dependent"):
        project(with_output((1.0, 2.0), (2.0, 4.0)))


# Massless coordinates -------------------------------------------------------------------------------------------------


def test_projection_refuses_a_servo_constrained_direction_without_mass_and_names_it() -> None:
    with pytest.raises(sc.InvalidModel, match=r"inertia in the servo constrained directions, .* singular on theta$"):
        sc.Projected().dae(redundant_pendulum("theta"))


def test_projection_refuses_a_singular_mass_block_and_names_all_of_it() -> None:
    """Two coordinates that move a mass together have no inertia against each other."""
    chain = changed(actuated_chain(), mass=ca.SX([[2.0, 2.0], [2.0, 2.0]]))
    with pytest.raises(sc.InvalidModel, match="singular on x1, x2"):
        sc.Projected().dae(chain)


def test_massless_coordinates_elsewhere_do_no_harm() -> None:
    """theta has no mass, x has: the torque converges to that of the pendulum in its angle, m l^2 a + m g l sin."""
    system = redundant_pendulum("x")
    assert np.linalg.matrix_rank(np.asarray(ca.DM(ca.evalf(ca.substitute(system.mass, system.p, [2, 1.5, 9.81]))))) == 2
    pendulum = as_scene(system, sc.rest_to_rest((0.1,), (0.9,), 2.0))
    errors = []
    for steps in (200, 400):
        found = sc.solve(pendulum, sc.Projected(), sc.BackwardEuler(), step=2.0 / steps)
        x, x1, x2 = pendulum.reference.jet(found.t, 2)[:, :, 0].T
        sin, cos = x / 1.5, np.sqrt(1.0 - (x / 1.5) ** 2)
        rate = x1 / (1.5 * cos)
        acceleration = x2 / (1.5 * cos) + sin / cos * rate**2
        np.testing.assert_allclose(found["theta"], np.arcsin(sin), atol=1e-12)
        exact = 2.0 * 1.5**2 * acceleration + 2.0 * 9.81 * 1.5 * sin
        errors.append(np.abs(found["torque"] - exact).max())
    assert errors[0] < 0.5
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


# Full actuation: plain inverse dynamics -------------------------------------------------------------------------------

PATH = polynomial_path([[0.2, -0.1], [0.5, 0.3], [-0.7, 1.1], [0.9, -2.0], [1.3, 0.4]])


@pytest.mark.parametrize("formulation", [sc.Projected(), sc.Reduced()], ids=lambda f: f.name)
@pytest.mark.parametrize("steps", [2, 50])
def test_with_as_many_inputs_as_coordinates_inputs_are_exact_at_every_step(
    formulation: sc.Formulation, steps: int
) -> None:
    """u = M gamma'' + c gamma' + K gamma where every coordinate is prescribed; v enters the projected form by its
    numerical derivative, so the damper is left out here."""
    chain = as_scene(actuated_chain(), PATH).with_parameters(c=0.0)
    found = sc.solve(chain, formulation, sc.BackwardEuler(), step=1.0 / steps)
    x, _, x2 = np.moveaxis(PATH.jet(found.t, 2), 1, 0)
    exact = x2 @ np.array([[3.0, 0.5], [0.5, 2.0]]) + x @ (70.0 * np.array([[2.0, -1.0], [-1.0, 1.0]]))
    np.testing.assert_allclose(np.column_stack([found["F1"], found["F2"]]), exact, rtol=1e-13, atol=1e-11)


def test_the_damper_of_a_prescribed_motion_shows_the_first_order_of_the_velocity() -> None:
    """A velocity is the backward difference: c (gamma(t) - gamma(t - h))/h, to the last digit."""
    h = 0.125
    chain = as_scene(actuated_chain(), PATH)
    found = sc.solve(chain, sc.Projected(), sc.BackwardEuler(), step=h)
    rigid = sc.solve(chain.with_parameters(c=0.0), sc.Projected(), sc.BackwardEuler(), step=h)
    x = PATH.jet(found.t, 0)[:, 0]
    for k, name in enumerate(("F1", "F2")):
        damper = (found[name] - rigid[name])[1:]
        np.testing.assert_allclose(damper, 3.0 * np.diff(x[:, k]) / h, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("steps", [3, 40])
def test_a_driven_pendulum_gets_its_torque_exactly_at_every_step(steps: int) -> None:
    path = sc.rest_to_rest((0.0,), (3.0,), 2.0)
    found = sc.solve(as_scene(driven_pendulum(), path), sc.Projected(), sc.BackwardEuler(), step=2.0 / steps)
    angle, _, acceleration = path.jet(found.t, 2)[:, :, 0].T
    exact = 2.0 * 1.5**2 * acceleration + 2.0 * 9.81 * 1.5 * np.sin(angle)
    np.testing.assert_allclose(found["torque"], exact, rtol=1e-13, atol=1e-12)


def test_the_original_form_differentiates_twice_backwards_so_a_parabola_is_exact_and_a_cubic_is_not() -> None:
    """(gamma(t) - 2 gamma(t - h) + gamma(t - 2h))/h^2 = gamma'' - h gamma''': error 6 m h on t^3."""
    h, inertia = 0.125, 2.0 * 1.5**2
    free = as_scene(driven_pendulum(), polynomial_path([[0.0], [0.0], [1.0]])).with_parameters(g=0.0)
    parabola = sc.solve(free, sc.Original(), sc.BackwardEuler(), step=h)
    np.testing.assert_allclose(parabola["torque"][2:], 2.0 * inertia, rtol=1e-12)
    cubic = sc.solve(
        free.with_reference(polynomial_path([[0.0], [0.0], [0.0], [1.0]])), sc.Original(), sc.BackwardEuler(), step=h
    )
    np.testing.assert_allclose(cubic["torque"][2:], inertia * (6.0 * cubic.t[2:] - 6.0 * h), rtol=1e-12)


# Internal dynamics ----------------------------------------------------------------------------------------------------


MOVING = polynomial_path([[0.3], [0.8], [-0.5], [0.4], [0.2], [-0.1], [0.05]], 2.0)
"""Moves, accelerates and jerks at its start and end: nothing is at rest that could hide a wrong history."""

DAMPED = [
    pytest.param(each, id=each.method.name) for each in METHODS if each.damped and each.steps and each.starts_in_motion
]


def order_on_a_moving_path(
    by: MethodCase, formulation: sc.Formulation, system: sc.MechanicalSystem, exact: Callable[[Array], Array], name: str
) -> float:
    """Return the observed order of one input; of generalized-alpha after its first phase, which has order one.

    Arnold, Bruels and Cardona, Numer. Math. 129 (2015) 149, explain that phase.
    """
    errors = []
    for steps in (50, 100) if by.first_order_equations else (160, 320):
        found = sc.solve(as_scene(system, MOVING), formulation, by.method, step=2.0 / steps)
        error = np.abs(found[name] - exact(found.t))
        errors.append(error[0 if by.first_order_equations else steps // 2 :].max())
    return float(np.log2(errors[0] / errors[1]))


@pytest.mark.parametrize("by", DAMPED)
def test_a_start_in_motion_costs_no_order_where_the_history_follows_from_the_path(by: MethodCase) -> None:
    """Two cars: index 3 after projection, all values before the start from the exact inversion there."""
    order = order_on_a_moving_path(
        by, sc.Projected(), car_chain(), lambda t: car_chain_exact(MOVING.jet(t, 4))["F"].value, "F"
    )
    assert order == pytest.approx(by.by_index[2], abs=0.15)


@pytest.mark.parametrize("by", DAMPED)
def test_a_start_in_motion_costs_no_order_where_the_history_is_integrated_backwards(by: MethodCase) -> None:
    """The mass on a car: index 1 when reduced, values before the start by its internal dynamics."""
    car = scene("mass_on_car").with_reference(MOVING)
    order = order_on_a_moving_path(by, sc.Reduced(), car.model(), lambda t: car.exact(t)["u"], "u")
    assert order == pytest.approx(by.by_index[0], abs=0.15)
