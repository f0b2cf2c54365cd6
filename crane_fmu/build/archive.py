"""The archive of an FMU: PythonFMU's, completed, rearranged and reproducible.

All FMUs of one Python process share its modules, so the bundled sources become one package whose name holds a hash of
all its content: builds never meet each other, nor an installed servocore. The archive is packed again in fixed order
with fixed dates: equal sources give equal bytes.
"""

from __future__ import annotations

import io
import re
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

from pythonfmu.builder import FmuBuilder

import servocore as sc
from crane_fmu.build.bundle import PREFIX, Content, Progress
from crane_fmu.build.description import wrapped
from crane_fmu.build.page import documentation_page
from crane_fmu.build.shim import with_shim
from crane_fmu.files import put
from crane_fmu.run import nothing_left

_ICON = Path(__file__).parent / "resources" / "model.png"
_PYTHONFMU_SOURCES = ("_version", "default_experiment", "enums", "fmi2slave", "logmsg", "variables")


def packed(content: Content, tell: Progress = lambda _: None) -> bytes:
    """Return the archive with everything that belongs into it."""
    members = _rearranged(_packed_by_pythonfmu(content), content.bundle)
    notes = {name: metadata.version(name) for name in ("casadi", "pythonfmu")}
    members |= {
        "modelDescription.xml": wrapped(content.native, content.kind.name, notes),
        "documentation/index.html": documentation_page(content.kind).encode(),
        "documentation/licenses/pythonfmu.txt": _licence("pythonfmu"),
        "model.png": _ICON.read_bytes(),
    }
    return zipped(with_shim(members, content.kind.name, content.token, tell))


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


def _licence(package: str) -> bytes:
    """Return the terms under which a package's files may be passed on."""
    found = [file for file in metadata.files(package) or () if file.name.upper().startswith("LICENSE")]
    if not found:
        raise sc.ServocoreError(f"the installed {package} has no licence file to pass on with the FMU")
    return found[0].read_binary()


def _packed_by_pythonfmu(content: Content) -> dict[str, bytes]:
    """Stage the bundle, let PythonFMU pack it and return the members of its archive."""
    with _no_traces(), tempfile.TemporaryDirectory(prefix="crane_fmu_") as scratch:
        folder = Path(scratch)
        put(folder, content.files)
        archive = FmuBuilder.build_FMU(
            folder / f"{content.name}.py",
            folder / content.kind.file_name,
            project_files=[folder / content.bundle],
            canGetAndSetFMUstate=True,
            canSerializeFMUstate=True,
        )
        with zipfile.ZipFile(archive) as members:
            return {name: members.read(name) for name in members.namelist()}


def _privately(source: str, bundle: str) -> str:
    """Let a source import PythonFMU from the bundle."""
    return re.sub(r"^(\s*)from pythonfmu\b", rf"\1from {bundle}.pythonfmu", source, flags=re.MULTILINE)


@contextmanager
def _no_traces() -> Iterator[None]:
    """Keep what PythonFMU's builder imports and writes out of this process and of the bundle.

    Modules that an FMU of the same content has left in this process are dropped first: the builder would take them
    for those it packs, and find no slave that is its own.
    """
    for name in [module for module in sys.modules if module.startswith(PREFIX)]:
        del sys.modules[name]
    write_bytecode = sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    try:
        with nothing_left():
            yield
    finally:
        sys.dont_write_bytecode = write_bytecode


def _rearranged(members: Mapping[str, bytes], bundle: str) -> dict[str, bytes]:
    """Move PythonFMU's own modules into the bundle, those that are needed, and import them from there."""
    kept = {f"resources/pythonfmu/{name}.py": f"resources/{bundle}/pythonfmu/{name}.py" for name in _PYTHONFMU_SOURCES}
    result = {f"resources/{bundle}/pythonfmu/__init__.py": b""}
    for name, data in members.items():
        if name in kept:
            result[kept[name]] = data
        elif name.endswith(".py") and name.startswith(f"resources/{bundle}/"):
            result[name] = _privately(data.decode(), bundle).encode()
        elif not name.startswith("resources/pythonfmu/"):
            result[name] = data
    return result
