"""Systems whose paths start or end in motion: the load begins on its path, in the motion that the path has there."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from command_lines import crane_fmu as run
from fmu_host import fmu_file, members
from loops import CRANE, FORCES, Case, deviation
from native_fmu import END, Native, exported
from numpy.polynomial import Polynomial
from problems import polynomial_path

import servocore as sc
from crane_fmu.build.ssp import SystemOptions, start_values
from crane_fmu.catalogue import CRANE_PLANT, ORDERS, components
from crane_fmu.run import run_ssp
from servocore.files import csv_text

WHOLE = CRANE.reference
POSITION, VELOCITY = components("start.position"), components("start.velocity")


def rows(file: Path, path: sc.Reference, instants: tuple[float, float], shift: float = 0.0) -> Path:
    """Write a part of a path with all derivatives; its times are earlier by `shift`."""
    t = np.linspace(*instants, 41)
    jets = path.jet(t, 4)
    names = [f"{prefix}{axis}" for prefix in ("", "v", "a", "j", "s") for axis in "xyz"]
    file.write_text(csv_text(["time", *names], [t - shift, jets.reshape(len(t), -1)]))
    return file


def accelerating(duration: float = 5.0) -> sc.Reference:
    """Return a path that starts with an acceleration and a jerk, but no velocity, and ends at rest."""
    start, end = np.array([5.0, 0.0, -5.0]), np.array([5.6, 0.4, -4.5])
    share = Polynomial([1.0, -1.0 / duration]) ** 5 * Polynomial([1.0, 5.0 / duration])  # of the way that is left
    return polynomial_path(np.outer(share.coef, start - end) + np.outer(np.eye(7)[0], end), duration)


def starts_of(path: sc.Reference) -> dict[str, float]:
    """Return the start values of the plant."""
    found = start_values(SystemOptions(path), sc.ExactInversion(CRANE.with_reference(path), native=False))
    return {name: float(value) for name, value in found[CRANE_PLANT.name].items()}


@pytest.fixture
def path(tmp_path: Path) -> sc.Reference:
    return sc.from_csv(rows(tmp_path / "path.csv", WHOLE, (8.0, 20.0), 8.0))


@pytest.mark.usefixtures("compiler")
def test_a_load_that_begins_in_the_motion_of_its_path_stays_on_it(path: sc.Reference) -> None:
    starts = starts_of(path)
    at_rest = {name: value for name, value in starts.items() if name in POSITION}
    assert deviation(Case(path, disturbance=starts), 0.01) < 0.03
    assert deviation(Case(path, disturbance=at_rest), 0.01, feedback_distance=5.0) > 100.0


def test_an_acceleration_without_a_velocity_is_a_start_in_motion_too(tmp_path: Path) -> None:
    path = sc.from_csv(rows(tmp_path / "path.csv", accelerating(), (0.0, 5.0)))
    _, velocity, acceleration = path.jet(0.0, 2)
    assert np.linalg.norm(velocity) < 1e-12
    assert np.linalg.norm(acceleration) > 0.1
    starts = starts_of(path)
    hanging = {name: value for name, value in starts.items() if name in (*POSITION, *VELOCITY, *FORCES)}
    assert deviation(Case(path, disturbance=starts), 0.01) < 0.2
    assert deviation(Case(path, disturbance=hanging), 0.01) > 1.0


PLANTS = {"python": partial(Native, "python", 2), "native": partial(Native, "rotary_crane plant", 2)}
MOTION = ("phi", "s", "l", "phi_dot", "s_dot", "l_dot", "tension", *components("load.position", "load.velocity"))


def plants(name: str) -> Native:
    return PLANTS[name](fmu_file("CranePlant")) if name == "python" else PLANTS[name]()


@pytest.mark.usefixtures("compiler")
def test_both_plants_begin_where_an_exact_inversion_has_them() -> None:
    random, names = np.random.default_rng(5), components(*(f"start.{order}" for order in ORDERS[:4]))
    for _ in range(20):
        jet = np.zeros((5, 3))
        jet[:4] = random.standard_normal((4, 3))
        jet[0] += [5.0, 1.0, -5.0]
        assert CRANE.closed_form is not None
        wanted = {name: value[0] for name, value in CRANE.closed_form(jet[None], CRANE.parameter_values()).items()}
        found = []
        for name in PLANTS:
            with plants(name) as host:
                host.numbers_set([*names, *FORCES], [*jet[:4].ravel(), *(wanted[each] for each in FORCES)])
                host.start()
                found.append(host.get(*MOTION))
        python, native = found
        np.testing.assert_allclose(python, native, rtol=1e-11, atol=1e-11)
        for place in ("phi", "s", "l", "tension"):
            assert python[MOTION.index(place)] == pytest.approx(wanted[place], rel=1e-10, abs=1e-10)
        np.testing.assert_allclose(python[-6:], jet[:2].ravel(), rtol=1e-10, atol=1e-10)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("name", PLANTS)
def test_zeros_of_a_master_that_passes_nothing_on_before_the_first_step_are_no_inputs(name: str) -> None:
    """FMPy's is such a master: a load that starts in motion would fall for a step."""
    found = []
    for told, brakes in (((5.0, 2.0, -90.0), 1), ((0.0, 0.0, 0.0), 1), ((0.0, 0.0, 0.0), 2)):
        with plants(name) as host:
            host.numbers_set([*VELOCITY, *FORCES], [0.3, 0.2, 0.1, 5.0, 2.0, -90.0])
            host.start(brakes=brakes)
            for k in range(2):
                host.numbers_set(FORCES, told if k == 0 else (6.0, 2.0, -91.0))
                assert host.step(k * 0.1, 0.1), host.messages
            found.append(host.get(*MOTION))
    held, zeros, free = found
    np.testing.assert_array_equal(held, zeros)
    assert np.abs(free - zeros).max() > 0.01


