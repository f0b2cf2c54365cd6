"""Named symbols: coordinates and parameters, their bounds and their refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import casadi as ca
import numpy as np
import pytest

import servocore as sc

MASS = sc.Parameter("mass", 2.0, "kg", 0.5, 4.0, "of the load")
LENGTH = sc.Parameter("length", 1.0, "m")


def test_coordinates_are_found_by_name_and_by_place() -> None:
    coordinates = sc.Coordinates(sc.Quantity("x", "m"), sc.Quantity("phi", "rad", nominal=10.0))
    assert len(coordinates) == 2
    assert coordinates.names == ("x", "phi")
    assert coordinates.nominal == (1.0, 10.0)
    assert coordinates.index("phi") == 1
    assert ca.is_equal(coordinates["phi"], coordinates.q[1])
    assert ca.is_equal(coordinates.velocity("phi"), coordinates.v[1])
    assert [str(each) for each in ca.vertsplit(coordinates.v)] == ["v_x", "v_phi"]


def test_no_coordinates_are_an_empty_column() -> None:
    assert sc.Coordinates().q.shape == (0, 1)
    assert sc.Parameters().values().shape == (0,)


@pytest.mark.parametrize("access", [lambda c: c["y"], lambda c: c.index("y"), lambda c: c.velocity("y")])
def test_an_unknown_coordinate_is_refused_and_the_known_ones_listed(access: Callable[[sc.Coordinates], object]) -> None:
    with pytest.raises(sc.InvalidModel, match="no coordinate is called y; there are x, z"):
        access(sc.Coordinates(sc.Quantity("x"), sc.Quantity("z")))


def test_names_must_be_unique() -> None:
    with pytest.raises(sc.InvalidModel, match="coordinate named twice: a, b"):
        sc.Coordinates(*(sc.Quantity(name) for name in ("b", "a", "c", "a", "b")))
    with pytest.raises(sc.InvalidModel, match="parameter named twice: mass"):
        sc.Parameters(MASS, LENGTH, MASS)


def test_values_are_defaults_with_changes_in_the_order_of_the_symbols() -> None:
    parameters = sc.Parameters(MASS, LENGTH)
    np.testing.assert_array_equal(parameters.values(), [2.0, 1.0])
    np.testing.assert_array_equal(parameters.values({"length": 7.0}), [2.0, 7.0])
    assert ca.is_equal(parameters["length"], parameters.p[1])


@pytest.mark.parametrize("value", [0.5, 4.0, 1, np.float32(2.5)])
def test_bounds_belong_to_the_range(value: float) -> None:
    assert MASS.check(value) == float(value)


@pytest.mark.parametrize("value", [0.4999, 4.0001, float("nan"), float("inf"), -float("inf")])
def test_values_outside_their_bounds_are_refused_with_name_value_unit_and_range(value: float) -> None:
    with pytest.raises(sc.InvalidModel, match=r"parameter mass = .* kg is outside its range \[0.5, 4\] kg"):
        sc.Parameters(MASS).values({"mass": value})


def test_unknown_parameters_are_refused_and_the_known_ones_listed() -> None:
    parameters = sc.Parameters(MASS, LENGTH)
    with pytest.raises(sc.InvalidModel, match="no parameter is called colour, weight; there are mass, length"):
        parameters.values({"colour": 1.0, "weight": 2.0})
    with pytest.raises(sc.InvalidModel, match="no parameter is called weight"):
        parameters["weight"]
    with pytest.raises(sc.InvalidModel, match="no parameter is called 0; there are mass, length"):
        parameters[cast(str, 0)]
    with pytest.raises(sc.InvalidModel, match="there are none"):
        sc.Parameters().values({"weight": 1.0})
