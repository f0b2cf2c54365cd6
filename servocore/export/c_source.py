"""`export_c`: a scene's inverse model as C source for hosts without FMI."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import casadi as ca

from servocore.errors import InvalidSetting
from servocore.export.building import inverse_model
from servocore.export.c_functions import c_source, operations, scratch_of
from servocore.export.inverse_functions import METHOD
from servocore.export.native_model import NativeModel, identifier_of
from servocore.export.sources import SHARED, rendered, tables
from servocore.export.targets import host, libraries
from servocore.export.variables import INTERNAL_STEP
from servocore.files import made_folder, require_writable, write_together
from servocore.model.scene import Scene
from servocore.numerics.newton import MAX_ITERATIONS

_NAMES = ("main.c", "CMakeLists.txt", "README.md")  # besides those named after the scene
_CALLED = ("quick", "begin", "advance")  # those of them that exist; only FMUs have derivatives


def export_c(scene: Scene, folder: str | Path, *, model: str | None = None) -> Path:
    """Write the inverse model of a scene as C source, with an example, a CMake file and a page.

    Parameters
    ----------
    scene : Scene
        With its parameter values.
    folder : str or Path
        A new folder, or one with C source of this scene, which is overwritten.
    model : str, optional
        Model of the scene; its smallest when not given.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InvalidModel, InvalidReference
        As `export_fmu`.
    InvalidSetting
        If the folder cannot be written, or contains other files of these names.
    """
    place = Path(folder)
    require_folder(scene, place)
    files = c_files(inverse_model(scene, model))
    with made_folder(place, place):
        write_together({place / name: text for name, text in files.items()})
    return place


def require_folder(scene: Scene, place: Path) -> None:
    """Raise `InvalidSetting` if C source of a scene cannot be written there, or other files would be overwritten."""
    require_writable(place, place)
    if not place.parent.exists():
        raise InvalidSetting(f"cannot write {place}: there is no folder {place.parent}; make it first")
    lost = [name for name in _NAMES if (place / name).exists()]
    if lost and not (place / f"{identifier_of(scene.name)}.h").exists():
        raise InvalidSetting(f"cannot write to {place}: its {', '.join(lost)} would be lost; name a new folder")


def runtime(
    model: NativeModel, more: Mapping[str, ca.Function] = MappingProxyType({})
) -> tuple[dict[str, str], dict[str, Any]]:
    """Return header and source by file name, with more functions in the mathematics, and the values in them."""
    functions = {name: each for name, each in model.functions.items() if name in _CALLED} | dict(more)
    source = c_source(f"{model.identifier}_mathematics", functions.values())[1]
    path = (SHARED / "path.h").read_text(encoding="utf-8")  # without the lines that make it a header
    values = tables(model) | {
        "parameter_list": [variable for variable in model.of("parameter") if variable.name != INTERNAL_STEP],
        "rest": [start for variable in model.of("input") for start in variable.starts],
        "functions": functions,
        "scratch": scratch_of(functions.values()),
        "method": METHOD.name if model.of("local") else "",
        "path_source": path[path.index("/* Continue a path") : path.rindex("#endif")].rstrip(),
        "mathematics_source": source,
    }
    return {f"{model.identifier}.{ending}": rendered(f"source.{ending}.j2", **values) for ending in "hc"}, values


def c_files(model: NativeModel) -> dict[str, str]:
    """Return all texts by file name."""
    texts, values = runtime(model)
    functions, source = values["functions"], values["mathematics_source"]
    usual = "quick" if "quick" in functions else "advance" if "advance" in functions else "begin"
    longest = "advance" if "advance" in functions else "begin"  # `quick` is followed by it where it fails
    page = values | {
        "operations": operations(functions[usual], at_most=False),
        "most_operations": sum(operations(functions[each], at_most=True) for each in {usual, longest}),
        "most_iterations": MAX_ITERATIONS,
        "blocks": source.count("casadi_newton(&") // 2,  # each has a fast and a damped loop
        "memory_bytes": _memory_bytes(model, values["scratch"]),
        "measured": _measured(texts, model.identifier),
    }
    return {
        **{name: model.about.notice + text for name, text in texts.items()},
        "main.c": model.about.notice + rendered("main.c.j2", **values),
        "CMakeLists.txt": rendered("CMakeLists.txt.j2", **values),
        "README.md": rendered("README.md.j2", **page),
    }


def _memory_bytes(model: NativeModel, scratch: Mapping[str, int]) -> int:
    """Return the size of the memory of the C source, which is of numbers, pointers and integers."""
    state = max(int(model.own["state_size"]), 1)
    numbers = model.numbers("input") * (1 + len(model.own["nodes"])) + len(model.outputs) + 2 * state
    numbers += int(model.timed) + max(len(model.limits), 1) + max(scratch["numbers"], 1)
    integers = (max(scratch["integers"], 1) + 1) // 2  # two in the place of a number
    return 8 * (numbers + scratch["arguments"] + scratch["results"] + integers)


def _measured(files: Mapping[str, str], name: str) -> dict[str, str]:
    """Measure stack and code of a library of this machine."""
    try:
        (library,) = libraries(files, [f"{name}.c"], name, [host()], 3).values()
        code = _loaded_bytes(library.content)
    except (InvalidSetting, KeyError, ValueError, struct.error):
        return dict.fromkeys(("stack", "code"), "not measured: no compiler that reports it was found")
    by = "measured in a library of this machine's compiler, with `-O3`"
    stack = "not reported by the compiler" if library.stack is None else f"at most {library.stack} bytes, {by}"
    return {"stack": stack, "code": f"{code} bytes, constants included, {by}"}


def _loaded_bytes(elf: bytes) -> int:
    """Return the size of code and constants in a 64-bit ELF file: allocated sections with content."""
    if elf[:5] != b"\x7fELF\x02":
        raise ValueError("no 64-bit ELF file")
    (table,), (size, count) = struct.unpack_from("<Q", elf, 40), struct.unpack_from("<HH", elf, 58)
    rows = [struct.unpack_from("<IIQQQQ", elf, table + k * size) for k in range(count)]
    return sum(length for _, kind, flags, _, _, length in rows if kind == 1 and flags & 2)
