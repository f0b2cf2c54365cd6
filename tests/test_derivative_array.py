"""The derivative array: square, differentiated rightly, and exact at an instant."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from hypothesis.strategies import DataObject
from problems import MODELS, actuated_chain, car_chain, car_chain_exact, scene
from suite import inverted

from servocore.numerics.compiled_calls import Array
from servocore.structure.derivative_array import derivative_array, differentiated_once_more, jacobian
from servocore.structure.inversion import inversion


@pytest.mark.parametrize(("name", "model"), MODELS)
def test_it_is_square_once_the_states_are_known(name: str, model: str) -> None:
    array = derivative_array(scene(name).model(model))
    assert len(array.determined) == len(array.rows) == array.residual.numel()
    assert len(array.unknowns) == len(array.determined) + array.signature.degrees_of_freedom
    assert len(set(array.unknowns)) == len(array.unknowns)


@pytest.mark.parametrize(("name", "model"), MODELS)
def test_its_jacobian_by_leibniz_rule_is_that_of_casadi(name: str, model: str) -> None:
    array = differentiated_once_more(derivative_array(scene(name).model(model)))
    found = jacobian(array, array.determined), ca.jacobian(array.residual, array.column(array.determined))
    arguments = ca.vertcat(*ca.symvar(ca.veccat(*found)))
    values = ca.Function("both", [arguments], [*found])(np.linspace(0.5, 1.5, arguments.numel()))
    same, expected = (np.asarray(each) for each in values)
    np.testing.assert_allclose(same, expected, rtol=1e-9, atol=1e-13 * np.abs(expected).max())
    assert found[0].sparsity().is_subset(found[1].sparsity())


def test_every_row_is_the_time_derivative_of_the_row_before() -> None:
    """Along any motion y(t), gamma(t), polynomial in t: the rows are compared with derivatives of a Taylor series."""
    array = derivative_array(scene("overhead_crane").model("points"))
    system = array.system
    generator = np.random.default_rng(7)
    orders = array.y.size2()
    y = generator.uniform(0.5, 1.5, array.y.shape)
    gamma = generator.uniform(0.5, 1.5, system.gamma.shape)
    p = system.parameters.values()
    t = ca.SX.sym("t")
    powers = [t**k / float(np.prod(np.arange(1.0, k + 1))) for k in range(orders)]
    along = [sum(y[j, k] * powers[k] for k in range(orders)) for j in range(len(y))]
    path = [sum(gamma[i, k] * powers[k] for k in range(orders)) for i in range(len(gamma))]
    equations = array.signature.equations
    columns = [ca.vertcat(*along)]
    for _ in range(2):
        columns.append(ca.jacobian(columns[-1], t))
    placed = ca.substitute(
        equations.residual,
        ca.vertcat(ca.vec(equations.y), system.gamma[:, 0], system.p),
        ca.vertcat(*columns, ca.vertcat(*path), ca.DM(p)),
    )
    assert max(order for _, order in array.rows) >= 3
    evaluate = ca.Function("rows", [array.y, system.gamma, system.p], [array.residual])
    found = np.asarray(evaluate(y, gamma, p)).ravel()
    derivative = placed
    expected: dict[tuple[int, int], float] = {}
    for order in range(max(order for _, order in array.rows) + 1):
        values = np.asarray(ca.Function("at", [t], [derivative])(0.0)).ravel()
        expected |= {(i, order): values[i] for i in range(len(values))}
        derivative = ca.jacobian(derivative, t)
    np.testing.assert_allclose(found, [expected[row] for row in array.rows], rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("cars", [2, 3, 5])
@settings(max_examples=10)
@given(data=st.data())
def test_the_force_on_a_row_of_cars_is_the_exact_one_of_flatness(cars: int, data: DataObject) -> None:
    """x_(i+1) = x_i - d + (m_1 x_1'' + ... )/k and F = sum m x'': with all derivatives of all cars."""
    settings_ = ([1.0 + k for k in range(cars)], [50.0 + 10 * k for k in range(cars - 1)], [0.5] * (cars - 1))
    jet = data.draw(arrays(float, (2 * cars + 1, 1), elements=st.floats(-5.0, 5.0)))
    found = inverted(car_chain(*settings_), jet, np.zeros(0))
    exact = car_chain_exact(jet, *settings_)
    for name, expected in exact.items():
        variable = f"u.{name}" if name == "F" else f"q.{name}"
        for order, value in enumerate(expected.derivatives()):
            if (variable, order) in found:
                assert found[variable, order] == pytest.approx(value, rel=1e-10, abs=1e-9)
    assert ("u.F", 0) in found
    assert (f"q.x{cars}", 2) in found


@settings(max_examples=10)
@given(jet=arrays(float, (3, 2), elements=st.floats(-3.0, 3.0)))
def test_full_actuation_is_plain_inverse_dynamics(jet: Array) -> None:
    """u = M gamma'' + c gamma' + K gamma."""
    found = inverted(actuated_chain(), jet, np.array([70.0, 3.0]))
    stiffness = 70.0 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    expected = np.array([[3.0, 0.5], [0.5, 2.0]]) @ jet[2] + 3.0 * jet[1] + stiffness @ jet[0]
    np.testing.assert_allclose([found["u.F1", 0], found["u.F2", 0]], expected, rtol=1e-12, atol=1e-11)


def test_an_instant_without_solution_is_not_passed_off_as_one() -> None:
    """A slack rope: below free fall the load cannot be held by any tension, the matrix is singular at the limit."""
    system = scene("rotary_crane").model("points")
    array = derivative_array(system)
    gamma = np.zeros((3, array.reference_order + 1))
    gamma[:, 0], gamma[2, 2] = (4.0, 0.0, -5.0), -9.81
    found, _, residual = inversion(array).function(gamma, system.parameters.values())
    assert not (np.isfinite(np.asarray(found)).all() and float(residual) < 1e-6)
