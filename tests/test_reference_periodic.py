"""Periodic paths: exact derivatives, cycles that do not age, sentences for what makes no sense."""

from __future__ import annotations

import numpy as np
import pytest

from servocore import figure_of_eight, periodic
from servocore.errors import InvalidReference

PERIOD = 7.0
W = 2 * np.pi / PERIOD
EIGHT = figure_of_eight((4.0, 0.0, -5.0), (0.0, 1.5, 0.0), (0.5, 0.0, 0.2), PERIOD, cycles=3)


def test_a_figure_of_eight_is_two_sines_with_all_their_derivatives() -> None:
    t = np.linspace(-2.0, 25.0, 271)
    jets = EIGHT.jet(t, 9)
    for k in range(10):
        along, across = (W**k * np.sin(W * t + k * np.pi / 2), (2 * W) ** k * np.sin(2 * W * t + k * np.pi / 2))
        np.testing.assert_allclose(jets[:, k, 1], 1.5 * along, atol=1e-12 * W**k)
        np.testing.assert_allclose(jets[:, k, 0], 0.5 * across + 4.0 * (k == 0), atol=1e-11 * (2 * W) ** k)
        np.testing.assert_allclose(jets[:, k, 2], 0.2 * across - 5.0 * (k == 0), atol=1e-11 * (2 * W) ** k)
    bounds = EIGHT._bounds(t[:1], t[-1:], 9)[0, 1:]
    np.testing.assert_allclose(bounds, np.abs(jets).max(axis=0)[1:], rtol=0.01)  # a sine reaches its amplitude


def test_cosines_and_sines_of_any_harmonic_are_allowed() -> None:
    path = periodic((1.0,), [[0.5], [0.0], [0.25]], [[0.0], [2.0], [0.0]], PERIOD)
    t = np.linspace(0.0, PERIOD, 50)
    expected = 1.0 + 0.5 * np.cos(W * t) + 0.25 * np.cos(3 * W * t) + 2.0 * np.sin(2 * W * t)
    np.testing.assert_allclose(path.jet(t, 0)[:, 0, 0], expected, atol=1e-14)


def test_a_late_cycle_is_as_accurate_as_the_first() -> None:
    t = np.arange(64) / 64 * 8.0
    path = figure_of_eight((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), 8.0, cycles=10**6)
    np.testing.assert_array_equal(path.jet(t, 6), path.jet(t + 8.0 * 10**6, 6))


def test_it_starts_and_ends_with_whole_cycles_and_is_smooth_for_ever() -> None:
    assert (EIGHT.start_time, EIGHT.end_time, EIGHT.dimension) == (0.0, 21.0, 3)
    assert EIGHT.smoothness == EIGHT.max_order > 24
    later = figure_of_eight((0.0,), (1.0,), (1.0,), 2.0, start_time=5.0)
    np.testing.assert_array_equal(later.jet(5.0, 0), [[0.0]])
    assert (later.start_time, later.end_time) == (5.0, 7.0)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (((0.0,), [[1.0]], [[1.0]], 0.0), "period of a path must be a positive time, not 0.0 s"),
        (((0.0,), [[1.0]], [[1.0]], float("nan")), "period of a path must be a positive time"),
        (((0.0,), [[1.0]], [[1.0]], 1.0, 0), "one or more whole cycles, not 0"),
        (((0.0,), [[1.0]], [[1.0]], 1.0, 1.5), "one or more whole cycles, not 1.5"),
        (((0.0, 1.0), [[1.0]], [[1.0]], 1.0), r"a centre with 2 components .* shapes \(1, 1\) and \(1, 1\)"),
        (((0.0,), [[1.0]], [[1.0], [2.0]], 1.0), r"shapes \(1, 1\) and \(2, 1\)"),
        (((0.0,), [[float("inf")]], [[1.0]], 1.0), "cosine 0, component 0 is inf"),
    ],
)
def test_what_makes_no_sense_is_refused(
    arguments: tuple[tuple[float, ...] | list[list[float]] | float, ...], sentence: str
) -> None:
    with pytest.raises(InvalidReference, match=sentence):
        periodic(*arguments)  # type: ignore[arg-type]  # wrong on purpose


def test_it_is_divided_into_half_periods_of_the_highest_harmonic() -> None:
    np.testing.assert_allclose(np.diff(EIGHT.stretches), PERIOD / 4, rtol=1e-12)
    assert EIGHT.stretches[[0, -1]].tolist() == [EIGHT.start_time, EIGHT.end_time]
