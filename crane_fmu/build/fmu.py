"""Build an FMU: compile the models, bundle what the slave needs, pack, check, put in place."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path

import servocore as sc
from crane_fmu.build.archive import Progress, packed
from crane_fmu.build.native import native_fmu
from crane_fmu.build.page import user_page
from crane_fmu.catalogue import KINDS, NO_STARTS, ROTARY_CRANE, FmuKind, Starts
from crane_fmu.files import put
from servocore.files import made_folder, require_writable, write_together

USUAL_TARGETS = "host,x86_64-windows"
"""Platforms whose libraries an FMU has where nothing else is asked for."""

_CHECK = Path(__file__).parent / "resources" / "check_fmu.py"
_CHECK_SECONDS = 300.0


def build_fmu(
    directory: Path,
    progress: Progress = lambda _: None,
    kind: FmuKind = ROTARY_CRANE,
    path: sc.Reference | None = None,
    starts: Starts = NO_STARTS,
    targets: str | None = None,
) -> Path:
    """Build an FMU, check it in a process of its own and only then rename it into place.

    Parameters
    ----------
    directory : Path
        Where it goes; made if it does not exist.
    progress : callable
        Called with a phrase for every stage.
    kind : FmuKind
        Which FMU.
    path : Reference, optional
        What a trajectory carries.
    starts : mapping of str to float or str
        Start values of variables that differ from the defaults; names that the FMU does not have are passed over.
    targets : str, optional
        Platforms that it has libraries for, as `sc.export_fmu` takes them: this machine's and 64-bit Windows when not
        given.

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
    import_module("pythonfmu")  # if it is missing it is so now, not after all is compiled
    directory = Path(directory)
    target = directory / kind.file_name
    require_writable(directory, directory)
    with made_folder(directory, directory):
        native = native_fmu(kind, path, starts, targets or USUAL_TARGETS, progress, deferred_refusals=True)
        progress(f"packing {kind.file_name}")
        archive = packed(native, kind)
        progress(f"checking {kind.file_name} in a process of its own")
        _check(archive, kind, starts)
        write_together({target: archive})
    return target


def _check(archive: bytes, kind: FmuKind, starts: Starts) -> None:
    wanted = (json.dumps(each) for each in (kind.runs_with(starts), kind.rest(starts)))
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        put(Path(folder), {kind.file_name: archive})
        command = [sys.executable, "-I", str(_CHECK), kind.file_name, *wanted]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=_CHECK_SECONDS, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise sc.ServocoreError(f"the FMU did not finish its check in {_CHECK_SECONDS:g} s") from error
    if done.returncode:
        why = (done.stderr or done.stdout).strip() or f"the process ended with {done.returncode}"
        raise sc.ServocoreError(f"the FMU was built but failed its check, so it was not written: {why}")


def main(arguments: list[str] | None = None) -> int:
    """Run the command ``python build_fmu.py``; returns its exit code.

    Parameters
    ----------
    arguments : list of str, optional
        Of the command line; those of the process when not given.

    Returns
    -------
    int
        0, or 2 for bad input.
    """
    parser = argparse.ArgumentParser(prog="build_fmu.py", description=f"Build {ROTARY_CRANE.file_name} and check it.")
    add = parser.add_argument
    add("-o", "--output", type=Path, default=Path(), metavar="DIR", help="where it goes (default: here)")
    add("--fmu", choices=KINDS, default=ROTARY_CRANE.name, help="which one (default: %(default)s)")
    add("--targets", metavar="LIST", help="platforms to compile for (default: this one and 64-bit Windows)")
    add("--page", type=Path, metavar="FILE", help="only write the user page, as Markdown")
    chosen = parser.parse_args(arguments)
    kind = KINDS[chosen.fmu]
    try:
        if chosen.page:
            described = native_fmu(kind, targets="none", deferred_refusals=True)
            write_together({chosen.page: user_page(kind, described).encode()})
            return 0
        file = build_fmu(
            chosen.output, lambda stage: print(f"{stage} ...", file=sys.stderr), kind, targets=chosen.targets
        )
    except sc.ServocoreError as error:
        print(f"build_fmu.py: {error}", file=sys.stderr)
        return 2
    print(file)
    return 0
