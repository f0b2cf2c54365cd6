"""The laboratory crane: friction that differs by direction, ranges, and the comparison."""

from __future__ import annotations

import numpy as np
import pytest

import servocore as sc
from benchmarks.inteco import driven, laws, real

CRANE = sc.scenes.inteco()


def test_its_inputs_move_the_plant_with_friction_within_a_micrometre() -> None:
    rng = np.random.default_rng(5)
    for _ in range(3):
        start, end = (rng.uniform((0.1, 0.1, -0.7), (0.4, 0.5, -0.3)) for _ in range(2))
        crane = CRANE.with_reference(sc.rest_to_rest(tuple(start), tuple(end), 4.0))
        assert sc.simulate(crane, sc.solve(crane, step=0.005))["tracking_error"].max() < 1e-6


def test_dry_friction_differs_by_direction() -> None:
    there, back = (0.1, 0.3, -0.5), (0.4, 0.3, -0.5)
    one, other = (
        sc.solve(CRANE.with_reference(sc.rest_to_rest(*pair, 4.0)), step=0.5)["u_x"]
        for pair in ((there, back), (back, there))
    )
    p = CRANE.parameter_values()
    difference = (p["dry_x_backwards"] - p["dry_x_forwards"]) / p["gain_x"]
    np.testing.assert_allclose(-other[3:-3] - one[3:-3], difference, rtol=1e-4)


@pytest.mark.parametrize(
    ("end", "name"), [((0.6, 0.5, -0.35), "s_x"), ((0.4, 0.7, -0.35), "s_y"), ((0.4, 0.5, -1.1), "l")]
)
def test_paths_beyond_the_ranges_of_rails_and_line_are_refused(end: tuple[float, float, float], name: str) -> None:
    with pytest.raises(sc.ServocoreError, match=rf"\b{name}\b"):
        sc.solve(CRANE.with_reference(sc.rest_to_rest((0.1, 0.1, -0.6), end, 6.0)))


def test_a_path_that_needs_more_than_full_duty_is_refused() -> None:
    with pytest.raises(sc.ServocoreError, match=r"\bu_[xyl]\b"):
        sc.solve(CRANE.with_reference(sc.rest_to_rest((0.1, 0.1, -0.6), (0.4, 0.5, -0.35), 1.0)))


@pytest.mark.parametrize("after", [5.0, 0.6])
def test_feedforward_with_loops_leaves_a_hundredth_of_the_sway_of_a_ramp(
    after: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.inteco.AFTER", after)
    drive = laws(CRANE)
    ramp, both = (driven(real(CRANE), drive[name]) for name in ("ramp of positions, loops", "feedforward, loops"))
    assert both.sway < 0.01 * ramp.sway
    assert both.stray < 1e-3
    assert ramp.stray > 0.02
    assert both.settling == 0.0
