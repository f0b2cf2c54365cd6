"""Which time an input belongs to, proven with a sine; and derivatives that are not connected, estimated."""

from __future__ import annotations

import numpy as np
import pytest
from fmu_host import Host
from hypothesis import given
from hypothesis import strategies as st

import servocore as sc
from crane_fmu.slave.estimate import amplification, completed, contradiction, kept_samples
from crane_fmu.slave.interface import ORDERS

CRANE = sc.scenes.rotary_crane()
RATE, SIZE = 1.0, 0.5


def sine(t):
    """Jets of a load that swings to and fro along the bridge, shape (n, 5, 3)."""
    t = np.atleast_1d(t)
    jets = np.zeros((len(t), 5, 3))
    for k in range(5):
        jets[:, k, 0] = SIZE * RATE**k * np.sin(RATE * t + k * np.pi / 2)
    jets[:, 0] += 5.0, 0.0, -5.0
    return jets


def driven(step, connected, stop=3.0, settings=None, jets=sine):
    """Times and outputs of a host that connects derivatives up to one order, from the first step on."""
    t = np.arange(round(stop / step) + 1) * step
    names = ("M_b", "F", "M_w", "s", "l")
    rows = []
    with Host() as host:
        host.set(**(settings or {}))
        host.start(_told(jets(t[:1])[0], connected))
        for k in range(len(t) - 1):
            host.tell(_told(jets(t[k : k + 1])[0], connected))
            assert host.step(t[k], step), host.messages
            rows.append([host[name] for name in names])
        said = list(host.messages)
    return t[1:], dict(zip(names, np.array(rows).T, strict=True)), said


def _told(jet, connected):
    told = jet.copy()
    told[ORDERS.index(connected) + 1 :] = 0.0
    return told


def exact(t):
    return sc.scenes.rotary_crane().closed_form(sine(t), CRANE.parameter_values())


def error(name, step, connected="snap", **settings):
    t, found, _ = driven(step, connected, settings={"connected": connected, **settings})
    late = t > 1.0
    return np.abs(found[name] - exact(t)[name])[late].max()


def test_with_all_derivatives_connected_the_lag_is_gone():
    """A host that holds its inputs would see s late by a step: an error of 5e-3 m at 10 ms."""
    assert error("s", 0.01) < 1e-6 * SIZE
    t, found, _ = driven(0.01, "snap")
    lagging = np.abs(found["s"] - exact(t - 0.01)["s"]).max()
    assert lagging > 3e-3 * SIZE


