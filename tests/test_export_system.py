"""Plant, trajectory and feedback in C: what the PythonFMUs and the library compute, to the last digits."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from command_lines import servocore as run
from command_lines import write
from fmpy import read_model_description
from fmu_host import members
from native_fmu import END, Native, exported, path_of
from present import of_kind, present
from problems import began

import servocore as sc
from servocore.export.plant_model import plant_model
from servocore.export.trajectory_model import trajectory_model
from servocore.numerics.compiled_calls import Array
from servocore.references.csv_file import path_to_csv
from servocore.references.profiles import polynomial
from servocore.references.rest_to_rest import RestToRest

CRANE = sc.scenes.rotary_crane()
DRIVES = ("M_b", "F", "M_w")
pytestmark = pytest.mark.usefixtures("compiler")


# Trajectory ----------------------------------------------------------------------------------------------------------


def played(instants: Array, file: Path) -> Array:
    """Return jets (N, orders, m) of a trajectory whose steps end at some instants."""
    with Native("rotary_crane trajectory", 2, file) as host:
        host.start(time=float(instants[0]))
        found = [host.values()]
        for before, after in pairwise(instants):
            assert host.step(before, after - before), host.messages
            found.append(host.values())
    return np.array(found).reshape(len(instants), 5, 3)


def assert_as(found: Array, expected: Array, within: float = 1e-12) -> None:
    peaks = np.abs(expected).max(axis=(0, 2), keepdims=True)
    assert (np.abs(found - expected) / peaks).max() < within


LINE = partial(sc.rest_to_rest, (5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 17.9)
# With what may be lost of the peaks: estimated derivatives amplify a difference in the last digit by 1/h^4.
OWN: dict[str, tuple[sc.Reference, float]] = {
    "degree 9": (LINE(sc.DEGREE9), 0.0),
    "degree 13": (LINE(sc.DEGREE13), 0.0),
    "three phases": (LINE(sc.three_phase(), start_time=1.1), 0.0),
    "a ramp, from before the run": (LINE(sc.three_phase(3.0), start_time=-4.0), 0.0),
    "no law of the choices": (LINE(polynomial(15), start_time=3.0), 1e-7),
    "periodic": (sc.figure_of_eight((8.0, 0.0, -5.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.5), 12.0, 2, 1.0), 1e-7),
}


@pytest.mark.parametrize("name", OWN)
def test_a_trajectory_begins_with_the_path_of_its_scene(name: str, tmp_path: Path) -> None:
    path, within = OWN[name]
    file = sc.export_trajectory(CRANE.with_reference(path), tmp_path / "path.fmu", fmi=2, targets="host")
    t = np.arange(-64.0, 300.0) / 8  # outside of its times too; sums of steps are exact
    expected = path.jet(t, 4)
    found = played(t, file)
    if within:
        assert_as(found, expected, within)
        np.testing.assert_allclose(found[:, 0], expected[:, 0], rtol=0.0, atol=1e-12)
    else:
        np.testing.assert_array_equal(found, expected)
    experiment = read_model_description(str(file)).defaultExperiment
    assert float(experiment.startTime) == min(0.0, path.start_time)
    assert float(experiment.stopTime) == pytest.approx(path.end_time)


@pytest.mark.parametrize("name", sc.scenes.REGISTRY)
def test_a_trajectory_begins_with_the_law_of_its_scene(name: str) -> None:
    scene = sc.scenes.REGISTRY[name]()
    (choice,) = trajectory_model(scene).choices
    law = sc.TIME_LAWS[choice.items[choice.start - 1][0]]
    assert law == of_kind(RestToRest, scene.reference).profile


def test_a_profile_that_is_none_is_refused() -> None:
    with pytest.raises(sc.InvalidSetting, match="there is no profile 'degree8'; there are degree9, degree13, three-p"):
        trajectory_model(CRANE, None, sc.TrajectoryOptions(profile="degree8"))


# Plant ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", sc.scenes.REGISTRY)
def test_a_plant_of_any_scene_moves_and_observes_as_that_of_the_library(name: str, fmi: int) -> None:
    scene, h, steps = sc.scenes.REGISTRY[name](), 0.01, 50
    made = exported(f"{name} plant")
    state, hold = began(scene, made.model)
    system = scene.model(made.model)
    plant, p, still = sc.compile_plant(system), system.parameters.values(), np.zeros(len(system.outputs))
    rising = 0.05 * (np.abs(hold) + 1.0) * np.arange(1.0, len(hold) + 1.0)
    with Native(f"{name} plant", fmi) as host:
        host.start(hold, brakes=2, input_time=END)
        for k in range(steps):
            host.tell(later := hold + rising * np.sin((k + 1) * h))
            assert host.step(k * h, h), host.messages
            u = hold + rising * np.sin(k * h)
            for i in range(5):
                state = plant.advance(state, u + (later - u) * i / 5, (later - u) / h, still, p, h / 5)
        found = dict(zip((each.name for each in made.outputs), host.values(), strict=True))
    wanted = plant.values(state, later, still, p)
    assert found == {each: pytest.approx(wanted[each], rel=1e-11, abs=1e-12) for each in found}
    assert {each.name for each in scene.model().observables} <= set(found)


FALLING = {"rotary_crane": (0.0, 0.0, 1e3), "overhead_crane": (0.0, 1e3), "gantry_crane": (0.0, 0.0, 1e3),
           "boom_crane": (0.0, 0.0, 1e3), "inteco": (0.0, 0.0, 1.0), "quadrotor_with_load": (-100.0, 0.0)}  # fmt: skip
# The elements of the heavy rope are springs, which push.
TAUT = [
    name for name, make in sc.scenes.REGISTRY.items()
    if name != "heavy_rope" and "tension" in {e.name for e in make().model().observables}
]  # fmt: skip


@pytest.mark.parametrize("name", TAUT)
def test_a_rope_that_would_have_to_push_is_refused_with_its_tension(name: str) -> None:
    with Native(f"{name} plant") as host:
        (tension,) = [each for each in host.description.modelVariables if each.name == "tension"]
        assert (tension.unit, float(tension.min), tension.description) == ("N", 0.0, "rope tension")
        _, hold = began(sc.scenes.REGISTRY[name](), exported(host.name).model)
        host.start(hold, brakes=2)
        before = host.get("tension")[0]
        assert before > 1.0
        host.tell(np.array(FALLING[name]))
        assert not host.step(0.0, 0.01)
        assert "tension is -" in host.messages[-1]
        assert host.get("tension")[0] == before


@pytest.mark.parametrize("model", CRANE.models)
def test_a_tension_is_watched_in_every_model(model: str) -> None:
    outputs = plant_model(CRANE, model).outputs
    assert {each.name for each in outputs if each.positive} >= {"l", "tension"}
    assert "swing" not in {each.name for each in outputs if each.positive}  # it may be zero


# Command line --------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("empty_folder")
def test_the_command_writes_plant_and_trajectory() -> None:
    write("path.csv", path_to_csv(present(path_of("rotary_crane"))))
    common = ("--targets", "host", "--fmi", "2")
    said = run("export", "cars", "--plant", "-o", "plant.fmu", *common).output
    assert "plant.fmu: plant of cars, FMI 2" in said
    said = run("export", "rotary_crane", "--trajectory", "--reference", "path.csv", "-o", "path.fmu", *common).output
    assert "path.fmu: trajectory of rotary_crane, FMI 2" in said
    assert b'<Enumeration declaredType="Profile" start="4"' in members("path.fmu")["modelDescription.xml"]
