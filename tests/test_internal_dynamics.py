"""Internal dynamics with growing and decaying modes, integrated together, against each part on its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from problems import as_scene, changed, scene

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.scenes.internal_ode import backward, forward, two_sided

T = np.linspace(-1.0, 3.0, 81)
PATH = sc.rest_to_rest((0.0,), (1.0,), 2.0, sc.DEGREE13)
DECAYING = {"real": [[-3.0]], "complex": [[-2.0, 5.0], [-5.0, -2.0]]}
GROWING = {"real": [[4.0]], "complex": [[1.5, 4.0], [-4.0, 1.5]]}


def rate(matrix: Array, push: Array) -> Callable[[Any, Array], Array]:
    """Return x' = matrix x + push gamma'(t), for one time or many."""
    return lambda t, x: matrix @ x + np.multiply.outer(push, PATH.jet(t, 1)[..., 1, 0])


@pytest.mark.parametrize("decaying", DECAYING.values(), ids=DECAYING)
@pytest.mark.parametrize("growing", GROWING.values(), ids=GROWING)
def test_both_sides_at_once_are_each_part_by_itself(decaying: list[list[float]], growing: list[list[float]]) -> None:
    first, second = np.array(decaying), np.array(growing)
    n, m = len(first), len(second)
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[n:, n:] = first, second
    push = np.arange(1.0, n + m + 1.0)
    expected = np.concatenate([forward(rate(first, push[:n]), T, 0.0, n), backward(rate(second, push[n:]), T, 2.0, m)])
    mixed = np.linalg.qr(np.random.default_rng(3).normal(size=whole.shape))[0]
    found = two_sided(rate(mixed @ whole @ mixed.T, mixed @ push), T, 0.0, 2.0, mixed @ whole @ mixed.T)
    np.testing.assert_allclose(mixed.T @ found, expected, atol=1e-8 * np.abs(expected).max())


def test_a_bounded_motion_is_found_where_residuals_grow_on_the_way() -> None:
    car = scene("mass_on_car").model()
    bent = changed(car, potential=50 * car.coordinates["s"] ** 4 - 5 * car.coordinates["s"] ** 2)
    found = sc.solve(as_scene(bent, sc.rest_to_rest((0.0,), (0.5,), 0.7)), None, sc.StableInversion(1e-3), step=0.07)
    assert found.error.relative["u"] == pytest.approx(0.0, abs=1e-8)


def test_modes_that_all_decay_are_refused_with_their_eigenvalues() -> None:
    matrix = np.diag([-1.0, -2.5])
    with pytest.raises(sc.InvalidModel, match=r"their eigenvalues are -1, -2\.5$"):
        two_sided(rate(matrix, np.ones(2)), T, 0.0, 2.0, matrix)
