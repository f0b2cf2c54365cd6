"""Machine code: CasADi's functions written in C and built by the compiler of this machine.

CasADi interprets its expressions, at some nanoseconds an operation. Machine code takes a fifth of that, and one to
four seconds to build, once a process.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

import casadi as ca

from servocore.errors import InvalidSetting

COMPILERS = ("cc", "gcc", "clang")
# No fused operations and nothing reordered: a program must not depend on who evaluates it.
_OPTIONS = ("-O2", "-fPIC", "-shared", "-ffp-contract=off")
_SECONDS = 600.0


def c_compiler() -> list[str]:
    """Return the command of the C compiler: the variable CC, or the first of `COMPILERS` on the path.

    Raises
    ------
    InvalidSetting
        If there is none.
    """
    named = shlex.split(os.environ.get("CC", ""))
    for command in (named, *([each] for each in COMPILERS)):
        if command and shutil.which(command[0]) is not None:
            return command
    raise InvalidSetting(
        f"machine code needs a C compiler: there is none in the variable CC, and none of {', '.join(COMPILERS)} is on"
        f" the path"
    )


def compiled(functions: Mapping[str, ca.Function], of_what: str) -> dict[str, ca.Function]:
    """Compile functions to machine code, for as long as the process lives.

    Parameters
    ----------
    functions : mapping of str to casadi.Function
        By any name.
    of_what : str
        What they belong to, for messages.

    Raises
    ------
    InvalidSetting
        If there is no C compiler, or it does not compile.
    """
    generator = ca.CodeGenerator("program.c")
    for name, function in functions.items():
        generator.add(_renamed(function, f"sc_native_{name}"))
    command = c_compiler()
    # What is loaded stays loaded: the file may go.
    with tempfile.TemporaryDirectory(prefix="servocore_") as folder:
        source, library = Path(folder) / "program.c", Path(folder) / "program.so"
        source.write_text(generator.dump(), encoding="utf-8")
        build = [*command, *_OPTIONS, source.name, "-o", library.name, "-lm"]
        try:
            subprocess.run(build, cwd=folder, capture_output=True, text=True, timeout=_SECONDS, check=True)
        except subprocess.CalledProcessError as error:
            reason = (error.stderr or "").strip().splitlines()[:1]
            raise InvalidSetting(f"{command[0]} does not compile {of_what}: {''.join(reason)}") from error
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InvalidSetting(f"{command[0]} does not compile {of_what}: {error}") from error
        return {name: ca.external(f"sc_native_{name}", str(library)) for name in functions}


def _renamed(function: ca.Function, name: str) -> ca.Function:
    """Return a function of another name: names must differ within a library, and none is longer than C allows."""
    arguments = [ca.MX.sym(f"i{k}", function.sparsity_in(k)) for k in range(function.n_in())]
    return ca.Function(name, arguments, list(function.call(arguments)))
