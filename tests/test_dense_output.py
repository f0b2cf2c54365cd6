"""Between the instants of a run the method's own polynomial answers."""

from __future__ import annotations

import numpy as np
import pytest
from problems import along_its_line

import servocore as sc

CRANE = along_its_line(sc.scenes.rotary_crane(), 20.0, sc.DEGREE13)


def midpoint_error(method: sc.Method, steps: int, name: str) -> float:
    """Largest error in the middle of all steps of the default crane, relative to the peak."""
    stepper = sc.Stepper(CRANE, sc.Projected(), method, step=20.0 / steps)
    reference = CRANE.reference
    state, _ = stepper.start(reference.jet(stepper.step * np.array(stepper.start_instants), stepper.start_order))
    found, times = [], []
    for k in range(steps):
        start = k * stepper.step
        jets = reference.jet(start + stepper.step * np.array(stepper.nodes), stepper.start_order)
        state, report = stepper.advance(state, jets)
        assert report.converged
        times.append(start + stepper.step / 2)
        found.append(stepper.values(state, reference.jet(times[-1], stepper.start_order), fraction=0.5)[name])
    exact = CRANE.exact(np.array(times))[name]
    return float(np.abs(np.array(found) - exact).max() / np.abs(exact).max())


# A polynomial through begin and s stages has order s + 1; between two instants backward Euler's line has order two in
# positions, which are exact at the instants themselves. Of inputs, see `test_prepared`.
@pytest.mark.parametrize(
    ("method", "name", "order"),
    [
        (sc.BackwardEuler(), "s", 2),
        (sc.BDF(3), "s", 4),
        (sc.RadauIIA(3), "s", 4),
        (sc.GeneralizedAlpha(0.5), "l", 2),
        (sc.Trapezoidal(), "s", 2),
    ],
    ids=lambda each: getattr(each, "name", each),
)
def test_dense_output_has_the_order_of_its_polynomial(method: sc.Method, name: str, order: int) -> None:
    coarse, fine = midpoint_error(method, 200, name), midpoint_error(method, 400, name)
    assert np.log2(coarse / fine) > order - 0.25
