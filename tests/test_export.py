"""Native FMUs compute what the library computes, to the bit or nearly, whatever calls them."""

from __future__ import annotations

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from native_fmu import (
    END,
    FULL,
    START,
    Native,
    along_path,
    exported,
    inputs_along_path,
    joined,
    native_file,
    scene_called,
)

import servocore as sc

FLAT = (("rotary_crane", 2), ("rotary_crane", 3), ("elastic_hoist", 3))
INTERNAL = ("mass_on_car", 2)
SOME: tuple[tuple[str, int], ...] = (*FLAT, INTERNAL, ("ship", 3), ("elastic_arm", 2))
if FULL:
    SOME = tuple((name, fmi) for name in (*sc.scenes.REGISTRY, "elastic_hoist", "ship", "wind") for fmi in (2, 3))
SYSTEM = [(f"rotary_crane {what}", 2) for what in ("plant", "trajectory", "loop")]
if FULL:
    SYSTEM = [
        (f"{name} {what}", fmi) for name in sc.scenes.REGISTRY for what in ("plant", "trajectory") for fmi in (2, 3)
    ]
    SYSTEM += [("rotary_crane loop", fmi) for fmi in (2, 3)]
MOVES = {
    "mass_on_car": ("start.s.position", "start.s.velocity"),
    "wind": ("start.theta.position", "start.theta.velocity"),
}

pytestmark = pytest.mark.usefixtures("compiler")


def input_names(name: str) -> tuple[str, ...]:
    return tuple(each.name for each in scene_called(name).model().inputs)


# Numbers -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "fmi"), [*SOME, *SYSTEM])
def test_a_checker_has_nothing_to_say(name: str, fmi: int) -> None:
    assert validate_fmu(str(native_file(name, fmi))) == []


@pytest.mark.parametrize(("name", "fmi"), [*FLAT, INTERNAL])
def test_with_nothing_connected_it_rests(name: str, fmi: int) -> None:
    result = simulate_fmu(str(native_file(name, fmi)), stop_time=1.0, output_interval=0.1)
    assert len(result) == 11
    assert result["time"][-1] == pytest.approx(1.0)
    for channel in result.dtype.names[1:]:
        np.testing.assert_allclose(result[channel], result[channel][0], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("name", "fmi"), SOME)
def test_along_the_path_its_inputs_are_those_of_the_library(name: str, fmi: int) -> None:
    with Native(name, fmi) as host:
        found = along_path(host, 100)[:, : len(input_names(name))]
    expected = inputs_along_path(name, 100)
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("name", "fmi", "division", "start"),
    [
        ("mass_on_car", 2, 1, {}),
        ("mass_on_car", 2, 4, {"s": 0.02, "s_dot": -0.1}),
        ("wind", 3, 1, {}),
        ("wind", 3, 4, {"theta": 0.3, "theta_dot": -0.5}),
    ],
)
def test_with_internal_dynamics_its_inputs_are_those_of_solve(
    name: str, fmi: int, division: int, start: dict[str, float]
) -> None:
    scene, steps = joined(name, 40), 40
    h, inputs = scene.reference.duration / steps, input_names(name)
    with Native(name, fmi) as host:
        host.start(scene.reference.jet([0.0], exported(name).own["orders"] - 1)[0])
        at_rest = host.get(*[each.name for each in exported(name).of("local")])
    moved = dict(zip(MOVES[name], np.array(list(start.values())) - at_rest, strict=True)) if start else {}
    with Native(name, fmi) as host:
        found = along_path(host, steps, internal_step=h / division, **moved)[:, : len(inputs)]
        state = host.get(*[each.name for each in exported(name).of("local")])
    solution = sc.solve(scene, sc.Reduced(), sc.RadauIIA(3), step=h / division, start=start)
    expected = np.column_stack([solution[each][::division] for each in inputs])
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()
    own = solution[exported(name).of("local")[0].name.split(".")[1]]
    assert np.abs(state[0] - own[-1]) <= 1e-12 * np.abs(own).max()


def test_fmi_3_has_the_path_as_vectors() -> None:
    with Native("rotary_crane", 3) as host:
        assert host.inputs == tuple(f"load.{each}" for each in ("position", "velocity", "acceleration", "jerk", "snap"))
        sizes = [each.dimensions[0].start for each in host.description.modelVariables if each.causality == "input"]
    assert sizes == [3] * 5


# States and statuses -------------------------------------------------------------------------------------------------


def test_the_state_of_another_model_is_refused() -> None:
    with Native("rotary_crane", 2) as crane, Native("mass_on_car", 2) as car:
        bytes_of_car = car.saved()
        size = len(crane.saved())
        with pytest.raises(FMICallException):
            crane.restore(bytes_of_car)
        with pytest.raises(FMICallException):
            crane.restore(bytes_of_car.ljust(size, b"\0")[:size])
    assert crane.messages == ["the state to restore is not one of this FMU; nothing was changed"] * 2


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"y.acceleration": 2.0}, "at t = 0.1 s F is 1417 N, it must stay below 1300 N"),
        (
            {"y.acceleration": -9.9},
            "at t = 0.1 s the rope goes slack: g + y'' is -0.09 m/s2, it must stay above 0 m/s2",
        ),
        ({"y.velocity": -2.5}, "at t = 0.1 s w.rate is -2.5 m/s, it must stay above -2 m/s"),
        ({"y.velocity": 1.0, "y.jerk": 300.0}, "at t = 0.1 s w.rate is 2.5 m/s, it must stay below 2 m/s"),
    ],
)
def test_limits_that_a_user_has_set_by_name_are_kept_on_both_sides(changed: dict[str, float], sentence: str) -> None:
    with Native("limited", 3) as host:
        host.start(input_time=END)
        host.numbers_set(list(changed), list(changed.values()))
        assert not host.step(0.0, 0.1)
        assert host.messages[-1] == sentence
        host.numbers_set(list(changed), [0.1 * each for each in changed.values()])
        assert host.step(0.0, 0.1)


@pytest.mark.parametrize(("input_time", "instant"), [(START, "0.1"), (END, "0.2")])
def test_a_path_whose_derivatives_are_not_connected_is_remarked_upon_and_then_refused(
    input_time: int, instant: str
) -> None:
    said = []
    with Native("rotary_crane", 2) as host:
        host.start(input_time=input_time)
        for k in range(3):
            host.set(**{"load.position[1]": 5.0 + 0.01 * k})
            said.append(host.step(0.1 * k, 0.1))
    assert said == [True, True, False]  # a warning is no exception
    assert host.messages[0] == (
        f"at t = {instant} s the load's position changes, but its velocity and acceleration and jerk and snap stay"
        " zero: connect what is missing; the outputs are those of a load that stands still, and the next such step is"
        " refused"
    )
