"""The assignment that the signature method rests on is as good as any."""

from itertools import permutations

import numpy as np
import pytest
import scipy.optimize

from servocore.numerics.components import largest_assignment


@pytest.mark.parametrize("size", [1, 2, 7, 30, 100])
@pytest.mark.parametrize("absent", [0.0, 0.5, 0.9])
def test_the_sum_is_that_of_an_independent_algorithm(size: int, absent: float) -> None:
    generator = np.random.default_rng(size)
    weights = generator.integers(-1, 4, (size, size))
    weights[generator.random((size, size)) < absent] = -4 * (size + 1)
    found = largest_assignment(weights)
    assert sorted(found) == list(range(size))
    rows, columns = scipy.optimize.linear_sum_assignment(weights, maximize=True)
    assert weights[np.arange(size), found].sum() == weights[rows, columns].sum()


def test_all_orders_of_four_are_tried() -> None:
    generator = np.random.default_rng(4)
    for _ in range(20):
        weights = generator.integers(-9, 9, (4, 4))
        best = max(sum(weights[k, each[k]] for k in range(4)) for each in permutations(range(4)))
        assert weights[np.arange(4), largest_assignment(weights)].sum() == best
