"""Lagrange's formula: exact for polynomials, the same for numbers and for symbols."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.strategies import DataObject
from numpy.polynomial import Polynomial

from servocore.numerics.interpolation import lagrange

NODES = {"one": [2.0], "even": [0.0, -1.0, -2.0, -3.0], "uneven": [0.1, 0.15, 0.4, 0.9, 1.0]}
POINTS = np.array([-0.5, 0.15, 0.7, 1.6])


@pytest.mark.parametrize("nodes", NODES.values(), ids=NODES)
@given(data=st.data())
def test_polynomials_come_back_at_any_point(nodes: list[float], data: DataObject) -> None:
    coefficients = data.draw(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=len(nodes)))
    path = Polynomial(coefficients)
    np.testing.assert_allclose(np.asarray(lagrange(nodes, POINTS)).T @ path(np.array(nodes)), path(POINTS), atol=1e-11)


@pytest.mark.parametrize("nodes", NODES.values(), ids=NODES)
def test_at_the_nodes_the_weights_are_exactly_those_of_each_node(nodes: list[float]) -> None:
    np.testing.assert_array_equal(np.asarray(lagrange(nodes, nodes)), np.eye(len(nodes)))


def test_extrapolation_by_one_step_has_the_binomial_weights_exactly() -> None:
    np.testing.assert_array_equal(np.asarray(lagrange(-np.arange(6.0), [1.0])).T, [[6, -15, 20, -15, 6, -1]])


@pytest.mark.parametrize("nodes", NODES.values(), ids=NODES)
def test_symbols_give_what_numbers_give(nodes: list[float]) -> None:
    at = ca.SX.sym("at", len(POINTS))
    weights = ca.Function("weights", [at], [lagrange(nodes, ca.vertsplit(at))])
    np.testing.assert_allclose(np.asarray(weights(POINTS)), np.asarray(lagrange(nodes, POINTS)), rtol=1e-14, atol=1e-15)
