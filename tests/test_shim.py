"""The library in front of PythonFMU's binary: native hosts, addresses, the GUID, null states, no compiler."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmu_host import Host, extracted, fmu_file, in_a_process, scratch

from crane_fmu.build import shim
from crane_fmu.build.machine_code import c_compiler

COMPILER = c_compiler()
pytestmark = pytest.mark.skipif(
    COMPILER is None or sys.platform != "linux", reason="native hosts need a C compiler on Linux"
)

STEPS = 3
OUTPUTS = 27, 8  # first reference, behind path and measured values, and number


@cache
def native_host() -> Path:
    program = scratch() / "native_host"
    source, headers = Path(__file__).with_name("native_host.c"), Path(fmpy.__file__).parent / "c-code"
    command = [*(COMPILER or []), "-Wall", "-Wextra", "-Werror", "-isystem", str(headers), str(source), "-o"]
    subprocess.run([*command, str(program), "-ldl"], check=True)
    return program


def unpacked(name: str = "native") -> Path:
    folder = scratch() / name
    if not folder.exists():
        shutil.copytree(extracted(fmu_file()), folder)
    return folder


def guid() -> str:
    return str(read_model_description(str(fmu_file())).guid)


def run(
    folder: Path, *, given: str | None = None, location: str | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the C program without anything of this process's environment."""
    binary = folder / "binaries" / shim.PLATFORM / "RotaryCrane.so"
    where = location or (folder / "resources").as_uri()
    return subprocess.run(
        [native_host(), binary, given or guid(), where, str(STEPS), *map(str, OUTPUTS)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env={"PATH": os.defpath, **environment},
    )


HERE = {"CRANE_FMU_PYTHON": sys.executable}


def numbers(text: str) -> np.ndarray:
    return np.array([[float(each) for each in line.split()] for line in text.splitlines() if line[:4] != "log:"])


def expected() -> np.ndarray:
    with Host() as host:
        rows = [host.start().outputs()]
        for k in range(STEPS):
            assert host.step(0.1 * k, 0.1)
            rows.append(host.outputs())
    return np.array(rows)


def test_a_c_program_runs_it_with_nothing_preloaded_and_gets_the_same_numbers() -> None:
    done = run(unpacked(), **HERE)
    assert done.returncode == 0, done.stdout
    wanted = expected()
    # two instances, one after the other: Python is not ended in between
    assert numbers(done.stdout).tolist() == [*wanted.tolist(), *wanted.tolist()]
    assert wanted[-1][2] == pytest.approx(-98.1)


def test_the_active_virtual_environment_is_used() -> None:
    done = run(unpacked(), VIRTUAL_ENV=sys.prefix)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("folder", ["Krähe", "a b [1] #é", "50%"])
def test_the_folder_may_have_any_name(folder: str) -> None:
    done = run(unpacked(folder), **HERE)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("form", ["file:{}", "file://localhost{}", "file://{}", "{}"])
def test_addresses_may_have_every_form_that_hosts_use(form: str) -> None:
    folder = unpacked()
    done = run(folder, location=form.format(folder / "resources"), **HERE)
    assert done.returncode == 0, done.stdout


def test_python_hosts_too_may_unpack_into_a_folder_of_any_name(tmp_path: Path) -> None:
    (tmp_path / "Krähe [1]").mkdir()
    code = (
        "import sys\nfrom fmpy import simulate_fmu\n"
        "print(len(simulate_fmu(sys.argv[1], stop_time=1.0, output_interval=0.1)))"
    )
    done = in_a_process(code, fmu_file(), TMPDIR=str(tmp_path / "Krähe [1]"))
    assert done.stdout.strip() == "11", done.stderr


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"given": "other"}, "the host's description of the FMU has the GUID other, its binary"),
        ({"given": "%s%n"}, "has the GUID %s%n, its binary"),
        ({"location": "file://"}, "the resource location that the host gives is empty"),
        ({"location": "file:///a%00b"}, "the resource location that the host gives is empty"),
        ({"location": "file:///a%2520b"}, "is unpacked into /a%20b; a folder with %20 in its name cannot be used"),
        ({"CRANE_FMU_LIBPYTHON": "/none.so"}, "CRANE_FMU_LIBPYTHON = /none.so is no Python library: /none.so: cannot"),
        ({"CRANE_FMU_PYTHON": "/none/python"}, "CRANE_FMU_PYTHON = /none/python is no program that can be run"),
        ({"CRANE_FMU_PYTHON": "/tmp"}, "CRANE_FMU_PYTHON = /tmp is no program that can be run"),
        ({"location": "file:///tmp/%FF%FE"}, "the FMU is unpacked into a folder whose name is not UTF-8"),
        ({"CRANE_FMU_LIBPYTHON": "libm.so.6"}, "CRANE_FMU_LIBPYTHON = libm.so.6 is no Python library"),
    ],
)
def test_what_is_wrong_is_told_in_a_sentence_and_no_instance_is_made(arguments: dict[str, str], sentence: str) -> None:
    done = run(unpacked(), **{**HERE, **arguments})
    assert done.returncode == 3
    assert sentence in done.stdout
    assert done.stdout.startswith("log: 3 ")


