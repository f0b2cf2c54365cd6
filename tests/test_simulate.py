"""`simulate`: its own accuracy against a pendulum, and what inputs do to the load."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import scipy.special
from problems import (
    FLAT_MODELS,
    as_scene,
    driven_pendulum,
    exact,
    polynomial_path,
    problem,
    redundant_pendulum,
    scene,
    solved,
)
from scipy.interpolate import make_interp_spline
from thinned import thinned

import servocore as sc

CRANE = scene("rotary_crane")
NO_TORQUE = lambda time: np.zeros(1)  # noqa: ARG005, E731


def released(system: sc.MechanicalSystem, start: float, duration: float) -> sc.Scene:
    """Return a scene whose reference only says where the system starts, at rest."""
    return as_scene(system, polynomial_path([[start]], duration))


def period(amplitude: float) -> float:
    """4 sqrt(l/g) K(m), m = sin^2(amplitude/2)."""
    return float(4.0 * np.sqrt(1.5 / 9.81) * scipy.special.ellipk(np.sin(amplitude / 2) ** 2))


@pytest.mark.parametrize("amplitude", [0.01, 1.0, 2.5])
def test_a_free_pendulum_swings_with_the_period_of_the_elliptic_integral(amplitude: float) -> None:
    t = np.array([0.0, 0.25, 0.5, 1.0]) * period(amplitude)
    found = sc.simulate(released(driven_pendulum(), amplitude, t[-1]), NO_TORQUE, t=t, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(found["theta"], amplitude * np.array([1.0, 0.0, -1.0, 1.0]), atol=1e-8)


def test_a_free_pendulum_keeps_its_energy() -> None:
    """Over ten swings of more than a right angle, from angles and their rates by a spline of degree seven."""
    t = np.linspace(0.0, 25.0, 2001)
    angle = sc.simulate(released(driven_pendulum(), 2.0, 25.0), NO_TORQUE, t=t)["theta"]
    rate = make_interp_spline(t, angle, k=7).derivative()(t)
    energy = 1.5**2 * rate**2 / 2 - 9.81 * 1.5 * np.cos(angle)
    assert np.ptp(energy) < 1e-6 * 9.81 * 1.5


def test_tighter_tolerances_give_smaller_errors() -> None:
    """After ten swings and a quarter the pendulum passes the vertical."""
    errors = []
    for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
        t = np.array([0.0, 10.25 * period(2.0)])
        found = sc.simulate(released(driven_pendulum(), 2.0, t[-1]), NO_TORQUE, t=t, rtol=rtol, atol=rtol)
        errors.append(abs(found["theta"][-1]))
    assert all(coarse > 10 * fine for coarse, fine in pairwise(errors))
    assert errors[-1] < 1e-7


def test_redundant_coordinates_swing_as_the_angle_does_and_keep_the_rod() -> None:
    one = released(driven_pendulum(), 1.2, 4.0)
    other = released(redundant_pendulum("theta"), 1.2, 4.0)
    t = np.linspace(0.0, 4.0, 81)
    expected = sc.simulate(one, NO_TORQUE, t=t)
    found = sc.simulate(other, NO_TORQUE, t=t)
    np.testing.assert_allclose(found["theta"], expected["theta"], atol=1e-7)
    np.testing.assert_allclose(np.hypot(found["x"], found["z"]), 1.5, atol=1e-8)
    assert found.statistics.constraint_violation < 1e-8


def test_constraints_do_not_drift_off_however_long_it_runs() -> None:
    """Differentiated constraints alone would leave the rod like t^2: 1e-3 m after 80 s at this tolerance."""
    rods = []
    for duration in (20.0, 80.0):
        t = np.linspace(0.0, duration, 201)
        subject = released(redundant_pendulum("theta"), 2.0, duration)
        found = sc.simulate(subject, NO_TORQUE, t=t, rtol=1e-6, atol=1e-6)
        rods.append(np.abs(np.hypot(found["x"], found["z"]) - 1.5).max())
    assert max(rods) < 1e-6
    assert rods[1] < 3 * rods[0]


QUICK = {"boom_crane": sc.rest_to_rest((6.0, 0.0, -1.0), (4.0, 3.0, 1.0), 4.0)}
"""Paths of their own: a boom that a torque alone holds up falls over, and round-off grows tenfold in two seconds."""


@pytest.mark.parametrize(("name", "model"), thinned(FLAT_MODELS, lambda case: case[1] != "bodies"))
def test_under_the_exact_inputs_of_solve_the_load_returns_to_its_path(name: str, model: str) -> None:
    """A thousand samples and a cubic spline leave a tenth of a micrometre."""
    subject = scene(name).with_reference(QUICK.get(name, scene(name).reference))
    inputs = sc.solve(subject, step=subject.reference.duration / 1000)
    most = 1e-6 if name == "quadrotor_with_load" else 1e-7
    assert sc.simulate(subject, inputs, model=model)["tracking_error"].max() < most


def test_it_reports_inputs_outputs_observables_and_coordinates_with_units() -> None:
    inputs = solved(problem("overhead_crane", "points", "reduced"), 200)
    found = sc.simulate(scene("overhead_crane"), inputs)
    for name, unit in {
        "F": "N", "M_w": "N.m", "x": "m", "s": "m", "l": "m", "tension": "N", "swing": "rad", "tracking_error": "m",
    }.items():  # fmt: skip
        assert found.unit(name) == unit
    np.testing.assert_allclose(found["F"], inputs["F"], atol=1e-9)
    np.testing.assert_allclose(found["tension"], exact("overhead_crane", 200)["tension"], rtol=1e-3)
    np.testing.assert_array_equal(found.t, inputs.t)
    assert found.statistics.steps > 10
    assert found.statistics.servo_violation == pytest.approx(found["tracking_error"].max())


def test_inputs_given_as_a_function_need_times() -> None:
    with pytest.raises(sc.InvalidSetting, match="need the times at which to report"):
        sc.simulate(released(driven_pendulum(), 1.0, 1.0), NO_TORQUE)


def test_a_heavier_load_than_planned_does_not_arrive() -> None:
    """What the simulation is for: the inputs were made for another crane."""
    inputs = solved(problem("overhead_crane", "points", "reduced"), 800)
    found = sc.simulate(scene("overhead_crane").with_parameters(load_mass=130.0), inputs)
    assert found["tracking_error"][-1] > 0.1
    assert sc.simulate(scene("overhead_crane"), inputs)["tracking_error"][-1] < 1e-4
