"""The file itself: valid, complete, reproducible, independent of its host, in place only when it works."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from fmpy import read_model_description
from fmu_host import Host, described, fmu_file, in_a_process, members, scratch
from native_fmu import Native
from present import present
from processes import python

import servocore as sc
from crane_fmu.build import fmu as build
from crane_fmu.build.fmu import packed
from crane_fmu.build.native import OF_PYTHONFMU, native_model
from crane_fmu.catalogue import LOAD_TRAJECTORY, ROTARY_CRANE
from crane_fmu.slave import kernel
from servocore.export.native_model import NativeModel
from servocore.export.parameter_sets import base_units
from servocore.export.targets import host, libraries
from servocore.files import zipped

THIS_MACHINE = (host(),)
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def native() -> NativeModel:
    """Return the model of a native FMU that is soon compiled."""
    return native_model(LOAD_TRAJECTORY, host=OF_PYTHONFMU)


def test_the_command_builds_into_a_folder_it_makes(tmp_path: Path) -> None:
    there = fmu_file().read_bytes()  # built for all files: what it compiles is not compiled again below
    folder = tmp_path / "a b" / "c"
    done = python(ROOT / "build_fmu.py", "--targets", "host", "-o", folder, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(folder / "RotaryCrane.fmu")
    assert [each.name for each in folder.iterdir()] == ["RotaryCrane.fmu"]
    # another process, another folder, the same bytes
    assert (folder / "RotaryCrane.fmu").read_bytes() == there


def test_an_fmu_that_fails_its_check_is_not_put_in_place(
    native: NativeModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build, "native_model", lambda *_: native)
    (tmp_path / "LoadTrajectory.fmu").write_text("older")
    broken = tmp_path / "slave.py"
    broken.write_text("raise RuntimeError('broken')\n")
    with monkeypatch.context() as patch:
        patch.setattr(kernel, "__file__", str(broken))
        # PythonFMU's own look at the slave meets it first
        with pytest.raises(RuntimeError, match="broken"):
            build.build_fmu(tmp_path, kind=LOAD_TRAJECTORY, targets="host")
    broken.unlink()
    monkeypatch.setattr(build, "packed", lambda *_: zipped({}))
    with pytest.raises(sc.ServocoreError, match=r"failed its check, .*modelDescription"):
        build.build_fmu(tmp_path, kind=LOAD_TRAJECTORY, targets="host")
    assert [each.read_text() for each in tmp_path.iterdir()] == ["older"]


def test_a_library_missing_from_the_bundle_is_found_by_the_check(
    native: NativeModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without_libraries(*given: Any) -> bytes:
        parts = members(io.BytesIO(packed(*given)))
        return zipped({name.replace("/libraries/linux64/", "/libraries/win64/"): parts[name] for name in parts})

    monkeypatch.setattr(build, "native_model", lambda *_: native)
    monkeypatch.setattr(build, "packed", without_libraries)
    with pytest.raises(sc.ServocoreError, match="the FMU has libraries for win64, none for linux64"):
        build.build_fmu(tmp_path, kind=LOAD_TRAJECTORY, targets="host")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("call", "said"), [("abort", "ended the process with code -6"), ("pause", "did not end")])
def test_a_library_that_crashes_or_hangs_fails_the_check_alone(
    call: str, said: str, native: NativeModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    headers = "#include <stdlib.h>\n#include <unistd.h>\n"
    text = f"{headers}__attribute__((constructor)) static void loaded(void) {{ {call}(); }}"
    ((_, broken),) = libraries({"broken.c": text}, ["broken.c"], "broken", THIS_MACHINE, 2).items()

    def with_the_broken_one(*given: Any) -> bytes:
        parts = members(io.BytesIO(packed(*given)))
        return zipped({name: broken.content if "/libraries/" in name else parts[name] for name in parts})

    monkeypatch.setattr(build, "native_model", lambda *_: native)
    monkeypatch.setattr(build, "packed", with_the_broken_one)
    monkeypatch.setattr(build, "_PATIENCE", 3.0)
    with pytest.raises(sc.ServocoreError, match=said):
        build.build_fmu(tmp_path, kind=LOAD_TRAJECTORY, targets="host")
    assert not list(tmp_path.iterdir())


def test_building_leaves_no_traces_in_the_process(native: NativeModel) -> None:
    path, modules = list(sys.path), set(sys.modules)
    packed(native, LOAD_TRAJECTORY, THIS_MACHINE)
    assert sys.path == path
    assert not {each for each in set(sys.modules) - modules if each.startswith("rotary_crane")}


def test_the_archive_holds_what_is_needed_and_nothing_else() -> None:
    found = members(fmu_file())
    assert next(iter(found)) == "modelDescription.xml"
    assert {"model.png", "documentation/index.html"} <= set(found)
    assert {"binaries/linux64/RotaryCrane.so", "binaries/win64/RotaryCrane.dll"} <= set(found)
    assert b"MIT License" in found["documentation/licenses/pythonfmu.txt"]
    assert found["model.png"].startswith(b"\x89PNG")
    ours = [name for name in found if name.endswith(".py") and "/pythonfmu/" not in name]
    assert len(ours) == 3  # entry, package, slave
    assert not [name for name in found if name.endswith(("builder.py", "deploy.py", "csvbuilder.py"))]
    assert not [name for name in found if "__pycache__" in name]
    assert str(ROOT).encode() not in b"".join(found.values())
    assert fmu_file().stat().st_size < 3_000_000


def test_its_state_may_be_copied_and_serialized() -> None:
    told = present(ET.fromstring(members(fmu_file())["modelDescription.xml"]).find("CoSimulation")).attrib
    assert told["canGetAndSetFMUstate"] == told["canSerializeFMUstate"] == "true"


def test_all_variables_have_units_with_their_dimension() -> None:
    description = ET.fromstring(members(fmu_file())["modelDescription.xml"])
    defined = {each.get("name"): each.find("BaseUnit") for each in description.iter("Unit")}
    units = [each.unit for each in described() if each.type == "Real"]
    assert None not in units
    for unit in set(units):
        exponents = {base: int(n) for base, n in present(defined[unit]).attrib.items()}
        assert exponents == base_units(unit)
    assert {"deg", "kN"} <= {each.get("name") for each in description.iter("DisplayUnit")}


def test_defaults_and_bounds_are_those_of_the_crane_to_the_last_bit() -> None:
    rows = {each.name: each for each in described()}
    for each in sc.scenes.rotary_crane().model().parameters.declared:
        found = rows[each.name]
        assert (float(found.start), float(found.min), float(found.max)) == (each.default, each.lower, each.upper)
        assert found.unit == each.unit


def test_outputs_depend_on_inputs_at_the_start_only() -> None:
    description = read_model_description(str(fmu_file()))
    assert all(each.dependencies == [] for each in description.outputs)
    for each in description.initialUnknowns:
        names = {source.name for source in each.dependencies}
        assert {"load.position[1]", "load_mass", "gravity"} <= names
        assert not [name for name in names if name.startswith("measured.")]


def test_two_builds_are_equal_byte_by_byte_and_the_identifier_changes_with_the_content(
    native: NativeModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def archive() -> bytes:
        return packed(native, LOAD_TRAJECTORY, THIS_MACHINE)

    def entry() -> str:
        return members(io.BytesIO(archive()))["resources/slavemodule.txt"].decode()

    assert archive() == archive()
    usual = entry()
    other = tmp_path / "kernel.py"
    other.write_text(Path(str(kernel.__file__)).read_text(encoding="utf-8") + "\n")
    monkeypatch.setattr(kernel, "__file__", str(other))
    assert entry() != usual


def test_two_builds_of_different_content_live_in_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another version of the slave, and of the library: the crane has a lighter load. Two native FMUs run beside."""
    fmu_file()  # built while the slave is the usual one
    lighter = native_model(ROTARY_CRANE, starts={"load_mass": 50.0}, host=OF_PYTHONFMU)
    slave = Path(str(kernel.__file__)).read_text(encoding="utf-8")
    (tmp_path / "kernel.py").write_text(slave.replace("current_time, step_size, 1)", "current_time, step_size / 2, 1)"))
    monkeypatch.setattr(kernel, "__file__", str(tmp_path / "kernel.py"))
    other = scratch() / "another.fmu"
    other.write_bytes(packed(lighter, ROTARY_CRANE, THIS_MACHINE))
    with (
        Host() as usual,
        Host(other) as another,
        Native("rotary_crane", 2) as first,
        Native("rotary_crane", 3) as second,
    ):
        for host in (usual, another, first, second):
            assert host.start().step(0.0, 0.1)
        assert (usual["tension"], another["tension"]) == pytest.approx((981.0, 490.5))
        assert [host["F"] for host in (first, second)] == pytest.approx([usual["F"]] * 2)
        assert usual.step(0.1, 0.1)
        assert not another.step(0.1, 0.1)
        assert another.step(0.05, 0.1)


