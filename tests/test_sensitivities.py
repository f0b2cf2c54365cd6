"""Derivatives by parameters are those of the closed form and of simulations with other parameters."""

from __future__ import annotations

import numpy as np
import pytest

import servocore as sc
from servocore.numerics.compiled_calls import Array

CRANE = sc.scenes.rotary_crane().with_reference(sc.rest_to_rest((5, 0, -5), (-2, 2, -2), 8.0))
OVERHEAD = sc.scenes.overhead_crane()
BAR = sc.scenes.elastic_bar()


def central(scene: sc.Scene, name: str, t: Array, part: float = 1e-4) -> Array:
    """Return central differences of the closed form's inputs by a parameter, of order four."""
    value = scene.parameter_values()[name]
    h = part * value

    def inputs(change: float) -> Array:
        exact = scene.with_parameters(**{name: value + change}).exact(t)
        return np.column_stack([exact[each.name] for each in scene.model().inputs])

    return (8.0 * (inputs(h) - inputs(-h)) - (inputs(2 * h) - inputs(-2 * h))) / (12.0 * h)


@pytest.mark.parametrize("scene", [CRANE, OVERHEAD, BAR], ids=lambda scene: scene.name)
def test_derivatives_of_inputs_equal_central_differences(scene: sc.Scene) -> None:
    found = sc.sensitivities(scene)
    assert found.parameters == tuple(scene.parameter_values())
    for name in found.parameters:
        expected = central(scene, name, found.t)
        own = np.column_stack([found[each.name, name] for each in scene.model().inputs])
        assert np.abs(own - expected).max() <= 1e-7 * max(np.abs(expected).max(), 1.0)


@pytest.mark.parametrize("name", ["load_mass", "trolley_mass", "winch_radius"])
def test_the_drift_is_that_of_simulations_with_other_parameters(name: str) -> None:
    scene = OVERHEAD.with_reference(sc.rest_to_rest((0, -4), (2, -3.5), 4.0))
    found = sc.sensitivities(scene, (name,), step=0.1)
    inputs, h = sc.ExactInversion(scene), 1e-5 * scene.parameter_values()[name]
    ends = []
    for change in (h, -h):
        other = scene.with_parameters(**{name: scene.parameter_values()[name] + change})
        motion = sc.simulate(other, inputs.__call__, t=found.t, rtol=1e-12, atol=1e-12)
        ends.append(np.column_stack([motion["x"], motion["z"]]))
    expected = (ends[0] - ends[1]) / (2 * h)
    own = np.column_stack([found["x drift", name], found["z drift", name]])
    assert np.abs(own - expected).max() <= 1e-5 * np.abs(expected).max()


def test_what_has_no_derivatives_is_refused() -> None:
    with pytest.raises(sc.InvalidSetting, match="no parameter mass; there are"):
        sc.sensitivities(CRANE, ("mass",))
    with pytest.raises(sc.InvalidModel, match="internal dynamics"):
        sc.sensitivities(sc.scenes.mass_on_car())
    found = sc.sensitivities(OVERHEAD, ("gravity",), step=1.5)
    with pytest.raises(KeyError, match=r"'F' is no pair of a quantity and a parameter, such as found\['F', 'load"):
        _ = found["F"]  # type: ignore[index]  # wrong on purpose
    with pytest.raises(KeyError, match="there are"):
        _ = found["F", "load_mass"]
