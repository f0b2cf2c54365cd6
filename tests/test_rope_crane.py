"""The crane on a flexible rope: against the path of a rope without mass, energy, and ropes of lumps."""

from __future__ import annotations

import numpy as np
import pytest

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.scenes.rotary_crane_rope import at_rest

PATH = sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 3.0, sc.DEGREE9)
"""Fast hoisting: three metres in three seconds, while the load goes round the mast."""
HEAVY = {"rope_mass": 5.0, "rope_stiffness": 1e9}


def crane(elements: int, **parameters: float) -> sc.Scene:
    return sc.scenes.rotary_crane(rope_elements=elements).with_reference(PATH).with_parameters(**parameters)


@pytest.fixture(scope="module")
def inputs() -> sc.Solution:
    """Exact ones of the crane on a stiff rope without mass."""
    return sc.solve(sc.scenes.rotary_crane().with_reference(PATH), step=0.002)


def simulated(scene: sc.Scene, inputs: sc.Solution, step: float = 0.002, end: float = 3.0) -> sc.Solution:
    t = np.arange(round(end / 0.02) + 1.0) * 0.02
    return sc.simulate(scene, inputs, t=t, start=at_rest(scene), method=sc.EnergyMomentum(), step=step)


def load(solution: sc.Solution) -> Array:
    return np.array([solution[axis] for axis in "xyz"])


# Hoisting -------------------------------------------------------------------------------------------------------------


def test_on_a_rope_without_mass_the_load_follows_its_path(inputs: sc.Solution) -> None:
    """With an error of the step alone, which falls with its square."""
    scene = crane(2, rope_mass=1e-6, rope_stiffness=1e9)
    errors = [simulated(scene, inputs, step)["tracking_error"].max() for step in (0.004, 0.002)]
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.2)


def test_motions_converge_with_the_square_of_the_number_of_elements(inputs: sc.Solution) -> None:
    runs = {elements: load(simulated(crane(elements, **HEAVY), inputs)) for elements in (2, 4, 8, 16)}
    errors = [np.abs(runs[elements] - runs[16]).max() for elements in (2, 4, 8)]
    # Against 16 elements instead of infinitely many: (1/N^2 - 1/16^2)
    expected = np.array([1 / 4, 1 / 16, 1 / 64]) - 1 / 256
    np.testing.assert_allclose(np.divide(errors, errors[1]), expected / expected[1], rtol=0.2)
    assert errors[-1] < 1e-3


def test_while_hoisting_energy_changes_by_the_work_of_the_inputs(inputs: sc.Solution) -> None:
    found, start = simulated(crane(4, **HEAVY), inputs), at_rest(crane(4, **HEAVY))
    assert [found[name][0] for name in "xyzsl"] == pytest.approx([start[name] for name in "xyzsl"])
    change = found["energy"] - found["energy"][0]
    assert np.ptp(change) > 1000.0
    assert np.abs(change - found["work"]).max() < 1e-10 * np.abs(found["energy"]).max()


def test_ropes_of_lumps_approach_it(inputs: sc.Solution) -> None:
    """As many as effects of the crane have, on links without stretch, by error control: other equations throughout."""
    rope = load(simulated(crane(16, **HEAVY), inputs, end=0.6))
    errors = []
    for lumps in (2, 4):
        scene = sc.scenes.rotary_crane().with_effects(f"rope mass {lumps}").with_reference(PATH)
        scene = scene.with_parameters(rope_mass=5.0, rope_piece=1.5)
        names = scene.model().coordinates.names
        start = dict.fromkeys(names, 0.0) | {"d_x": 1.0, "p_x": 5.0, "s": 5.0, "l": 5.0, "x": 5.0, "z": -5.0}
        for k in range(lumps):
            start |= {f"rope_{k + 1}_x": 5.0, f"rope_{k + 1}_z": -5.0 + 1.5 / lumps * (k + 0.5)}
        start |= dict.fromkeys((f"{name}_dot" for name in names), 0.0)
        errors.append(np.abs(load(sc.simulate(scene, inputs, t=np.arange(31.0) * 0.02, start=start)) - rope).max())
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("elements", [-1, 1.5, True])
def test_ropes_of_no_whole_number_of_elements_are_refused(elements: float) -> None:
    crane(1).model()  # which True is not, though it equals 1
    with pytest.raises(sc.InvalidModel, match="rope rope: its number of elements must be a whole number of at least 1"):
        crane(elements).model()  # type: ignore[arg-type]  # wrong on purpose


def test_the_trolley_of_a_crane_on_a_rope_cannot_pass_its_axis() -> None:
    with pytest.raises(sc.InvalidSetting, match="for the crossing of its axis, or invariant"):
        sc.scenes.rotary_crane(across_axis=True, rope_elements=2)
