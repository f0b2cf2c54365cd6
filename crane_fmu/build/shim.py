"""Put a small C library in front of PythonFMU's binary, so that hosts that are not Python can run the FMU.

`shim.c` says what the library does. It is compiled against the FMI headers that come with FMPy, where a C
compiler is found; without one the FMU keeps PythonFMU's binary alone and works in Python hosts.
"""

from __future__ import annotations

import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import fmpy

PLATFORM = "linux64"
"""Folder of the binaries that get a shim; PythonFMU's other binaries stay as they are."""

REAL_BINARY = "pythonfmu.so"
"""Name of PythonFMU's binary beside the shim."""

REQUIRED_PACKAGES = ("numpy", "casadi")
"""Packages that the Python of the host must have."""

_SOURCE = Path(__file__).with_name("shim.c")
_HEADERS = Path(fmpy.__file__).parent / "c-code"
_COMPILERS = ("cc", "gcc", "clang")
_VERSIONS = ((3, 13), (3, 12), (3, 11))  # that the FMU runs on
_SECONDS = 60.0

# Nothing of the time, the machine or the folder may get into the library: equal sources give equal bytes.
_OPTIONS = (
    "-std=gnu11 -O2 -g0 -fPIC -shared -fvisibility=hidden -Wall -Wextra -Werror"
    " -fno-ident -ffile-prefix-map={folder}=. -frandom-seed=shim -Wl,--build-id=none -Wl,-s -ldl -pthread"
)


def add_shim(folder: Path, notice: Callable[[str], None]) -> bool:
    """Compile the shim into an unpacked FMU and put PythonFMU's binary beside it.

    Parameters
    ----------
    folder : Path
        The FMU's content: `modelDescription.xml` in its final form, `binaries`.
    notice : callable
        Called with a sentence when the shim is left out.

    Returns
    -------
    bool
        False when the shim is left out; the folder is then as it was.
    """
    description = ET.parse(folder / "modelDescription.xml").getroot()
    kind = description.find("CoSimulation")
    identifier = kind.get("modelIdentifier", "") if kind is not None else ""
    binary = folder / "binaries" / PLATFORM / f"{identifier}.so"
    library = compiled_shim(description.get("guid", ""), notice) if binary.is_file() else None
    if library is None:
        return False
    binary.replace(binary.with_name(REAL_BINARY))
    binary.write_bytes(library)
    binary.chmod(0o755)
    return True


def compiled_shim(guid: str, notice: Callable[[str], None]) -> bytes | None:
    """Return the library for an FMU with this GUID, or None, with a notice, where it cannot be made."""
    left_out = "the FMU will run in hosts that are Python only"
    compiler = c_compiler()
    if not is_shim_platform():
        notice(f"native hosts are served on 64-bit Linux only; {left_out}")
        return None
    if compiler is None:
        notice(f"no C compiler is found; {left_out}")
        return None
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as scratch:
        shutil.copy(_SOURCE, scratch)
        (Path(scratch) / "shim_config.h").write_text(_configuration(guid), encoding="utf-8")
        options = _OPTIONS.format(folder=scratch).split()
        command = [*compiler, "-I.", "-isystem", str(_HEADERS), _SOURCE.name, *options, "-o", "shim.so"]
        try:
            subprocess.run(command, cwd=scratch, capture_output=True, text=True, timeout=_SECONDS, check=True)
        except (OSError, subprocess.SubprocessError) as error:
            said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
            notice(f"{compiler[0]} does not compile the library for native hosts ({said[0]}); {left_out}")
            return None
        return (Path(scratch) / "shim.so").read_bytes()


def is_shim_platform() -> bool:
    """Return whether this machine makes binaries of the kind that `PLATFORM` names."""
    return sys.platform == "linux" and platform.machine() == "x86_64"


def c_compiler() -> list[str] | None:
    """Return the command of a C compiler: the environment variable CC, or what is found."""
    named = shlex.split(os.environ.get("CC", ""))
    if named:
        return named if shutil.which(named[0]) else None
    found = next((each for each in _COMPILERS if shutil.which(each)), None)
    return [found] if found else None


def _configuration(guid: str) -> str:
    libraries = ", ".join(f'"{_c_text(each)}"' for each in python_libraries())
    packages = ", ".join(f'"{each}"' for each in REQUIRED_PACKAGES)
    plain = guid.removeprefix("{").removesuffix("}")
    return (
        f'#define FMU_GUID "{_c_text(plain)}"\n'
        f'#define REAL_BINARY "{REAL_BINARY}"\n'
        f"#define REQUIRED_PACKAGES {packages}\n"
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
