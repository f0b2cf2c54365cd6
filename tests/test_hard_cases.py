"""Hard cases of the literature, as the page compares them: servo constraints by optimization."""

from __future__ import annotations

from benchmarks.servo_by_optimization import inverted, optimized


def test_optimal_control_approaches_exact_inversion_as_its_weight_falls_and_stops_at_its_discretization() -> None:
    exact = inverted()
    assert max(exact.inputs) < 1e-12
    assert exact.stray < 1e-6
    coarse, middle, finest = (found for _, found in optimized((1e-5, 1e-7, 1e-11), steps=150))
    assert coarse.inputs[0] > 3 * middle.inputs[0] > 0.03
    assert min(middle.stray, finest.stray) > 1e-3
