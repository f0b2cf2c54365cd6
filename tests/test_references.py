"""Reference paths: exact derivatives, rest where it is promised, sentences for what cannot be followed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from present import present
from processes import python

import servocore as sc
from servocore import (
    DEGREE3,
    DEGREE5,
    DEGREE7,
    DEGREE9,
    DEGREE13,
    rest_to_rest,
    sampled,
    three_phase,
    through,
)
from servocore.errors import InvalidReference
from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.profiles import PolynomialProfile, Profile, polynomial
from servocore.references.rest_to_rest import RestToRest
from servocore.references.timed_path import TimeScaled

START, END, DURATION = (5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 20.0
PROFILES = [DEGREE3, DEGREE5, DEGREE7, DEGREE9, DEGREE13, polynomial(1), three_phase(5.0), three_phase(10.0)]
EPS = np.finfo(float).eps


def unit(profile: sc.Profile, duration: float = DURATION, start_time: float = 0.0) -> RestToRest:
    return rest_to_rest((0.0,), (1.0,), duration, profile, start_time)


def exact_derivative(coefficients: Sequence[float | Fraction], T: float | Fraction, order: int) -> Fraction:
    """Derivative by T of a polynomial in rational arithmetic, for a float T taken as the rational it is."""
    for _ in range(order):
        coefficients = [i * c for i, c in enumerate(coefficients)][1:]
    value = Fraction(0)
    for c in reversed(list(coefficients)):
        value = value * Fraction(T) + Fraction(c)
    return value


def exact_three_phase(t: float | Fraction, tau: float | Fraction, tau0: float | Fraction, order: int) -> Fraction:
    """theory.md section 3 in rational arithmetic, order at most 1 outside the ramps."""
    t, tau, tau0 = Fraction(t), Fraction(tau), Fraction(tau0)
    if t > tau / 2:
        mirrored = exact_three_phase(tau - t, tau, tau0, order)
        return 1 - mirrored if order == 0 else (-1) ** (order + 1) * mirrored
    if t > tau0:
        return ((t - tau0 / 2) if order == 0 else Fraction(int(order == 1))) / (tau - tau0)
    ramp: list[float | Fraction] = [0, 0, 0, 0, 0, 7 / tau0**4, -14 / tau0**5, 10 / tau0**6, Fraction(-5, 2) / tau0**7]
    return exact_derivative(ramp, t, order) / (tau - tau0)


# --- profiles ---------------------------------------------------------------------------------------------


def test_degree_nine_and_thirteen_have_the_coefficients_of_the_theory() -> None:
    assert DEGREE9.coefficients == (0, 0, 0, 0, 0, 126, -420, 540, -315, 70)
    assert DEGREE13.coefficients == (0,) * 7 + (1716, -9009, 20020, -24024, 16380, -6006, 924)


@pytest.mark.parametrize("degree", [1, 3, 5, 7, 9, 11, 13, 21])
def test_a_polynomial_profile_satisfies_its_end_conditions_in_rational_arithmetic(degree: int) -> None:
    profile = polynomial(degree)
    assert exact_derivative(profile.coefficients, 0, 0) == 0
    assert exact_derivative(profile.coefficients, 1, 0) == 1
    for order in range(1, profile.smoothness + 1):
        assert exact_derivative(profile.coefficients, 0, order) == 0
        assert exact_derivative(profile.coefficients, 1, order) == 0
    assert exact_derivative(profile.coefficients, 0, profile.smoothness + 1) != 0


@pytest.mark.parametrize("profile", [DEGREE3, DEGREE5, DEGREE7, DEGREE9, DEGREE13], ids=lambda p: p.name)
def test_polynomial_derivatives_of_every_order_equal_rational_arithmetic(profile: PolynomialProfile) -> None:
    T = np.concatenate([np.linspace(0.0, 1.0, 65)[:-1], [1e-9, 1e-3, 1.0 - 1e-3, 1.0 - 2.0**-40]])
    jets = unit(profile, 1.0).jet(T, 15)[:, :, 0]
    for order in range(16):
        exact = np.array([float(exact_derivative(profile.coefficients, value, order)) for value in T])
        np.testing.assert_allclose(jets[:, order], exact, rtol=0.0, atol=16 * EPS * np.abs(exact).max())


@pytest.mark.parametrize("profile", [DEGREE9, DEGREE13], ids=lambda p: p.name)
def test_slopes_near_the_end_keep_full_relative_accuracy(profile: PolynomialProfile) -> None:
    T = 1.0 - 2.0 ** -np.arange(1.0, 30.0)
    jets = unit(profile, 1.0).jet(T, 4)[:, :, 0]
    for order in range(1, 5):
        exact = np.array([float(exact_derivative(profile.coefficients, value, order)) for value in T])
        np.testing.assert_allclose(jets[1:, order], exact[1:], rtol=50 * EPS)


@pytest.mark.parametrize("ramp", [1.0, 4.5, 10.0])
def test_the_three_phase_profile_equals_the_formula_of_the_theory(ramp: float) -> None:
    t = np.linspace(0.0, DURATION, 97)[:-1]
    jets = unit(three_phase(ramp)).jet(t, 4)[:, :, 0]
    for order in range(5):
        exact = np.array([float(exact_three_phase(value, DURATION, ramp, order)) for value in t])
        np.testing.assert_allclose(jets[:, order], exact, rtol=0.0, atol=16 * EPS * np.abs(exact).max())


def test_a_three_phase_profile_without_a_ramp_accelerates_for_a_quarter_of_the_duration() -> None:
    t = np.linspace(0.0, DURATION, 50)
    np.testing.assert_array_equal(unit(three_phase()).jet(t, 4), unit(three_phase(5.0)).jet(t, 4))


@pytest.mark.parametrize("profile", PROFILES, ids=str)
@given(fraction=st.floats(0.0, 1.0), duration=st.floats(0.1, 100.0))
def test_profiles_are_symmetric_about_the_middle(profile: Profile, fraction: float, duration: float) -> None:
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
def test_profiles_start_and_end_with_derivatives_that_are_exactly_zero(profile: Profile) -> None:
    path = unit(profile, start_time=3.7)
    k = path.smoothness
    np.testing.assert_array_equal(path.jet([path.start_time], k)[0, :, 0], np.zeros(k + 1))
    np.testing.assert_array_equal(path.jet([path.end_time], k)[0, :, 0], np.eye(k + 1)[0])
    assert path.jet(path.start_time, k + 1)[k + 1, 0] > 0.0  # the next one jumps: C^k and no more


def test_a_profile_of_even_degree_or_a_ramp_that_is_not_positive_does_not_exist() -> None:
    with pytest.raises(InvalidReference, match="odd degree of 1 or more, not 8"):
        polynomial(8)
    with pytest.raises(InvalidReference, match="positive time, not 0"):
        three_phase(0.0)
    with pytest.raises(InvalidReference, match="positive time, not nan"):
        three_phase(float("nan"))


# --- rest to rest -----------------------------------------------------------------------------------------


def test_the_default_manoeuvre_runs_along_the_straight_line_of_equation_32() -> None:
    path = rest_to_rest(START, END, DURATION)
    t = np.linspace(0.0, DURATION, 41)
    gamma = path.jet(t, 0)[:, 0]
    s = [float(exact_derivative(DEGREE9.coefficients, value / DURATION, 0)) for value in t]
    line = np.array(START) + np.outer(s, np.subtract(END, START))
    np.testing.assert_allclose(gamma, line, rtol=0.0, atol=1e-14)
    assert path.dimension == 3
    assert path.duration == DURATION
    assert path.fit_error is None


def test_before_the_start_and_after_the_end_the_path_rests_at_its_end_points() -> None:
    path = rest_to_rest(START, END, DURATION, DEGREE7, start_time=2.0)
    jets = path.jet([-1e9, 1.999, 22.0, 1e9], 9)
    np.testing.assert_array_equal(jets[:2, 0], [START, START])
    np.testing.assert_array_equal(jets[2:, 0], [END, END])
    assert not jets[:, 1:].any()


def test_one_time_gives_one_jet_and_it_is_the_one_of_the_row_of_times() -> None:
    path = rest_to_rest(START, END, DURATION)
    rows = path.jet([3.0, 4.0], 5)
    assert rows.shape == (2, 6, 3)
    np.testing.assert_array_equal(path.jet(4.0, 5), rows[1])
    assert path.jet([], 2).shape == (0, 3, 3)


@pytest.mark.parametrize("profile", PROFILES[2:5] + PROFILES[6:], ids=str)
@given(center=st.floats(0.05, 0.95), delta=st.floats(-0.4, 0.4))
def test_a_taylor_step_from_one_jet_reaches_the_jet_at_another_time(
    profile: Profile, center: float, delta: float
) -> None:
    path = rest_to_rest(START, END, DURATION, profile)
    t0, t1 = center * DURATION, center * DURATION + delta
    ramp = getattr(profile, "ramp", DURATION)
    assume(not any(min(t0, t1) <= joint <= max(t0, t1) for joint in (0.0, ramp, DURATION - ramp, DURATION)))
    jet, other = path.jet(t0, 16), path.jet(t1, 4)
    for order in range(5):
        expanded = sum(jet[order + i] * delta**i / np.prod(np.arange(1.0, i + 1)) for i in range(13))
        np.testing.assert_allclose(expanded, other[order], rtol=0.0, atol=1e-13)


def test_paths_are_values_that_compare_and_cannot_be_changed() -> None:
    path = rest_to_rest(START, END, DURATION)
    assert path == rest_to_rest(list(START), np.array(END).tolist(), DURATION)
    with pytest.raises(AttributeError):
        path.end_time = 3.0  # type: ignore[misc]  # wrong on purpose


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
def test_a_path_that_makes_no_sense_is_refused_with_a_sentence(
    arguments: tuple[tuple[float, ...] | float | Profile, ...], sentence: str
) -> None:
    with pytest.raises(InvalidReference, match=sentence):
        rest_to_rest(*arguments)  # type: ignore[arg-type]  # wrong on purpose


def test_jets_refuse_orders_and_times_they_cannot_answer() -> None:
    path = rest_to_rest(START, END, DURATION)
    with pytest.raises(InvalidReference, match="order 100 are not available: this path has orders 0 to 99"):
        path.jet(0.0, 100)
    with pytest.raises(InvalidReference, match="order -1"):
        path.jet(0.0, -1)
    with pytest.raises(InvalidReference, match="time number 1 is nan"):
        path.jet([0.0, np.nan], 1)
    with pytest.raises(InvalidReference, match="time number 0 is inf"):
        path.jet(np.inf, 1)
    with pytest.raises(InvalidReference, match=r"shape \(1, 1\)"):
        path.jet([[0.0]], 1)


# --- through waypoints ------------------------------------------------------------------------------------

WAYPOINTS = np.array([[5, 0, -6], [5, 0, -3], [2, 4, -3], [-3, 4, -3], [-4, 3, -6.0]])
TIMES = np.array([0.0, 12.0, 22.0, 31.0, 40.0])
PATH = through(WAYPOINTS, TIMES)


def relative_errors(path: PiecewisePolynomial, truth: Reference, order: int) -> Array:
    t = np.linspace(truth.start_time, truth.end_time, 1003)[1:-1]
    found, exact = path.jet(t, order), truth.jet(t, order)
    return np.asarray(np.abs(found - exact).max(axis=(0, 2)) / np.abs(exact).max(axis=(0, 2)))


def test_a_path_through_two_waypoints_is_the_rest_to_rest_path_of_degree_nine() -> None:
    path, line = through([START, END], [2.0, 22.0]), rest_to_rest(START, END, 20.0, start_time=2.0)
    assert relative_errors(path, line, 9).max() < 1e-13


@pytest.mark.parametrize("order", [1, 2, 3, 6, 8])
def test_paths_rest_in_as_many_derivatives_as_are_asked_for(order: int) -> None:
    line = rest_to_rest(START, END, DURATION, polynomial(2 * order + 1))
    t = np.linspace(0.0, DURATION, 201)
    way = through([START, END], [0.0, DURATION], rest_order=order)
    found = sampled(t, line.jet(t, 0)[:, 0], rest_order=order)
    for path in (way, found):
        assert (path.smoothness, path.max_order) == (order, 2 * order + 1)
        assert relative_errors(path, line, order).max() < 1e-11
        assert not path.jet([-1.0, 0.0, DURATION, 99.0], order)[:, 1:].any()


@pytest.mark.parametrize("order", [0, -1, 2.5])
def test_an_end_rests_in_one_or_more_whole_derivatives(order: float) -> None:
    paths: tuple[Callable[[], Reference], ...] = (
        lambda: through([START, END], duration=1.0, rest_order=order),  # type: ignore[arg-type]  # wrong on purpose
        lambda: sampled([], [], rest_order=order),  # type: ignore[arg-type]  # wrong on purpose
    )
    for path in paths:
        with pytest.raises(InvalidReference, match=f"one or more whole derivatives vanish, not {order}"):
            path()


def test_who_doubts_less_gets_rougher_paths() -> None:
    t = np.linspace(0.0, 10.0, 401)
    rounded = np.sin(t)[:, None].round(8)
    with pytest.raises(InvalidReference, match="too rough"):
        sampled(t, rounded)
    assert sampled(t, rounded, doubt=1e9).dimension == 1
    with pytest.raises(InvalidReference, match="must be a positive fraction"):
        sampled(t, rounded, doubt=0.0)


def test_a_path_meets_its_waypoints_and_rests_exactly_at_and_beyond_its_ends() -> None:
    np.testing.assert_allclose(PATH.jet(TIMES, 0)[:, 0], WAYPOINTS, rtol=0.0, atol=1e-14)
    outside = PATH.jet([-1.0, 0.0, 40.0, 99.0], 4)
    np.testing.assert_array_equal(outside[:, 0], WAYPOINTS[[0, 0, -1, -1]])
    assert not outside[:, 1:].any()
    assert (PATH.smoothness, PATH.max_order, PATH.fit_error, PATH.dimension) == (4, 9, None, 3)


def test_derivatives_to_the_eighth_are_continuous_at_inner_waypoints() -> None:
    before, after = PATH.jet(TIMES[1:-1] - 1e-12, 9), PATH.jet(TIMES[1:-1] + 1e-12, 9)
    peaks = np.abs(PATH.jet(np.linspace(0.0, 40.0, 400), 9)).max(axis=(0, 2))
    jump = np.abs(after - before).max(axis=(0, 2)) / peaks
    assert jump[:9].max() < 1e-10
    assert jump[9] > 0.1


def test_the_derivatives_of_a_spline_are_the_taylor_coefficients_of_its_positions() -> None:
    t, delta = np.linspace(0.5, 39.5, 79), np.array([-0.4, 0.3])
    jets = PATH.jet(t[~np.isin(np.round(t), TIMES)], 9)
    centers = t[~np.isin(np.round(t), TIMES)]
    for step in delta:
        for order in range(9):
            powers = step ** np.arange(10 - order) / [np.prod(np.arange(1.0, i + 1)) for i in range(10 - order)]
            expanded = np.einsum("i,nid->nd", powers, jets[:, order:])
            np.testing.assert_allclose(expanded, PATH.jet(centers + step, 9)[:, order], rtol=0.0, atol=1e-13)


def test_without_times_a_straight_row_of_waypoints_is_passed_like_a_three_phase_motion() -> None:
    row = np.outer(np.linspace(0.0, 1.0, 9), [3.0, 4.0])
    path, ideal = through(row, duration=20.0), rest_to_rest(row[0], row[-1], 20.0, three_phase())
    t = np.linspace(0.0, 20.0, 101)
    assert np.abs(path.jet(t, 0) - ideal.jet(t, 0)).max() < 1e-3 * np.linalg.norm(row[-1])
    assert path.duration == 20.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"waypoints": [START]}, "at least two waypoints"),
        ({"waypoints": [START, END]}, "either the times of the waypoints or the duration"),
        ({"waypoints": [START, END], "times": [0, 1], "duration": 1}, "either the times"),
        ({"waypoints": [START, START, END], "duration": 1.0}, "waypoints 0 and 1 coincide"),
        ({"waypoints": [START, END], "duration": -1.0}, "positive time, not -1.0 s"),
        ({"waypoints": [START, END], "times": [0.0, 0.0]}, "waypoint 1 is at 0.0 s after one at 0.0 s"),
        ({"waypoints": [START, END], "times": [0.0]}, "2 waypoints need 2 times"),
        ({"waypoints": [START, END[:2]], "duration": 1.0}, "same number of finite numbers"),
        ({"waypoints": [START, (0, 0, np.inf)], "duration": 1.0}, "waypoint 1, component 2 is inf"),
    ],
)
def test_waypoints_that_make_no_path_are_refused(
    arguments: dict[str, list[tuple[float, float, float]]], sentence: str
) -> None:
    with pytest.raises(InvalidReference, match=sentence):
        through(**arguments)  # type: ignore[arg-type]  # wrong on purpose


# --- sampled positions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.5, 0.1, 0.05, 0.01])
def test_samples_of_the_default_manoeuvre_give_it_back_to_rounding(step: float) -> None:
    truth = rest_to_rest(START, END, DURATION)
    t = np.linspace(0.0, DURATION, round(DURATION / step) + 1)
    path = sampled(t, truth.jet(t, 0)[:, 0])
    assert relative_errors(path, truth, 6).max() < 1e-13
    assert present(path.fit_error) < 1e-13
    assert path.rests_before
    assert path.rests_after


@pytest.mark.parametrize("step", [0.5, 0.1, 0.01, 0.005])
def test_samples_of_a_spline_give_its_snap_back_however_dense_they_are(step: float) -> None:
    t = np.linspace(0.0, 40.0, round(40.0 / step) + 1)
    path = sampled(t, PATH.jet(t, 0)[:, 0])
    assert relative_errors(path, PATH, 4)[4] < 1e-5
    assert relative_errors(path, PATH, 0)[0] * 6.0 <= max(present(path.fit_error), 1e-14)
    assert path.smoothness == 4


def test_a_path_that_moves_at_its_ends_goes_on_as_it_is() -> None:
    t = np.linspace(0.0, 10.0, 101)
    path = sampled(t, np.stack([np.sin(t), t], axis=1))
    outside = path.jet([-0.05, 10.05], 3)
    np.testing.assert_allclose(outside[:, 0, 0], np.sin([-0.05, 10.05]), atol=1e-8)
    np.testing.assert_allclose(outside[:, 1, 1], 1.0, atol=1e-8)
    assert path.smoothness == 8


def test_a_motion_after_a_rest_and_before_a_start_at_speed_rests_at_one_end_only() -> None:
    t = np.linspace(0.0, 1.2, 121)
    path = sampled(t, DEGREE13.jet(t / 2, 1.0 - t / 2, 1.0, 0) + np.zeros(1))
    assert path.rests_before
    assert not path.rests_after


@pytest.mark.parametrize("step", [0.5, 0.1, 0.02])
@pytest.mark.parametrize("profile", [polynomial(1), DEGREE3, DEGREE5], ids=lambda p: p.name)
def test_a_jump_in_one_of_the_first_three_derivatives_is_refused_however_dense_the_samples(
    profile: PolynomialProfile, step: float
) -> None:
    t = np.linspace(0.0, 24.0, round(24.0 / step) + 1)
    positions = rest_to_rest(START, END, 16.0, profile, start_time=4.0).jet(t, 0)[:, 0]
    with pytest.raises(InvalidReference, match="too rough near t = ") as refusal:
        sampled(t, positions)
    named = float(str(refusal.value).split("t = ")[1].split()[0])
    assert min(abs(named - 4.0), abs(named - 20.0)) <= 2.0 * step


@pytest.mark.parametrize(
    ("t", "positions", "tolerance", "sentence"),
    [
        (np.arange(19.0), np.zeros((19, 3)), None, "19 samples are too few: .* at least 20"),
        (np.arange(20.0), np.zeros((19, 3)), None, "19 samples need 19 times"),
        (np.zeros(20), np.zeros((20, 3)), None, "sample 1 is at 0.0 s after one at 0.0 s"),
        (np.arange(20.0), np.full((20, 3), np.nan), None, "sample 0, component 0 is nan"),
        (np.full(20, np.nan), np.zeros((20, 3)), None, "time of sample 0, component 0 is nan"),
        (np.arange(20.0), np.zeros(20), None, "one sample a row"),
        (np.arange(20.0), np.zeros((20, 3)), -1.0, "length in m, not -1.0"),
    ],
)
def test_samples_that_are_no_table_are_refused(
    t: Array, positions: Array, tolerance: float | None, sentence: str
) -> None:
    with pytest.raises(InvalidReference, match=sentence):
        sampled(t, positions, tolerance)


def test_the_references_can_be_imported_and_evaluated_without_scipy() -> None:
    script = """
