"""Reference paths: exact derivatives, rest where it is promised, sentences for what cannot be followed."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servocore.errors import InvalidReference
from servocore.references import (
    DEGREE3,
    DEGREE5,
    DEGREE7,
    DEGREE9,
    DEGREE13,
    rest_to_rest,
    three_phase,
)
from servocore.references.profiles import polynomial

START, END, DURATION = (5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 20.0
PROFILES = [DEGREE3, DEGREE5, DEGREE7, DEGREE9, DEGREE13, polynomial(1), three_phase(5.0), three_phase(10.0)]
EPS = np.finfo(float).eps


def unit(profile, duration=DURATION, start_time=0.0):
    return rest_to_rest((0.0,), (1.0,), duration, profile, start_time)


def exact_derivative(coefficients, T, order):
    """Derivative by T of a polynomial in rational arithmetic, for a float T taken as the rational it is."""
    for _ in range(order):
        coefficients = [i * c for i, c in enumerate(coefficients)][1:]
    value = Fraction(0)
    for c in reversed(list(coefficients)):
        value = value * Fraction(T) + c
    return value


def exact_three_phase(t, tau, tau0, order):
    """theory.md section 3 in rational arithmetic, order at most 1 outside the ramps."""
    t, tau, tau0 = Fraction(t), Fraction(tau), Fraction(tau0)
    if t > tau / 2:
        mirrored = exact_three_phase(tau - t, tau, tau0, order)
        return 1 - mirrored if order == 0 else (-1) ** (order + 1) * mirrored
    if t > tau0:
        return ((t - tau0 / 2) if order == 0 else Fraction(int(order == 1))) / (tau - tau0)
    ramp = [0, 0, 0, 0, 0, 7 / tau0**4, -14 / tau0**5, 10 / tau0**6, Fraction(-5, 2) / tau0**7]
    return exact_derivative(ramp, t, order) / (tau - tau0)


# --- profiles ---------------------------------------------------------------------------------------------


def test_degree_nine_and_thirteen_have_the_coefficients_of_the_theory():
    assert DEGREE9.coefficients == (0, 0, 0, 0, 0, 126, -420, 540, -315, 70)
    assert DEGREE13.coefficients == (0,) * 7 + (1716, -9009, 20020, -24024, 16380, -6006, 924)


@pytest.mark.parametrize("degree", [1, 3, 5, 7, 9, 11, 13, 21])
def test_a_polynomial_profile_satisfies_its_end_conditions_in_rational_arithmetic(degree):
    profile = polynomial(degree)
    assert exact_derivative(profile.coefficients, 0, 0) == 0
    assert exact_derivative(profile.coefficients, 1, 0) == 1
    for order in range(1, profile.smoothness + 1):
        assert exact_derivative(profile.coefficients, 0, order) == 0
        assert exact_derivative(profile.coefficients, 1, order) == 0
    assert exact_derivative(profile.coefficients, 0, profile.smoothness + 1) != 0


@pytest.mark.parametrize("profile", [DEGREE3, DEGREE5, DEGREE7, DEGREE9, DEGREE13], ids=lambda p: p.name)
def test_polynomial_derivatives_of_every_order_equal_rational_arithmetic(profile):
    T = np.concatenate([np.linspace(0.0, 1.0, 65)[:-1], [1e-9, 1e-3, 1.0 - 1e-3, 1.0 - 2.0**-40]])
    jets = unit(profile, 1.0).jet(T, 15)[:, :, 0]
    for order in range(16):
        exact = np.array([float(exact_derivative(profile.coefficients, value, order)) for value in T])
        np.testing.assert_allclose(jets[:, order], exact, rtol=0.0, atol=16 * EPS * np.abs(exact).max())


@pytest.mark.parametrize("profile", [DEGREE9, DEGREE13], ids=lambda p: p.name)
def test_slopes_near_the_end_keep_full_relative_accuracy(profile):
    T = 1.0 - 2.0 ** -np.arange(1.0, 30.0)
    jets = unit(profile, 1.0).jet(T, 4)[:, :, 0]
    for order in range(1, 5):
        exact = np.array([float(exact_derivative(profile.coefficients, value, order)) for value in T])
        np.testing.assert_allclose(jets[1:, order], exact[1:], rtol=50 * EPS)


@pytest.mark.parametrize("ramp", [1.0, 4.5, 10.0])
def test_the_three_phase_profile_equals_the_formula_of_the_theory(ramp):
    t = np.linspace(0.0, DURATION, 97)[:-1]
    jets = unit(three_phase(ramp)).jet(t, 4)[:, :, 0]
    for order in range(5):
        exact = np.array([float(exact_three_phase(value, DURATION, ramp, order)) for value in t])
        np.testing.assert_allclose(jets[:, order], exact, rtol=0.0, atol=16 * EPS * np.abs(exact).max())


def test_a_three_phase_profile_without_a_ramp_accelerates_for_a_quarter_of_the_duration():
    t = np.linspace(0.0, DURATION, 50)
    np.testing.assert_array_equal(unit(three_phase()).jet(t, 4), unit(three_phase(5.0)).jet(t, 4))


@pytest.mark.parametrize("profile", PROFILES, ids=str)
@given(fraction=st.floats(0.0, 1.0), duration=st.floats(0.1, 100.0))
def test_profiles_are_symmetric_about_the_middle(profile, fraction, duration):
    if duration < profile.shortest_duration:
        duration += profile.shortest_duration
    elapsed = np.array([fraction * duration])
    remaining = duration - elapsed
    there = profile.jet(elapsed, remaining, duration, 4)[0]
    back = profile.jet(remaining, elapsed, duration, 4)[0]
    assert there[0] + back[0] == pytest.approx(1.0, abs=2 * EPS)
    if profile.smoothness >= 4:
        np.testing.assert_allclose(there[1:], back[1:] * [1, -1, 1, -1], rtol=1e-13, atol=0.0)


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_profiles_start_and_end_with_derivatives_that_are_exactly_zero(profile):
    path = unit(profile, start_time=3.7)
    k = path.smoothness
    np.testing.assert_array_equal(path.jet([path.start_time], k)[0, :, 0], np.zeros(k + 1))
    np.testing.assert_array_equal(path.jet([path.end_time], k)[0, :, 0], np.eye(k + 1)[0])
    assert path.jet(path.start_time, k + 1)[k + 1, 0] > 0.0  # the next one jumps: C^k and no more


def test_a_profile_of_even_degree_or_a_ramp_that_is_not_positive_does_not_exist():
    with pytest.raises(InvalidReference, match="odd degree of 1 or more, not 8"):
        polynomial(8)
    with pytest.raises(InvalidReference, match="positive time, not 0"):
        three_phase(0.0)
    with pytest.raises(InvalidReference, match="positive time, not nan"):
        three_phase(float("nan"))


# --- rest to rest -----------------------------------------------------------------------------------------


def test_the_default_manoeuvre_runs_along_the_straight_line_of_equation_32():
    path = rest_to_rest(START, END, DURATION)
    t = np.linspace(0.0, DURATION, 41)
    gamma = path.jet(t, 0)[:, 0]
    s = [float(exact_derivative(DEGREE9.coefficients, value / DURATION, 0)) for value in t]
    line = np.array(START) + np.outer(s, np.subtract(END, START))
    np.testing.assert_allclose(gamma, line, rtol=0.0, atol=1e-14)
    assert path.dimension == 3
    assert path.duration == DURATION
    assert path.fit_error is None


def test_before_the_start_and_after_the_end_the_path_rests_at_its_end_points():
    path = rest_to_rest(START, END, DURATION, DEGREE7, start_time=2.0)
    jets = path.jet([-1e9, 1.999, 22.0, 1e9], 9)
    np.testing.assert_array_equal(jets[:2, 0], [START, START])
    np.testing.assert_array_equal(jets[2:, 0], [END, END])
    assert not jets[:, 1:].any()


def test_one_time_gives_one_jet_and_it_is_the_one_of_the_row_of_times():
    path = rest_to_rest(START, END, DURATION)
    rows = path.jet([3.0, 4.0], 5)
    assert rows.shape == (2, 6, 3)
    np.testing.assert_array_equal(path.jet(4.0, 5), rows[1])
    assert path.jet([], 2).shape == (0, 3, 3)


@pytest.mark.parametrize("profile", PROFILES[2:5] + PROFILES[6:], ids=str)
@given(center=st.floats(0.05, 0.95), delta=st.floats(-0.4, 0.4))
def test_a_taylor_step_from_one_jet_reaches_the_jet_at_another_time(profile, center, delta):
    path = rest_to_rest(START, END, DURATION, profile)
    t0, t1 = center * DURATION, center * DURATION + delta
    ramp = getattr(profile, "ramp", DURATION)
    if any(min(t0, t1) <= joint <= max(t0, t1) for joint in (0.0, ramp, DURATION - ramp, DURATION)):
        return
    jet, other = path.jet(t0, 16), path.jet(t1, 4)
    for order in range(5):
        expanded = sum(jet[order + i] * delta**i / np.prod(np.arange(1.0, i + 1)) for i in range(13))
        np.testing.assert_allclose(expanded, other[order], rtol=0.0, atol=1e-13)


def test_paths_are_values_that_compare_and_cannot_be_changed():
    path = rest_to_rest(START, END, DURATION)
    assert path == rest_to_rest(list(START), np.array(END), DURATION)
    with pytest.raises(AttributeError):
        path.end_time = 3.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (((0.0, 1.0), (1.0,), 1.0), "start has 2 components and end has 1"),
        (((0.0, np.nan), (1.0, 1.0), 1.0), "start point 0, component 1 is nan"),
        (((0.0,), (np.inf,), 1.0), "end point 0, component 0 is inf"),
        (((0.0,), (1.0,), 0.0), "positive time, not 0.0 s"),
        (((0.0,), (1.0,), np.nan), "positive time, not nan s"),
        (((0.0,), (1.0,), 1.0, three_phase(0.6)), "takes at least 1.2 s, but its duration is 1.0 s"),
        (((0.0,), (1.0,), 1.0, DEGREE9, np.inf), "times must be finite"),
        (((0.0,), (1.0,), 1e-3, DEGREE9, 1e16), "must end after it starts"),
        (((), (), 1.0), "shape"),
    ],
)
def test_a_path_that_makes_no_sense_is_refused_with_a_sentence(arguments, sentence):
    with pytest.raises(InvalidReference, match=sentence):
        rest_to_rest(*arguments)


def test_jets_refuse_orders_and_times_they_cannot_answer():
    path = rest_to_rest(START, END, DURATION)
    with pytest.raises(InvalidReference, match="order 100 were asked for, but this path has orders 0 to 99"):
        path.jet(0.0, 100)
    with pytest.raises(InvalidReference, match="order -1"):
        path.jet(0.0, -1)
    with pytest.raises(InvalidReference, match="time number 1 is nan"):
        path.jet([0.0, np.nan], 1)
    with pytest.raises(InvalidReference, match="time number 0 is inf"):
        path.jet(np.inf, 1)
    with pytest.raises(InvalidReference, match=r"shape \(1, 1\)"):
        path.jet([[0.0]], 1)


def test_the_references_can_be_imported_and_evaluated_without_scipy():
    script = """
import sys, types
package = types.ModuleType("servocore")
package.__path__ = [sys.argv[1]]
sys.modules["servocore"], sys.modules["scipy"] = package, None
from servocore.references import rest_to_rest
import servocore.jets
rest_to_rest((0.0,), (1.0,), 1.0).jet(0.5, 4)
"""
    room = Path(__file__).resolve().parents[1] / "servocore"
    subprocess.run([sys.executable, "-c", script, str(room)], check=True, timeout=60)
