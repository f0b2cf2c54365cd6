"""Plant, trajectory and feedback in C: what the PythonFMUs and the library compute, to the last digits."""

from __future__ import annotations

import zipfile
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_lines import CommandLine, write
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from native_fmu import DISCARD, END, FULL, OK, Native, began, exported, native_file, path_of
from present import of_kind, present

import servocore as sc
from crane_fmu.cli.commands import app as crane_app
from servocore.cli.commands import app
from servocore.export.plant_model import plant_model
from servocore.export.trajectory_model import trajectory_model
from servocore.numerics.compiled_calls import Array
from servocore.references.csv_file import path_to_csv
from servocore.references.profiles import polynomial
from servocore.references.rest_to_rest import RestToRest

CRANE = sc.scenes.rotary_crane()
DRIVES = ("M_b", "F", "M_w")
NAMES = ["rotary_crane plant", "rotary_crane trajectory", "rotary_crane loop"]
if FULL:
    NAMES += [f"{name} {what}" for name in sc.scenes.REGISTRY for what in ("plant", "trajectory") if name not in NAMES]

pytestmark = pytest.mark.usefixtures("compiler")
run, crane = CommandLine(app, "servocore"), CommandLine(crane_app, "crane-fmu")


@pytest.mark.parametrize("fmi", [2, 3] if FULL else [2])
@pytest.mark.parametrize("name", NAMES)
def test_a_checker_has_nothing_to_say(name: str, fmi: int) -> None:
    assert validate_fmu(str(native_file(name, fmi))) == []


# Trajectory ----------------------------------------------------------------------------------------------------------


def played(instants: Array, file: Path | None = None, **parameters: Any) -> Array:
    """Return jets (N, orders, m) of the crane's trajectory, or of a file, whose steps end at some instants."""
    with Native("rotary_crane trajectory", 2, file) as host:
        host.start(time=float(instants[0]), **parameters)
        found = [host.values()]
        for before, after in pairwise(instants):
            assert host.step(before, after - before) == OK, host.messages
            found.append(host.values())
    return np.array(found).reshape(len(instants), 5, 3)


def assert_as(found: Array, expected: Array, within: float = 1e-12) -> None:
    peaks = np.abs(expected).max(axis=(0, 2), keepdims=True)
    assert (np.abs(found - expected) / peaks).max() < within


@pytest.mark.parametrize(
    ("number", "profile"), [(1, sc.DEGREE9), (2, sc.DEGREE13), (3, sc.three_phase()), (3, sc.three_phase(3.0))]
)
def test_time_laws_are_those_of_the_library(number: int, profile: sc.Profile) -> None:
    """To the last digit: estimated derivatives amplify a difference there by 1/h^4."""
    t = np.arange(-8.0, 185.0) / 8  # sums of steps are exact
    ramp = getattr(profile, "ramp", None) or 0.0
    found = played(t, profile=number, ramp=ramp, start_time=1.1, duration=17.9)
    path = sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 17.9, profile, 1.1)
    np.testing.assert_array_equal(found, path.jet(t, 4))


def test_a_path_that_is_baked_in_is_that_path() -> None:
    t = np.linspace(-1.0, 21.0, 221)
    assert_as(played(t, profile=4), present(path_of("rotary_crane")).jet(t, 4))


LINE = partial(sc.rest_to_rest, (5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 17.9)
OWN: dict[str, tuple[sc.Reference, float]] = {  # with what may be lost of the peaks
    "degree 13": (LINE(sc.DEGREE13), 0.0),
    "a ramp, from before the run": (LINE(sc.three_phase(3.0), start_time=-4.0), 0.0),
    "no law of the choices": (LINE(polynomial(15), start_time=3.0), 1e-7),
    "periodic": (sc.figure_of_eight((8.0, 0.0, -5.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.5), 12.0, 2, 1.0), 1e-7),
}


@pytest.mark.parametrize("name", OWN)
def test_a_trajectory_begins_with_the_path_of_its_scene(name: str, tmp_path: Path) -> None:
    path, within = OWN[name]
    file = sc.export_trajectory(CRANE.with_reference(path), tmp_path / "path.fmu", fmi=2, targets="host")
    t = np.arange(path.start_time - 3.0, path.end_time + 9.0, 0.25)  # outside of its times too
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
            assert host.step(k * h, h) == OK, host.messages
            u = hold + rising * np.sin(k * h)
            for i in range(5):
                state = plant.advance(state, u + (later - u) * i / 5, (later - u) / h, still, p, h / 5)
        found = dict(zip((each.name for each in made.outputs), host.values(), strict=True))
    wanted = plant.values(state, later, still, p)
    assert found == {each: pytest.approx(wanted[each], rel=1e-11, abs=1e-12) for each in found}
    assert {each.name for each in scene.model().observables} <= set(found)


FALLING = {"rotary_crane": (0.0, 0.0, 1e3), "overhead_crane": (0.0, 1e3), "gantry_crane": (0.0, 0.0, 1e3),
           "boom_crane": (0.0, 0.0, 1e3), "quadrotor_with_load": (-100.0, 0.0)}  # fmt: skip
TAUT = [name for name, make in sc.scenes.REGISTRY.items() if "tension" in {e.name for e in make().model().observables}]


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
        assert host.step(0.0, 0.01) == DISCARD
        assert "tension is -" in host.messages[-1]
        assert host.get("tension")[0] == before


@pytest.mark.parametrize("model", CRANE.models)
def test_a_tension_is_watched_in_every_model(model: str) -> None:
    outputs = plant_model(CRANE, model).outputs
    assert {each.name for each in outputs if each.positive} >= {"l", "tension"}
    assert "swing" not in {each.name for each in outputs if each.positive}  # it may be zero


# Command line --------------------------------------------------------------------------------------------------------


def test_the_command_writes_plant_and_trajectory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CFLAGS", "-O0")
    write("path.csv", path_to_csv(present(path_of("rotary_crane"))))
    common = ("--targets", "host", "--fmi", "2")
    said = run("export", "cars", "--plant", "-o", "plant.fmu", *common).output
    assert "plant.fmu: plant of cars, FMI 2" in said
    said = run("export", "rotary_crane", "--trajectory", "--reference", "path.csv", "-o", "path.fmu", *common).output
    assert "path.fmu: trajectory of rotary_crane, FMI 2" in said
    with zipfile.ZipFile("path.fmu") as archive:
        assert b'<Enumeration declaredType="Profile" start="4"' in archive.read("modelDescription.xml")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--plant", "--trajectory", "-o", "x.fmu"), "one at a time"),
        (("--plant", "--reference", "p.csv", "-o", "x.fmu"), "--reference belongs to --trajectory"),
        (("--plant", "--c", "x"), "--c is about inverse models: not with --plant"),
        (("--plant", "--wasm", "x.wasm"), "--wasm is about inverse models: not with --plant"),
        (
            ("--trajectory", "-o", "x.fmu", "--wasm", "x.wasm", "--cross-check"),
            "--wasm and --cross-check are about inverse models: not with --trajectory",
        ),
        (("--trajectory", "-o", "x.fmu", "--fmi", "1"), "no export for FMI 1"),
        (("--plant", "-o", "x.fmu", "--tolerance", "1"), "--tolerance belongs to --reference"),
        (("--trajectory",), "name the file to write with -o"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    options: tuple[str, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run.assert_refused(run("export", "cars", *options), words)
    assert not any(tmp_path.iterdir())
