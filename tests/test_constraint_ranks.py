"""Which constraints are redundant: told where they hold, from round-off, and only if the others imply them."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from present import present

from servocore.numerics.compiled_calls import Array
from servocore.numerics.constraint_ranks import ROUND_OFF, ConstraintRank, assembled, constraint_rank, scaled_rows

Q = ca.SX.sym("q", 3)
X, Y, Z = Q[0], Q[1], Q[2]
P = ca.SX.sym("p", 0)
SPHERE = ca.sumsqr(Q) - 1
START = np.array([0.9, 0.3, 0.2])


def rank_of(*rows: ca.SX, start: tuple[float, float, float] | Array = START) -> ConstraintRank:
    return constraint_rank(ca.vertcat(*rows), Q, P, [np.asarray(start)], np.zeros(0), (1.0, 1.0, 1.0))


def test_independent_constraints_are_all_kept() -> None:
    assert rank_of(SPHERE, X - Y) == ConstraintRank(2, 2)
    assert rank_of() == ConstraintRank(0, 0)


@given(st.lists(st.floats(0.5, 2.0), min_size=2, max_size=2), st.integers(0, 2))
def test_the_last_of_rows_that_depend_on_one_another_is_redundant(factors: tuple[float, ...], place: int) -> None:
    rows = [SPHERE, X - Y]
    rows.insert(place, factors[0] * SPHERE - factors[1] * (X - Y))
    assert rank_of(*rows) == ConstraintRank(3, 2, (2,))


def test_rows_that_depend_on_one_another_only_where_they_hold_are_redundant() -> None:
    """As the hinges of a Bricard linkage: off the plane z = 0 the three gradients are independent."""
    rows = ca.vertcat(Z, X**2 + Y**2 - 1, SPHERE + X * Z)
    gradients = np.asarray(ca.Function("G", [Q], [ca.jacobian(rows, Q)])(START))
    assert np.linalg.svd(gradients)[1][-1] > 0.02
    assert rank_of(*ca.vertsplit(rows)) == ConstraintRank(3, 2, (2,))


def test_a_home_where_independent_rows_happen_to_be_parallel_makes_none_of_them_redundant() -> None:
    assert rank_of(SPHERE, X - 1 + Z**3 + (Y - Z), start=(1.0, 0.0, 0.0)).redundant == ()
    touching = rank_of(SPHERE, X**2 + 2 * Y**2 + 3 * Z**2 - 1, start=(1.0, 0.0, 0.0))
    assert touching.redundant == ()


def test_a_constraint_that_is_a_square_is_singular_but_not_redundant() -> None:
    assert rank_of(X**2, Y).redundant == ()


def test_constraints_that_contradict_one_another_are_not_redundant() -> None:
    found = rank_of(X - Y, X - Y - 1)
    assert found == ConstraintRank(2, 2, assembled=False)


def test_almost_the_same_constraint_twice_is_told_from_round_off() -> None:
    small = 1e3 * ROUND_OFF
    assert rank_of(X - Y, X - Y + small * Z).redundant == ()
    assert rank_of(X - Y, (X - Y) * np.pi / 3.0).redundant == (1,)


def test_assembly_from_afar_ends_on_the_constraints_and_gives_up_where_there_is_nothing() -> None:
    rows = scaled_rows(ca.vertcat(SPHERE, X - Y), Q, P, np.zeros(0), np.ones(3))
    found = present(assembled(rows, np.array([5.0, -3.0, 2.0])))
    assert np.abs(rows(found)[0]).max() < 1e-12
    nowhere = scaled_rows(ca.vertcat(SPHERE, X - 3), Q, P, np.zeros(0), np.ones(3))
    assert assembled(nowhere, START) is None
    outside = scaled_rows(ca.vertcat(ca.sqrt(X - 3)), Q, P, np.zeros(0), np.ones(3))
    assert assembled(outside, START) is None


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_units_of_rows_and_coordinates_do_not_decide(unit: float) -> None:
    rows = (unit * SPHERE, X - Y, unit**2 * (X - Y) + SPHERE)
    found = constraint_rank(ca.vertcat(*rows), Q, P, [START], np.zeros(0), (1.0, 1.0, unit))
    assert found.redundant in {(2,), (1,)}
    assert found.rank == 2
