"""Paths of a user's own whose derivatives are none: every equation would hold, with inputs of no motion."""

from __future__ import annotations

import numpy as np
import pytest
from outside import moving
from outside.paths import Sine

import servocore as sc

RATE = 2.0
RIGHT = tuple(RATE**k for k in range(7))


def cars(path: sc.Reference) -> sc.Scene:
    return moving.two_cars_with_a_cubic_spring().scene.with_reference(path)


def test_a_path_whose_derivatives_are_its_own_is_followed() -> None:
    assert sc.solve(cars(Sine.of(RATE, RIGHT)), step=0.02).error.largest == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("order", range(1, 5))
@pytest.mark.parametrize("factor", [0.0, -1.0, 0.5, 1.2])
def test_a_derivative_that_is_none_is_refused_with_its_order(order: int, factor: float) -> None:
    factors = tuple(factor * right if k == order else right for k, right in enumerate(RIGHT))
    with pytest.raises(sc.InvalidReference, match=f"Sine: the derivative of order {order} of component 0 is not"):
        cars(Sine.of(RATE, factors))


def test_a_table_of_another_shape_is_refused() -> None:
    class Flat(Sine):
        def _derivatives(self, t: np.ndarray, order: int) -> np.ndarray:
            return super()._derivatives(t, order)[:, :, 0]

    path = Flat.of(RATE, RIGHT)
    with pytest.raises(sc.InvalidReference, match=r"Flat: .* the shape \(9, 7, 1\), not \(9, 7\)"):
        cars(path)


BOUNDS: dict[str, tuple[object, str]] = {
    "degree": (3, "a degree of more than 3 between its joints"),
    "joints": ([0.0, 1.0], "joints must be an array of times that rise from 0.0 to"),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_what_bounds_a_path_is_refused_where_it_is_not_so(name: str) -> None:
    value, words = BOUNDS[name]
    path = type("Bounded", (Sine,), {name: value}).of(RATE, RIGHT)  # type: ignore[attr-defined]  # of Sine
    with pytest.raises(sc.InvalidReference, match=f"Bounded: .*{words}"):
        cars(path)


def test_an_enclosure_of_another_shape_is_refused() -> None:
    path = type("Short", (Sine,), {"enclosure": lambda *_: np.zeros((2, 1))}).of(RATE, RIGHT)  # type: ignore[attr-defined]  # of Sine
    with pytest.raises(sc.InvalidReference, match="Short: an enclosure must be coefficients of shape"):
        sc.certify(cars(path))
