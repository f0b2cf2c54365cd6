"""The gantry crane: exact inversion, first order of the projected form, and the overhead crane as its plane case."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import servocore as sc


@cache
def scene() -> sc.Scene:
    return sc.scenes.gantry_crane()


@pytest.mark.parametrize("along_x", [True, False])
def test_in_a_vertical_plane_it_is_the_overhead_crane(along_x: bool) -> None:
    overhead = sc.scenes.overhead_crane()
    start, end = ((0.0, 2.0, -4.0), (5.0, 2.0, -1.0)) if along_x else ((2.0, 0.0, -4.0), (2.0, 5.0, -1.0))
    gantry = scene().with_parameters(bridge_mass=0.0).with_reference(sc.rest_to_rest(start, end, 3.0))
    found, expected = sc.solve(gantry, sc.Reduced(), step=0.1), overhead.exact(np.linspace(0.0, 3.0, 31))
    used, idle = ("x", "y") if along_x else ("y", "x")
    np.testing.assert_allclose(found[f"F_{used}"], expected["F"], rtol=0.0, atol=1e-10 * np.abs(expected["F"]).max())
    np.testing.assert_allclose(found["M_w"], expected["M_w"], rtol=1e-10)
    np.testing.assert_allclose(found[f"F_{idle}"], 0.0, atol=1e-10)
    np.testing.assert_allclose(found["swing"], np.abs(expected["swing"]), atol=1e-10)


@pytest.mark.parametrize(
    ("end", "duration", "sentence"),
    [((0.0, 0.0, -9.0), 1.0, "the rope goes slack"), ((1.0, 1.0, 0.5), 9.0, "the load is not below the trolley")],
)
def test_a_path_that_it_cannot_follow_is_refused_with_the_reason(
    end: tuple[float, float, float], duration: float, sentence: str
) -> None:
    steep = scene().with_reference(sc.rest_to_rest((0.0, 0.0, -5.0), end, duration))
    with pytest.raises(sc.InvalidReference, match=sentence):
        sc.solve(steep)
