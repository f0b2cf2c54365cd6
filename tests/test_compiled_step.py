"""The usual step of some programs as machine code: the same bits as CasADi's interpreter, and never needed."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from fmu_host import extracted, fmu_file
from present import present

import servocore as sc
from crane_fmu.build.compiled_step import compiled_steps
from crane_fmu.build.machine_code import c_compiler, makes_linux_binaries
from crane_fmu.catalogue import ROTARY_CRANE
from crane_fmu.slave.motion import begin
from crane_fmu.slave.quick_step import QuickStep, quick_step, usual_step
from servocore import Program

CRANE = sc.scenes.rotary_crane()
NAMES = ["-".join(route) for route in ROTARY_CRANE.to_machine_code]
H = 0.05

CAN_COMPILE = c_compiler() is not None and makes_linux_binaries()
compiles = pytest.mark.skipif(not CAN_COMPILE, reason="steps are compiled by a C compiler on 64-bit Linux")


def bundle() -> Path:
    (found,) = Path(extracted(fmu_file())).glob("resources/*_bundle")
    return found


def program(name: str) -> sc.Program:
    return Program.from_json((bundle() / f"{name}.json").read_text())


def states(quick: QuickStep | None, saved: sc.Program, name: str) -> list[bytes]:
    """Bits of all that quick steps along the manoeuvre give, from exact values on."""
    p = CRANE.model(name.split("-", maxsplit=1)[0]).parameters.values(CRANE.parameters)
    jets = CRANE.reference.jet(np.arange(0.0, 20.0, H), 4)
    jets[200:, 2] = 0.0  # and along one that is none
    now = begin(saved, jets[0], p, 0.0)
    now.__dict__["step"] = H
    found = []
    for jet in jets:
        assert quick is not None
        after = quick(now, jet.ravel().tolist(), H, H, p)
        assert after is not None
        found.append(b"".join(each.tobytes() for each in (after.state, after.jet, after.values)))
        now = after
    return found


@compiles
@pytest.mark.parametrize("name", NAMES)
def test_machine_code_gives_the_bits_that_the_interpreter_gives(name: str) -> None:
    saved = program(name)
    compiled = quick_step(saved, bundle() / f"{name}.so")
    interpreted = QuickStep(saved, usual_step(saved))
    assert states(compiled, saved, name) == states(interpreted, saved, name)


@compiles
def test_the_libraries_are_those_that_were_chosen_and_are_used() -> None:
    assert sorted(each.stem for each in bundle().glob("*.so")) == sorted(["feedback", *NAMES])
    names = [f"{model}-{formulation}" for model in CRANE.models for formulation in ("reduced", "projected", "original")]
    assert set(NAMES) <= set(names)
    for name in names:
        used = present(quick_step(program(name), bundle() / f"{name}.so"))
        assert used.is_compiled == (name in NAMES)


@pytest.mark.parametrize("content", [None, b"", b"no library", b"\x7fELF" + bytes(200)])
def test_a_library_that_cannot_be_loaded_is_done_without(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "step.so"
    if content is not None:
        file.write_bytes(content)
    saved = program("points-reduced")
    found = present(quick_step(saved, file))
    assert not found.is_compiled
    assert states(found, saved, "points-reduced")


@compiles
def test_a_library_of_another_program_is_done_without() -> None:
    assert not present(quick_step(program("points-reduced"), bundle() / "points-original.so")).is_compiled


@compiles
def test_two_libraries_of_one_machine_are_equal_byte_by_byte() -> None:
    text = (bundle() / "points-reduced.json").read_text()
    made = [compiled_steps({"a.json": text}, pytest.fail)["a.so"] for _ in range(2)]
    assert made[0] == made[1] == (bundle() / "points-reduced.so").read_bytes()


@compiles
def test_a_compiler_that_fails_is_told_once_and_costs_the_libraries_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "false")
    text = (bundle() / "points-reduced.json").read_text()
    said: list[str] = []
    assert compiled_steps({"a.json": text, "b.json": text}, said.append) == {}
    (notice,) = said
    assert notice.startswith("false does not compile")


def test_without_a_compiler_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert compiled_steps({"a.json": "not even read"}, pytest.fail) == {}


@compiles
def test_the_libraries_need_nothing_but_the_c_library() -> None:
    command = ["readelf", "-d", str(bundle() / "points-reduced.so")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    needed = [line.split("[")[1].rstrip("]") for line in done.stdout.splitlines() if "(NEEDED)" in line]
    assert set(needed) <= {"libm.so.6", "libc.so.6"}
