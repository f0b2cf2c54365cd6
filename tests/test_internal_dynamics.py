"""Internal dynamics with growing and decaying modes, integrated together, against each part on its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.scenes.internal_ode import backward, forward, two_sided

T = np.linspace(-1.0, 3.0, 81)
PATH = sc.rest_to_rest((0.0,), (1.0,), 2.0, sc.DEGREE13)
DECAYING = {"real": [[-3.0]], "complex": [[-2.0, 5.0], [-5.0, -2.0]]}
GROWING = {"real": [[4.0]], "complex": [[1.5, 4.0], [-4.0, 1.5]]}


def rate(matrix: Array, push: Array) -> Callable[[Any, Array], Array]:
    """Return x' = matrix x + push gamma'(t), for one time or many."""

    def of(t: float, x: Array) -> Array:
        speed = PATH.jet(t, 1)[..., 1, 0]
        return matrix @ x + np.multiply.outer(push, speed)

    return of


@pytest.mark.parametrize("decaying", DECAYING.values(), ids=DECAYING)
@pytest.mark.parametrize("growing", GROWING.values(), ids=GROWING)
def test_both_sides_at_once_are_the_decaying_part_forward_and_the_growing_part_backward(
    decaying: list[list[float]], growing: list[list[float]]
) -> None:
    first, second = np.array(decaying), np.array(growing)
    n, m = len(first), len(second)
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[n:, n:] = first, second
    push = np.arange(1.0, n + m + 1.0)
    expected = np.concatenate([forward(rate(first, push[:n]), T, 0.0, n), backward(rate(second, push[n:]), T, 2.0, m)])
    mixed = np.linalg.qr(np.random.default_rng(3).normal(size=whole.shape))[0]
    found = two_sided(rate(mixed @ whole @ mixed.T, mixed @ push), T, 0.0, 2.0, mixed @ whole @ mixed.T)
    np.testing.assert_allclose(mixed.T @ found, expected, atol=1e-8 * np.abs(expected).max())


def test_modes_that_all_decay_are_refused_with_their_eigenvalues() -> None:
    matrix = np.diag([-1.0, -2.5])
    with pytest.raises(sc.InvalidModel, match=r"their eigenvalues are -1, -2\.5$"):
        two_sided(rate(matrix, np.ones(2)), T, 0.0, 2.0, matrix)
