"""Native FMUs in hosts that are not Python, and on other platforms.

`make native` asks all scenes in both versions of FMI; `make platforms` runs the libraries of other platforms, with Wine
and QEMU where they are installed.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmu_host import extracted
from native_fmu import (
    FULL,
    HEADERS,
    NATIVE,
    Native,
    along_path,
    c_host,
    exported,
    jets_of,
    native_file,
    numbers_of,
    scene_called,
)

import servocore as sc
from servocore.export.targets import zig

PLATFORMS = os.environ.get("SERVOCORE_PLATFORMS") == "all"
WINE = next((each for each in ("wine64", "wine", "/usr/lib/wine/wine64") if shutil.which(each)), None)
QEMU = next((each for each in ("qemu-aarch64-static", "qemu-aarch64") if shutil.which(each)), None)


def host_words(name: str, fmi: int, steps: int) -> tuple[list[str], str]:
    """Return the arguments of the plain host behind the library, and what it reads."""
    model, reference = exported(name), scene_called(name).reference
    t = np.linspace(reference.start_time, reference.end_time, steps + 1)
    variables = len(model.of("input"))
    inputs = model.numbers("input")
    numbers = sum(each.size or 1 for each in model.variables) if fmi == 2 else len(model.variables)
    first = inputs if fmi == 2 else variables
    outputs = len(model.of("output"))
    words = [variables, inputs, first, outputs, numbers, steps, repr(float(t[1] - t[0])), 1]
    return [str(each) for each in words], " ".join(map(repr, jets_of(name, t).ravel().tolist()))


# Hosts ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_host_in_c_gets_what_a_host_in_python_gets(fmi: int) -> None:
    name, steps = "rotary_crane", 100
    folder = Path(extracted(native_file(name, fmi)))
    (library,) = folder.glob("binaries/*/*.so")
    words, path = host_words(name, fmi, steps)
    token = read_model_description(str(folder)).guid
    done = subprocess.run([c_host(fmi), library, token, *words], input=path, capture_output=True, text=True, check=True)
    with Native(name, fmi) as instance:
        expected = along_path(instance, steps)
    assert (numbers_of(done.stdout) == expected).all()


# Branches, and all platforms ----------------------------------------------------------------------------------------


@pytest.mark.skipif(not FULL, reason="make native")
def test_a_branch_that_is_followed_is_followed_in_an_fmu_too() -> None:
    scene, steps = scene_called("crossing"), 300
    inputs = [each.name for each in scene.model().inputs]
    solution = sc.solve(scene, step=scene.reference.duration / steps)
    expected = np.column_stack([solution[each] for each in inputs])
    with Native("crossing", 3) as host:
        outputs = along_path(host, steps)
        found, trolley = outputs[:, : len(inputs)], outputs[:, host.results.index("s")]
    assert trolley.min() < -1.0
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


RUNNERS: dict[str, tuple[str | None, ...]] = {
    "x86_64-linux": (),
    "x86_64-windows": (WINE,),
    "aarch64-linux": (QEMU, "-L", "/usr/aarch64-linux-gnu"),  # Debian: libc6-arm64-cross
}


@pytest.mark.skipif(not PLATFORMS, reason="make platforms")
@pytest.mark.parametrize("target", RUNNERS)
def test_libraries_of_other_platforms_give_the_same_digits(target: str, tmp_path: Path) -> None:
    runner, compiler = [word for word in RUNNERS[target] if word is not None], zig()
    if compiler is None or len(runner) < len(RUNNERS[target]) or not all(Path(word).exists() for word in runner[2:]):
        pytest.skip("needs ziglang, and Wine or QEMU with a C library")
    name, steps = "rotary_crane", 100
    # With a second platform all are built by zig, this machine's own too.
    file = sc.export_fmu(scene_called(name), tmp_path / "crane.fmu", targets=f"{target},aarch64-linux")
    folder = Path(str(fmpy.extract(str(file), str(tmp_path / "crane"))))
    (library,) = folder.glob(f"binaries/{target}/*")
    windows = target.endswith("windows")
    host = tmp_path / ("host.exe" if windows else "host")
    options = ["-target", f"{target}-gnu", "-O1", "-w", "-DFMI=3", f"-I{HEADERS}", *(() if windows else ("-ldl",))]
    subprocess.run([*compiler, "cc", *options, NATIVE / "host.c", "-o", host], check=True, timeout=900)
    words, path = host_words(name, 3, steps)
    done = subprocess.run(
        [*runner, host, library, read_model_description(str(folder)).guid, *words],
        input=path, capture_output=True, text=True, check=False, timeout=600,
        env=os.environ | {"WINEDEBUG": "-all", "WINEPREFIX": str(tmp_path / "wine")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with Native(name, 3) as instance:
        expected = along_path(instance, steps)
    found = numbers_of(done.stdout)
    drives = [instance.results.index(each.name) for each in scene_called(name).model().inputs]
    assert (found[:, drives] == expected[:, drives]).all()
    # Angles pass through atan2, which the C libraries of Linux and Windows round differently.
    assert (np.abs(found - expected) <= np.spacing(np.abs(expected)) * windows).all()


@pytest.mark.skipif(not PLATFORMS, reason="make platforms")
def test_the_library_for_macos_is_universal_and_signed_where_it_has_to_be(tmp_path: Path) -> None:
    if zig() is None:
        pytest.skip("needs ziglang")
    file = sc.export_fmu(scene_called("cars"), tmp_path / "cars.fmu", fmi=2)
    packed = zipfile.ZipFile(file)
    assert {name for name in packed.namelist() if name.startswith("binaries/")} == {
        "binaries/linux64/cars.so", "binaries/win64/cars.dll", "binaries/darwin64/cars.dylib"
    }  # fmt: skip
    library = packed.read("binaries/darwin64/cars.dylib")
    assert struct.unpack_from(">II", library) == (0xCAFEBABE, 2)
    signed = {}
    for k in range(2):
        processor, _, offset, size, alignment = struct.unpack_from(">5I", library, 8 + 20 * k)
        assert (alignment, offset % 2**14) == (14, 0)
        one = library[offset : offset + size]
        commands, at = [], 32
        for _ in range(struct.unpack_from("<I", one, 16)[0]):
            command, length = struct.unpack_from("<II", one, at)
            commands.append(command)
            at += length
        signed[processor] = 0x1D in commands  # LC_CODE_SIGNATURE
    assert set(signed) == {0x01000007, 0x0100000C}  # x86-64 and arm64
    assert signed[0x0100000C]


@pytest.mark.skipif(not FULL or shutil.which("cmake") is None, reason="make native, with cmake")
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_tool_builds_it_again_from_its_sources(fmi: int, tmp_path: Path) -> None:
    file = tmp_path / "cars.fmu"
    with zipfile.ZipFile(native_file("cars", fmi)) as packed, zipfile.ZipFile(file, "w") as bare:
        for name in packed.namelist():
            if not name.startswith("binaries/"):
                bare.writestr(name, packed.read(name))
    subprocess.run([sys.executable, "-m", "fmpy", "compile", file], check=True, capture_output=True)
    result = simulate_fmu(str(file), stop_time=1.0, output_interval=0.1)
    assert len(result) == 11
    assert (result["u"] == 0.0).all()


@pytest.mark.skipif(not PLATFORMS, reason="make platforms")
@pytest.mark.parametrize("fmi", [2, 3])
def test_libraries_for_linux_run_on_old_systems_and_need_nothing_but_c(fmi: int, tmp_path: Path) -> None:
    if zig() is None or shutil.which("readelf") is None:
        pytest.skip("needs ziglang and readelf")
    targets = "x86_64-linux,aarch64-linux" if fmi == 3 else "x86_64-linux,x86_64-windows"
    file = sc.export_fmu(scene_called("cars"), tmp_path / "cars.fmu", fmi=fmi, targets=targets)
    folder = Path(str(fmpy.extract(str(file), str(tmp_path / "cars"))))
    for library in folder.glob("binaries/*/*.so"):
        text = subprocess.run(["readelf", "-dV", library], capture_output=True, text=True, check=True).stdout
        needed = {line.split("[")[1].rstrip("]") for line in text.splitlines() if "(NEEDED)" in line}
        assert needed <= {"libc.so.6", "libm.so.6"}
        versions = {tuple(map(int, word[6:].split("."))) for word in text.split() if word.startswith("GLIBC_2")}
        assert max(versions) <= (2, 17)
    for library in folder.glob("binaries/*/*.dll"):  # without the date: a later build has the same bytes
        assert abs(struct.unpack_from("<I", library.read_bytes(), 0x80)[0] - library.stat().st_mtime) > 1e6
