"""Jets differentiate exactly: against closed forms, and against one another by identities."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from hypothesis.strategies import SearchStrategy

from servocore.numerics.compiled_calls import Array
from servocore.scenes.jets import Jet, atan2, sqrt

ORDER = 6
TIMES = np.linspace(0.3, 2.1, 7)


def time_at(t: Array | float, order: int = ORDER) -> Jet:
    """Jet of the time itself."""
    return Jet.constant(t, order) + Jet.from_derivatives([0.0, 1.0, *[0.0] * (order - 1)])


def jets(low: float = -2.0, high: float = 2.0, first: tuple[float, float] = (0.5, 2.0)) -> SearchStrategy[Jet]:
    """Jets of shape (3,) whose leading coefficient is away from zero."""
    rest = arrays(float, (ORDER, 3), elements=st.floats(low, high))
    lead = arrays(float, (1, 3), elements=st.floats(*first))
    return st.builds(lambda a, b: Jet(np.concatenate([a, b])), lead, rest)


def assert_same(a: Jet, b: Jet, tolerance: float = 1e-9) -> None:
    assert a.order == b.order
    scale = 1.0 + np.abs(a.coefficients).max()
    np.testing.assert_allclose(a.coefficients, b.coefficients, rtol=0.0, atol=tolerance * scale)


def test_derivatives_go_in_and_come_out_unchanged() -> None:
    values = np.arange(12.0).reshape(4, 3) + 1.0
    jet = Jet.from_derivatives(values)
    np.testing.assert_array_equal(jet.coefficients[3], values[3] / 6.0)
    np.testing.assert_allclose(jet.derivatives(), values, rtol=1e-15)
    assert jet.order == 3
    np.testing.assert_array_equal(jet.value, values[0])


def test_polynomials_have_their_textbook_derivatives() -> None:
    t = time_at(TIMES)
    p = 2.0 * t**3 - t**2 + 4.0 - t * 3.0
    zero = np.zeros_like(TIMES)
    expected = [
        2 * TIMES**3 - TIMES**2 + 4 - 3 * TIMES,
        6 * TIMES**2 - 2 * TIMES - 3,
        12 * TIMES - 2,
        12 + zero,
    ]
    np.testing.assert_allclose(p.derivatives(), [*expected, zero, zero, zero], rtol=1e-14, atol=1e-14)


def test_reciprocals_have_their_textbook_derivatives() -> None:
    expected = [(-1) ** k * factorial(k) / TIMES ** (k + 1) for k in range(ORDER + 1)]
    np.testing.assert_allclose((1.0 / time_at(TIMES)).derivatives(), expected, rtol=1e-13)


def test_square_roots_have_their_textbook_derivatives() -> None:
    falling = [np.prod([0.5 - i for i in range(k)]) for k in range(ORDER + 1)]
    expected = [f * TIMES ** (0.5 - k) for k, f in enumerate(falling)]
    np.testing.assert_allclose(sqrt(time_at(TIMES)).derivatives(), expected, rtol=1e-13)


@given(a=jets())
def test_the_slope_of_an_angle_is_that_of_the_arc_tangent(a: Jet) -> None:
    assert_same(atan2(a, Jet.constant(np.ones(3), ORDER)).d(), a.d() / (1.0 + a * a), 1e-6)


@given(a=jets(), b=jets(first=(-3.0, 3.0)), radius=jets(low=-1.0, high=1.0, first=(1.0, 2.0)))
def test_atan2_finds_the_angle_of_a_point_whatever_its_distance(a: Jet, b: Jet, radius: float) -> None:
    assert_same(atan2(radius * a, radius * b), atan2(a, b), 1e-4)


@given(a=jets(), b=jets())
def test_the_time_derivative_obeys_the_product_rule(a: Jet, b: Jet) -> None:
    assert_same((a * b).d(), a.d() * b + a * b.d())


def test_operations_truncate_to_the_lower_order() -> None:
    low, high = time_at(TIMES, 2), time_at(TIMES, 5)
    for result in (low + high, high - low, high * low, low / high, atan2(high, low)):
        assert result.order == 2
    assert high.d().order == 4


def test_arrays_and_numbers_are_constants_on_either_side() -> None:
    t = time_at(TIMES)
    table = np.array([[1.0], [2.0]])
    for jet in (table * t, t * table):
        assert jet.coefficients.shape == (ORDER + 1, 2, TIMES.size)
        np.testing.assert_allclose(jet.derivatives()[1], table + 0.0 * TIMES)
    np.testing.assert_allclose((TIMES - t).coefficients[:2], [0.0 * TIMES, -1.0 + 0.0 * TIMES])
    np.testing.assert_allclose((1.0 - t).value, 1.0 - TIMES)
    np.testing.assert_allclose((table + t).value, table + TIMES)
    np.testing.assert_allclose((t / 2).derivatives()[1], 0.5)
    np.testing.assert_allclose((table / t).value, table / TIMES)


def test_what_is_unknown_is_refused() -> None:
    with pytest.raises(ValueError, match="order 0"):
        Jet.constant(1.0, 0).d()
    with pytest.raises(ValueError, match="whole powers"):
        time_at(1.0) ** 0
    assert atan2(Jet.constant(1.0, 0), Jet.constant(1.0, 0)).value == pytest.approx(np.pi / 4)
