"""Validate the docstrings of all public names by numpydoc: `python tests/docstrings.py`, a part of `make check`.

Public is what the faces of both packages list in `__all__`, and what some modules without a face define; methods of
their classes too. The checks are those that `[tool.numpydoc_validation]` in pyproject.toml names. Two things differ
from numpydoc: the fields of a class may stand under *Attributes*, and a method that a protocol or a base class
describes needs no second description.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from numpydoc.docscrape import get_doc_object
from numpydoc.validate import Validator, validate

ROOT = Path(__file__).resolve().parent.parent
FACES = ("servocore", "servocore.scenes", "crane_fmu.build")
OPEN = ("crane_fmu.catalogue", "crane_fmu.demo", "crane_fmu.drive", "crane_fmu.files", "crane_fmu.run")
"""Modules without a face of their own: what they define without an underscore is public."""
DESCRIBED_ELSEWHERE = {"PR01", "RT01", "YD01"}


class Documented(Validator):  # type: ignore[misc]  # numpydoc has no types
    """A validator to which the attributes of a class are what it is made of."""

    def __init__(self, obj_name: object) -> None:
        super().__init__(get_doc_object(obj_name, config={"show_class_members": False}))

    @property
    def doc_parameters(self) -> dict[str, tuple[str, str]]:
        """Parameters, and attributes of a class that its constructor takes."""
        found: dict[str, tuple[str, str]] = self._doc_parameters(["Parameters"])
        if inspect.isclass(self.obj):
            attributes = self._doc_parameters(["Attributes"])
            found |= {name: attributes[name] for name in self.signature_parameters if name in attributes}
        return found

    @property
    def doc_all_parameters(self) -> dict[str, tuple[str, str]]:
        """The same with other parameters."""
        others: dict[str, tuple[str, str]] = self._doc_parameters(["Other Parameters"])
        return self.doc_parameters | others


def methods(kind: type) -> Iterator[tuple[str, object]]:
    """Yield the public functions and properties that a class defines itself."""
    for name, member in vars(kind).items():
        plain = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        default = name in getattr(kind, "__dataclass_fields__", ())  # a field whose default is a function
        if not (name.startswith("_") or default) and (inspect.isfunction(plain) or isinstance(plain, property)):
            yield name, plain


def listed_names(module: ModuleType) -> list[str]:
    """Return the public names of a module: those of its face, or those that it defines."""
    if hasattr(module, "__all__"):
        return list(module.__all__)
    defined = {name for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__}
    return sorted(name for name in defined if not name.startswith("_"))


def public() -> Iterator[tuple[str, object, set[str]]]:
    """Yield every public name once, with its object and the checks that it is spared."""
    seen: set[int] = set()
    faces = [importlib.import_module(name) for name in (*FACES, *OPEN)]
    listed = [(face.__name__, name, getattr(face, name)) for face in faces for name in listed_names(face)]
    protocols = {member for _, _, kind in listed if getattr(kind, "_is_protocol", False) for member, _ in methods(kind)}
    for face, name, found in listed:
        if id(found) in seen or not (inspect.isfunction(found) or inspect.isclass(found)):
            continue
        seen.add(id(found))
        protocol = getattr(found, "_is_protocol", False)
        yield f"{face}.{name}", found, DESCRIBED_ELSEWHERE if protocol else set()
        if not inspect.isclass(found):
            continue
        for member, method in methods(found):
            above = not protocol and (member in protocols or any(member in vars(base) for base in found.__mro__[1:]))
            yield f"{face}.{name}.{member}", method, DESCRIBED_ELSEWHERE if above else set()


def raised(found: object) -> set[str]:
    """Return the exceptions that a function raises by itself."""
    if not inspect.isfunction(found):
        return set()
    tree = ast.parse(textwrap.dedent(inspect.getsource(found)))
    calls = (node.exc for node in ast.walk(tree) if isinstance(node, ast.Raise))
    names = {each.func.id for each in calls if isinstance(each, ast.Call) and isinstance(each.func, ast.Name)}
    return {each for each in names if each[0].isupper()}  # others are functions that return an exception


def complaints() -> Iterator[str]:
    """Yield a line for each check that fails."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["numpydoc_validation"]
    checks = set(settings["checks"])
    for name, found, spared in public():
        silent = sorted(each for each in raised(found) if each not in (inspect.getdoc(found) or ""))
        if silent:
            yield f"{name}: it raises {', '.join(silent)} and does not say so"
        for code, message in validate(found, Documented)["errors"]:
            if code in checks - spared:
                yield f"{name}: {code} {message}"


def main() -> None:
    """Print what is missing; exit with 1 if anything is."""
    found = list(complaints())
    print("\n".join(found) or f"{sum(1 for _ in public())} public docstrings: all complete")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
