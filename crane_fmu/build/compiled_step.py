"""Compile usual steps to machine code, which CasADi would interpret otherwise: equal bits in a fraction of the time.

What an FMU gains by it is speed alone. Where no compiler is found, and on hosts that the library is not made for,
`slave_quick` has CasADi interpret the same function.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import casadi as ca

from crane_fmu.build.shim import c_compiler, is_shim_platform
from crane_fmu.slave.quick import usual_step
from servocore import Program

# As the interpreter computes: no fused operations, nothing reordered, any 64-bit processor. Nothing of the machine or
# the folder may get into the library: equal sources give equal bytes.
_OPTIONS = "-O1 -g0 -fPIC -shared -ffp-contract=off -fno-ident -frandom-seed=step -Wl,--build-id=none -Wl,-s -lm"
_SECONDS = 300.0


def compiled_steps(programs: Mapping[str, str], notice: Callable[[str], None]) -> dict[str, bytes]:
    """Return shared libraries with the usual steps of programs.

    Parameters
    ----------
    programs : mapping of str to str
        Serialised programs by any key.
    notice : callable
        Called with a sentence when libraries are left out.

    Returns
    -------
    dict of str to bytes
        By the same keys; empty where they cannot be made.
    """
    compiler = c_compiler()
    if compiler is None or not is_shim_platform():
        return {}  # the shim says why
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        libraries = pool.map(lambda text: _library(text, tuple(compiler)), programs.values())
        made = dict(zip(programs, libraries, strict=True))
    if None in made.values():
        notice(f"{compiler[0]} does not compile CasADi's C; the FMU will take more time for its steps")
    return {name: library for name, library in made.items() if library is not None}


@cache
def _library(text: str, compiler: tuple[str, ...]) -> bytes | None:
    function = usual_step(Program.from_json(text))
    generator = ca.CodeGenerator("step.c")
    generator.add(function)
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as scratch:
        source, target = Path(scratch) / "step.c", Path(scratch) / "step.so"
        source.write_text(generator.dump(), encoding="utf-8")
        command = [*compiler, source.name, *_OPTIONS.split(), "-o", target.name]
        try:
            subprocess.run(command, cwd=scratch, capture_output=True, timeout=_SECONDS, check=True)
        except (OSError, subprocess.SubprocessError):
            return None
        return target.read_bytes()
