"""Marching the elastic bar in space against d'Alembert's solution."""

from __future__ import annotations

import numpy as np
import pytest
from flexible import wave_time

import servocore as sc
from servocore import periodic
from servocore.scenes.bar_marching import BarMotion, march_bar
from servocore.scenes.elastic_bar import dalembert

BAR = sc.scenes.elastic_bar()
VALUES = BAR.parameter_values()
DELAY = wave_time(VALUES)
PATHS = {
    "default": BAR.reference,
    "fast": sc.rest_to_rest((0.2,), (1.0,), 3.3 * DELAY, sc.DEGREE9, start_time=5.0),
    "faster than a wave": sc.rest_to_rest((0.0,), (-0.5,), 0.7 * DELAY, sc.DEGREE5),
    "waypoints": sc.through([(0.0,), (1.0,), (0.5,)], times=[0.0, 1.0, 2.5]),
}


def march(path: sc.Reference, pieces: int = 40, **changed: float) -> BarMotion:
    return march_bar(path, **{**VALUES, **changed}, pieces=pieces)


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("pieces", [1, 2, 17, 400])
def test_it_equals_dalembert_to_round_off_on_any_grid(name: str, pieces: int) -> None:
    found = march(PATHS[name], pieces)
    for k in (0, pieces // 2, pieces):
        exact = dalembert(found.t, PATHS[name], VALUES, float(found.X[k]))
        np.testing.assert_allclose(found.force[k], exact["u"], atol=2e-12 * np.abs(exact["u"]).max() + 1e-13)
        np.testing.assert_allclose(found.displacement[k], exact["w"], atol=2e-12)


@pytest.mark.parametrize("end_mass", [0.0, 3.0])
def test_any_end_mass_goes(end_mass: float) -> None:
    path, values = PATHS["fast"], {**VALUES, "end_mass": end_mass}
    found = march(path, end_mass=end_mass)
    exact = dalembert(found.t, path, values)
    np.testing.assert_allclose(found.input, exact["u"], atol=1e-12 * np.abs(exact["u"]).max())


def test_velocity_is_the_rate_of_displacement() -> None:
    found = march(PATHS["default"], 200)
    rate = np.gradient(found.displacement[-1], found.t)
    np.testing.assert_allclose(rate[2:-2], found.velocity[-1, 2:-2], atol=1e-3 * np.abs(found.velocity).max())


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"length": 0.0}, "length of a bar must be positive"),
        ({"axial_stiffness": -1.0}, "axial stiffness of a bar must be positive"),
        ({"line_mass": float("nan")}, "line mass of a bar must be positive"),
        ({"end_mass": -1.0}, "end mass of a bar must be finite and not negative"),
        ({"pieces": 0}, "one or more whole pieces, not 0"),
    ],
)
def test_what_makes_no_sense_is_refused(changed: dict[str, float], sentence: str) -> None:
    with pytest.raises(sc.InvalidSetting, match=sentence):
        march(PATHS["default"], **{"pieces": 10, **changed})  # type: ignore[arg-type]  # wrong on purpose


def test_a_path_that_never_rests_is_refused() -> None:
    with pytest.raises(sc.InvalidReference, match="marched from rest to rest, but its path still moves"):
        march(periodic((0.0,), [[0.3]], [[1.0]], 2.0))


def test_a_path_in_space_is_refused() -> None:
    with pytest.raises(sc.InvalidReference, match="a path with 1 component, this one has 3"):
        march(sc.rest_to_rest((0, 0, 0), (1, 1, 1), 1.0))
