"""Build an FMU: compile the models, add the slave, pack, check, put in place."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType

import servocore as sc
from crane_fmu.build.archive import packed
from crane_fmu.build.native import OF_PYTHONFMU, native_fmu
from crane_fmu.build.page import user_page
from crane_fmu.catalogue import NO_STARTS, ROTARY_CRANE, FmuKind, Starts
from crane_fmu.files import put
from servocore.files import made_folder, require_writable, write_together

USUAL_TARGETS = "host,x86_64-windows"
"""Platforms that an FMU is built for by default."""

_CHECK = Path(__file__).parent / "resources" / "check_fmu.py"
_CHECK_SECONDS = 300.0


def build_fmu(
    directory: Path,
    progress: Callable[[str], None] = lambda _: None,
    kind: FmuKind = ROTARY_CRANE,
    path: sc.Reference | None = None,
    starts: Starts = NO_STARTS,
    targets: str | None = None,
    drives: Mapping[str, sc.Drive] = MappingProxyType({}),
) -> Path:
    """Build an FMU, check it in a separate process, and then rename it into place.

    Parameters
    ----------
    directory : Path
        Folder of the FMU; made if it does not exist.
    progress : callable
        Called with a phrase for every stage.
    kind : FmuKind
        Which FMU.
    path : Reference, optional
        The path in a trajectory.
    starts : mapping of str to float or str
        Start values of variables that differ from the defaults, parameters of the crane among them.
    targets : str, optional
        Platforms of its libraries, as of `sc.export_fmu`; this machine and 64-bit Windows by default.
    drives : mapping of str to Drive
        Motors and transmissions of the crane.

    Returns
    -------
    Path
        The FMU.

    Raises
    ------
    InvalidSetting
        If the folder cannot be made or written.
    ServocoreError
        If the FMU fails its check.
    """
    import_module("pythonfmu")  # fails before the compilation if it is not installed
    directory = Path(directory)
    target = directory / kind.file_name
    require_writable(directory, directory)
    with made_folder(directory, directory):
        native = native_fmu(kind, path, starts, targets or USUAL_TARGETS, progress, OF_PYTHONFMU, drives)
        progress(f"packing {kind.file_name}")
        archive = packed(native, kind)
        progress(f"checking {kind.file_name} in a separate process")
        _check(archive, kind, starts)
        write_together({target: archive})
    return target


def page_of(kind: FmuKind) -> str:
    """Return the user page of an FMU as Markdown, without compiling it.

    Parameters
    ----------
    kind : FmuKind
        Which one.

    Returns
    -------
    str
        The page.
    """
    return user_page(kind, native_fmu(kind, targets="none", host=OF_PYTHONFMU))


def _check(archive: bytes, kind: FmuKind, starts: Starts) -> None:
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        put(Path(folder), {kind.file_name: archive})
        command = [sys.executable, "-I", str(_CHECK), kind.file_name, json.dumps(kind.runs_with(starts))]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=_CHECK_SECONDS, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise sc.ServocoreError(f"the FMU did not finish its check in {_CHECK_SECONDS:g} s") from error
    if done.returncode:
        reason = (done.stderr or done.stdout).strip() or f"the process ended with {done.returncode}"
        raise sc.ServocoreError(f"the FMU was built but failed its check, so it was not written: {reason}")