def test_a_python_without_any_package_is_enough(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "bare"], check=True)
    done = run(unpacked(), CRANE_FMU_PYTHON=str(tmp_path / "bare" / "bin" / "python"))
    assert done.returncode == 0, done.stdout


def test_the_environment_decides_which_python_library_is_opened(tmp_path: Path) -> None:
    """One of another version than that of the building Python: its library, or a sentence with its name."""
    other = next(
        version for version in ("3.12", "3.13", "3.11") if version != f"{sys.version_info[0]}.{sys.version_info[1]}"
    )
    python = tmp_path / "bin" / "python"
    python.parent.mkdir()
    python.symlink_to("/bin/true")
    (tmp_path / "lib" / f"python{other}" / "site-packages").mkdir(parents=True)
    done = run(unpacked(), CRANE_FMU_PYTHON=str(python))
    assert done.returncode == 3
    missing = f"is Python {other}, but no library libpython{other}.so.1.0 was found"
    assert missing in done.stdout or "importing numpy with the packages of" in done.stdout


def test_a_guid_in_braces_is_the_same() -> None:
    assert run(unpacked(), given=f"{{{guid()}}}", **HERE).returncode == 0


def test_null_pointers_and_states_given_back_twice_are_harmless() -> None:
    code = (
        "import ctypes, sys\nfrom pathlib import Path\nfrom fmu_host import Host\n"
        "with Host(Path(sys.argv[1])) as host:\n"
        "    host.start()\n"
        "    dll, c = host.fmu.dll, ctypes.c_void_p(host.fmu.component)\n"
        "    state = ctypes.c_void_p()\n"
        "    free, get = dll['fmi2FreeFMUstate'], dll['fmi2GetFMUstate']\n"
        "    assert free(c, ctypes.byref(state)) == 0\n"
        "    assert dll['fmi2SetFMUstate'](c, None) == 3\n"
        "    for _ in range(3):\n"
        "        assert get(c, ctypes.byref(state)) == 0\n"
        "    assert free(c, ctypes.byref(state)) == 0 and state.value is None\n"
        "    assert free(c, ctypes.byref(state)) == 0\n"
        "    assert dll['fmi2SerializedFMUstateSize'](c, state, ctypes.byref(ctypes.c_size_t())) == 3\n"
        "    assert dll['fmi2DoStep'](None, ctypes.c_double(0), ctypes.c_double(0.1), 0) == 3\n"
        "    assert host.step(0.0, 0.1)\n"
        "print('alive')"
    )
    done = in_a_process(code, fmu_file())
    assert done.stdout.strip() == "alive", done.stderr


def test_only_co_simulation_is_offered() -> None:
    said = []
    library = ctypes.CDLL(str(unpacked() / "binaries" / shim.PLATFORM / "RotaryCrane.so"))
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(lambda *arguments: said.append(arguments[-1].decode()))
    library.fmi2Instantiate.restype = ctypes.c_void_p
    location = (unpacked() / "resources").as_uri().encode()
    made = library.fmi2Instantiate(b"x", 0, guid().encode(), location, ctypes.byref(callbacks), 0, 0)
    assert made is None
    assert said == ["the FMU offers co-simulation only"]


# --- building --------------------------------------------------------------------------------------------------------


def test_two_libraries_of_one_machine_are_equal_byte_by_byte() -> None:
    first, second = (shim.compiled_shim("some guid", pytest.fail) for _ in range(2))
    assert first is not None
    assert first == second
    assert first != shim.compiled_shim("another", pytest.fail)
    assert str(Path(__file__).parents[1]).encode() not in first
    assert b"/tmp" not in first


@pytest.mark.parametrize(
    ("variable", "value", "sentence"),
    [
        ("PATH", "", "no C compiler is found"),
        ("CC", "false", "false does not compile the library for native hosts"),
    ],
)
def test_without_a_working_compiler_there_is_a_notice_and_the_fmu_stays_as_it_was(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, sentence: str
) -> None:
    monkeypatch.setenv(variable, value)
    folder = unpacked()
    before = {each.relative_to(folder).as_posix(): each.read_bytes() for each in folder.rglob("*") if each.is_file()}
    said: list[str] = []
    assert shim.with_shim(before, "RotaryCrane", guid(), said.append) == before
    (notice,) = said
    assert notice.startswith(sentence)
    assert notice.endswith("the FMU will run in hosts that are Python only")


def test_a_place_on_the_building_machine_is_never_the_only_one_that_is_tried() -> None:
    libraries = shim.python_libraries()
    assert {f"libpython3.{minor}.so.1.0" for minor in (11, 12, 13)} <= set(libraries)


def test_pythonfmus_binary_alone_still_works_in_python_hosts() -> None:
    """What an FMU that was built without a compiler holds."""
    folder = unpacked("plain")
    binaries = folder / "binaries" / shim.PLATFORM
    if (binaries / shim.REAL_BINARY).exists():
        (binaries / shim.REAL_BINARY).replace(binaries / "RotaryCrane.so")
    code = (
        "import sys\nfrom fmpy import simulate_fmu\n"
        "print(len(simulate_fmu(sys.argv[1], stop_time=1.0, output_interval=0.1)))"
    )
    done = in_a_process(code, folder)
    assert done.stdout.strip() == "11", done.stderr