@pytest.mark.usefixtures("compiler")
def test_a_plant_of_another_scene_begins_in_a_motion_to_its_last_derivative() -> None:
    """The quadrotor's path has six derivatives; its rates follow from the fifth."""
    name = "quadrotor_with_load"
    scene = sc.scenes.REGISTRY[name]()
    solution = sc.solve(scene, step=scene.reference.duration / 100)
    k, h = 30, 1e-3
    instant = float(solution.t[k])
    orders = [each for each in exported(f"{name} plant").settings if each.name.startswith("start.")]
    jet = scene.reference.jet(instant, 6)
    with Native(f"{name} plant") as host:
        moving = [each.name for each in orders if each.size == 2]
        assert len(moving) == 6, moving
        for each, values in zip(moving, jet, strict=False):
            host.numbers_set([each], values)
        inputs = sc.ExactInversion(scene, native=False)
        host.start(inputs(instant), brakes=2, input_time=END)
        for i in range(100):
            host.tell(inputs(instant + (i + 1) * h))
            assert host.step(i * h, h), host.messages
        found = dict(zip((each.name for each in exported(host.name).outputs), host.values(), strict=True))
    after = scene.reference.jet(instant + 100 * h, 0)[0]
    at = [found[each.name] for each in scene.model().outputs]
    np.testing.assert_allclose(at, after, rtol=0.0, atol=1e-7)


EACH_SYSTEM = pytest.mark.parametrize(
    "variant", [["--targets", "host"], ["--native", "--targets", "host"]], ids=["python", "native"]
)


@EACH_SYSTEM
@pytest.mark.parametrize(
    ("begin", "words"),
    [
        (
            8.0,
            ("the path starts in motion at t = 5 s, with a velocity of 0.823 m/s", "run of the system starts at 0 s"),
        ),
        (0.0, ("the path starts at t = -3 s, but the run of the system",)),
    ],
    ids=["in motion", "before the run"],
)
def test_a_path_that_does_not_start_as_the_run_does_is_refused(
    begin: float, words: tuple[str, ...], variant: list[str], tmp_path: Path
) -> None:
    file = rows(tmp_path / "path.csv", WHOLE, (begin, 20.0), 3.0)
    run.assert_refused(run("ssp", "-o", tmp_path / "out", "--reference", file, *variant), *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("compiler")
@EACH_SYSTEM
def test_a_system_begins_and_ends_in_motion_with_nothing_set_in_the_master(variant: list[str], tmp_path: Path) -> None:
    file = rows(tmp_path / "path.csv", WHOLE, (6.0, 14.0), 6.0)
    done = run("ssp", "-o", tmp_path / "out", "--reference", file, *variant)
    assert done.exit_code == 0, done.output
    assert (
        "the path does not end at rest, but at t = 8 s with a velocity of 0.482 m/s: run the system until then only"
        in done.stderr
    )
    system, path = tmp_path / "out" / "Crane.ssp", sc.from_csv(file)
    root = ET.fromstring(members(system)["SystemStructure.ssd"])
    bound = {
        each.get("name"): float(each[0].get("value", "")) for each in root.iter() if each.tag.endswith("}Parameter")
    }
    jet = path.jet(0.0, 3)
    assert [bound[name] for name in components(*(f"start.{order}" for order in ORDERS[:4]))] == jet.ravel().tolist()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        found = run_ssp(system, 7.995, 0.01)
    load = np.array([found[f"plant.load.position[{k}]"] for k in (1, 2, 3)]).T
    assert np.linalg.norm(load - path.jet(found["time"], 0)[:, 0], axis=1).max() < 1e-6
