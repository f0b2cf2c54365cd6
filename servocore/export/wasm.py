"""`export_wasm`: a scene's inverse model as a WebAssembly module, for web pages and other JavaScript engines."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import casadi as ca

from servocore.errors import InvalidModel, InvalidSetting, install
from servocore.export.building import InverseModel, followed, inverse_model
from servocore.export.c_functions import c_source, checked_once, copied_in_one_place, scratch_of
from servocore.export.marching import Marching, marching
from servocore.export.sources import SHARED, rendered
from servocore.export.targets import zig
from servocore.export.variables import Variable, listed, path_variables
from servocore.files import require_places, write_together
from servocore.model.scene import Scene
from servocore.numerics.machine_code import compile_in
from servocore.problem import Problem

LOADER = "loader.mjs"
"""The file with the JavaScript that loads any of the modules."""

SECTION = "servocore"
"""Name of the section of a module that describes it."""

_INVERTING = ("quick", "begin")
# Optimized for size: compilers cannot speed up the mathematics. The features are in browsers since 2021; without them a
# step of marching takes up to a third longer.
_OPTIONS = ("-target", "wasm32-wasi", "-mcpu=mvp+bulk_memory+nontrapping_fptoint", "-mexec-model=reactor", "-Os",
            "-ffp-contract=off", "-w", "-Wl,--strip-all", "-Wl,--export=__heap_base")  # fmt: skip
_VERDICTS = (
    "fine",
    "the path is not finite",
    "the equations are not solved",
    "the solution is on another branch than the intended one",
)


def export_wasm(scene: Scene, path: str | Path, *, model: str | None = None) -> Path:
    """Write the inverse model of a scene as a WebAssembly module that imports nothing, and its loader beside it.

    Parameters
    ----------
    scene : Scene
        With its parameter values, the defaults of the module.
    path : str or Path
        The file; the loader has its name with the suffix ``.mjs``.
    model : str, optional
        Model of the scene; its smallest when not given.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InvalidModel, InvalidReference
        As `export_fmu`.
    InvalidSetting
        If the package ziglang is not installed, the file cannot be written or does not end with ``.wasm``.

    Examples
    --------
    >>> import servocore as sc
    >>> sc.export_wasm(sc.scenes.rotary_crane(), "crane.wasm").name
    'crane.wasm'
    """
    file, exported = require_module(path), inverse_model(scene, model)
    called = () if exported.state_size else _INVERTING
    inverting = {name: each for name, each in exported.functions.items() if name in called}
    problem = followed(Problem.of(scene, model))
    try:
        marched = marching(problem, exported.identifier)
    except InvalidModel:
        if not inverting:
            raise
        marched = None
    orders = max(exported.orders, marched.orders if marched else 0)
    home = problem.reference.jet([problem.reference.start_time], 0)[0, 0]
    about = described(exported, path_variables(problem.system.outputs, scene.tracked, orders, home), marched)
    compiled = _compiled(_source(exported, inverting, marched, orders), exported.title)
    # Engines ignore a custom section, and JavaScript can read it by its name.
    section = _counted(SECTION.encode()) + json.dumps(about, separators=(",", ":")).encode()
    module = compiled + b"\0" + _counted(section)
    write_together({file: module, loader_beside(file): (SHARED / LOADER).read_bytes()})
    return file


def require_module(path: str | Path) -> Path:
    """Return the file of a module; raises `InvalidSetting` if it cannot be built or written there."""
    file = Path(path)
    if file.suffix != ".wasm":
        raise InvalidSetting(f"cannot write {file}: the name of a WebAssembly module ends with .wasm")
    require_places({"the module": file, "its loader": loader_beside(file)})
    if zig() is None:
        raise InvalidSetting(f"WebAssembly is built by the package ziglang: {install('native')}")
    return file


def loader_beside(file: Path) -> Path:
    """Return the file of the loader of a module."""
    return file.with_suffix(".mjs")


def described(model: InverseModel, path: Sequence[Variable], marched: Marching | None) -> dict[str, Any]:
    """Return the description of a module: names, units and values in the order of its arguments and results."""
    return {
        "title": model.title,
        "model": model.model,
        "path": [{"name": each.name, "unit": each.unit} for each in listed(path, 2)],
        "outputs": [{"name": e.name, "unit": e.unit, "description": e.description} for e in model.outputs],
        "parameters": [
            {"name": e.name, "unit": e.unit, "start": e.starts[0], **e.bounds, "description": e.description}
            for e in model.of("parameter")
            if e not in model.settings
        ],
        "verdicts": [*_VERDICTS, *(limit.text for limit in model.limits)],
        "timed": model.timed,
        "instants": [] if marched is None else [k + 0.0 for k in marched.instants],  # without -0
    }


def _counted(content: bytes) -> bytes:
    """Return bytes after their length in LEB128."""
    length, encoded = len(content), bytearray()
    while length > 127:
        encoded.append(length & 127 | 128)
        length >>= 7
    return bytes(encoded) + bytes([length]) + content


def _source(model: InverseModel, inverting: Mapping[str, ca.Function], marched: Marching | None, orders: int) -> str:
    functions = dict(inverting)
    margins_once = "quick" in functions and all(limit.row < 0 for limit in model.limits)
    if margins_once:
        functions["begin"] = _without_margins(functions["begin"])
    if marched is not None:
        functions |= marched.functions
    return rendered(
        "module.c.j2",
        model=model,
        marched=marched,
        orders=orders,
        functions=tuple(functions),
        has_quick="quick" in functions,
        inverts=bool(inverting),
        margins_once=margins_once,
        scratch=scratch_of(functions.values()),
        mathematics_source=copied_in_one_place(checked_once(c_source("mathematics", functions.values())[1])),
    )


def _without_margins(begin: ca.Function) -> ca.Function:
    """Return ``begin`` without the margins of limits, where those of ``quick`` are of the path alone."""
    arguments = begin.mx_in()
    before, outputs, _, residual = begin.call(arguments, True, False)
    return ca.Function(begin.name(), arguments, [before, outputs, residual])


def _compiled(source: str, title: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="servocore_") as folder:
        Path(folder, "module.c").write_text(source, encoding="utf-8")
        call = [*(zig() or ()), "cc", *_OPTIONS, "module.c", "-o", "module.wasm"]
        compile_in(Path(folder), call, f"{title} to WebAssembly")
        return Path(folder, "module.wasm").read_bytes()
