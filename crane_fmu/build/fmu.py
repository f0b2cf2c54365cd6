"""Build an FMU: compile the models, bundle what the slave needs, pack, check, put in place.

PythonFMU packs; what it leaves open is settled here. All FMUs of one Python process share its modules, so the
bundled sources become one package whose name holds a hash of all its content: builds never meet each other, nor an
installed servocore. The archive is packed again in fixed order with fixed dates: equal sources give equal bytes.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

from pythonfmu.builder import FmuBuilder

import servocore as sc
from crane_fmu.build.compiled_step import compiled_steps
from crane_fmu.build.description import complete
from crane_fmu.build.page import documentation_page, user_page
from crane_fmu.build.shim import add_shim
from crane_fmu.catalogue.kinds import FORMULATIONS, KINDS, ROTARY_CRANE, Kind, Progress
from crane_fmu.slave.base import INTERFACE_FILE
from crane_fmu.slave.interface import Interface
from crane_fmu.slave.trajectory import PATH_FILE
from servocore.writing import write_together

__all__ = ["FORMULATIONS", "build_fmu", "collect", "interface", "main", "packed"]

_HERE = Path(__file__).parent
_PYTHONFMU_SOURCES = ("_version", "default_experiment", "enums", "fmi2slave", "logmsg", "variables")
_CHECK_SECONDS = 300.0
_PREFIX = "rotary_crane_"

_ENTRY = '''"""Entry of the FMU. PythonFMU executes it once more for every instance."""

import ctypes as _ctypes

try:
    import {bundle}.crane_fmu.{module} as _slave
except ImportError as error:
    raise ImportError(
        f"{name}.fmu needs NumPy and CasADi in the Python that runs it, but: {{error}};"
        " install what resources/requirements.txt in the FMU lists"
    ) from error

# For every instance PythonFMU 0.7 gives away a reference to this module's names that it does not own; without one
# more each time, they would be destroyed when none is left, and a later instance would find an empty module.
_ctypes.pythonapi.Py_IncRef(_ctypes.py_object(globals()))


class {name}(_slave.{slave}):
    """What the host sees; everything else is in the bundle."""
'''


@dataclass(frozen=True)
class Content:
    """What goes into an FMU.

    Attributes
    ----------
    files : mapping of str to str
        Texts of the bundle by their path inside it.
    interface : Interface
        The table of variables.
    kind : Kind
        Which FMU it is.
    path : bytes, optional
        A table for a trajectory, which is no part of the bundle: users may replace it.
    """

    files: Mapping[str, str]
    interface: Interface
    kind: Kind = ROTARY_CRANE
    path: bytes | None = None

    @property
    def name(self) -> str:
        """Name of the entry module, unique to the content."""
        digest = hashlib.sha256(f"{self.kind.name}{_ENTRY}{metadata.version('pythonfmu')}".encode())
        for path, text in sorted(self.files.items()):
            digest.update(f"{path}\0{text}\0".encode())
        return f"{_PREFIX}{digest.hexdigest()[:16]}"

    @property
    def bundle(self) -> str:
        """Name of the package with everything else."""
        return f"{self.name}_bundle"


def build_fmu(
    directory: Path, progress: Progress | None = None, kind: Kind = ROTARY_CRANE, path: bytes | None = None
) -> Path:
    """Build an FMU, check it in a process of its own and only then rename it into place.

    Parameters
    ----------
    directory : Path
        Where it goes; made if it does not exist.
    progress : callable, optional
        Called with a phrase for every stage.
    kind : Kind
        Which FMU.
    path : bytes, optional
        A table that a trajectory carries, as CSV.

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
    tell = progress or (lambda _: None)
    directory = Path(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise sc.InvalidSetting(f"cannot make the folder {directory}: {error.strerror or error}") from error
    content = replace(collect(tell) if kind is ROTARY_CRANE else collect(tell, kind), path=path)
    tell(f"packing {kind.file_name}")
    archive = packed(content, tell)
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        candidate = Path(folder) / kind.file_name
        candidate.write_bytes(archive)
        tell(f"checking {kind.file_name} in a process of its own")
        _check(candidate, kind)
    target = directory / kind.file_name
    write_together({target: archive})
    return target


def collect(tell: Progress = lambda _: None, kind: Kind = ROTARY_CRANE) -> Content:
    """Compile what an FMU runs on and gather the sources that its slave needs."""
    files = {
        "__init__.py": f'"""What {kind.file_name} runs on."""\n',
        "crane_fmu/__init__.py": "",
        "servocore/__init__.py": kind.face,
    }
    files |= {f"crane_fmu/slave/{name}.py": _text(_HERE.parent / "slave" / f"{name}.py") for name in kind.own_sources}
    servocore = Path(sc.__file__).parent
    for name in kind.servocore_sources:
        for file in sorted((servocore / name).glob("*.py")) or [servocore / f"{name}.py"]:
            files[f"servocore/{file.relative_to(servocore).as_posix()}"] = _text(file)
    files |= kind.compiled(tell)
    table = kind.interface()
    files[INTERFACE_FILE] = table.to_json()
    return Content(files, table, kind)


def interface() -> Interface:
    """Return the table of the inverse model's variables."""
    return ROTARY_CRANE.interface()


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def packed(content: Content, tell: Progress = lambda _: None) -> bytes:
    """Return the archive: PythonFMU's, completed and reproducible."""
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        raw = _packed_by_pythonfmu(content, Path(folder))
    notes = {name: metadata.version(name) for name in ("casadi", "pythonfmu")}
    members = _rearranged(raw, content.bundle)
    members["modelDescription.xml"] = complete(members["modelDescription.xml"], content.interface, notes)
    members["resources/requirements.txt"] = "\n".join([*requirements(), ""]).encode()
    members["documentation/index.html"] = documentation_page(
        user_page(content.interface, content.kind.template), content.kind.file_name
    ).encode()
    members["documentation/licenses/pythonfmu.txt"] = _licence("pythonfmu")
    programs = {name: content.files[name] for name in content.kind.to_machine_code if name in content.files}
    for name, library in compiled_steps(programs, tell).items():
        members[f"resources/{content.bundle}/{Path(name).with_suffix('.so')}"] = library
    if content.path is not None:
        members[f"resources/{PATH_FILE}"] = content.path
    members["model.png"] = (_HERE / "resources" / "model.png").read_bytes()
    return zipped(_for_native_hosts(members, tell))


def _for_native_hosts(members: dict[str, bytes], tell: Progress) -> dict[str, bytes]:
    """Add the library that opens Python, where it can be compiled."""
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        touched = [name for name in members if name.startswith("binaries/") or name == "modelDescription.xml"]
        for name in touched:
            (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            (Path(folder) / name).write_bytes(members[name])
        if not add_shim(Path(folder), tell):
            return members
        binaries = {
            each.relative_to(folder).as_posix(): each.read_bytes() for each in Path(folder, "binaries").glob("*/*")
        }
    return {**members, **binaries}


def _licence(package: str) -> bytes:
    """Return the terms under which a package's files may be passed on."""
    found = [file for file in metadata.files(package) or () if file.name.upper().startswith("LICENSE")]
    if not found:
        raise sc.ServocoreError(f"the installed {package} has no licence file to pass on with the FMU")
    return found[0].read_binary()


def requirements() -> tuple[str, ...]:
    """Return what the host's Python must have: CasADi reads functions that it, or an older version, has saved."""
    return "numpy>=1.26", f"casadi>={metadata.version('casadi')}"


def _packed_by_pythonfmu(content: Content, folder: Path) -> dict[str, bytes]:
    """Stage the bundle, let PythonFMU pack it and return the members of its archive."""
    bundle = folder / content.bundle
    for path, text in content.files.items():
        target = bundle / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(_privately(text, content.bundle) if path.endswith(".py") else text, encoding="utf-8")
    entry = folder / f"{content.name}.py"
    entry.write_text(
        _ENTRY.format(
            bundle=content.bundle, name=content.kind.name, module=content.kind.module, slave=content.kind.slave
        ),
        encoding="utf-8",
    )
    options = {"canGetAndSetFMUstate": True, "canSerializeFMUstate": True}
    with _no_traces():
        archive = FmuBuilder.build_FMU(entry, folder / content.kind.file_name, project_files=[bundle], **options)
    with zipfile.ZipFile(archive) as packed_members:
        return {name: packed_members.read(name) for name in packed_members.namelist()}


def _privately(source: str, bundle: str, packages: str = "crane_fmu|servocore") -> str:
    """Let a source import `packages` from the bundle."""
    return re.sub(rf"^(\s*)from ({packages})\b", rf"\1from {bundle}.\2", source, flags=re.MULTILINE)


@contextmanager
def _no_traces() -> Iterator[None]:
    """Undo what PythonFMU's builder leaves behind: its search path and the modules of the FMU.

    Modules that an FMU of the same content has left in this process are dropped first: the builder would take them
    for those it packs, and find no slave that is its own.
    """
    search_path, write_bytecode = list(sys.path), sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    _forget_modules()
    try:
        yield
    finally:
        sys.path[:] = search_path
        sys.dont_write_bytecode = write_bytecode
        _forget_modules()


def _forget_modules() -> None:
    for name in [each for each in sys.modules if each.startswith(_PREFIX)]:
        del sys.modules[name]


def _rearranged(members: Mapping[str, bytes], bundle: str) -> dict[str, bytes]:
    """Move PythonFMU's own modules into the bundle, those that are needed, and import them from there."""
    kept = {f"resources/pythonfmu/{name}.py": f"resources/{bundle}/pythonfmu/{name}.py" for name in _PYTHONFMU_SOURCES}
    result = {f"resources/{bundle}/pythonfmu/__init__.py": b""}
    for name, data in members.items():
        if name in kept:
            result[kept[name]] = data
        elif name.endswith(".py") and name.startswith(f"resources/{bundle}/"):
            result[name] = _privately(data.decode(), bundle, "pythonfmu").encode()
        elif not name.startswith("resources/pythonfmu/"):
            result[name] = data
    return result


def zipped(members: Mapping[str, bytes], first: str = "modelDescription.xml") -> bytes:
    """Pack with fixed order, dates and rights."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(members, key=lambda each: (each != first, each)):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, members[name])
    return stream.getvalue()


def _check(file: Path, kind: Kind) -> None:
    script = _HERE / "resources" / "check_fmu.py"
    command = [sys.executable, "-I", str(script), str(file), json.dumps(kind.runs), json.dumps(kind.rest)]
    try:
        done = subprocess.run(
            command, cwd=file.parent, capture_output=True, text=True, timeout=_CHECK_SECONDS, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise sc.ServocoreError(f"the FMU did not finish its check in {_CHECK_SECONDS:g} s") from error
    if done.returncode:
        why = (done.stderr or done.stdout).strip() or f"the process ended with {done.returncode}"
        raise sc.ServocoreError(f"the FMU was built but failed its check, so it was not written: {why}")


def main(arguments: list[str] | None = None) -> int:
    """Run the command ``python build_fmu.py``; returns its exit code."""
    parser = argparse.ArgumentParser(prog="build_fmu.py", description=f"Build {ROTARY_CRANE.file_name} and check it.")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path(), metavar="DIR", help="where it goes (default: here)"
    )
    parser.add_argument("--fmu", choices=KINDS, default=ROTARY_CRANE.name, help="which one (default: %(default)s)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="only write the user page, as Markdown")
    chosen = parser.parse_args(arguments)
    kind = KINDS[chosen.fmu]
    try:
        if chosen.page:
            write_together({chosen.page: user_page(kind.interface(), kind.template).encode()})
            return 0
        file = build_fmu(chosen.output, lambda stage: print(f"{stage} ...", file=sys.stderr), kind)
    except sc.ServocoreError as error:
        print(f"build_fmu.py: {error}", file=sys.stderr)
        return 2
    print(file)
    return 0
