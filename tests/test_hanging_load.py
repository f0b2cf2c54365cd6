"""Every crane in every model with a load that swings far or a rope that is nearly slack, against the closed form."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

import numpy as np
import pytest
from thinned import thinned

import servocore as sc
from servocore.numerics.compiled_calls import at_instants
from servocore.structure.inversion import inversion

T = np.linspace(0.0, 1.0, 20_001)
PEAK = float(np.abs(sc.DEGREE9.jet(T, 1.0 - T, 1.0, 2)[:, 2]).max())
"""Largest acceleration of a metre in a second."""

CRANES = {
    "overhead_crane": (sc.scenes.overhead_crane, ((0, -5), (4, -5)), ((0, -2), (1, -5))),
    "gantry_crane": (sc.scenes.gantry_crane, ((0, 0, -5), (2.4, 3.2, -5)), ((0, 0, -2), (1, 1, -5))),
    "rotary_crane": (sc.scenes.rotary_crane, ((6, -2, -5), (6, 2, -5)), ((5, 0, -2), (5, 1, -5))),
}
"""A crane, a level way of 4 m, and a way that goes down by 3 m."""

MODELS = [(name, model) for name, (crane, *_) in CRANES.items() for model in crane().models]


EACH_MODEL = pytest.mark.parametrize(("name", "model"), thinned(MODELS, lambda case: case[1] != "bodies"))
"""Models of bodies take minutes and give the same."""


def passing_close(warned: bool) -> AbstractContextManager[object]:
    """Between the instants inputs grow to more than ten times what they are at any: that is told."""
    return pytest.warns(sc.ServocoreWarning, match="passes close to a pole") if warned else nullcontext()


def largest_error(scene: sc.Scene, model: str) -> float:
    """Largest error of a reduced run of 60 steps, of any quantity in relation to its peak."""
    found = sc.solve(scene, sc.Reduced(), step=scene.reference.duration / 60, model=model)
    exact = {name: values for name, values in scene.exact(found.t).items() if np.abs(values).max() > 1e-9}
    assert set(exact) >= {each.name for each in scene.model(model).inputs}
    return float(max(np.abs(found[name] - values).max() / np.abs(values).max() for name, values in exact.items()))


def rounding_error(scene: sc.Scene, model: str) -> float:
    """Changes of the inputs, relative to their peaks, that Newton's method makes of rounding the parameters.

    No evaluation of these equations is more accurate: where the bridge of the generalized crane turns fastest, large
    accelerations cancel.
    """
    problem = sc.Problem.of(scene, model)
    jets = scene.reference.jet(np.linspace(0.0, scene.reference.duration, 61), problem.array.reference_order)
    search = inversion(problem.array).search_from_guess
    places = [problem.array.position(f"u.{each.name}", 0) for each in problem.system.inputs]
    roundings = np.finfo(float).eps * np.random.default_rng(1).uniform(-1.0, 1.0, (20, len(problem.p)))
    inputs = np.array([at_instants(search, jets=jets, p=problem.p * (1.0 + each))[0][places] for each in roundings])
    return float((np.ptp(inputs, axis=0).max(axis=1) / np.abs(inputs).max(axis=(0, 2))).max())


@EACH_MODEL
@pytest.mark.parametrize("swing", [30.0, 64.0, 80.0, 89.5])
def test_a_load_that_swings_far_is_solved_exactly(name: str, model: str, swing: float) -> None:
    """The rope hangs along the effective weight: in weak gravity a level way of 4 m swings it by `swing` degrees."""
    crane, level, _ = CRANES[name]
    duration = 6.0
    gravity = 4.0 * PEAK / duration**2 / np.tan(np.radians(swing))
    scene = crane().with_reference(sc.rest_to_rest(*level, duration)).with_parameters(gravity=float(gravity))
    assert np.degrees(scene.exact(duration * T)["swing"].max()) == pytest.approx(swing, abs=0.01)
    with passing_close(swing > 89.0 and name == "rotary_crane"):  # its bridge turns within a hundredth of a step
        assert largest_error(scene, model) < max(1e-12, rounding_error(scene, model))


@EACH_MODEL
@pytest.mark.parametrize("margin", [3.0, 0.1, 1e-3])
def test_a_rope_that_is_nearly_slack_is_solved_exactly(name: str, model: str, margin: float) -> None:
    """The load falls almost freely: g + z'' comes down to `margin` in m/s2."""
    crane, _, downwards = CRANES[name]
    duration = float(np.sqrt(3.0 * PEAK / (9.81 - margin)))
    scene = crane().with_reference(sc.rest_to_rest(*downwards, duration))
    with passing_close(margin < 0.01):
        assert largest_error(scene, model) < 1e-9
