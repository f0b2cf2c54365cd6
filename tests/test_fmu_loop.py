"""The loop of inverse model and plant holds at every step, in masters of our own; ``make loop`` has all cases."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from called import laws
from fmu_host import Host
from loop_information import smallest_distance
from loop_stability import sensitivity, transition_norms
from loops import (
    BOUNDS,
    CRANE,
    KINDS,
    STEPS,
    Case,
    Loop,
    deviation,
    distances,
    fastest,
    random_case,
    schedule,
)
from plain_crane import advance, flat, linear, measured_of, riccati, sampled, worth
from scipy.linalg import expm, logm
from thinned import thinned

import servocore as sc
from crane_fmu.build.sampling import SHORT_TURN

MASTERS = ("start", "end")
GUSTS = [(0.0, 20.0, 0.0), (20.0, 0.0, 0.0), (0.0, 0.0, -20.0), (-14.14, -14.14, 0.0)]


@pytest.mark.parametrize("h", STEPS[:-2])
@pytest.mark.parametrize("at", MASTERS)
def test_the_default_manoeuvre_holds_at_every_step(at: str, h: float) -> None:
    assert deviation(Case(), h, at) < BOUNDS[h] / 50.0


@pytest.mark.parametrize("any_crane", [False, True], ids=["nominal", "any crane"])
@pytest.mark.parametrize("at", MASTERS)
def test_random_manoeuvres_hold_at_long_steps(at: str, any_crane: bool) -> None:
    rng = np.random.default_rng(11 + any_crane)
    for h in (0.1, 0.05):
        for _ in range(2):
            case = random_case(rng, any_crane=any_crane)
            if fastest(case) * h <= 1.0:
                assert deviation(case, h, at) < BOUNDS[h] * (3.0 if any_crane else 1.0), case.name


# Steps that vary -----------------------------------------------------------------------------------------------------

GUST = {"gust[2]": 20.0, "gust_start": 8.0, "gust_duration": 2.0}
BLOWN_AT = Case(disturbance={"mass_error": 0.05, **GUST})


@pytest.mark.parametrize(
    ("longest", "factor", "at"),
    thinned(
        [(h, factor, at) for h, factor in ((0.1, 10.0), (0.01, 30.0)) for at in MASTERS],
        lambda case: case == (0.1, 10.0, "start"),
    ),
)
def test_no_load_is_lost_where_steps_vary(longest: float, factor: float, at: str) -> None:
    """A law that counts on a step as long as the last loses all of them with a Jacobi master."""
    for kind in KINDS:
        assert np.isfinite(distances(2, kind, longest, factor, at)).all(), kind


@pytest.mark.parametrize("at", MASTERS)
def test_fmus_keep_the_load_where_steps_vary(at: str) -> None:
    steps = schedule(np.random.default_rng(5), "either", 0.1, 10.0, 21.0)
    assert deviation(Case(), steps, at) < BOUNDS[0.1]
    assert deviation(BLOWN_AT, steps, at) < 60.0  # with feedforward alone the load falls


def test_steps_that_differ_by_round_off_are_steps_of_one_length() -> None:
    uneven = np.diff(0.1 * np.arange(211))
    assert len(set(uneven.tolist())) > 1
    assert deviation(Case(), uneven) == pytest.approx(deviation(Case(), 0.1), rel=1e-9)


NEAR_AXIS = sc.rest_to_rest([0.5, -2.1, -7.0], [-3.2, 0.8, -5.2], 15.8, sc.three_phase())
"""The trolley passes the axis at 1.4 m, on a rope of 6.7 m."""


@pytest.mark.parametrize("force", GUSTS)
@pytest.mark.parametrize(
    ("path", "begin"), [(CRANE.reference, 8.0), (NEAR_AXIS, 4.2)], ids=["default", "near the axis"]
)
def test_a_mass_error_and_a_gust_cost_less_than_10_mm_at_10_ms(
    path: sc.Reference, begin: float, force: tuple[float, float, float]
) -> None:
    gust = {f"gust[{k + 1}]": force[k] for k in range(3)} | {"gust_start": begin, "gust_duration": 2.0}
    case = Case(path, disturbance={"mass_error": 0.05, **gust})
    assert deviation(case, 0.01, stop=begin + 3.0) < 10.0


def test_without_feedback_a_gust_is_not_forgiven() -> None:
    """The bound above is no matter of course: a pendulum of four metres gives way by 80 mm."""
    assert deviation(Case(disturbance=GUST), 0.01, stop=11.0, feedback=0.0) > 50.0


def test_a_steady_wind_leaves_no_lasting_error() -> None:
    blown = Case(disturbance={"wind[1]": 10.0, "wind[2]": -10.0, "mass_error": -0.05})
    assert deviation(blown, 0.01, stop=6.0) < 10.0


def test_a_breeze_does_not_let_the_load_fall_before_the_first_inputs_arrive() -> None:
    assert deviation(Case(disturbance={"wind[1]": 1e-3}), 0.01, stop=4.0, feedback=0.0) < 0.2


def test_drives_that_give_no_more_bring_the_load_back_without_winding_up() -> None:
    """The gust takes some 1.6 kN.m; with half a kN.m the load gives way and returns."""
    path, h, count = CRANE.reference, 0.02, 800
    jets, errors, peak = path.jet(h * np.arange(count + 1), 4), [], 0.0
    limits: dict[str, Any] = {"limit.M_b": 500.0}
    with Loop(Case(disturbance=GUST), **limits) as loop:
        for k in range(count):
            errors.append(np.linalg.norm(loop.step(jets, k, h) - jets[k + 1, 0]))
            peak = max(peak, abs(loop.crane["M_b"]))
    assert peak == pytest.approx(500.0)
    assert 0.008 < max(errors) < 0.2
    assert errors[-1] < 1e-3


OFF_THE_PATH = {
    "along x": {"start.position[1]": 5.4},
    "along y": {"start.position[2]": -0.4},
    "above": {"start.position[3]": -4.6},
    "falling": {"start.velocity[3]": -0.5},
    "moving": {"start.velocity[2]": 0.25},
    "swinging": {"start.swing[1]": 0.05, "start.swing[2]": -0.05},
}


@pytest.mark.parametrize(
    ("h", "at"), thinned([(h, at) for h in (0.1, 0.02) for at in MASTERS], lambda case: case == (0.1, "start"))
)
@pytest.mark.parametrize("start", OFF_THE_PATH.values(), ids=OFF_THE_PATH)
def test_a_plant_that_starts_off_its_path_is_led_back_with_a_taut_rope(
    start: dict[str, float], h: float, at: str
) -> None:
    jets, tensions = CRANE.reference.jet(h * np.arange(round(9.0 / h)), 4), []
    with Loop(Case(disturbance=start), at) as loop:
        for k in range(len(jets) - 1):
            place = loop.step(jets, k, h)
            tensions.append(loop.plant["tension"])
        assert not loop.crane.messages
    assert np.linalg.norm(place - jets[-1, 0]) < 1e-3
    assert min(tensions) > 0.8 * 981.0


def at_rest(shift: float) -> dict[str, float]:
    """What a crane at rest measures whose load hangs off by a distance along x."""
    return {"measured.s": 5.0 + shift, "measured.l": 5.0, "measured.position[1]": 5.0 + shift,
            "measured.position[3]": -5.0}  # fmt: skip


def test_a_load_far_from_its_path_is_left_to_the_feedforward_and_told_once() -> None:
    with Host() as host:
        host.start()
        for k, shift in enumerate((0.6, 0.4, 0.6, 0.2)):
            host.set(**at_rest(shift))
            assert host.step(0.1 * k, 0.1)
            assert (host["F"] == pytest.approx(0.0, abs=1e-6)) == (k < 3)
        assert len(host.messages) == 1
        assert "the measured load is 0.6 m from its path, more than feedback_distance = 0.5 m" in host.messages[0]


def test_a_step_too_long_for_the_pendulum_is_told_with_the_longest_that_will_do() -> None:
    with Host() as host:
        host.start().set(**at_rest(0.01))
        assert host.step(0.0, 0.3)
        assert host["F"] == pytest.approx(0.0, abs=1e-6)
        longest = 1.0 / np.sqrt(9.81 / 5.0 * 11.0)
        assert f"it may be {longest:.3g} s at most" in host.messages[0]


# Stability -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("h", [0.1])
@pytest.mark.parametrize("at", MASTERS)
def test_the_transition_matrix_of_the_whole_loop_decays_over_the_path(at: str, h: float) -> None:
    """Frozen eigenvalues prove nothing for a crane that moves: the product over the path has to become small."""
    norms = list(transition_norms(laws()[at], at, h))
    assert norms[-1] < 1e-10 * max(norms)


@pytest.mark.parametrize(("at", "bound"), [("start", 4.8), ("end", 3.1)])
def test_disturbances_at_the_inputs_are_amplified_no_more_than_the_page_says(at: str, bound: float) -> None:
    law = laws()[at]
    for h in (0.1, 0.01):
        for place in CRANE.reference.jet(np.array([0.0, 10.0, 20.0]), 0)[:, 0]:
            assert sensitivity(law, at, h, place) < bound


@pytest.mark.parametrize("h", [0.1, 0.01, 0.001, 0.0001])
@pytest.mark.parametrize("at", MASTERS)
def test_the_first_gains_are_stationary_and_stable(at: str, h: float) -> None:
    """The only cost-to-go that a Riccati step leaves as it is, and under whose gains the loop is stable."""
    random = np.random.default_rng(13)
    for case in (Case(), *(random_case(random, any_crane=True) for _ in range(4))):
        jet, p = np.zeros((5, 3)), np.array(list((CRANE.parameter_values() | case.crane).values()))
        jet[0] = case.reference.jet(0.0, 0)[0]
        x, u = flat(jet, p)
        M = laws()[at].begin(jet.ravel(), measured_of(x), p, h)[0][:100].reshape(10, 10)
        A, new, old = model = linear(at, sampled(False, x, u, np.zeros(3), p, h))
        R, S = worth(x, p, h, 0.0)
        size, reach = np.sqrt(np.diag(M)), A @ new + old
        assert (np.abs(riccati(M, *model, R, S) - M) < 1e-13 * np.outer(size, size)).all(), case.name
        effort, pull = R + new.T @ S @ new + reach.T @ M @ reach, new.T @ S + reach.T @ M @ A
        assert np.abs(np.linalg.eigvals(A - reach @ np.linalg.solve(effort, pull))).max() < 1.0 - 0.5 * h


# What is not known in time -------------------------------------------------------------------------------------------


def test_a_jump_of_crackle_costs_what_no_jacobi_master_can_save() -> None:
    """The law stays within a dozen times of the least that any inputs could reach, those without bounds included."""
    assert smallest_distance() == pytest.approx(1.33, abs=0.01)
    assert smallest_distance(most=5.0) == pytest.approx(2.66, abs=0.01)
    assert smallest_distance(first=1) < 0.15
    path = sc.rest_to_rest([5.0, 2.0, -5.0], [2.0, 6.0, -4.0], 10.0, sc.three_phase())
    jump = float(np.linalg.norm(path.jet(np.zeros(1), 5)[0, 5]))
    found = 1e-3 * deviation(Case(path), 0.1) / (jump * 0.1**5)
    assert 1.33 < found < 16.0


# Short steps ---------------------------------------------------------------------------------------------------------


def test_the_linearized_crane_over_a_step_is_that_of_the_matrix_exponential() -> None:
    """And a short step is computed with less work: of the law in NumPy, which the kernel's is equal to."""
    x, u, d = np.array([5.0, 1.0, 5.3, 0.8, -4.0, 0.2, 0.4, 0.1, 0.3, -0.2]), np.array([30.0, 20.0, -40.0]), np.ones(3)
    p, slope, turn = np.array(list(CRANE.parameter_values().values())), np.array([100.0, 50.0, 20.0]), fastest(Case())
    apart = [advance(each, x, u, slope, d, p, SHORT_TURN / turn) for each in (True, False)]
    assert 0.0 < np.abs(apart[0] - apart[1]).max() < 1e-6
    tiny, begun, _ = sampled(False, x, u, d, p, 1e-3)
    rate = logm(tiny).real / 1e-3
    for short, h in ((True, SHORT_TURN / turn), (False, 1.0 / turn)):
        whole = np.zeros((16, 16))  # of state, inputs and their slope: its exponential has all three
        whole[:10, :10], whole[:10, 10:13] = rate, np.linalg.solve(tiny - np.eye(10), rate) @ begun
        whole[10:13, 13:] = np.eye(3)
        exact = expm(whole * h)
        wanted = exact[:10, :10], exact[:10, 10:13], exact[:10, 13:] / h
        for found, each in zip(sampled(short, x, u, d, p, h), wanted, strict=True):
            assert np.abs(found - each).max() < 1e-3 * np.abs(each).max()