def test_another_servocore_in_the_process_is_neither_used_nor_disturbed() -> None:
    done = in_a_process(
        "import sys, types\nfrom pathlib import Path\n"
        "from fmu_host import Host\n"
        "for name in ('servocore', 'servocore.errors', 'crane_fmu', 'crane_fmu.slave', 'pythonfmu'):\n"
        "    sys.modules[name] = types.ModuleType(name)\n"
        "foreign = dict(sys.modules)\n"
        "with Host(Path(sys.argv[1])) as host:\n"
        "    assert host.start().step(0.0, 0.1)\n"
        "assert all(sys.modules[name] is module for name, module in foreign.items())\n"
        "print('alive')",
        fmu_file(),
    )
    assert done.stdout.strip() == "alive", done.stderr


CLEAN = """
import sys
from fmpy import simulate_fmu
result = simulate_fmu(sys.argv[1], stop_time=1.0, output_interval=0.1)
assert len(result) == 11 and result["time"][-1] == 1.0
unwanted = {"casadi", "scipy", "servocore", "crane_fmu", "pythonfmu", "matplotlib"}
print(*sorted(unwanted & {each.split(".")[0] for each in sys.modules}))
"""


def test_a_clean_process_runs_it_without_casadi_or_the_project(tmp_path: Path) -> None:
    done = python("-I", "-c", CLEAN, fmu_file(), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""
