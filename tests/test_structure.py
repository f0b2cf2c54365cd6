"""The signature method: index and internal degrees of freedom where the literature knows them."""

from __future__ import annotations

import casadi as ca
import numpy as np
from problems import car_chain, redundant_pendulum, scene

import servocore as sc
from servocore.structure.derivative_array import analyse_structure, second_order_equations
from servocore.structure.signature import ABSENT, signature


def offsets(system: sc.MechanicalSystem) -> tuple[dict[str, int], dict[str, int]]:
    found = analyse_structure(system)
    names = found.equations
    return (
        dict(zip(names.equations, found.equation_offsets, strict=True)),
        dict(zip(names.names, found.variable_offsets, strict=True)),
    )


def test_without_the_remedy_generalized_coordinates_hide_the_index() -> None:
    """Accelerations that cancel: the equations as they stand have a singular Jacobian."""
    generalized = scene("rotary_crane").model("generalized")
    assert any("less servo accelerations" in name for name in analyse_structure(generalized).equations.equations)
    assert signature(second_order_equations(generalized)).index < 5


def test_offsets_of_two_cars_are_those_found_by_hand() -> None:
    """y is differentiated four times, car 1's balance twice, car 2's not at all; F is algebraic."""
    c, d = offsets(car_chain())
    assert c == {"momentum of x1": 2, "momentum of x2": 0, "servo constraint on y": 4}
    assert d == {"q.x1": 4, "q.x2": 2, "u.F": 0}


def test_the_signature_matrix_lists_highest_derivatives() -> None:
    found = signature(second_order_equations(car_chain()))
    np.testing.assert_array_equal(found.sigma, [[2, 0, ABSENT], [0, 2, 0], [0, ABSENT, ABSENT]])


def test_offsets_bound_every_entry_of_the_signature_matrix_and_are_tight_on_a_transversal() -> None:
    """d_j - c_i >= sigma_ij, equal on a full matching: else the Jacobian would have an empty row."""
    for system in (scene("rotary_crane").model("points"), scene("mass_on_car").model(), car_chain()):
        found = analyse_structure(system)
        gap = np.subtract.outer(-np.array(found.equation_offsets), -np.array(found.variable_offsets))
        present = found.sigma != ABSENT
        assert (gap[present] >= found.sigma[present]).all()
        tight = ca.DM(((gap == found.sigma) & present).astype(float))
        assert ca.sprank(ca.sparsify(tight)) == len(found.sigma)
        assert min(found.equation_offsets) == 0


def test_the_system_jacobian_of_two_cars_is_the_one_written_by_hand() -> None:
    """Rows: m1 x1'' + k (x1 - x2 - d), m2 x2'' - k (...) - F, x1 - y; columns x1^(4), x2'', F."""
    found = signature(second_order_equations(car_chain()))
    np.testing.assert_array_equal(
        np.asarray(ca.DM(found.jacobian)), [[1.0, -50.0, 0.0], [0.0, 2.0, -1.0], [1.0, 0.0, 0.0]]
    )


def test_units_do_not_decide_about_rank() -> None:
    """Cars of a gram on springs of a giganewton per metre are as regular as any."""
    assert analyse_structure(car_chain([1e-3, 1e-3], [1e9], [0.5])).index == 5


def test_equations_and_variables_are_named_for_humans() -> None:
    equations = second_order_equations(redundant_pendulum("x"))
    assert equations.names == ("q.x", "q.z", "q.theta", "lam.1", "lam.2", "u.torque")
    assert equations.equations == (
        "momentum of x", "momentum of z", "momentum of theta", "servo constraint on y",
        "holonomic constraint 1", "holonomic constraint 2",
    )  # fmt: skip
    assert set(equations.embedded) == {0}
