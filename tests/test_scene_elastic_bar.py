"""The elastic bar: exact as a chain, and d'Alembert's answer for what the chain stands for."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from flexible import wave_time
from numpy.polynomial import Polynomial
from present import present

import servocore as sc
from servocore.references.profiles import polynomial
from servocore.scenes.elastic_bar import dalembert, elastic_bar

DURATION = 2.0
SMOOTH = sc.rest_to_rest((0.0,), (1.0,), DURATION, polynomial(49))


@cache
def scene(count: int = 3) -> sc.Scene:
    return elastic_bar(count)


def test_the_chain_has_the_mass_of_the_bar_and_carries_it_as_a_rigid_body() -> None:
    p = scene(6).with_parameters(axial_stiffness=1e9).parameter_values()
    t = np.linspace(0.0, DURATION, 9)
    jet = scene(6).reference.jet(t, 12)
    rigid = (p["end_mass"] + p["line_mass"] * p["length"]) * jet[:, 2, 0]
    np.testing.assert_allclose(present(scene(6).closed_form)(jet, p)["u"], rigid, atol=1e-6)


def test_the_bar_is_driven_from_a_wave_time_before_the_motion_to_a_wave_time_after() -> None:
    p = scene().parameter_values()
    delay = wave_time(p)
    assert delay == pytest.approx(0.1)
    fast = sc.rest_to_rest((0.0,), (1.0,), 0.5)
    t = np.array([-delay, -delay / 2, 0.5 + delay / 2, 0.5 + delay])
    u = dalembert(t, fast, p)["u"]
    np.testing.assert_array_equal(u[[0, 3]], 0.0)
    assert (np.abs(u[[1, 2]]) > 0.1).all()


def test_within_the_motion_the_chain_converges_to_the_bar_with_the_square_of_the_piece() -> None:
    p, delay = scene().parameter_values(), wave_time(scene().parameter_values())
    t = np.linspace(delay, DURATION - delay, 61)
    bar = dalembert(t, SMOOTH, p)
    found = {}
    for count in (5, 9, 12):
        chain = elastic_bar(count).with_reference(SMOOTH).exact(t)
        found[count] = np.array([np.abs(chain["u"] - bar["u"]).max(), np.abs(chain[f"w_{count}"] - bar["w"]).max()])
    np.testing.assert_allclose(found[5] / found[9], (8 / 4) ** 2, rtol=0.02)
    np.testing.assert_allclose(found[9] / found[12], (11 / 8) ** 2, rtol=0.02)
    assert found[12][0] < 1e-3 * np.abs(bar["u"]).max()


def test_at_its_start_the_chain_continues_the_path_as_a_polynomial_and_not_as_rest() -> None:
    """With d'Alembert's formula for the polynomial itself, of degree 9 and 0.5 s long."""
    fast, p = sc.rest_to_rest((0.0,), (1.0,), 0.5), scene().parameter_values()
    delay, t = wave_time(p), np.array([0.01])
    path = Polynomial(sc.DEGREE9.coefficients)(Polynomial([0.0, 2.0]))
    speed = p["length"] / delay
    continued = p["axial_stiffness"] / (2 * speed) * (path.deriv()(t + delay) - path.deriv()(t - delay))
    continued += p["end_mass"] / 2 * (path.deriv(2)(t + delay) + path.deriv(2)(t - delay))
    coarse, fine = (elastic_bar(count).with_reference(fast).exact(t)["u"] for count in (6, 12))
    ratio = np.abs(coarse - continued) / np.abs(fine - continued)
    np.testing.assert_allclose(ratio, (11 / 5) ** 2, rtol=0.1)
    assert np.abs(fine - dalembert(t, fast, p)["u"]) > 10 * np.abs(fine - continued)


@pytest.mark.parametrize(("count", "sentence"), [(1, "a chain of masses has at least 2"), (13, "at most 12 masses")])
def test_other_numbers_of_masses_are_refused(count: int, sentence: str) -> None:
    with pytest.raises(sc.InvalidModel, match=sentence):
        elastic_bar(count)
