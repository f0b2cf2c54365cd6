"""`export_wasm`: a scene's inverse model as a WebAssembly module, for web pages and other JavaScript engines.

A module calls the C source of `export_c` at many instants, and takes steps of the scheme of the paper: projected form
(19) or (29), backward Euler (31).
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

import casadi as ca

from servocore.errors import InvalidModel, InvalidSetting, install
from servocore.export.building import followed, inverse_model
from servocore.export.c_source import runtime
from servocore.export.routes import step_functions
from servocore.export.sources import SHARED, rendered
from servocore.export.targets import zig
from servocore.export.variables import listed, path_variables
from servocore.files import require_places, write_together
from servocore.formulations.projected import Projected
from servocore.methods.backward_euler import BackwardEuler
from servocore.model.scene import Scene
from servocore.numerics.machine_code import compile_in
from servocore.problem import Problem
from servocore.stepping.program import program_of

LOADER = ".mjs"
"""Suffix of the JavaScript beside a module that loads it."""

SECTION = "servocore"
"""Name of the section of a module that describes it."""

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
    problem, orders = followed(Problem.of(scene, model)), exported.own["orders"]
    marched, instants = dict[str, ca.Function](), tuple[float, ...]()
    try:
        program = program_of(problem, Projected(), BackwardEuler())
        orders, instants = max(orders, program.start_order + 1), program.start_instants
        marched = step_functions(program, f"{exported.identifier}_march", exported.outputs, orders)
    except InvalidModel:
        if exported.own["state_size"]:
            raise
    home = problem.reference.jet([problem.reference.start_time], 0)[0, 0]
    told = path_variables(problem.system.outputs, scene.tracked, orders, home)
    about = {
        "title": exported.title,
        "model": exported.model,
        "path": [{"name": each.name, "unit": each.unit} for each in listed(told, 2)],
        "outputs": [{"name": e.name, "unit": e.unit, "description": e.description} for e in exported.outputs],
        "parameters": [
            {"name": e.name, "unit": e.unit, "start": e.starts[0], **e.bounds, "description": e.description}
            for e in exported.of("parameter")
            if e not in exported.settings
        ],
        "verdicts": [*_VERDICTS, *(limit.text for limit in exported.limits)],
        "timed": exported.timed,
        "instants": [k + 0.0 for k in instants],  # without -0
    }
    texts, values = runtime(exported, {f"march_{name}": each for name, each in marched.items()})
    texts[f"{exported.identifier}.c"] = _tested_once(texts[f"{exported.identifier}.c"])
    texts["module.c"] = rendered("module.c.j2", **values, given=orders, instants=instants, marched=marched)
    # Engines ignore a custom section, and JavaScript can read it by its name.
    section = _counted(SECTION.encode()) + json.dumps(about, separators=(",", ":")).encode()
    module = _compiled(texts, exported.title) + b"\0" + _counted(section)
    write_together({file: module, file.with_suffix(LOADER): (SHARED / "loader.mjs").read_bytes()})
    return file


def require_module(path: str | Path) -> Path:
    """Return the file of a module; raises `InvalidSetting` if it cannot be built or written there."""
    file = Path(path)
    if file.suffix != ".wasm":
        raise InvalidSetting(f"cannot write {file}: the name of a WebAssembly module ends with .wasm")
    require_places({"the module": file, "its loader": file.with_suffix(LOADER)})
    if zig() is None:
        raise InvalidSetting(f"WebAssembly is built by the package ziglang: {install('native')}")
    return file


def _counted(content: bytes) -> bytes:
    """Return bytes after their length in LEB128."""
    length, encoded = len(content), bytearray()
    while length > 127:
        encoded.append(length & 127 | 128)
        length >>= 7
    return bytes(encoded) + bytes([length]) + content


_TESTED = {
    "static const double ZEROS": re.compile(r"(arg)\[(\d+)\]\? (arg\[\2\]\[(\d+)\]) : 0"),
    "static double UNWANTED": re.compile(r"if \((res)\[(\d+)\]!=0\) (res\[\2\]\[(\d+)\]=)"),
}
_BEGIN = re.compile(r"^(?=(?:CASADI_SYMBOL_EXPORT|static) int \w+\(const casadi_real\*\* arg, )", re.MULTILINE)


def _tested_once(source: str) -> str:
    """Return C source whose functions test pointers for NULL once, not for each number: a tenth less compiled code."""
    for spare, pattern in _TESTED.items():
        size = 1 + max((int(each[4]) for each in pattern.finditer(source)), default=0)
        parts = [f"{spare}[{size}];\n"]
        for part in _BEGIN.split(source):
            places = sorted({f"{each[1]}[{each[2]}]" for each in pattern.finditer(part)})
            tests = "".join(f"  if (!{each}) {each} = {spare.split()[-1]};\n" for each in places)
            parts.append(pattern.sub(r"\3", part).replace("{\n", "{\n" + tests, 1) if tests else part)
        source = "".join(parts)
    return source


def _compiled(texts: Mapping[str, str], title: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="servocore_") as folder:
        for name, text in texts.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        call = [*(zig() or ()), "cc", *_OPTIONS, "module.c", "-o", "module.wasm"]
        compile_in(Path(folder), call, f"{title} to WebAssembly")
        return Path(folder, "module.wasm").read_bytes()
