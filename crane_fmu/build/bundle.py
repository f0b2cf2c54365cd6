"""What goes into an FMU: its slave, and the libraries and the model description of the native FMU of the same kind."""

from __future__ import annotations

import hashlib
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree as ET

from crane_fmu.build.native import NativeWishes, native_fmu
from crane_fmu.catalogue import ROTARY_CRANE, FmuKind
from crane_fmu.slave import kernel

Progress = Callable[[str], None]
"""Called with what is being done."""

USUAL_TARGETS = "host,x86_64-windows"
"""Platforms whose libraries an FMU has where nothing else is asked for."""

PREFIX = "rotary_crane_"
"""How the names of all entry modules begin."""

_ENTRY = '''"""Entry of the FMU. PythonFMU executes it once more for every instance."""

import ctypes as _ctypes

from {bundle} import kernel as _kernel

# For every instance PythonFMU 0.7 gives away a reference to this module's names that it does not own; without one
# more each time, they would be destroyed when none is left, and a later instance would find an empty module.
_ctypes.pythonapi.Py_IncRef(_ctypes.py_object(globals()))


class {name}(_kernel.Slave):
    """What the host sees; everything else is in the bundle."""
    token = {token!r}
'''


@dataclass(frozen=True)
class Content:
    """What goes into an FMU.

    Attributes
    ----------
    slave : str
        Source of the slave.
    libraries : mapping of str to bytes
        Those of the native FMU, by platform and file name.
    native : bytes
        Its model description.
    kind : FmuKind
        Which FMU it is.
    """

    slave: str
    libraries: Mapping[str, bytes]
    native: bytes
    kind: FmuKind

    @property
    def name(self) -> str:
        """Name of the entry module, unique to the content."""
        digest = hashlib.sha256(f"{self.kind.name}{_ENTRY}{metadata.version('pythonfmu')}{self.slave}".encode())
        for part in (
            self.native,
            *(each for item in sorted(self.libraries.items()) for each in (item[0].encode(), item[1])),
        ):
            digest.update(part)
        return f"{PREFIX}{digest.hexdigest()[:16]}"

    @property
    def bundle(self) -> str:
        """Name of the package with everything else."""
        return f"{self.name}_bundle"

    @property
    def token(self) -> str:
        """What host and binary have to agree upon."""
        return ET.fromstring(self.native).get("guid", "")

    @property
    def files(self) -> dict[str, str | bytes]:
        """What PythonFMU packs, by path: the entry module and its bundle."""
        entry = _ENTRY.format(bundle=self.bundle, name=self.kind.name, token=self.token)
        libraries = {f"{self.bundle}/{kernel.LIBRARIES}/{path}": each for path, each in self.libraries.items()}
        about = f'"""What {self.kind.file_name} runs on."""\n'
        return {
            f"{self.name}.py": entry,
            f"{self.bundle}/__init__.py": about,
            f"{self.bundle}/kernel.py": self.slave,
            **libraries,
        }


def collect(
    kind: FmuKind = ROTARY_CRANE, tell: Progress = lambda _: None, wishes: NativeWishes | None = None
) -> Content:
    """Build the native FMU of a kind and take its libraries; its own platform is among them, for it is tried here."""
    wishes = wishes or NativeWishes()
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        late = replace(wishes, targets=wishes.targets or USUAL_TARGETS, judged_late=True)
        with zipfile.ZipFile(native_fmu(Path(folder), kind, late, tell)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    libraries = {name.removeprefix("binaries/"): each for name, each in members.items() if name.startswith("binaries/")}
    source = Path(kernel.__file__).read_text(encoding="utf-8")
    return Content(source, libraries, members["modelDescription.xml"], kind)
