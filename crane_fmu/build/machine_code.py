"""Shared libraries for 64-bit Linux, by the C compiler of this machine; equal sources give equal bytes."""

from __future__ import annotations

import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import servocore as sc
from crane_fmu.files import put

# Nothing of the time, the machine or the folder may get into a library.
_OPTIONS = "-g0 -fPIC -shared -fno-ident -ffile-prefix-map={folder}=. -frandom-seed=library -Wl,--build-id=none -Wl,-s"
_SECONDS = 300.0


def makes_linux_binaries() -> bool:
    """Return whether this machine makes binaries for 64-bit Linux."""
    return sys.platform == "linux" and platform.machine() == "x86_64"


def c_compiler() -> list[str] | None:
    """Return the command of the C compiler, or None where there is none."""
    try:
        return sc.c_compiler()
    except sc.InvalidSetting:
        return None


def shared_library(compiler: list[str], sources: Mapping[str, str], options: str) -> bytes:
    """Compile C to a library.

    Parameters
    ----------
    compiler : list of str
        Its command.
    sources : mapping of str to str
        Files by name: the one to compile, then those that it includes.
    options : str
        What the compiler is told beside what every library needs.

    Raises
    ------
    ServocoreError
        If it does not compile; the sentence is the first that the compiler said.
    """
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as scratch:
        folder = Path(scratch)
        put(folder, sources)
        always = _OPTIONS.format(folder=folder).split()
        command = [*compiler, "-I.", *always, next(iter(sources)), *options.split(), "-o", "library.so"]
        try:
            subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_SECONDS, check=True)
        except (OSError, subprocess.SubprocessError) as error:
            said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
            raise sc.ServocoreError(said[0]) from error
        return (folder / "library.so").read_bytes()
