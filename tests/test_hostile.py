"""Hostile use: random sequences of FMI calls, in a process of their own, so that a crash is one failed test.

`make hostile` runs ten thousand sequences with every PythonFMU, `make native` a thousand with each of a dozen native
FMUs; these are a sample.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from fmu_host import extracted, fmu_file, in_a_process
from native_fmu import FULL, exported, native_file

from crane_fmu.catalogue import KINDS
from servocore.export.sources import compiled_files, fmu_sources

MANY = int(os.environ.get("SERVOCORE_HOSTILE_SEQUENCES", "0"))
SEED = os.environ.get("SERVOCORE_HOSTILE_SEED", "0")
CODE = "import sys, hostile; hostile.main(*sys.argv[1:])"

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the calls are made through the Linux binary")


def last_sequence(said: str) -> str:
    """Calls of the sequence that was running, and what followed."""
    return said[said.rfind("--- a new sequence") :] if "Traceback" not in said else said[said.rfind("Traceback") :]


def survive(sequences: int, steps: int, *folders: str, **environment: str) -> None:
    """Run the sequences, and see that they end as they should."""
    given = map(str, (sequences, steps, SEED, *folders))
    done = in_a_process(CODE, *given, seconds=300 + sequences, **environment)
    assert done.returncode == 0, f"ended with {done.returncode}:\n{last_sequence(done.stderr)[-8000:]}"
    print(f"{folders}: {done.stdout.strip()}")
    assert done.stdout.startswith(f"{sequences} sequences survived")


@pytest.mark.parametrize("name", KINDS)
def test_no_sequence_of_calls_ends_the_process_or_leaves_a_trace(name: str) -> None:
    survive(MANY or (100 if name == "RotaryCrane" else 25), 100, extracted(fmu_file(name)))


FAULTS = {
    "a state that is not restored": "Instance.set_state = lambda self, state: 0",
    "an input that is lost": "set_reals = Instance.set_reals\n"
    "Instance.set_reals = lambda self, r, v: set_reals(self, r[:3], v[:3]) if self.messages else set_reals(self, r, v)",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_machine_is_not_blind(fault: str) -> None:
    code = f"from hostile_fmu import Instance\n{FAULTS[fault]}\n{CODE}"
    done = in_a_process(code, "300", "0", SEED, extracted(fmu_file()), seconds=100)
    assert done.returncode == 1, done.stdout
    assert "AssertionError" in done.stderr


# Native FMUs, with sanitizers ----------------------------------------------------------------------------------------

NATIVE = [("cars", 2), ("mass_on_car plant", 2), ("rotary_crane trajectory", 2), ("gantry_crane", 3)]
if FULL:
    more = ("rotary_crane", "mass_on_car", "elastic_hoist", "crossing", "limited")
    NATIVE += [(name, 2) for name in more]
    NATIVE += [(name, fmi) for name in ("wind", "rotary_crane plant", "rotary_crane loop") for fmi in (2, 3)]
PREFIXES = ("-DFMI2_OVERRIDE_FUNCTION_PREFIX", "-DFMI3_OVERRIDE_FUNCTION_PREFIX")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def sanitized(name: str, fmi: int, compiler: list[str], folder: Path) -> str:
    """Return a folder with an FMU whose library was built with sanitizers."""
    folder = Path(shutil.copytree(extracted(native_file(name, fmi)), folder))
    (library,), model, source = folder.glob("binaries/*/*.so"), exported(name), folder / "again"
    source.mkdir()
    for file, text in fmu_sources(model, fmi).items():
        (source / file).write_text(text, encoding="utf-8")
    options = ["-std=c99", "-g", "-O1" if FULL else "-O0", "-w", "-fPIC", "-shared", "-ffp-contract=off", *PREFIXES]
    build = [*compiler, *options, *SANITIZERS, *compiled_files(model, fmi), "-o", str(library), "-lm"]
    built = subprocess.run(build, cwd=source, capture_output=True, text=True, check=False)
    if built.returncode and "sanitize" in built.stderr + "libasan":
        pytest.skip(f"this compiler has no sanitizers: {built.stderr.splitlines()[-1]}")
    return str(folder)


def test_no_sequence_of_calls_meets_a_sanitizer(compiler: list[str], tmp_path: Path) -> None:
    asan = subprocess.run([*compiler, "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    if not Path(asan.stdout.strip()).is_absolute():
        pytest.skip("this compiler has no sanitizer that can be loaded before all else")
    folders = [sanitized(name, fmi, compiler, tmp_path / f"{name} {fmi}") for name, fmi in NATIVE]
    # Python keeps some of what it takes; its buffers come from the sanitizer, which then knows where they end
    settings = {"LD_PRELOAD": asan.stdout.strip(), "ASAN_OPTIONS": "detect_leaks=0", "PYTHONMALLOC": "malloc"}
    survive(1000 if FULL else 30, 100_000 if FULL else 3000, *folders, **settings)
