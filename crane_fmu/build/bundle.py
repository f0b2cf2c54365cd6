"""What goes into an FMU: the sources that its slave imports, compiled functions, the table of variables.

Nobody lists the sources: they are found by following the slave's imports, in this package as in servocore. A package
travels without its own ``__init__``, which may import what the host lacks; the FMU gets one that offers those names
only that are asked of it.
"""

from __future__ import annotations

import ast
import hashlib
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree as ET

import servocore as sc
from crane_fmu.build.compiled_step import compiled_feedback, compiled_steps
from crane_fmu.build.estimates import estimate_functions
from crane_fmu.build.feedback_law import LAW_MODEL, feedback_functions, feedback_text
from crane_fmu.build.native import NativeWishes, native_fmu
from crane_fmu.catalogue import FORMULATIONS, ROTARY_CRANE, FmuKind
from crane_fmu.slave.interface import FEEDBACK_FILE, INTERFACE_FILE, Interface, program_file
from crane_fmu.slave.kernel import LIBRARIES

Progress = Callable[[str], None]
"""Called with what is being done."""

USUAL_TARGETS = "host,x86_64-windows"
"""Platforms whose libraries an FMU has where nothing else is asked for."""

PREFIX = "rotary_crane_"
"""How the names of all entry modules begin."""

_OURS = ("crane_fmu", "servocore")

_ENTRY = '''"""Entry of the FMU. PythonFMU executes it once more for every instance."""

import ctypes as _ctypes

try:
    import {bundle}.crane_fmu.slave.{module} as _slave
except ImportError as error:
    raise ImportError(
        f"{name}.fmu needs {packages} in the Python that runs it, but: {{error}};"
        " install what resources/requirements.txt in the FMU lists"
    ) from error

# For every instance PythonFMU 0.7 gives away a reference to this module's names that it does not own; without one
# more each time, they would be destroyed when none is left, and a later instance would find an empty module.
_ctypes.pythonapi.Py_IncRef(_ctypes.py_object(globals()))


class {name}(_slave.Slave):
    """What the host sees; everything else is in the bundle."""
{more}'''


@dataclass(frozen=True)
class Content:
    """What goes into an FMU.

    Attributes
    ----------
    files : mapping of str to str
        Texts of the bundle by their path inside it.
    interface : Interface
        The table of variables.
    kind : FmuKind
        Which FMU it is.
    libraries : mapping of str to bytes
        Machine code, by its path in the bundle.
    native : bytes
        The model description of the native FMU that it hands its calls to; empty where it computes by itself.
    """

    files: Mapping[str, str]
    interface: Interface
    kind: FmuKind
    libraries: Mapping[str, bytes]
    native: bytes = b""

    @property
    def name(self) -> str:
        """Name of the entry module, unique to the content."""
        digest = hashlib.sha256(f"{self.kind.name}{_ENTRY}{metadata.version('pythonfmu')}".encode())
        for path, text in sorted(self.files.items()):
            digest.update(f"{path}\0{text}\0".encode())
        digest.update(self.native)
        return f"{PREFIX}{digest.hexdigest()[:16]}"

    @property
    def bundle(self) -> str:
        """Name of the package with everything else."""
        return f"{self.name}_bundle"

    @property
    def entry(self) -> str:
        """Source of the entry module."""
        more = f"    token = {self.token!r}\n" if self.native else ""
        names = {"bundle": self.bundle, "name": self.kind.name, "module": self.kind.module}
        return _ENTRY.format(**names, packages=self.kind.needs, more=more)

    @property
    def token(self) -> str:
        """What host and binary have to agree upon."""
        return ET.fromstring(self.native).get("guid", "") if self.native else self.interface.guid


def collect(
    kind: FmuKind = ROTARY_CRANE, tell: Progress = lambda _: None, wishes: NativeWishes | None = None
) -> Content:
    """Compile what an FMU runs on and gather the sources that its slave needs."""
    wishes = wishes or NativeWishes()
    if not kind.routes:
        return _wrapping(kind, tell, wishes)
    table = kind.interface().with_starts(wishes.starts)
    files = {
        "__init__.py": f'"""What {kind.file_name} runs on."""\n',
        **travelling(f"crane_fmu.slave.{kind.module}"),
        **_compiled(kind, tell),
        INTERFACE_FILE: table.to_json(),
    }
    programs = [program_file(*route) for route in kind.to_machine_code]
    libraries = compiled_steps({name: files[name] for name in programs}, tell)
    if kind.has_feedback:
        tell("compiling feedback and estimation")
        law = feedback_functions(sc.scenes.rotary_crane().model(LAW_MODEL))
        carried = law | estimate_functions(len(table.of("output")))
        files[FEEDBACK_FILE] = feedback_text(carried)
        libraries |= compiled_feedback(carried, tell)
    return Content(files, table, kind, libraries)


