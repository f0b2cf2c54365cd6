"""Trajectory, inverse model and plant together: where the load goes, and how far it is from where it should be."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from functools import cache
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from command_lines import crane_fmu as run
from fmpy import read_csv
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssd
from fmu_host import fmu_file, in_a_process, members, scratch, system
from test_masters import missing

import servocore as sc
from crane_fmu.build import SystemOptions, build_ssp
from crane_fmu.build.ssp import COMPONENTS, connections, elements_of
from crane_fmu.catalogue import KINDS
from crane_fmu.run import nothing_left
from servocore.export.system import Element, packed_system
from servocore.numerics.compiled_calls import Array

STEP = 0.01


def simulated(file: Path, stop: float, parameters: Mapping[str, float] = {}) -> Any:
    """Return rows of a run in fmpy's own master."""
    values = [SimpleNamespace(name=name.replace("__", "."), value=value) for name, value in parameters.items()]
    with nothing_left(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        given = SimpleNamespace(parameters=values)
        return simulate_ssp(str(file), stop_time=stop, step_size=STEP, parameter_set=given)


def load_of(rows: Any, name: str) -> Array:
    """Return where a component has the load, shape (N, 3)."""
    return np.array([rows[f"{name}.load.position[{k}]"] for k in (1, 2, 3)]).T


def deviation(stop: float = 20.0, native: bool = False, /, **parameters: float) -> float:
    """Largest distance in mm of the load from where it should be."""
    rows = simulated(system(native), stop, parameters)
    assert len(rows) >= round(stop / STEP)
    wanted, found = (load_of(rows, name) for name in ("trajectory", "plant"))
    path = sc.scenes.rotary_crane().reference
    np.testing.assert_allclose(wanted, path.jet(rows["time"] + STEP, 0)[:, 0], atol=1e-9)  # rows show ends of steps
    return 1e3 * float(np.linalg.norm(wanted - found, axis=1).max())


def test_feedforward_alone_keeps_the_load_within_5_mm() -> None:
    assert deviation(crane__feedback=0.0) < 1.3


@pytest.mark.parametrize("native", [False, True], ids=["Python", "native"])
def test_feedback_keeps_the_load_within_1_mm(native: bool) -> None:
    assert deviation(20.0, native) < 0.01


ECOS = """
import sys
from ecospy import EcosSimulation
with EcosSimulation(ssp_path=sys.argv[1], step_size=float(sys.argv[3])) as simulation:
    simulation.init()
    simulation.step(int(sys.argv[2]))
    for name in ("trajectory", "plant"):
        print("place", *(simulation.get_real(f"{name}::load.position[{k}]") for k in (1, 2, 3)), flush=True)
"""
LIBCOSIM = """
import sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
execution = CosimExecution.from_ssp_file(sys.argv[1], round(1e9 * float(sys.argv[3])))
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
assert all(execution.step() for _ in range(int(sys.argv[2])))
for name in ("trajectory", "plant"):
    number = execution.slave_index_from_instance_name(name)
    known = {each.name.decode(): each.reference for each in execution.slave_variables(number)}
    places = observer.last_real_values(number, [known[f"load.position[{k}]"] for k in (1, 2, 3)])
    print("place", *places, flush=True)
"""


MASTERS = {"ecospy": ECOS, "libcosimpy": LIBCOSIM}


def places(package: str, file: Path, steps: int, step: float = STEP) -> Array:
    """Where trajectory and plant have the load after so many steps in another master."""
    if reason := missing(package):
        pytest.skip(reason)
    done = in_a_process(MASTERS[package], file, str(steps), str(step))
    found = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("place")]
    return np.array(found, dtype=float)


@pytest.mark.parametrize("native", [False, True], ids=["Python", "native"])
@pytest.mark.parametrize("package", MASTERS)
def test_other_masters_run_it_as_well(package: str, native: bool) -> None:
    """And a system with a path and a crane of one's own."""
    wanted, found = places(package, system(native), 1000)
    np.testing.assert_allclose(wanted, sc.scenes.rotary_crane().reference.jet(10.0, 0)[0], atol=1e-9)
    assert 1e3 * np.linalg.norm(wanted - found) < 0.01
    wanted, found = places(package, own_system(native), 1100)
    np.testing.assert_allclose(wanted, GOAL, atol=1e-9)
    assert np.linalg.norm(found - GOAL) < 1e-4


@cache
def elements() -> list[Element]:
    return elements_of({name: fmu_file(name).read_bytes() for name in KINDS}, {})


def test_every_connection_joins_an_output_with_an_input_of_the_same_unit() -> None:
    tables = {element.name: {port["name"]: port for port in element.ports} for element in elements()}
    wires = connections(elements())
    for (source, output), (sink, given) in wires:
        assert tables[source][output]["causality"] == "output"
        assert tables[sink][given]["causality"] == "input"
        assert tables[source][output]["unit"] == tables[sink][given]["unit"]
    assert {sink for _, sink in wires} == {(each.name, port) for each in elements() for port in each.named("input")}
    assert len({sink for _, sink in wires}) == len(wires)


