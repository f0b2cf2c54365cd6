"""`MechanicalSystem` holds equation (1) and refuses what contradicts itself."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import actuated_chain, car_chain, changed, driven_pendulum, redundant_pendulum, scene

import servocore as sc
from servocore.model.system import DERIVED, MAX_REFERENCE_ORDER
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import gyroscopic_forces

q = sc.Coordinates(sc.Quantity("a", "m"), sc.Quantity("b", "m"))
STRANGER = ca.SX.sym("stranger")


def value(expression: ca.SX, *pairs: tuple[ca.SX, Sequence[float]]) -> Array:
    """Evaluate an expression; the pairs are (symbols, values)."""
    symbols, values = zip(*pairs, strict=True)
    return np.asarray(ca.Function("value", list(symbols), [expression])(*values))


# What it says ---------------------------------------------------------------------------------------------------------


def test_momentum_balance_is_newton_s_second_law() -> None:
    """M a + grad V - f + B^T u, with -B^T u the force of the inputs: two masses on springs and dampers, by hand."""
    system = actuated_chain()
    a = ca.SX.sym("a", 2)
    x, v, acceleration, u, (k, c) = [0.3, -0.2], [1.0, 2.0], [5.0, -4.0], [7.0, 11.0], (70.0, 3.0)
    found = value(
        system.momentum_balance(a),
        (a, acceleration), (system.q, x), (system.v, v), (system.u, u), (system.p, [k, c]),
    )  # fmt: skip
    spring = [k * x[0] - k * (x[1] - x[0]), k * (x[1] - x[0])]
    inertia = np.array([[3.0, 0.5], [0.5, 2.0]]) @ acceleration
    np.testing.assert_allclose(found.ravel(), inertia + spring + c * np.array(v) - u, rtol=1e-14)


def test_constraint_forces_are_G_transposed_times_lam() -> None:  # noqa: N802
    system = redundant_pendulum()
    G = value(system.G, (system.q, [0.0, 0.0, 0.7]), (system.p, [2.0, 1.5, 9.81]))
    np.testing.assert_allclose(G, [[1.0, 0.0, -1.5 * np.cos(0.7)], [0.0, 1.0, -1.5 * np.sin(0.7)]], rtol=1e-14)
    forces = value(
        system.constraint_forces,
        (system.q, [0, 0, 0.7]), (system.p, [2.0, 1.5, 9.81]), (system.lam, [3.0, 5.0]), (system.u, [0.5]),
    )  # fmt: skip
    np.testing.assert_allclose(forces.ravel(), G.T @ [3.0, 5.0] + [0.0, 0.0, -0.5], rtol=1e-14)


def test_C_is_the_jacobian_of_the_servo_output() -> None:  # noqa: N802
    system = scene("mass_on_car").model()
    C = value(system.C, (system.p, system.parameters.values({"inclination": 0.3}).tolist()))
    np.testing.assert_allclose(C, [[1.0, np.cos(0.3)]])


def test_degrees_of_freedom_are_coordinates_less_constraints() -> None:
    assert car_chain().degrees_of_freedom == 2
    assert redundant_pendulum().degrees_of_freedom == 1


def test_inputs_named_in_order_are_the_symbols_u() -> None:
    assert [str(each) for each in ca.vertsplit(actuated_chain().u)] == ["F1", "F2"]


def test_what_is_not_given_is_zero_or_made() -> None:
    system = driven_pendulum()
    assert system.constraints.numel() == system.lam.numel() == 0
    assert system.force.is_zero()
    assert system.gamma.shape == (1, MAX_REFERENCE_ORDER + 1)
    assert system.home == (1.0,)
    assert system.guess.is_zero()
    chain = car_chain()
    assert chain.gyroscopic.is_zero(), "a constant M has no gyroscopic forces"


def test_home_configuration_is_the_guess_at_home_with_default_parameters() -> None:
    configuration, p = redundant_pendulum("theta").home_configuration()
    np.testing.assert_allclose(configuration, [1.5 * np.sin(0.4), -1.5 * np.cos(0.4), 0.4], rtol=1e-15)
    np.testing.assert_array_equal(p, [2.0, 1.5, 9.81])


def test_gyroscopic_forces_of_polar_coordinates_are_coriolis_and_centrifugal() -> None:
    """M = diag(1, r^2): -r phi'^2 along r, 2 r r' phi' along phi."""
    polar, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    found = gyroscopic_forces(ca.diag(ca.vertcat(1, polar[0] ** 2)), polar, v)
    r, rate = 1.7, [0.3, -2.0]
    expected = [-r * rate[1] ** 2, 2 * r * rate[0] * rate[1]]
    np.testing.assert_allclose(value(found, (polar, [r, 0.4]), (v, rate)).ravel(), expected, rtol=1e-14)


@settings(max_examples=20)
@given(st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6))
def test_gyroscopic_forces_do_the_work_that_a_changing_mass_takes(numbers: tuple[float, ...]) -> None:
    """v . (M_dot v - grad(v^T M v)/2) = v^T M_dot v / 2, so that kinetic energy balances for any M(q)."""
    q3, v3 = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    root = ca.SX(3, 3)
    root[0, 0], root[1, 1], root[2, 2] = 2 + ca.sin(q3[1]), 1 + q3[0] ** 2, 3
    root[1, 0], root[2, 1], root[2, 0] = q3[2], ca.cos(q3[0]), q3[1] * q3[2]
    mass = ca.mtimes(root, root.T)
    work = ca.dot(v3, gyroscopic_forces(mass, q3, v3))
    rate_of_energy = ca.jtimes(ca.dot(v3, ca.mtimes(mass, v3)), q3, v3) / 2
    found, expected = value(ca.vertcat(work, rate_of_energy), (q3, numbers[:3]), (v3, numbers[3:])).ravel()
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-10)


