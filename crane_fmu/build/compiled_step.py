"""Compile usual steps to machine code, which CasADi would interpret otherwise: equal bits in a fraction of the time.

What an FMU gains by it is speed alone. Where no compiler is found, and on hosts that the library is not made for,
`crane_fmu.slave.quick_step` has CasADi interpret the same function.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import casadi as ca

import servocore as sc
from crane_fmu.build.machine_code import c_compiler, makes_linux_binaries, shared_library
from crane_fmu.slave.interface import COMPILED, FEEDBACK_FILE
from crane_fmu.slave.quick_step import usual_step

_OPTIONS = "-O3 -ffp-contract=off -lm"  # as the interpreter computes: no fused operations, nothing reordered


def compiled_feedback(functions: Mapping[str, ca.Function], notice: Callable[[str], None]) -> dict[str, bytes]:
    """Return a shared library with feedback and estimation by its name in the bundle; empty where it cannot be made.

    Parameters
    ----------
    functions : mapping of str to casadi.Function
        What the FMU carries, by name.
    notice : callable
        Called with a sentence when the library is left out.
    """
    chosen = [functions[name] for name in COMPILED]
    return _libraries({FEEDBACK_FILE: lambda: chosen}, notice)


def compiled_steps(programs: Mapping[str, str], notice: Callable[[str], None]) -> dict[str, bytes]:
    """Return shared libraries with the usual steps of programs.

    Parameters
    ----------
    programs : mapping of str to str
        Serialized programs by file name.
    notice : callable
        Called with a sentence when libraries are left out.

    Returns
    -------
    dict of str to bytes
        By the same names with the suffix of a library; empty where they cannot be made.
    """
    return _libraries({name: partial(_usual_steps, text) for name, text in programs.items()}, notice)


def _usual_steps(text: str) -> list[ca.Function]:
    return [usual_step(sc.Program.from_json(text))]


def _libraries(
    functions: Mapping[str, Callable[[], list[ca.Function]]], notice: Callable[[str], None]
) -> dict[str, bytes]:
    compiler = c_compiler()
    if compiler is None or not makes_linux_binaries():
        return {}  # the shim says why

    def library(make: Callable[[], list[ca.Function]]) -> bytes | None:
        generator = ca.CodeGenerator("step.c")
        for each in make():
            generator.add(each)
        try:
            return shared_library(compiler, {"step.c": generator.dump()}, _OPTIONS)
        except sc.ServocoreError:
            return None

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        made = dict(zip(functions, pool.map(library, functions.values()), strict=True))
    if None in made.values():
        notice(f"{compiler[0]} does not compile CasADi's C; the FMU will take more time for its steps")
    return {str(Path(name).with_suffix(".so")): each for name, each in made.items() if each is not None}
