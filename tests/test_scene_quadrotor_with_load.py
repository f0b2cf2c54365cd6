"""The quadrotor with a load: what is known without its flatness, forward dynamics, flips, the ends of its validity."""

from __future__ import annotations

import numpy as np
import pytest
from problems import scene

import servocore as sc

DRONE = scene("quadrotor_with_load")
P = DRONE.parameter_values()
MASS = P["quadrotor_mass"] + P["load_mass"]


def flown(
    start: tuple[float, float], end: tuple[float, float], duration: float, profile: sc.Profile = sc.DEGREE13
) -> sc.Scene:
    """The quadrotor with another line of the load from rest to rest."""
    return DRONE.with_reference(sc.rest_to_rest(start, end, duration, profile))


@pytest.mark.parametrize("model", DRONE.models)
def test_a_load_that_goes_straight_up_is_a_body_that_is_lifted(model: str) -> None:
    found = sc.solve(flown((1.0, 0.0), (1.0, 4.0), 3.0), step=0.1, model=model)
    acceleration = sc.rest_to_rest((0.0,), (4.0,), 3.0, sc.DEGREE13).jet(found.t, 2)[:, 2, 0]
    np.testing.assert_allclose(found["f"], MASS * (P["gravity"] + acceleration), rtol=1e-13)
    np.testing.assert_allclose(found["tension"], P["load_mass"] * (P["gravity"] + acceleration), rtol=1e-13)
    for name in ("M", "pitch", "swing"):
        np.testing.assert_allclose(found[name], 0.0, atol=1e-12)
    np.testing.assert_allclose(found["p_z"] - found["z"], P["rope_length"], rtol=1e-13)


@pytest.mark.parametrize("model", DRONE.models)
def test_it_is_exact_where_the_quadrotor_turns_over(model: str) -> None:
    """So fast a start needs more than a right angle of pitch: the rotors pull downwards, and it turns once."""
    wild = flown((0.0, 1.0), (8.0, 1.0), 2.5)
    found = sc.solve(wild, step=0.025, model=model)
    exact = wild.exact(found.t)
    assert np.abs(exact["pitch"]).max() > 2 * np.pi
    for name, values in exact.items():
        np.testing.assert_allclose(found[name], values, rtol=0.0, atol=1e-11 * np.abs(values).max())


def test_the_rotors_share_thrust_and_moment() -> None:
    found = sc.solve(DRONE, step=0.1)
    np.testing.assert_allclose(found["front"] + found["rear"], found["f"], rtol=1e-14)
    np.testing.assert_allclose(P["arm_length"] * (found["rear"] - found["front"]), found["M"], atol=1e-14)
    with pytest.raises(sc.LimitBroken, match="rear"):
        sc.solve(flown((0.0, 1.0), (8.0, 1.0), 2.5).with_limits(rear=(0.0, 30.0)), step=0.025)


def test_a_path_of_too_few_derivatives_is_refused_with_one_that_does() -> None:
    with pytest.raises(
        sc.InvalidReference, match=r"index 7.*continuous up to order 4 only.*degree 13 is smooth enough"
    ):
        sc.solve(flown((0.0, 1.0), (5.0, 2.0), 4.0, sc.DEGREE9))


def test_a_load_that_falls_freely_is_refused_with_the_time() -> None:
    with pytest.raises(sc.InvalidReference, match=r"at t = .* s the rope goes slack: g \+ z'' is -"):
        sc.solve(flown((0.0, 6.0), (0.0, 0.0), 1.5))