def test_the_error_of_the_extrapolated_position_is_of_fifth_order():
    """The load's height has no part in it, and s = x + k x'': x is of order five, x'' of order three."""
    errors = []
    for step in (0.2, 0.1):
        t = np.arange(0.0, 3.0, step)
        jets = sine(t)
        moved = np.array([np.polynomial.polynomial.polyval(step, jet[:, 0] / [1, 1, 2, 6, 24]) for jet in jets])
        errors.append(np.abs(moved - sine(t + step)[:, 0, 0]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(5.0, abs=0.2)
    assert np.log2(error("s", 0.1) / error("s", 0.05)) == pytest.approx(3.0, abs=0.2)


def test_inputs_of_the_end_of_a_step_take_no_extrapolation():
    t = np.arange(301) * 0.01
    with Host() as host:
        host.set(input_time="end").start(sine(t[:1])[0])
        for k in range(300):
            host.tell(sine(t[k + 1])[0])
            assert host.step(t[k], 0.01)
        assert host["F"] == pytest.approx(exact(t[-1:])["F"][0], rel=1e-9)


@pytest.mark.parametrize("connected", ORDERS[:-1])
def test_what_is_not_connected_is_estimated_to_the_order_that_the_page_states(connected):
    """Snap, and with it F, to third order in the step, lag included: to first order by the extrapolation of snap."""
    motion = error("s", 0.02, connected)
    assert motion < 3e-5
    assert error("F", 0.02, connected) < 0.05 * 60.0
    assert error("F", 0.01, connected) < 0.6 * error("F", 0.02, connected)


@pytest.mark.parametrize("connected", ORDERS[:-1])
def test_estimates_fall_with_third_order_in_snap(connected):
    order, errors = ORDERS.index(connected), []
    for step in (0.04, 0.02):
        samples = ()
        for t in np.arange(-10, 1) * step:
            samples = kept_samples(samples, t, sine(t)[0, order], order)
        found = completed(samples, _told(sine(0.0)[0], connected), order, step)
        errors.append(np.abs(found[4] - sine(0.0)[0, 4]).max() + np.abs(found[3] - sine(0.0)[0, 3]).max() / step)
    assert np.log2(errors[0] / errors[1]) > 2.7


@given(st.lists(st.floats(-1, 1), min_size=5, max_size=5), st.sampled_from(range(4)), st.floats(0.005, 0.2))
def test_quartic_paths_are_estimated_exactly_also_with_steps_that_vary(coefficients, order, step):
    path = np.polynomial.Polynomial(coefficients)
    times = np.cumsum([0.0, *(step * f for f in (1.0, 0.7, 1.3, 1.0, 0.9, 1.1, 1.0))])
    times -= times[-1]
    samples = ()
    for t in times:
        samples = kept_samples(samples, t, (path.deriv(order)(t) if order else path(t),) * 3, order)
    jet = np.array([[path.deriv(k)(0.0) if k else path(0.0)] * 3 for k in range(5)])
    told = jet.copy()
    told[order + 1 :] = 0.0
    found = completed(samples, told, order, step)
    scale = step ** -np.maximum(np.arange(5) - order, 0.0)[:, None]
    assert (np.abs(found - jet) <= 1e-10 * scale).all()


def test_noise_comes_out_as_amplified_as_the_page_says():
    rng, step = np.random.default_rng(3), 0.01
    for order in range(4):
        samples = ()
        for t in np.arange(-10, 1) * step:
            samples = kept_samples(samples, t, 1e-9 * rng.choice([-1.0, 1.0], 3), order)
        found = np.abs(completed(samples, np.zeros((5, 3)), order, step)[4]).max()
        assert found <= amplification(order) * 1e-9 / step ** (4 - order) * (1 + 1e-9)


def test_positions_alone_are_enough_for_the_default_manoeuvre():
    _, found, said = driven(
        0.02, "position", 20.0, {"connected": "position"}, lambda t: CRANE.reference.jet(np.atleast_1d(t), 4)
    )
    wanted = CRANE.exact(np.arange(1, 1001) * 0.02)
    assert said == []
    for name in ("M_b", "F", "M_w"):
        assert np.abs(found[name] - wanted[name]).max() < 0.03 * np.abs(wanted[name]).max(), name


@pytest.mark.parametrize("connected", ORDERS[:-1])
def test_a_path_whose_derivatives_are_not_connected_is_remarked_upon_once(connected):
    _, _, said = driven(0.1, connected)
    assert len(said) == 1
    assert f"the load's {connected} changes, but its" in said[0]
    assert f"set connected = {connected}" in said[0]


def test_the_default_manoeuvre_gives_no_cause_for_remarks():
    for step in (0.01, 0.1, 1.0):
        _, _, said = driven(step, "snap", 20.0, jets=lambda t: CRANE.reference.jet(np.atleast_1d(t), 4))
        assert said == []


def test_a_load_at_rest_contradicts_nothing():
    rest = (5.0, 0.0, -5.0, *[0.0] * 12)
    assert contradiction(rest, rest, 4) == ""


def test_a_master_that_passes_connected_values_on_late_does_not_disturb_the_start():
    """FMPy's master for SSP starts with zeros everywhere: a load at the girder, on the axis, is no wish."""
    with Host() as host:
        host.start().tell(np.zeros((5, 3)))
        assert host.step(0.0, 0.01)
        assert host["M_w"] == pytest.approx(-98.1)
        assert not host.step(0.01, 0.01)


def test_measured_values_are_needed_all_or_none():
    with Host() as host:
        host.start().set(**{"measured.phi": 0.1})
        assert not host.step(0.0, 0.01)
        assert "feedback = 0 does without" in host.messages[0]
        assert host.set(feedback=0.0).step(0.0, 0.01)


def test_the_state_of_the_feedback_is_rolled_back_too():
    at_rest = {"measured.s": 5.01, "measured.l": 5.0, "measured.position[1]": 5.02, "measured.position[3]": -5.0}
    with Host() as host:
        host.start().set(**at_rest)
        assert host.step(0.0, 0.01)
        kept = host.fmu.getFMUState()
        assert host.step(0.01, 0.01)
        first = host.outputs().tolist()
        assert host.step(0.02, 0.01)
        host.fmu.setFMUState(kept)
        assert host.step(0.01, 0.01)
        assert host.outputs().tolist() == first
        assert abs(host["F"]) > 1.0
