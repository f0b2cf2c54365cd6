"""The assignment that the signature method rests on is as good as any."""

import numpy as np
import pytest
import scipy.optimize

from servocore.numerics.components import largest_assignment


@pytest.mark.parametrize("size", [1, 2, 4, 7, 30, 100])
@pytest.mark.parametrize("absent", [0.0, 0.5, 0.9])
def test_the_sum_is_that_of_an_independent_algorithm(size: int, absent: float) -> None:
    generator = np.random.default_rng(size)
    weights = generator.integers(-1, 4, (size, size))
    weights[generator.random((size, size)) < absent] = -4 * (size + 1)
    found = largest_assignment(weights)
    assert sorted(found) == list(range(size))
    rows, columns = scipy.optimize.linear_sum_assignment(weights, maximize=True)
    assert weights[np.arange(size), found].sum() == weights[rows, columns].sum()
