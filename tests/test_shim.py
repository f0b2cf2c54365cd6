"""The library in front of PythonFMU's binary: hosts without Python, addresses, GUID, null states, no compiler."""

from __future__ import annotations

import ctypes
import shutil
import sys
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmu_host import JET, OUTPUTS, Host, extracted, fmu_file, in_a_process, scratch
from native_fmu import c_host, numbers_of
from processes import in_bare_environment

from crane_fmu.catalogue import FEEDBACK_INPUTS

pytestmark = [
    pytest.mark.usefixtures("compiler"),
    pytest.mark.skipif(sys.platform != "linux", reason="the binary is that of Linux"),
]
PLATFORM = "linux64"
NO_CHOICE = 1000  # the host leaves input_time as it is

STEPS = 3


def unpacked(name: str = "native") -> Path:
    folder = scratch() / name
    if not folder.exists():
        shutil.copytree(extracted(fmu_file()), folder)
    return folder


def guid() -> str:
    return str(read_model_description(str(fmu_file())).guid)


def run(folder: Path, *, given: str | None = None, location: str | None = None) -> CompletedProcess[str]:
    """Follow a load at rest in a C program, which has no Python, without anything of this process's environment."""
    binary, inputs = folder / "binaries" / PLATFORM / "RotaryCrane.so", len(JET) + len(FEEDBACK_INPUTS)
    where = location or (folder / "resources").as_uri()
    words = [inputs, inputs, inputs, len(OUTPUTS), NO_CHOICE, STEPS, 0.1, 1, where]
    rest = [5.0, 0.0, -5.0, *[0.0] * (inputs - 3)] * (STEPS + 1)
    return in_bare_environment(c_host(2), binary, given or guid(), *words, given=" ".join(map(str, rest)))


def expected() -> np.ndarray:
    with Host() as host:
        rows = [host.start().outputs()]
        for k in range(STEPS):
            assert host.step(0.1 * k, 0.1)
            rows.append(host.outputs())
    return np.array(rows)


def test_a_c_program_runs_it_with_nothing_preloaded_and_gets_the_same_numbers() -> None:
    done = run(unpacked())
    assert done.returncode == 0, done.stderr
    wanted = expected()
    assert numbers_of(done.stdout).tolist() == wanted.tolist()
    assert wanted[-1][2] == pytest.approx(-98.1)


@pytest.mark.parametrize("folder", ["Krähe", "a b [1] #é", "50%"])
def test_the_folder_may_have_any_name(folder: str) -> None:
    done = run(unpacked(folder))
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("form", ["file:{}", "file://localhost{}", "file://{}", "{}"])
def test_addresses_may_have_every_form_that_hosts_use(form: str) -> None:
    folder = unpacked()
    done = run(folder, location=form.format(folder / "resources"))
    assert done.returncode == 0, done.stderr


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
        ({"location": "file:///tmp/%FF%FE"}, "the FMU is unpacked into a folder whose name is not UTF-8"),
    ],
)
def test_what_is_wrong_is_told_in_a_sentence_and_no_instance_is_made(arguments: dict[str, str], sentence: str) -> None:
    done = run(unpacked(), **arguments)
    assert done.returncode == 3
    assert sentence in done.stderr


def test_a_guid_in_braces_is_the_same() -> None:
    assert run(unpacked(), given=f"{{{guid()}}}").returncode == 0


def test_null_pointers_and_states_given_back_twice_are_harmless() -> None:
    with Host(fmu_file()) as host:
        host.start()
        dll, c = host.fmu.dll, ctypes.c_void_p(host.fmu.component)
        state = ctypes.c_void_p()
        free, get = dll["fmi2FreeFMUstate"], dll["fmi2GetFMUstate"]
        assert free(c, ctypes.byref(state)) == 0
        assert dll["fmi2SetFMUstate"](c, None) == 3
        for _ in range(3):
            assert get(c, ctypes.byref(state)) == 0
        assert free(c, ctypes.byref(state)) == 0
        assert state.value is None
        assert free(c, ctypes.byref(state)) == 0
        assert dll["fmi2SerializedFMUstateSize"](c, state, ctypes.byref(ctypes.c_size_t())) == 3
        assert dll["fmi2DoStep"](None, ctypes.c_double(0), ctypes.c_double(0.1), 0) == 3
        assert host.step(0.0, 0.1)


def test_only_co_simulation_is_offered() -> None:
    said = []
    library = ctypes.CDLL(str(unpacked() / "binaries" / PLATFORM / "RotaryCrane.so"))
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(lambda *arguments: said.append(arguments[-1].decode()))
    library.fmi2Instantiate.restype = ctypes.c_void_p
    location = (unpacked() / "resources").as_uri().encode()
    made = library.fmi2Instantiate(b"x", 0, guid().encode(), location, ctypes.byref(callbacks), 0, 0)
    assert made is None
    assert said == ["the FMU offers co-simulation only"]
