"""Types reach through CasADi: the stubs in stubs/casadi hold no `Any`, and nothing that CasADi does not have."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import casadi as ca
import pytest

ROOT = Path(__file__).resolve().parent.parent
STUB = ast.parse((ROOT / "stubs" / "casadi" / "__init__.pyi").read_text(encoding="utf-8"))
PARTS = ("servocore", "crane_fmu", "benchmarks", "stubs", "tests")
CHECKED = [path for part in PARTS for path in (ROOT / part).rglob("*.py*")]
PRIVATE = re.compile(r"_[^_]")


def functions() -> list[ast.FunctionDef]:
    return [node for node in ast.walk(STUB) if isinstance(node, ast.FunctionDef)]


def names(body: list[ast.stmt]) -> set[str]:
    """Return what a module or a class defines, but for helpers of the stubs, which begin with one underscore."""
    found = {node.name for node in body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    found |= {node.target.id for node in body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)}
    return {name for name in found if not PRIVATE.match(name)}


def test_no_value_of_casadi_is_any() -> None:
    assert not [node.lineno for node in ast.walk(STUB) if isinstance(node, ast.Name) and node.id == "Any"]


def test_all_arguments_and_results_of_casadi_have_types() -> None:
    open_ones = [
        f"{node.name}, line {node.lineno}"
        for node in functions()
        if node.returns is None
        or any(
            each.annotation is None
            for each in (*node.args.args, *node.args.kwonlyargs, node.args.vararg, node.args.kwarg)
            if each is not None and each.arg != "self"
        )
    ]
    assert open_ones == []


def test_whatever_has_types_is_there() -> None:
    missing = [name for name in names(STUB.body) if not hasattr(ca, name)]
    for node in STUB.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            kind = getattr(ca, node.name)
            missing += [f"{node.name}.{name}" for name in names(node.body) if not hasattr(kind, name)]
    assert missing == []


@pytest.mark.parametrize("kind", [ca.DM, ca.SX])
def test_numbers_beside_expressions_become_what_the_types_say(kind: type[ca.DM | ca.SX]) -> None:
    beside = kind(2.0)
    found = (ca.vertcat(1.0, beside), ca.dot(beside, 1.0), ca.if_else(beside > 1.0, 1.0, beside), 1.0 + beside)
    assert {type(each) for each in found} == {kind}
    assert {type(ca.vertcat(each, ca.SX.sym("x"))) for each in found} == {ca.SX}


def test_every_type_that_is_ignored_has_a_reason() -> None:
    silent = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in CHECKED
        if path.suffix in {".py", ".pyi"}
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if re.search(r"# type[:] ignore(\[[\w, -]+\])?(?! *(#|\[))", line)
    ]
    assert silent == []
