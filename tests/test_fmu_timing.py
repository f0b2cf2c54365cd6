"""Which time an input belongs to, proven with a sine; and derivatives that are not connected, estimated."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from called import estimation
from fmu_host import Host, follow
from hypothesis import given
from hypothesis import strategies as st
from present import present

import servocore as sc
from crane_fmu.build.estimates import amplification
from crane_fmu.catalogue import ORDERS
from servocore.numerics.compiled_calls import Array

CRANE = sc.scenes.rotary_crane()
RATE, SIZE = 1.0, 0.5


def sine(t: Array | float) -> Array:
    """Jets of a load that swings to and fro along the bridge, shape (n, 5, 3)."""
    t = np.atleast_1d(t)
    jets = np.zeros((len(t), 5, 3))
    for k in range(5):
        jets[:, k, 0] = SIZE * RATE**k * np.sin(RATE * t + k * np.pi / 2)
    jets[:, 0] += 5.0, 0.0, -5.0
    return jets


def driven(t: Array, connected: str, jets: Array, at: str = "start") -> tuple[dict[str, Array], list[str]]:
    """Outputs after each step, and what was said, of a host that connects derivatives up to one order."""
    told = jets.copy()
    told[:, ORDERS.index(connected) + 1 :] = 0.0
    with Host() as host:
        found = follow(host.set(connected=connected), told, t, at=at)
        return {name: row[1:] for name, row in found.items()}, list(host.messages)


def exact(t: Array) -> dict[str, Array]:
    return present(sc.scenes.rotary_crane().closed_form)(sine(t), CRANE.parameter_values())


def even(step: float, stop: float = 3.0) -> Array:
    return np.arange(round(stop / step) + 1.0) * step


def error(name: str, step: float, connected: str = "snap", at: str = "start") -> float:
    t = even(step)
    found, _ = driven(t, connected, sine(t), at)
    return float(np.abs(found[name] - exact(t[1:])[name])[t[1:] > 1.0].max())


def test_with_all_derivatives_connected_the_lag_is_gone() -> None:
    """A host that holds its inputs would see s late by a step: an error of 5e-3 m at 10 ms."""
    assert error("s", 0.01) < 1e-6 * SIZE
    t = even(0.01)
    found, _ = driven(t, "snap", sine(t))
    assert np.abs(found["s"] - exact(t[:-1])["s"]).max() > 3e-3 * SIZE


@pytest.mark.parametrize("at", ["start", "end"])
@pytest.mark.parametrize("connected", ORDERS[:-1])
def test_what_is_not_connected_is_estimated_to_the_order_that_the_page_states(connected: str, at: str) -> None:
    """Snap, and with it F, to third order in the step, lag included: to first order by the extrapolation of snap."""
    motion = error("s", 0.02, connected, at)
    assert motion < 3e-5
    errors = [error("F", step, connected, at) for step in (0.02, 0.01)]
    assert errors[0] < 0.05 * 60.0
    assert errors[1] < 0.6 * errors[0]


def estimates(times: Array, path: Callable[[float], Any], order: int) -> SimpleNamespace:
    """Return the estimated derivatives above one of a path of scalars or vectors at the last of some times."""

    def told(time: float) -> Array:
        jet = np.zeros((5, 3))
        jet[order] = path(time)
        return jet.ravel()

    (memory,) = estimation().begin(told(times[0]), order)
    for before, now in pairwise(times):
        memory, found, _, known = estimation().follow(memory, told(now), now - before, 1.0, order)
    return SimpleNamespace(rows=found.reshape(5, 3)[order + 1 :], is_known=known.item() == 1.0)


@pytest.mark.parametrize("connected", ORDERS[:-1])
def test_estimates_fall_with_third_order_in_snap(connected: str) -> None:
    order, errors = ORDERS.index(connected), []
    for step in (0.04, 0.02):
        found = estimates(np.arange(-20.0, 1.0) * step, lambda t: sine(t)[0, order], order)
        errors.append(np.abs(found.rows[-1] - sine(0.0)[0, 4]).max())
    assert np.log2(errors[0] / errors[1]) > 2.7 or errors[1] < 1e-6


@given(st.lists(st.floats(-1, 1), min_size=5, max_size=5), st.sampled_from(range(4)), st.floats(0.005, 0.2))
def test_quartic_paths_are_estimated_exactly_also_with_steps_that_vary(
    coefficients: Array, order: int, step: float
) -> None:
    path = np.polynomial.Polynomial(coefficients)
    times = np.cumsum([0.0, *(step * f for f in (1.0, 0.7, 1.3, 1.0, 0.9, 1.1, 1.0))])
    times -= times[-1]
    at = path.deriv(order) if order else path
    if abs(at(times[1]) - at(times[0])) <= 3e-6 + (times[1] - times[0]) ** (4 - order):
        return  # taken for a load that rests before
    found = estimates(times, at, order)
    assert found.is_known
    for k, row in enumerate(found.rows, start=order + 1):
        assert (np.abs(row - path.deriv(k)(0.0)) <= 1e-10 * step ** (order - k)).all()


def test_noise_comes_out_less_amplified_than_the_page_says() -> None:
    rng, step = np.random.default_rng(3), 0.01
    for order in range(4):
        found = estimates(np.arange(-200.0, 1.0) * step, lambda _: 1e-6 * rng.choice([-1.0, 1.0], 3), order)
        assert np.abs(found.rows[-1]).max() <= 1e-2 * amplification(order) * 1e-6 / step ** (4 - order)


MANOEUVRE = CRANE.reference
UNEVEN = np.random.default_rng(5)


def uneven(step: float, share: float) -> Array:
    t = np.cumsum([0.0, *(step * (1.0 + share * UNEVEN.uniform(-1.0, 1.0, round(22.0 / step))))])
    return t[t <= 20.0]


def drive_errors(times: Array, jets: Array | None = None) -> tuple[Array, list[str]]:
    """Largest errors of the drives' inputs as shares of their peaks with positions connected, and what was said."""
    found, said = driven(times, "position", MANOEUVRE.jet(times, 4) if jets is None else jets)
    wanted = CRANE.exact(times[1:])
    shares = [np.abs(found[name] - wanted[name]) / np.abs(wanted[name]).max() for name in ("M_b", "F", "M_w")]
    return np.max(shares, axis=0), said


