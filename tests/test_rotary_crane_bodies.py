"""The 42-coordinate crane: sizes as in the paper, and the same inputs as nine coordinates give."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
from suite import inverted

from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.scenes.rotary_crane import PARAMETERS, bodies, points

INPUT_NAMES = ("u.M_b", "u.F", "u.M_w")


@cache
def crane() -> MechanicalSystem:
    return bodies()


def random_jets(count: int = 40, seed: int = 0) -> Array:
    random = np.random.default_rng(seed)
    jets = random.normal(size=(count, 6, 3))
    jets[:, 0] = random.uniform((-6, -6, -8), (6, 6, -1), size=(count, 3))
    return jets


def test_its_constraints_hold_above_any_load() -> None:
    system = crane()
    residual = ca.Function("g", [system.gamma, system.p], [ca.substitute(system.constraints, system.q, system.guess)])
    gamma = np.zeros(system.gamma.shape)
    for load in random_jets()[:, 0]:
        gamma[:, 0] = load
        np.testing.assert_allclose(residual(gamma, PARAMETERS.values()), 0.0, atol=1e-11)


def test_servo_and_input_matrices_are_boolean_up_to_sign() -> None:
    system = crane()
    C, B = np.asarray(ca.DM(system.C)), np.asarray(ca.DM(system.input_matrix))
    names = system.coordinates.names
    assert [names[k] for k in C.argmax(axis=1)] == ["load.x", "load.y", "load.z"]
    assert [names[k] for k in (-B).argmax(axis=1)] == ["phi", "s", "beta"]
    for matrix in (C, -B):
        np.testing.assert_array_equal(np.sort(matrix, axis=1)[:, -1], 1.0)
        assert np.count_nonzero(matrix) == 3


def test_mass_is_constant_and_semidefinite_with_the_three_augmented_coordinates_massless() -> None:
    M = np.asarray(ca.Function("M", [crane().p], [crane().mass])(PARAMETERS.values()))
    eigenvalues = np.linalg.eigvalsh(M)
    assert eigenvalues.min() >= 0.0
    assert np.count_nonzero(eigenvalues == 0.0) == 3
    assert not ca.depends_on(crane().mass, crane().q)


def test_its_inputs_are_those_of_nine_coordinates_where_no_three_bodies_have_such_inertias() -> None:
    p = PARAMETERS.values({"bridge_inertia": 1.0, "winch_inertia": 50.0})  # their sums still count
    both = [[inverted(system, jet, p) for jet in random_jets()] for system in (crane(), points())]
    found, expected = ([[each[name, 0] for name in INPUT_NAMES] for each in model] for model in both)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
