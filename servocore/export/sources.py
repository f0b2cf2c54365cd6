"""The C sources of an inverse model: the mathematics, its tables, and the files that all scenes share."""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Mapping
from math import factorial
from pathlib import Path
from typing import Any

import numpy as np

from servocore.errors import InvalidSetting, missing_package
from servocore.export.inverse_model import InverseModel
from servocore.export.variables import Variable

SHARED = Path(__file__).parent / "c"
"""Folder of the files that all scenes share, and of the templates."""

_SHARED_HEADERS = ("inverse.h", "path.h")

HEADERS: Mapping[int, tuple[str, ...]] = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
"""The official headers, by version of FMI."""


def fmu_sources(model: InverseModel, fmi: int) -> dict[str, str]:
    """Return all C sources of an FMU by file name, FMI's own headers included.

    Raises
    ------
    InvalidSetting
        If FMPy, whose copy of the headers is taken, is not installed.
    """
    return {
        **_core_sources(model, fmi),
        f"fmi{fmi}.c": (SHARED / f"fmi{fmi}.c").read_text(encoding="utf-8"),
        **{name: (_headers_folder() / name).read_text(encoding="utf-8") for name in HEADERS[fmi]},
    }


def _core_sources(model: InverseModel, fmi: int) -> dict[str, str]:
    """Return the mathematics, the tables and what steps it."""
    header, source = model.mathematics.source()
    return {
        f"{model.identifier}_mathematics.h": header,
        f"{model.identifier}_mathematics.c": source,
        "model.h": rendered("model.h.j2", **tables(model, token_of(model, fmi))),
        **{name: (SHARED / name).read_text(encoding="utf-8") for name in _SHARED_HEADERS},
    }


def compiled_files(model: InverseModel, fmi: int) -> tuple[str, ...]:
    """Return the names of the files that a compiler is given."""
    return f"fmi{fmi}.c", f"{model.identifier}_mathematics.c"


def token_of(model: InverseModel, fmi: int) -> str:
    """Return the token of a build, which changes with everything that is compiled."""
    return model.token(*[(SHARED / name).read_text(encoding="utf-8") for name in (*_SHARED_HEADERS, f"fmi{fmi}.c")])


def rendered(template: str, **values: Any) -> str:
    """Fill in one of the templates."""
    try:
        import jinja2  # noqa: PLC0415 - only who exports pays for it
    except ImportError as error:
        raise missing_package(error) or error from None

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(SHARED),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=template.endswith(".html.j2"),
    )
    environment.filters.update(text=c_text, number=c_number, remark=c_remark, word=c_word)
    return environment.get_template(template).render(**values)


def c_text(text: str) -> str:
    """Return a text as a literal of C; what is not ASCII as octal escapes of its UTF-8."""
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


def end_conditions(orders: int) -> np.ndarray:
    """Return the inverse of the conditions at the end of a step on the upper half of a polynomial's coefficients.

    The polynomial of degree 2 orders - 1 joins two instants at which a path and its derivatives are known.
    """
    falling = [[factorial(j) / factorial(j - k) for j in range(orders, 2 * orders)] for k in range(orders)]
    return np.linalg.inv(np.array(falling))


def tables(model: InverseModel, token: str = "") -> dict[str, Any]:
    """Return what the templates are filled in with."""
    mathematics = model.mathematics
    return {
        "title": model.title,
        "model": model.model,
        "identifier": model.identifier,
        "token": token,
        "stamp": int(token[1:9] or "0", 16),
        "components": model.components,
        "orders": mathematics.orders,
        "outputs": mathematics.outputs,
        "parameters": len(model.of("parameter")) - len(model.settings),
        "settings": len(model.settings),
        "internal": len(model.of("local")),
        "state_size": mathematics.state_size,
        "nodes": mathematics.nodes,
        "limits": model.limits,
        "timed": model.timed,
        "arrays": model.variables,
        "has_quick": int("quick" in mathematics.functions),
        "scratch": mathematics.scratch(),
        "numbers": [row for each in model.variables for row in _numbers(each)],
        "end_conditions": end_conditions(mathematics.orders).tolist(),
    }


def _numbers(variable: Variable) -> list[dict[str, Any]]:
    starts = variable.starts or (0.0,) * (variable.size or 1)
    common = {"unit": variable.unit, "low": variable.low, "high": variable.high}
    return [{"name": n, "start": s, **common} for n, s in zip(variable.scalar_names, starts, strict=True)]


def _headers_folder() -> Path:
    found = importlib.util.find_spec("fmpy")
    if found is None or not found.submodule_search_locations:
        raise InvalidSetting("an FMU is built with FMI's headers as FMPy has them: install fmpy")
    return Path(found.submodule_search_locations[0]) / "c-code"
