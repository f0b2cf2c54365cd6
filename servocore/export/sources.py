"""The C sources of exported models: the mathematics, its tables, and the common files."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from servocore.errors import refused_if_missing
from servocore.export.c_functions import scratch_of
from servocore.export.native_model import NativeModel
from servocore.export.variables import listed

SHARED = Path(__file__).parent / "c"
"""Folder of the common files and of the templates."""

_KERNELS: Mapping[str, tuple[str, ...]] = {
    "inverse": ("inverse.h", "path.h", "routes.h"),
    "plant": ("plant.h",),
    "trajectory": ("trajectory.h",),
}

HEADERS: Mapping[int, tuple[str, ...]] = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
"""The official headers, by version of FMI."""


def fmu_sources(model: NativeModel, fmi: int) -> dict[str, str]:
    """Return all C sources of an FMU by file name: mathematics, tables, kernel, and FMI's own headers."""
    own = _own_sources(model, fmi, token_of(model, fmi))
    return {
        **{name: model.about.notice + text for name, text in own.items()},
        **{name: (SHARED / "fmi" / name).read_text(encoding="utf-8") for name in HEADERS[fmi]},
    }


def _own_sources(model: NativeModel, fmi: int, token: str = "") -> dict[str, str]:
    header, source = model.source
    values, shared = tables(model, token), ("instance.h", "calls.h", *_KERNELS[model.kernel], f"fmi{fmi}.c")
    return {
        f"{model.identifier}_mathematics.h": header,
        f"{model.identifier}_mathematics.c": source,
        **model.more_sources,
        "model.h": rendered("model.h.j2", **values, own=rendered(f"{model.kernel}_own.h.j2", **values)),
        **{name: (SHARED / name).read_text(encoding="utf-8") for name in shared},
    }


def compiled_files(model: NativeModel, fmi: int) -> tuple[str, ...]:
    """Return the names of the files to compile."""
    more = (name for name in model.more_sources if name.endswith(".c"))
    return f"fmi{fmi}.c", f"{model.identifier}_mathematics.c", *more


def token_of(model: NativeModel, fmi: int) -> str:
    """Return the token of a build: it changes when, and only when, variables or sources do."""
    parts = model.variables, model.choices, _own_sources(model, fmi)
    code = hashlib.sha256(repr(parts).encode()).hexdigest()
    return f"{{{code[:8]}-{code[8:12]}-{code[12:16]}-{code[16:20]}-{code[20:32]}}}"


def rendered(template: str, folder: Path = SHARED, **values: Any) -> str:
    """Return a template of a folder, filled in."""
    text: str = _environment(folder).get_template(template).render(**values)
    return text


@cache  # an export fills some templates in more than once
def _environment(folder: Path) -> Any:
    with refused_if_missing():
        import jinja2  # noqa: PLC0415 - imported for exports only

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=lambda template: (template or "").endswith(".html.j2"),
    )
    environment.filters.update(text=c_text, number=c_number, remark=c_remark, word=c_word)
    return environment


def c_text(text: str) -> str:
    """Return a text as a literal of C, with octal escapes for UTF-8 bytes outside ASCII."""
    return (
        '"' + "".join(chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode()) + '"'
    )


def c_remark(text: str) -> str:
    """Return a text as part of a comment of C: one line that does not end it."""
    return " ".join(text.replace("*/", "* /").split())


def c_word(name: str) -> str:
    """Return the name of a variable as part of an identifier of C."""
    return re.sub(r"\W+", "_", name).strip("_")


def c_number(value: float) -> str:
    """Return a number as an expression of C, to the last bit."""
    if math.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


def tables(model: NativeModel, token: str = "") -> dict[str, Any]:
    """Return the values for the templates."""
    parameters, settings = listed(model.of("parameter"), 2), len(listed(model.settings, 2))
    roles: dict[str, list[int]] = {}
    for k, each in enumerate(parameters):
        roles.setdefault(each.role, []).append(k)
    return {
        "model": model,
        "identifier": model.identifier,
        "token": token,
        "stamp": int(token[1:9] or "0", 16),
        "inputs": model.numbers("input"),
        "outputs": model.outputs,
        "parameters": len(parameters) - settings,
        "settings": settings,
        "roles": {role: places for role, places in roles.items() if role},
        "internal": model.numbers("local"),
        "scratch": scratch_of([*model.functions.values(), *model.elsewhere]),
        "numbers": listed(model.variables, 2),
        **model.own,
    }
