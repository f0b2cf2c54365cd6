"""Build a PythonFMU: compile the models, pack a slave around the native FMU of the same kind, check, put in place.

All FMUs of one Python process share its modules. The sources in an FMU are therefore a package whose name contains a
hash of its content: different builds do not collide, nor with an installed servocore. The order and the dates of the
members are fixed: equal sources give equal bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module, metadata
from pathlib import Path
from xml.etree import ElementTree as ET

import servocore as sc
from crane_fmu.build.native import OF_PYTHONFMU, native_model
from crane_fmu.build.page import documentation_page, user_page
from crane_fmu.catalogue import NO_STARTS, ROTARY_CRANE, FmuKind, Starts
from crane_fmu.files import put
from crane_fmu.run import nothing_left
from servocore.export.description import model_description
from servocore.export.native_model import NativeModel
from servocore.export.sources import HEADERS, compiled_files, fmu_sources, token_of
from servocore.export.targets import HOST, chosen_targets, host, libraries
from servocore.files import made_folder, require_writable, write_together, xml_document, zipped

USUAL_TARGETS = "host,x86_64-windows"
"""Platforms that an FMU is built for by default."""

_HERE = Path(__file__).parent
_CHECK = "import sys; from crane_fmu.run import check; check(*sys.argv[1:])"
_PATIENCE = 300.0  # s

PREFIX = "rotary_crane_"
"""Prefix of the names of all entry modules."""

_PYTHONFMU_SOURCES = ("_version", "default_experiment", "enums", "fmi2slave", "logmsg", "variables")
_ENTRY = '''"""Entry of the FMU. PythonFMU executes it once more for every instance."""

import ctypes as _ctypes

from {bundle} import kernel as _kernel

# For every instance PythonFMU 0.7 releases a reference to this module's namespace that it does not own. Without one
# more reference for each, the namespace would be destroyed, and a later instance would find an empty module.
_ctypes.pythonapi.Py_IncRef(_ctypes.py_object(globals()))


class {name}(_kernel.Slave):
    """The slave class; its code is in the bundle."""
    token = {token!r}
'''


def build_fmu(
    directory: Path,
    progress: Callable[[str], None] = lambda _: None,
    kind: FmuKind = ROTARY_CRANE,
    path: sc.Reference | None = None,
    starts: Starts = NO_STARTS,
    targets: str | None = None,
    drives: Mapping[str, sc.Drive] | None = None,
) -> Path:
    """Build an FMU, validate and run it with FMPy, and then write it.

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
    drives : mapping of str to Drive, optional
        Motors and transmissions of the crane.

    Returns
    -------
    Path
        The FMU.

    Raises
    ------
    InvalidSetting
        If the folder cannot be made or written, or this machine is not among the platforms.
    ServocoreError
        If the FMU fails its check.
    """
    import_module("pythonfmu")  # fails before the compilation if it is not installed
    platforms = chosen_targets(targets or USUAL_TARGETS, 2)
    if host() not in platforms:
        raise sc.InvalidSetting(f"the FMU is checked on this machine, {host()}: have {HOST} among its platforms")
    directory = Path(directory)
    target = directory / kind.file_name
    require_writable(directory, directory)
    with made_folder(directory, directory):
        model = native_model(kind, path, starts, drives, progress, OF_PYTHONFMU)
        archive = packed(model, kind, platforms, progress)
        progress(f"checking {kind.file_name}")
        _check(archive, kind, starts)
        write_together({target: archive})
    return target


def _check(archive: bytes, kind: FmuKind, starts: Starts) -> None:
    """Raise `ServocoreError` unless an FMU passes `crane_fmu.run.check`, in a process of its own.

    Native code that crashes ends that process alone, and one that hangs is ended.
    """
    failed = "the FMU was built but failed its check, so it was not written"
    with tempfile.TemporaryDirectory(prefix="crane_fmu_", ignore_cleanup_errors=True) as folder:
        put(Path(folder), {kind.file_name: archive})
        command = [sys.executable, "-c", _CHECK, str(Path(folder) / kind.file_name), json.dumps(kind.runs_with(starts))]
        search_path = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=_PATIENCE, check=False, env=os.environ | search_path
            )
        except subprocess.TimeoutExpired as error:
            raise sc.ServocoreError(f"{failed}: it did not end within {_PATIENCE:g} s") from error
    if done.returncode:
        reason = done.stderr.strip() or f"its library ended the process with code {done.returncode}"
        raise sc.ServocoreError(f"{failed}: {reason}")


# The archive ----------------------------------------------------------------------------------------------------------


def packed(
    model: NativeModel, kind: FmuKind, platforms: tuple[str, ...], progress: Callable[[str], None] = lambda _: None
) -> bytes:
    """Return the archive of an FMU whose slave forwards its calls to the libraries of a model.

    Parameters
    ----------
    model : NativeModel
        Of the native FMU of the same kind.
    kind : FmuKind
        Which FMU it is.
    platforms : tuple of str
        Platforms of the libraries.
    progress : callable
        Called with a phrase for every stage.
    """
    sources, token = fmu_sources(model, 2), token_of(model, 2)
    built = libraries(sources, compiled_files(model, 2), model.identifier, platforms, 2, progress, model.more_sources)
    progress(f"packing {kind.file_name}")
    behind = {place.removeprefix("binaries/"): each.content for place, each in built.items()}
    entry, files = _staged(kind, token, behind)
    members = _packed_by_pythonfmu(kind, entry, files)
    licence = next(each for each in metadata.files("pythonfmu") or () if each.name.upper().startswith("LICENSE"))
    members |= {
        "modelDescription.xml": _description(model, kind, token),
        "documentation/index.html": documentation_page(kind, user_page(kind, model)).encode(),
        "documentation/licenses/pythonfmu.txt": licence.read_binary(),
        "model.png": (_HERE / "resources" / "model.png").read_bytes(),
    }
    for name in [each for each in files if "/linux64/" in each]:
        # Hosts that are not Python run the FMU too: their calls go to the native library, see `shim.c`. In Python
        # processes it loads PythonFMU's own binary.
        texts = {"FMU_GUID": token, "REAL_BINARY": "pythonfmu.so", "LIBRARY": f"../../resources/{name}"}
        of_shim = {name: sources[name] for name in HEADERS[2]}
        of_shim["shim.c"] = (_HERE / "shim.c").read_text(encoding="utf-8")
        of_shim["shim_config.h"] = "".join(f'#define {key} "{text}"\n' for key, text in texts.items())
        ((place, shim),) = libraries(of_shim, ["shim.c"], kind.name, ["x86_64-linux"], 2).items()
        members[f"{Path(place).parent.as_posix()}/{texts['REAL_BINARY']}"] = members[place]
        members[place] = shim.content
    return zipped(members)


def _staged(kind: FmuKind, token: str, behind: Mapping[str, bytes]) -> tuple[str, dict[str, str | bytes]]:
    """Return the name of the entry module, unique to the content, and the files for PythonFMU: module and bundle."""
    from crane_fmu.slave import kernel  # noqa: PLC0415 - it needs PythonFMU, which native FMUs are built without

    slave = Path(kernel.__file__).read_text(encoding="utf-8")
    digest = hashlib.sha256(f"{kind.name}{_ENTRY}{metadata.version('pythonfmu')}{token}{slave}".encode())
    for path, library in sorted(behind.items()):
        digest.update(path.encode() + library)
    entry = f"{PREFIX}{digest.hexdigest()[:16]}"
    bundle = f"{entry}_bundle"
    return entry, {
        f"{entry}.py": _ENTRY.format(bundle=bundle, name=kind.name, token=token),
        f"{bundle}/__init__.py": f'"""The runtime of {kind.file_name}."""\n',
        f"{bundle}/kernel.py": slave,
        **{f"{bundle}/{kernel.LIBRARIES}/{path}": library for path, library in behind.items()},
    }


def _packed_by_pythonfmu(kind: FmuKind, entry: str, files: Mapping[str, str | bytes]) -> dict[str, bytes]:
    """Let PythonFMU pack an entry module and its bundle, and return the members of its archive.

    Modules that an FMU of the same content has left in this process are dropped first: the builder would import them
    in place of those that it packs, and find no slave. The required modules of PythonFMU are moved into the bundle, and
    imported from there.
    """
    from pythonfmu.builder import FmuBuilder  # noqa: PLC0415

    for name in [module for module in sys.modules if module.startswith(PREFIX)]:
        del sys.modules[name]
    with nothing_left(), tempfile.TemporaryDirectory(prefix="crane_fmu_") as scratch:
        folder = Path(scratch)
        put(folder, files)
        archive = FmuBuilder.build_FMU(
            folder / f"{entry}.py",
            folder / kind.file_name,
            project_files=[folder / f"{entry}_bundle"],
            canGetAndSetFMUstate=True,
            canSerializeFMUstate=True,
        )
        with zipfile.ZipFile(archive) as members:
            packed_files = {name: members.read(name) for name in members.namelist() if "__pycache__" not in name}
    home = f"resources/{entry}_bundle/"
    kept = {f"resources/pythonfmu/{name}.py": f"{home}pythonfmu/{name}.py" for name in _PYTHONFMU_SOURCES}
    result = {f"{home}pythonfmu/__init__.py": b""}
    for name, data in packed_files.items():
        if name.endswith(".py") and name.startswith(home):
            result[name] = re.sub(rb"(?m)^(\s*)from pythonfmu\b", rb"\1from %b_bundle.pythonfmu" % entry.encode(), data)
        elif name in kept or not name.startswith("resources/pythonfmu/"):
            result[kept.get(name, name)] = data
    return result


def _description(model: NativeModel, kind: FmuKind, token: str) -> bytes:
    """Return the model description: that of the native model, but without sources and directional derivatives."""
    notes = {name: metadata.version(name) for name in ("casadi", "pythonfmu")}
    about = replace(model.about, annotations={"servocore": notes})
    forwarded = replace(model, title=kind.name, identifier=kind.name, differentiable=False, about=about)
    root = ET.fromstring(model_description(forwarded, token.strip("{}"), 2))  # the GUID as PythonFMU writes it
    root.set("generationTool", f"{root.get('generationTool')} with PythonFMU {notes['pythonfmu']}")
    (simulation,) = root.iter("CoSimulation")
    simulation.set("needsExecutionTool", "true")
    for sources in simulation.findall("SourceFiles"):
        simulation.remove(sources)
    return xml_document(root)
