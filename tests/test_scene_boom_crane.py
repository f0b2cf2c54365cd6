"""The boom crane: its rope hangs from a torus; energy, forward dynamics, the ends of its reach."""

from __future__ import annotations

import numpy as np
import pytest
from problems import scene

import servocore as sc

CRANE = scene("boom_crane")
P = CRANE.parameter_values()
REACH = P["boom_length"] + P["foot_offset"]


def led(start: tuple[float, float, float], end: tuple[float, float, float], duration: float = 20.0) -> sc.Scene:
    """The crane with another line from rest to rest."""
    return CRANE.with_reference(sc.rest_to_rest(start, end, duration))


@pytest.mark.parametrize("model", CRANE.models)
def test_the_tip_is_on_the_rope_s_line_and_on_the_boom_s_torus(model: str) -> None:
    found = sc.solve(CRANE, step=0.5, model=model)
    load = np.column_stack([found[name] for name in ("x", "y", "z")])
    pull = CRANE.reference.jet(found.t, 2)[:, 2] + [0.0, 0.0, P["gravity"]]
    tip = load + found["l"][:, None] * pull / np.linalg.norm(pull, axis=1)[:, None]
    level = P["foot_offset"] + P["boom_length"] * np.cos(found["theta"])
    expected = (level * np.cos(found["phi"]), level * np.sin(found["phi"]), P["boom_length"] * np.sin(found["theta"]))
    np.testing.assert_allclose(tip, np.column_stack(expected), rtol=0.0, atol=1e-13)
    assert found["theta"].min() > 0.0


def test_at_rest_the_boom_carries_itself_and_the_load() -> None:
    found = CRANE.exact(np.array([0.0, CRANE.reference.duration]))
    moment = P["boom_mass"] * P["boom_centre"] + P["load_mass"] * P["boom_length"]
    np.testing.assert_allclose(found["M_l"], P["gravity"] * moment * np.cos(found["theta"]), rtol=1e-12)
    np.testing.assert_allclose(found["M_w"], -P["load_mass"] * P["gravity"] * P["winch_radius"], rtol=1e-12)
    np.testing.assert_allclose(found["M_s"], 0.0, atol=1e-9)


@pytest.mark.parametrize("model", CRANE.models)
def test_a_load_that_swings_far_is_solved_exactly(model: str) -> None:
    """In weak gravity the rope's line meets the torus far from where a vertical one would."""
    light = led((5.0, -1.5, -1.0), (5.0, 1.5, -1.0), 6.0).with_parameters(gravity=1.2)
    found = sc.solve(light, step=0.05, model=model)
    exact = light.exact(found.t)
    assert np.degrees(exact["swing"].max()) > 30.0
    for name in ("M_s", "M_l", "M_w", "phi", "theta", "l"):
        np.testing.assert_allclose(found[name], exact[name], rtol=0.0, atol=1e-11 * np.abs(exact[name]).max())


def test_a_load_at_rest_can_be_held_up_to_the_boom_s_length_and_the_offset() -> None:
    inside, outside = led((6.0, 0.0, -1.0), (REACH - 0.002, 0.0, -1.0)), led((6.0, 0.0, -1.0), (REACH, 0.0, -1.0))
    assert inside.exact(np.array([20.0]))["theta"][0] == pytest.approx(np.sqrt(2 * 0.002 / P["boom_length"]), rel=1e-3)
    assert sc.solve(inside)["theta"][-1] == pytest.approx(inside.exact(np.array([20.0]))["theta"][0], abs=1e-9)
    with pytest.raises(sc.InvalidReference, match=r"at t = .* s the load is out of the boom's reach: "):
        sc.solve(outside)


@pytest.mark.parametrize(
    ("start", "end", "duration", "sentence"),
    [
        ((6.0, 0.0, -1.0), (12.0, 0.0, -1.0), 20.0, "at t = .* s the load is out of the boom's reach"),
        ((6.0, 0.0, -1.0), (-6.0, 0.1, -1.0), 20.0, "at t = .* s the boom stands upright"),
        ((0.0, 0.0, -1.0), (6.0, 0.0, -1.0), 20.0, "at t = 0 s the boom stands upright, .* reach is -0.5 m"),
        ((6.0, 0.0, -1.0), (-6.0, 0.0, -1.0), 20.0, "at t = .* s the boom stands upright, .* reach is -0.0"),
        ((6.0, 0.0, -1.0), (6.0, 0.0, 6.0), 20.0, "at t = .* s the load reaches the boom's tip"),
        ((6.0, 0.0, 5.0), (6.0, 0.0, -1.0), 1.0, "at t = .* s the rope goes slack"),
    ],
)
def test_a_path_that_it_cannot_follow_is_refused_with_the_reason_and_the_time(
    start: tuple[float, float, float], end: tuple[float, float, float], duration: float, sentence: str
) -> None:
    with pytest.raises(sc.InvalidReference, match=sentence):
        sc.solve(led(start, end, duration))
