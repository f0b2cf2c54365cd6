"""`generalize`: the same system in other coordinates, section 3.1 of the paper, number by number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from hypothesis.strategies import DataObject, SearchStrategy
from problems import changed, redundant_pendulum, scene

import servocore as sc
from servocore.model.generalize import generalize
from servocore.model.system import DERIVED
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import gyroscopic_forces


def at(
    system: sc.MechanicalSystem, expressions: Sequence[ca.SX], q: Sequence[float] | Array, v: Sequence[float] | Array
) -> list[Array]:
    """Evaluate expressions of a system at a configuration and velocity, default parameters."""
    function = ca.Function("at", [system.q, system.v, system.p], [ca.densify(each) for each in expressions])
    results = function(q, v, system.parameters.values())
    return [np.asarray(each) for each in (results if isinstance(results, tuple) else (results,))]


def configurations(size: int) -> SearchStrategy[tuple[Array, Array]]:
    """Draw mu away from the axis and from horizontal ropes, with velocities."""
    return st.tuples(
        arrays(float, size, elements=st.floats(0.2, 1.2)), arrays(float, size, elements=st.floats(-2.0, 2.0))
    )


@pytest.mark.parametrize("name", ["rotary_crane", "overhead_crane"])
@settings(max_examples=10)
@given(data=st.data())
def test_inertia_forces_are_those_of_lagrange(name: str, data: DataObject) -> None:
    """P^T M P_dot nu, as derived, equals M~_dot nu - grad(nu^T M~ nu)/2 of the new mass matrix alone."""
    derived = scene(name).model("generalized")
    mu, nu = data.draw(configurations(len(derived.coordinates)))
    lagrange = gyroscopic_forces(derived.mass, derived.q, derived.v)
    found, expected = at(derived, [derived.gyroscopic, lagrange], mu, nu)
    np.testing.assert_allclose(found, expected, atol=1e-11 * max(1.0, np.abs(expected).max()))


ANGLE = sc.Coordinates(sc.Quantity("theta", "rad"))


def pendulum(
    mapping: ca.SX | None = None,
    coordinates: sc.Coordinates = ANGLE,
    system: sc.MechanicalSystem | None = None,
    name: str | None = None,
) -> sc.MechanicalSystem:
    """Return the redundant pendulum in its angle."""
    system = system or redundant_pendulum("theta")
    length = system.parameters["l"]
    theta = coordinates.q[0]
    F = ca.vertcat(length * ca.sin(theta), -length * ca.cos(theta), theta) if mapping is None else mapping
    return generalize(system, coordinates, F, name=name)


def test_the_pendulum_in_its_angle_is_the_textbook_pendulum() -> None:
    """M l^2 theta'' + m g l sin(theta) = torque; no constraints are left."""
    system = pendulum()
    mass, bias, B = at(system, [system.mass, system.bias, system.input_matrix], [0.7], [1.3])
    np.testing.assert_allclose(mass, 2.0 * 1.5**2)
    np.testing.assert_allclose(bias, 2.0 * 9.81 * 1.5 * np.sin(0.7))
    np.testing.assert_allclose(B, -1.0)
    assert system.constraints.numel() == 0
    assert system.degrees_of_freedom == 1


def test_applied_forces_and_given_gyroscopic_forces_come_along() -> None:
    """A drag -c v on the mass becomes -c l^2 theta'; a gyroscopic force given by hand is pulled back as it is."""
    base = redundant_pendulum("theta")
    dragged = changed(base, force=ca.vertcat(-3.0 * base.v[:2], 0))
    (bias,) = at(pendulum(system=dragged), [pendulum(system=dragged).force], [0.7], [1.3])
    np.testing.assert_allclose(bias, -3.0 * 1.5**2 * 1.3)
    spun = pendulum(system=changed(base, gyroscopic=ca.vertcat(0, 0, base.v[2] ** 2)))
    (forces,) = at(spun, [spun.gyroscopic], [0.7], [1.3])
    np.testing.assert_allclose(forces, 1.3**2, rtol=1e-12)


def test_parameters_inputs_reference_and_home_stay_those_of_the_system() -> None:
    base = redundant_pendulum("theta")
    system = pendulum(system=base)
    assert system.parameters is base.parameters
    assert (system.inputs, system.outputs, system.home) == (base.inputs, base.outputs, base.home)
    assert ca.is_equal(system.gamma, base.gamma)
    assert system.name == "redundant pendulum, generalized"
    assert pendulum(name="other").name == "other"


def test_observables_without_forces_come_along_and_those_with_multipliers_do_not() -> None:
    base = redundant_pendulum("theta")
    height, pull = sc.Quantity("height", "m"), sc.Quantity("pull", "N")
    observed = replace(base, observables={height: base.q[1], pull: base.lam[0]}, u=DERIVED)
    assert set(pendulum(system=observed).observables) == {height}
    (value,) = at(pendulum(system=observed), [pendulum(system=observed).observables[height]], [0.7], [0.0])
    np.testing.assert_allclose(value, -1.5 * np.cos(0.7))


def test_a_mapping_that_leaves_the_constraint_manifold_is_refused() -> None:
    theta = ANGLE.q[0]
    with pytest.raises(sc.InvalidModel, match="redundant pendulum: the mapping leaves the constraint manifold"):
        pendulum(ca.vertcat(ca.sin(theta), -ca.cos(theta), theta))  # a rod of one metre instead of l


def test_a_wrong_number_of_generalized_coordinates_is_refused() -> None:
    two = sc.Coordinates(sc.Quantity("a"), sc.Quantity("b"))
    with pytest.raises(sc.InvalidModel, match="has 1 degrees of freedom, not 2 generalized coordinates"):
        pendulum(coordinates=two)


@pytest.mark.parametrize("rows", [1, 4])
def test_a_mapping_of_the_wrong_length_is_refused(rows: int) -> None:
    theta = ANGLE.q[0]
    with pytest.raises(sc.InvalidModel):
        pendulum(ca.repmat(theta, rows, 1))
