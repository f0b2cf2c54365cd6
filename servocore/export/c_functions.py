"""CasADi's functions written as C, and how much working memory they take."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterable
from pathlib import Path

import casadi as ca


def c_source(name: str, functions: Iterable[ca.Function]) -> tuple[str, str]:
    """Return header and C source of functions, in files of a name."""
    generator = ca.CodeGenerator(f"{name}.c", {"with_header": True, "casadi_int": "int"})
    for function in functions:
        generator.add(function)
    with tempfile.TemporaryDirectory(prefix="servocore_") as folder:
        generator.generate(f"{folder}/")
        header, source = (Path(folder, f"{name}.{ending}").read_text(encoding="utf-8") for ending in "hc")
    return header, source


def renamed(function: ca.Function, name: str) -> ca.Function:
    """Return a function by another name, with results that have all their numbers."""
    arguments = [ca.MX.sym(f"i{k}", function.sparsity_in(k)) for k in range(function.n_in())]
    return ca.Function(name, arguments, [ca.densify(each) for each in function.call(arguments)])


def scratch_of(functions: Collection[ca.Function]) -> dict[str, int]:
    """Return how much working memory the largest of some functions takes, by kind."""
    sizes = {"arguments": "sz_arg", "results": "sz_res", "integers": "sz_iw", "numbers": "sz_w"}
    return {kind: max(getattr(function, size)() for function in functions) for kind, size in sizes.items()}