import sys, types
package = types.ModuleType("servocore")
package.__path__ = [sys.argv[1]]
sys.modules["servocore"], sys.modules["scipy"] = package, None
import servocore.references.csv_file, servocore.references.periodic, servocore.scenes.jets
from servocore.references.rest_to_rest import rest_to_rest
rest_to_rest((0.0,), (1.0,), 1.0).jet(0.5, 4)
"""
    package = Path(__file__).resolve().parents[1] / "servocore"
    run = python("-c", script, package)
    assert run.returncode == 0, run.stderr


# Stretches -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        (rest_to_rest((0.0,), (1.0,), 3.0, start_time=1.0), [1.0, 4.0]),
        (rest_to_rest((0.0,), (1.0,), 3.0, three_phase(0.5), start_time=1.0), [1.0, 1.5, 3.5, 4.0]),
        (rest_to_rest((0.0,), (1.0,), 3.0, three_phase(1.5)), [0.0, 1.5, 3.0]),
        (through([(0.0,), (1.0,), (3.0,)], times=[0.0, 2.0, 3.0]), [0.0, 2.0, 3.0]),
    ],
    ids=["one polynomial", "three phases", "no cruise", "waypoints"],
)
def test_a_path_tells_where_its_pieces_meet(path: Reference, expected: list[float]) -> None:
    np.testing.assert_allclose(path.stretches, expected, rtol=1e-15)


def test_a_path_is_the_same_however_many_times_are_asked_for_at_once() -> None:
    path = through([[0.0, 0.0], [1.0, 2.0], [3.0, 1.0]], [0.0, 2.0, 3.0])
    t = np.linspace(-1.0, 4.0, 10_001)
    assert np.array_equal(path.jet(t, 4), np.concatenate([path.jet(part, 4) for part in np.array_split(t, 977)]))


# Enclosures ----------------------------------------------------------------------------------------------------------

TURN = rest_to_rest((0.0, 1.0), (2.0, -1.0), 3.0, start_time=1.0)
ROUND = sc.periodic((1.0,), [[0.5], [0.25]], [[0.0], [2.0]], period=4.0)


@pytest.mark.parametrize(
    "path",
    [
        TURN,
        rest_to_rest((0.0,), (1.0,), 3.0, three_phase(0.5)),
        through([(0.0,), (1.0,), (3.0,)], times=[0.0, 2.0, 3.0]),
        ROUND,
        *(TimeScaled.to(each, 2.5 * each.duration) for each in (TURN, ROUND)),
    ],
    ids=["one polynomial", "three phases", "waypoints", "periodic", "slower polynomial", "slower periodic"],
)
def test_an_enclosure_holds_the_path_and_its_derivatives_and_is_hardly_wider(path: Reference) -> None:
    grid = np.union1d(path.joints, np.linspace(path.start_time, path.end_time, 33))
    coefficients, radii = path.enclosure(a := grid[:-1], b := grid[1:], 4)
    for share in np.linspace(-0.999, 0.999, 7):
        found = np.polynomial.chebyshev.chebval(share, np.moveaxis(coefficients, -1, 0))
        assert (np.abs(path.jet((a + b + share * (b - a)) / 2.0, 4) - found) <= radii).all()
    assert (radii.max(axis=0) < 1e-11 * np.abs(coefficients).sum(axis=-1).max(axis=0)).all()