@pytest.mark.parametrize(
    ("times", "within"),
    [(0.02 * np.arange(1001.0), 0.03), (uneven(0.02, 0.2), 0.05), (uneven(0.01, 0.2), 0.05),
     (np.sort(np.append(np.arange(0.0, 20.0, 0.01), [3.001, 8.001, 12.3456])), 0.05)],
    ids=["20 ms", "20 ms +-20 %", "10 ms +-20 %", "steps split"],
)  # fmt: skip
def test_positions_alone_are_enough_at_any_steps_and_nothing_is_said(times: Array, within: float) -> None:
    error, said = drive_errors(times)
    assert error.max() < within
    assert said == []


@pytest.mark.parametrize("rounding", [1e-6, 1e-5, 1e-4])
def test_rounded_positions_are_filtered_and_told(rounding: float) -> None:
    times = np.arange(0.0, 6.0, 0.01)
    jets = MANOEUVRE.jet(times, 4)
    jets[:, 0] = np.round(jets[:, 0] / rounding) * rounding
    error, said = drive_errors(times, jets)
    unfiltered = amplification(0) * rounding / 0.01**4
    assert error.max() * 141.0 < 1e-3 * 50.0 * unfiltered
    assert len(said) == 1
    assert "derivatives above the load's position are estimated to" in said[0]


def test_exact_positions_at_1_ms_are_not_lost_in_rounding() -> None:
    error, said = drive_errors(np.arange(7000.0, 9000.0) * 1e-3)
    assert error.max() < 0.05 or "starts in motion" in said[0]


def test_a_start_in_motion_waits_for_samples_and_says_so() -> None:
    error, (said,) = drive_errors(np.arange(800.0, 900.0) * 0.01)
    assert error[7:].max() < 0.05
    assert 0.5 < error.max() < 10.0
    assert "the load starts in motion: derivatives above the load's position are known after 7 samples" in said


@pytest.mark.parametrize("start", [-7.5, 1e6, 1e9])
def test_outputs_do_not_depend_on_when_the_run_begins(start: float) -> None:
    jets = MANOEUVRE.jet(8.0 + 0.01 * np.arange(200), 4)
    rows = []
    for begin in (0.0, start):
        with Host() as host:
            host.set(connected="position").start(jets[0], begin)
            assert all(host.tell(jet).step(begin + i * 0.01, 0.01) for i, jet in enumerate(jets))
            rows.append(host.outputs())
    np.testing.assert_allclose(rows[1], rows[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("step", [0.01, 0.1, 1.0])
def test_the_default_manoeuvre_gives_no_cause_for_remarks(step: float) -> None:
    t = even(step, 20.0)
    assert driven(t, "snap", MANOEUVRE.jet(t, 4))[1] == []


def test_a_master_that_passes_connected_values_on_late_does_not_disturb_the_start() -> None:
    """FMPy's master for SSP starts with zeros everywhere: a load at the girder, on the axis, is no wish."""
    with Host() as host:
        host.start().tell(np.zeros((5, 3)))
        assert host.step(0.0, 0.01)
        assert host["M_w"] == pytest.approx(-98.1)
        assert not host.step(0.01, 0.01)
