"""Cars in a row: the index grows with their number, and with it what a time step costs in accuracy."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from problems import shares_of_peaks

import servocore as sc
from servocore.references.profiles import polynomial
from servocore.scenes.cars import MOST_MASSES, cars

COUNTS = (2, 3, 4, 7, MOST_MASSES)


@cache
def scene(count: int = 2) -> sc.Scene:
    return cars(count)


def uneven(count: int) -> sc.Scene:
    """Cars, springs and gaps that all differ."""
    random = np.random.default_rng(count)
    values = {name: random.uniform(0.5, 2.0) * value for name, value in scene(count).parameter_values().items()}
    return scene(count).with_parameters(**values)


def test_two_cars_need_the_fourth_derivative_as_the_formula_says() -> None:
    this = uneven(2)
    m_1, m_2, k, d = (this.parameter_values()[name] for name in ("mass_1", "mass_2", "stiffness_1", "rest_length_1"))
    t = np.linspace(0.0, 4.0, 21)
    _, _, acceleration, _, snap = np.moveaxis(this.reference.jet(t, 4)[..., 0], 1, 0)
    np.testing.assert_allclose(this.exact(t)["u"], m_1 * m_2 / k * snap + (m_1 + m_2) * acceleration, rtol=1e-12)
    np.testing.assert_allclose(this.exact(t)["x_2"], this.exact(t)["y"] - d + m_1 * acceleration / k, rtol=1e-12)


def test_with_four_cars_small_steps_make_the_projected_form_worse() -> None:
    """Its index is 2 n - 1 = 7: rounding errors grow as h^-6 against a method error of first order."""
    best, small = (sc.solve(scene(4), sc.Projected(), sc.BackwardEuler(), step=h) for h in (0.005, 0.00125))
    assert shares_of_peaks(scene(4), small, "u") > 10 * shares_of_peaks(scene(4), best, "u")


@pytest.mark.parametrize("count", COUNTS)
def test_the_default_path_is_just_smooth_enough_for_the_force_to_start_and_end_at_zero(count: int) -> None:
    np.testing.assert_allclose(scene(count).exact(np.array([0.0, 4.0]))["u"], 0.0, atol=1e-9)
    rougher = scene(count).with_reference(sc.rest_to_rest((0.0,), (1.0,), 4.0, polynomial(4 * count - 1)))
    assert abs(rougher.exact(np.zeros(1))["u"][0]) > 1e-3


@pytest.mark.parametrize(("count", "said"), [(1, "1"), (0, "0"), (2.0, r"2\.0"), ("3", "the text '3'")])
def test_fewer_than_two_cars_are_no_chain(count: Any, said: str) -> None:
    with pytest.raises(sc.InvalidModel, match=f"a chain of cars has at least 2 of them, not {said}$"):
        cars(count)


def test_too_many_cars_are_refused_with_what_limits_their_number() -> None:
    with pytest.raises(sc.InvalidModel, match=r"13 cars need derivatives .* order 26, .* for 24 only: at most 12 cars"):
        cars(MOST_MASSES + 1)