def test_the_system_has_the_form_that_all_masters_read() -> None:
    read = read_ssd(str(system())).system
    assert [each.name for each in read.elements] == list(COMPONENTS.values())
    assert not read.connectors
    assert len(read.connections) == len(connections(elements()))
    found = members(system())
    assert set(found) == {"SystemStructure.ssd", *(f"resources/{name}.fmu" for name in KINDS)}
    assert b'version="1.0"' in found["SystemStructure.ssd"]
    assert b"ParameterBinding" not in found["SystemStructure.ssd"]


def test_the_default_experiment_ends_with_the_path_to_the_last_digit() -> None:
    packed = members(BytesIO(packed_system("Crane", elements(), [], 1234567.125)))
    assert b'stopTime="1234567.125"' in packed["SystemStructure.ssd"]


def test_two_builds_are_equal_byte_by_byte(tmp_path: Path) -> None:
    build_ssp(tmp_path, options=SystemOptions(targets="host"))
    assert (tmp_path / "Crane.ssp").read_bytes() == system().read_bytes()


@pytest.mark.parametrize("name", KINDS)
def test_cross_check_files_lie_beside_each_fmu_and_can_be_read(name: str) -> None:
    folder = system().parent
    found = read_csv(str(folder / f"{name}_ref.csv"))
    options = dict(line.split(",") for line in (folder / f"{name}_ref.opt").read_text().splitlines())
    assert found["time"][-1] == pytest.approx(float(options["StopTime"]))
    (element,) = (each for each in elements() if each.model == name)
    assert set(found.dtype.names) == {"time", *element.named("output")}
    assert (folder / f"{name}_in.csv").is_file() == (name != "LoadTrajectory")


def test_a_crane_of_ones_own_decides_what_it_can_follow(tmp_path: Path) -> None:
    path = sc.rest_to_rest((5.0, 0.0, -5.0), (5.0, 0.0, -2.0), 1.2)
    with pytest.raises(sc.InvalidReference, match="slack"):
        build_ssp(tmp_path / "out", options=SystemOptions(path=path, parameters={"gravity": 1.6}, targets="host"))
    assert not (tmp_path / "out").exists()


GOAL = (4.0, 2.0, -5.0)
WAY = "time,x,y,z\n0,6,-1,-5\n5,5,1,-4\n10,4,2,-5\n"


def own_path() -> sc.Reference:
    return sc.through([(6.0, -1.0, -5.0), (5.0, 1.0, -4.0), GOAL], times=[0.0, 5.0, 10.0])


@cache
def own_system(native: bool) -> Path:
    """Made by the command from a path and a crane of one's own."""
    folder = scratch() / f"own{' native' * native}"
    folder.mkdir()
    files = {
        "path.csv": sc.path_to_csv(own_path()),
        "way.csv": WAY,
        "crane.toml": "load_mass = 140.0\nbridge_inertia = 600.0",
    }
    for name, text in files.items():
        (folder / name).write_text(text)
    given = ["--waypoints", "way.csv", "--native"] if native else ["--reference", "path.csv"]
    options = [*given, "--parameters", "crane.toml", "--targets", "host"]
    with contextlib.chdir(folder):
        result = run("ssp", "-o", "out", *options)
    assert result.exit_code == 0, result.output
    assert "certificate: proved: one regular motion at all times from 0 s to" in result.stderr
    expected = [*(f"{name}.fmu" for name in KINDS), "Crane.ssp"]
    assert [line.rsplit("/")[-1] for line in result.stdout.splitlines()] == expected
    return folder / "out" / "Crane.ssp"


@pytest.mark.parametrize("native", [False, True], ids=["Python", "native"])
def test_a_path_and_a_crane_of_ones_own_need_nothing_set_in_the_master(native: bool) -> None:
    rows = simulated(own_system(native), 11.0)
    assert np.linalg.norm(load_of(rows, "plant")[-1] - GOAL) < 1e-4
    np.testing.assert_allclose(
        load_of(rows, "trajectory")[:999], own_path().jet(rows["time"][:999] + STEP, 0)[:, 0], atol=1e-9
    )
    packed = members(own_system(native))
    root = ET.fromstring(packed["SystemStructure.ssd"])
    files = [name for each in packed if each.endswith(".fmu") for name in members(BytesIO(packed[each]))]
    assert native != any(name.endswith(".py") or "python" in name for name in files)
    bound = {each.get("name"): each[0].get("value") for each in root.iter() if each.tag.endswith("}Parameter")}
    assert bound["load_mass"] == "140.0"
    assert bound["start.position[1]"] == "6.0"


def test_a_path_beside_a_time_law_is_refused() -> None:
    with pytest.raises(sc.InvalidSetting, match="give either a path or a profile"):
        SystemOptions(sc.rest_to_rest((5.0, 0.0, -5.0), (5.0, 0.0, -4.0), 9.0), profile="degree9")
