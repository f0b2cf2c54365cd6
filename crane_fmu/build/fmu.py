"""Build a PythonFMU: compile the models, pack a slave around the native FMU of the same kind, check, put in place.

All FMUs of one Python process share its modules. The sources in an FMU are therefore a package whose name contains a
hash of its content: different builds do not collide, nor with an installed servocore. The order and the dates of the
members are fixed: equal sources give equal bytes.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from importlib import import_module, metadata
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree as ET

import servocore as sc
from crane_fmu.build.native import OF_PYTHONFMU, native_fmu
from crane_fmu.build.page import documentation_page
from crane_fmu.catalogue import NO_STARTS, ROTARY_CRANE, FmuKind, Starts
from crane_fmu.files import put
from crane_fmu.run import nothing_left
from servocore.export.targets import HOST, chosen_targets, host, libraries
from servocore.files import made_folder, require_writable, write_together, xml_document, zipped

USUAL_TARGETS = "host,x86_64-windows"
"""Platforms that an FMU is built for by default."""

_HERE = Path(__file__).parent
_CHECK_SECONDS = 300.0

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
        If the folder cannot be made or written, or this machine is not among the platforms.
    ServocoreError
        If the FMU fails its check.
    """
    import_module("pythonfmu")  # fails before the compilation if it is not installed
    if host() not in chosen_targets(targets or USUAL_TARGETS, 2):
        raise sc.InvalidSetting(f"the FMU is checked on this machine, {host()}: have {HOST} among its platforms")
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


def _check(archive: bytes, kind: FmuKind, starts: Starts) -> None:
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        put(Path(folder), {kind.file_name: archive})
        script = str(_HERE / "resources" / "check_fmu.py")
        command = [sys.executable, "-I", script, kind.file_name, json.dumps(kind.runs_with(starts))]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=_CHECK_SECONDS, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise sc.ServocoreError(f"the FMU did not finish its check in {_CHECK_SECONDS:g} s") from error
    if done.returncode:
        reason = (done.stderr or done.stdout).strip() or f"the process ended with {done.returncode}"
        raise sc.ServocoreError(f"the FMU was built but failed its check, so it was not written: {reason}")


# The archive ----------------------------------------------------------------------------------------------------------


def packed(native: bytes, kind: FmuKind) -> bytes:
    """Return the archive of an FMU whose slave forwards its calls to the libraries of a native one.

    Parameters
    ----------
    native : bytes
        The archive of the native FMU.
    kind : FmuKind
        Which FMU it is.
    """
    with zipfile.ZipFile(io.BytesIO(native)) as archive:
        given = {name: archive.read(name) for name in archive.namelist()}
    description = given["modelDescription.xml"]
    token = ET.fromstring(description).get("guid", "")
    behind = {name.removeprefix("binaries/"): each for name, each in given.items() if name.startswith("binaries/")}
    entry, files = _staged(kind, token, behind)
    members = _packed_by_pythonfmu(kind, entry, files)
    notes = {name: metadata.version(name) for name in ("casadi", "pythonfmu")}
    licence = next(each for each in metadata.files("pythonfmu") or () if each.name.upper().startswith("LICENSE"))
    members |= {
        "modelDescription.xml": _wrapped(description, kind.name, notes),
        "documentation/index.html": documentation_page(kind, native).encode(),
        "documentation/licenses/pythonfmu.txt": licence.read_binary(),
        "model.png": (_HERE / "resources" / "model.png").read_bytes(),
    }
    of_linux = [path for path in behind if path.startswith("linux64/")]
    if of_linux:
        # Hosts that are not Python run the FMU too: their calls go to the native library, see `shim.c`.
        library = next(f"../../resources/{name}" for name in files if name.endswith(of_linux[0]))
        # In Python processes it loads PythonFMU's own binary.
        texts = {"FMU_GUID": token, "REAL_BINARY": "pythonfmu.so", "LIBRARY": library}
        sources = {Path(name).name: text.decode() for name, text in given.items() if re.search(r"/fmi2\w+\.h$", name)}
        sources["shim.c"] = (_HERE / "shim.c").read_text(encoding="utf-8")
        sources["shim_config.h"] = "".join(f'#define {name} "{text}"\n' for name, text in texts.items())
        ((place, built),) = libraries(sources, ["shim.c"], kind.name, ["x86_64-linux"], 2).items()
        members[f"{Path(place).parent.as_posix()}/{texts['REAL_BINARY']}"] = members[place]
        members[place] = built.content
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


def _wrapped(native: bytes, name: str, notes: Mapping[str, str]) -> bytes:
    """Return a native FMU's model description, changed for PythonFMU; notes become a vendor annotation.

    Outputs change in doStep only: there is no direct feedthrough, and there are no directional derivatives.
    """
    root = ET.fromstring(native)
    root.attrib |= {
        "modelName": name,
        "generationTool": f"{root.get('generationTool')} with PythonFMU {notes['pythonfmu']}",
    }
    root.set("guid", root.get("guid", "").strip("{}"))  # as PythonFMU writes it
    (simulation,) = root.iter("CoSimulation")
    simulation.attrib |= {"modelIdentifier": name, "needsExecutionTool": "true"}
    simulation.attrib.pop("providesDirectionalDerivative", None)
    for sources in simulation.findall("SourceFiles"):
        simulation.remove(sources)
    for unknown in root.iterfind("ModelStructure/Outputs/Unknown"):
        unknown.attrib |= {"dependencies": "", "dependenciesKind": ""}
    annotations = ET.Element("VendorAnnotations")
    ET.SubElement(ET.SubElement(annotations, "Tool", name="servocore"), "Build", dict(notes))
    root.insert([child.tag for child in root].index("DefaultExperiment") + 1, annotations)
    return xml_document(root)