def _wrapping(kind: FmuKind, tell: Progress, wishes: NativeWishes) -> Content:
    """Take the libraries of a native FMU; its own platform is always among them, for the slave is tried here."""
    targets = wishes.targets or USUAL_TARGETS
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        file = native_fmu(Path(folder), kind, replace(wishes, targets=targets, judged_late=True), tell)
        with zipfile.ZipFile(file) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    files = {"__init__.py": f'"""What {kind.file_name} runs on."""\n', **travelling(f"crane_fmu.slave.{kind.module}")}
    place = f"crane_fmu/slave/{LIBRARIES}"
    libraries = {f"{place}/{n.removeprefix('binaries/')}": m for n, m in members.items() if n.startswith("binaries/")}
    table = kind.interface().with_starts(wishes.starts)
    return Content(files, table, kind, libraries, members["modelDescription.xml"])


def _compiled(kind: FmuKind, tell: Progress) -> dict[str, str]:
    """Return programs as texts by file name."""
    crane, files = sc.scenes.rotary_crane(), {}
    for model, formulation in kind.routes:
        tell(f"compiling {model}, {formulation}")
        stepper = sc.Stepper(crane, FORMULATIONS[formulation], sc.BackwardEuler(), 0.1, model)
        files[program_file(model, formulation)] = stepper.program.to_json()
    return files


# What travels --------------------------------------------------------------------------------------------------------


def travelling(module: str) -> dict[str, str]:
    """Return the sources of a module and of all that it imports of this project, by their path in the bundle."""
    sources: dict[str, str] = {}
    faces: dict[str, dict[str, str]] = {}  # of packages: where each name comes from
    waiting = [module]
    while waiting:
        module = waiting.pop()
        path = f"{module.replace('.', '/')}.py"
        if path in sources:
            continue
        sources[path] = _source(module)
        parts = module.split(".")
        for depth in range(1, len(parts)):
            faces.setdefault(".".join(parts[:depth]), {})
        for imported, names in _imports(sources[path]):
            if not _is_package(imported):
                waiting.append(imported)
                continue
            for name in names:
                home = _home(imported, name)
                if home is None:  # a module of the package
                    waiting.append(f"{imported}.{name}")
                else:
                    waiting.append(home)
                    faces.setdefault(imported, {})[name] = home
    for package, offered in faces.items():
        lines = [f"from {home} import {name}\n" for name, home in sorted(offered.items())]
        sources[f"{package.replace('.', '/')}/__init__.py"] = "".join(lines)
    return sources


def _imports(source: str, later: bool = False) -> Iterator[tuple[str, list[str]]]:
    """Yield modules of this project, and the names taken from each, that a source imports when it runs.

    With `later`, also what it imports for types alone: there a face says where the names are that it offers later.
    """
    tree = ast.parse(source)
    for_types = {
        node
        for branch in ast.walk(tree)
        if isinstance(branch, ast.If) and ast.unparse(branch.test) == "TYPE_CHECKING"
        for node in ast.walk(branch)
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or node.module is None or (node in for_types and not later):
            continue
        if node.module.split(".")[0] in _OURS:
            yield node.module, [alias.name for alias in node.names]


def _home(package: str, name: str) -> str | None:
    """Return the module in which a name that a package offers is written down; None if it offers no such name."""
    for imported, names in _imports(_source(package), later=True):
        if name in names:
            return _home(imported, name) if _is_package(imported) else imported
    return None


def _is_package(module: str) -> bool:
    return _file(module).name == "__init__.py"


def _source(module: str) -> str:
    return _file(module).read_text(encoding="utf-8")


def _file(module: str) -> Path:
    found = find_spec(module)
    if found is None or found.origin is None:
        raise sc.ServocoreError(f"there is no module {module} to take into an FMU")
    return Path(found.origin)
