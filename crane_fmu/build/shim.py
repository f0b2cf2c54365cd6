"""Put a small C library in front of PythonFMU's binary, so that hosts that are not Python can run the FMU.

`shim.c` says what the library does. It is compiled against the FMI headers that come with FMPy, where a C
compiler is found; without one the FMU keeps PythonFMU's binary alone and works in Python hosts.
"""

from __future__ import annotations

import os
import re
import sysconfig
from collections.abc import Callable, Mapping
from pathlib import Path

import fmpy

import servocore as sc
from crane_fmu.build.machine_code import c_compiler, makes_linux_binaries, shared_library

PLATFORM = "linux64"
"""Folder of the binaries that get a shim; PythonFMU's other binaries stay as they are."""

REAL_BINARY = "pythonfmu.so"
"""Name of PythonFMU's binary beside the shim."""

_SOURCE = Path(__file__).with_name("shim.c")
_HEADERS = Path(fmpy.__file__).parent / "c-code"
_VERSIONS = ((3, 13), (3, 12), (3, 11))  # that the FMU runs on
_OPTIONS = f"-std=gnu11 -O3 -fvisibility=hidden -Wall -Wextra -Werror -isystem {_HEADERS} -ldl -pthread"


def with_shim(members: Mapping[str, bytes], name: str, guid: str, notice: Callable[[str], None]) -> dict[str, bytes]:
    """Put the shim into an FMU and PythonFMU's binary beside it.

    Parameters
    ----------
    members : mapping of str to bytes
        The FMU's content by path.
    name, guid : str
        The FMU's model identifier, and what tells its table of variables from others.
    notice : callable
        Called with a sentence when the shim is left out.

    Returns
    -------
    dict of str to bytes
        The content with the shim, or as it was.
    """
    binary = f"binaries/{PLATFORM}/{name}.so"
    library = compiled_shim(guid, notice) if binary in members else None
    if library is None:
        return dict(members)
    return {**members, binary: library, f"binaries/{PLATFORM}/{REAL_BINARY}": members[binary]}


def compiled_shim(guid: str, notice: Callable[[str], None]) -> bytes | None:
    """Return the library for an FMU with this GUID, or None, with a notice, where it cannot be made."""
    left_out = "the FMU will run in hosts that are Python only"
    if not makes_linux_binaries():
        notice(f"native hosts are served on 64-bit Linux only; {left_out}")
        return None
    compiler = c_compiler()
    if compiler is None:
        notice(f"no C compiler is found; {left_out}")
        return None
    sources = {
        _SOURCE.name: _SOURCE.read_text(encoding="utf-8"),
        "shim_config.h": _configuration(guid.strip("{}")),
    }
    try:
        return shared_library(compiler, sources, _OPTIONS)
    except sc.ServocoreError as error:
        notice(f"{compiler[0]} does not compile the library for native hosts ({error}); {left_out}")
        return None


def _configuration(guid: str) -> str:
    libraries = ", ".join(f'"{_c_text(library)}"' for library in python_libraries())
    return (
        f'#define FMU_GUID "{_c_text(guid)}"\n'
        f'#define REAL_BINARY "{REAL_BINARY}"\n'
        '#define REQUIRED_PACKAGES "ctypes"\n'
        f"#define PYTHON_LIBRARIES {libraries}\n"
    )


def python_libraries() -> tuple[str, ...]:
    """Return the Python libraries that a native host may open, best first.

    That of the building Python comes first: by its place on this machine, then by its name for the system's search.
    All versions that the FMU runs on follow.
    """
    own = sysconfig.get_config_var("INSTSONAME") or ""
    places = [sysconfig.get_config_var(name) or "" for name in ("LIBDIR", "LIBPL")]
    shared = own if re.fullmatch(r"libpython[\w.]*\.so[\d.]*", own) else ""
    here = [str(Path(place) / shared) for place in places if shared and place]
    named = [each for each in here if Path(each).is_file()][:1]
    general = [f"libpython{major}.{minor}.so.1.0" for major, minor in _VERSIONS]
    return tuple(dict.fromkeys([*named, *([shared] if shared else []), *general]))


def _c_text(text: str) -> str:
    """Write a text for the inside of a C string."""
    return "".join(
        chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f"\\{byte:03o}" for byte in os.fsencode(text)
    )
