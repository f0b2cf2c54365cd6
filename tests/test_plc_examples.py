"""The examples for controllers: a class in C++, compiled and run, and a function block that fits the C source."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import servocore as sc
from servocore.export.c_source import export_c

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "plc"
FITS = """
#include "rotary_crane.h"
#define SIZE(name, numbers, bytes) typedef char name##_fits[sizeof(double) * (numbers) == (bytes) ? 1 : -1];
SIZE(path, {path}, sizeof(double) * ROTARY_CRANE_PATH)
SIZE(outputs, {outputs}, sizeof(double) * ROTARY_CRANE_OUTPUTS)
SIZE(found, {found}, sizeof(double) * ROTARY_CRANE_OUTPUTS)
SIZE(parameters, {parameters}, sizeof(double) * ROTARY_CRANE_PARAMETERS)
SIZE(memory, {memory}, sizeof(rotary_crane_memory))
int rotary_crane_start({start}); int rotary_crane_step({step});
"""
TYPES = {"memory": "rotary_crane_memory *", "path": "const double *", "parameters": "const double *",
         "outputs": "double *", "h": "double"}  # fmt: skip


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_examples_for_controllers_fit_the_c_source(compiler: list[str], tmp_path: Path) -> None:
    """Inputs of the class are those of the library; the block has the sizes and arguments of the header."""
    scene = sc.scenes.rotary_crane()
    export_c(scene, tmp_path / "source")
    include = [f"-I{EXAMPLES}", f"-I{tmp_path / 'source'}"]
    plain = [*compiler, "-O0", "-w", "-ffp-contract=off", "-c"]
    subprocess.run([*plain, "rotary_crane.c", "-o", "../rotary_crane.o"], cwd=tmp_path / "source", check=True)
    strict = ["-std=c++17", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fno-exceptions", "-fno-rtti"]
    subprocess.run(["g++", *strict, *include, EXAMPLES / "main.cpp", "rotary_crane.o", "-o", "main"], cwd=tmp_path,
                   check=True)  # fmt: skip
    printed = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    found = np.array([line.split() for line in printed.splitlines()], dtype=float)
    wanted = sc.ExactInversion(scene)(np.linspace(0.0, 20.0, 201))
    assert (np.abs(found - wanted).max(axis=0) <= 1e-12 * np.abs(wanted).max(axis=0)).all()
    text = (EXAMPLES / "Feedforward.st").read_text(encoding="utf-8")
    sizes = {name: int(last) + 1 for name, last in re.findall(r"(\w+) : ARRAY\[0\.\.(\d+)\]", text)}
    blocks = re.findall(r"FUNCTION rotary_crane_(\w+) : DINT\nVAR_INPUT\n(.*?)END_VAR", text, re.DOTALL)
    declared = {name: ", ".join(TYPES[each] for each in re.findall(r"(\w+) :", body)) for name, body in blocks}
    (tmp_path / "fits.c").write_text(FITS.format(**sizes, **declared))
    subprocess.run([*compiler, *include, "-fsyntax-only", "fits.c"], cwd=tmp_path, check=True)