# What it refuses ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("attribute", "wrong", "shapes"),
    [
        ("mass", ca.SX.eye(3), r"mass has shape \(3, 3\), expected \(2, 2\)"),
        ("output", ca.SX(1, 1), r"output has shape \(1, 1\), expected \(2, 1\)"),
        ("input_matrix", ca.SX.eye(2)[:1, :], r"input_matrix has shape \(1, 2\), expected \(2, 2\)"),
        ("potential", ca.SX(2, 1), r"potential has shape \(2, 1\), expected \(1, 1\)"),
        ("force", ca.SX(3, 1), r"force has shape \(3, 1\), expected \(2, 1\)"),
        ("gyroscopic", ca.SX(1, 1), r"gyroscopic has shape \(1, 1\), expected \(2, 1\)"),
        ("multipliers", ca.SX.sym("lam", 1), r"multipliers has shape \(1, 1\), expected \(0, 1\)"),
        ("guess", ca.SX(3, 1), r"guess has shape \(3, 1\), expected \(2, 1\)"),
        ("gamma", ca.SX.sym("gamma", 2, 5), r"gamma has shape \(2, 5\), expected \(2, 25\)"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(attribute: str, wrong: ca.SX, shapes: str) -> None:
    with pytest.raises(sc.InvalidModel, match=f"actuated chain: {shapes}"):
        changed(actuated_chain(), **{attribute: wrong})


@pytest.mark.parametrize(
    "attribute", ["mass", "output", "input_matrix", "potential", "force", "gyroscopic", "constraints", "guess"]
)
def test_symbols_of_another_model_are_refused(attribute: str) -> None:
    system = redundant_pendulum()
    foreign = getattr(system, attribute) + 0
    foreign[0, 0] += STRANGER
    with pytest.raises(sc.InvalidModel, match=f"{attribute} holds symbols that it must not use: .*stranger"):
        changed(system, **{attribute: foreign})


@pytest.mark.parametrize("attribute", ["mass", "input_matrix", "potential"])
def test_velocities_are_refused_where_only_positions_belong(attribute: str) -> None:
    system = actuated_chain()
    wrong = getattr(system, attribute) + 0
    wrong[0, 0] += system.v[0]
    with pytest.raises(sc.InvalidModel, match=f"{attribute} holds symbols"):
        changed(system, **{attribute: wrong})


def test_velocities_in_an_output_are_refused_by_its_name() -> None:
    system = actuated_chain()
    with pytest.raises(sc.InvalidModel, match=r"the output y1 depends on velocities \(v_x1\)"):
        changed(system, output=system.output + ca.vertcat(system.v[0], 0))


def test_an_observable_with_a_stranger_is_refused_by_name() -> None:
    with pytest.raises(sc.InvalidModel, match=r"observable power holds symbols .*stranger"):
        changed(driven_pendulum(), observables={sc.Quantity("power", "W"): STRANGER})


def test_a_mass_matrix_asymmetric_away_from_zero_only_is_refused() -> None:
    system = actuated_chain()
    mass = ca.SX([[3.0, 0.5], [0.5, 2.0]])
    mass[0, 1] += system.q[0] * system.q[1]
    with pytest.raises(sc.InvalidModel, match="actuated chain: the mass matrix is not symmetric"):
        changed(system, mass=mass, gyroscopic=ca.SX.zeros(2))


def overactuated(base: sc.MechanicalSystem) -> sc.MechanicalSystem:
    """The pendulum in three coordinates with an input and an output too many."""
    wrong = {
        "inputs": (sc.Quantity("t1", "N"), sc.Quantity("t2", "N")),
        "outputs": (sc.Quantity("y1", "m"), sc.Quantity("y2", "m")),
        "output": base.q[:2],
        "input_matrix": -ca.SX.eye(3)[:2, :],
        "gamma": DERIVED,
        "guess": ca.SX([0.4, -1.0, 0.4]),
        "home": (0.4, -1.0),
    }
    return changed(base, **wrong)


def test_more_inputs_than_degrees_of_freedom_are_refused() -> None:
    counted = r"\(3 coordinates, 2 independent ones of 2 holonomic constraints\)"
    with pytest.raises(
        sc.InvalidModel, match=f"redundant pendulum: 2 inputs exceed the 1 degrees of freedom {counted}"
    ):
        overactuated(redundant_pendulum())


def test_redundant_constraints_take_no_degree_of_freedom_away() -> None:
    base = redundant_pendulum()
    thrice = ca.vertcat(base.constraints, base.constraints[0], ca.sum1(base.constraints))
    system = changed(base, constraints=thrice, multipliers=DERIVED)
    assert system.degrees_of_freedom == 1
    assert system.constraint_rank().redundant == (2, 3)
    with pytest.raises(sc.InvalidModel, match=r"2 of the 4 holonomic constraints are redundant \(rank 2\): g_3, g_4;"):
        system.require_independent_constraints()
    counted = r"\(3 coordinates, 2 independent ones of 4 holonomic constraints\)"
    with pytest.raises(sc.InvalidModel, match=f"2 inputs exceed the 1 degrees of freedom {counted}"):
        overactuated(system)


def test_names_of_constraints_are_as_many_as_constraints() -> None:
    with pytest.raises(sc.InvalidModel, match="redundant pendulum: 1 names for 2 holonomic constraints"):
        changed(redundant_pendulum(), constraint_names=("rod",))


def test_as_many_outputs_as_inputs_are_needed() -> None:
    with pytest.raises(sc.InvalidModel, match="2 inputs cannot prescribe 1 outputs"):
        changed(actuated_chain(), outputs=(sc.Quantity("y1", "m"),))
