"""The house stays one that a newcomer finds the way in: few entries, short ways down, values instead of memories."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
MOST_ENTRIES = {"servocore": 25, "crane_fmu": 12}
LONGEST_CHAIN = 12
MOST_MEMOS = 15
MEMO = re.compile(r"^\s*@(?:functools\.)?(?:lru_cache|cache|cached_property)\b")
SOURCES = [path for package in MOST_ENTRIES for path in sorted((ROOT / package).rglob("*.py"))]


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(path): path for path in SOURCES}


def imported(path: Path) -> Iterator[tuple[str, str]]:
    """Yield (module, name) of what a file imports from this project, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in MOST_ENTRIES:
            for each in node.names:
                whole = f"{node.module}.{each.name}"
                yield (whole, "") if whole in MODULES else (node.module or "", each.name)


@cache
def longest_chain(module: str) -> tuple[str, ...]:
    """Return the longest chain of imports that begins with a module; faces pass on what they import, uncounted."""
    path = MODULES[module]
    below = {name for name, _ in imported(path) if name != module}
    longest = max((longest_chain(each) for each in below), key=len, default=())
    return longest if path.name == "__init__.py" else (module, *longest)


@pytest.mark.parametrize("package", MOST_ENTRIES)
def test_a_package_has_few_entries_to_choose_from(package: str) -> None:
    entries = [each.name for each in (ROOT / package).iterdir() if not each.name.startswith((".", "__pycache__"))]
    assert len([each for each in entries if each != "py.typed"]) <= MOST_ENTRIES[package]


@pytest.mark.parametrize("package", MOST_ENTRIES)
def test_the_longest_chain_of_imports_is_short(package: str) -> None:
    modules = [name for name in MODULES if name.startswith(f"{package}.") and not name.endswith("__main__")]
    chain = max((longest_chain(each) for each in modules), key=len)
    within = [each for each in chain if each.startswith(package)]
    assert len(within) <= LONGEST_CHAIN, " > ".join(within)


def test_names_with_an_underscore_stay_in_their_file() -> None:
    strangers = [
        f"{path.relative_to(ROOT)} imports {name} from {module}"
        for path in SOURCES
        for module, name in imported(path)
        if name.startswith("_") and not name.startswith("__")
    ]
    assert strangers == []


def test_few_memos_stand_in_for_values_and_each_says_why() -> None:
    found, silent = [], []
    for path in SOURCES:
        lines = path.read_text(encoding="utf-8").splitlines()
        for k, line in enumerate(lines):
            if MEMO.match(line):
                place = f"{path.relative_to(ROOT)}:{k + 1}"
                found.append(place)
                if "  # " not in line and not lines[k - 1].lstrip().startswith("#"):
                    silent.append(place)
    assert len(found) <= MOST_MEMOS, found
    assert silent == []


def test_the_map_of_the_documentation_shows_every_room() -> None:
    page = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    house = page.split("## The house")[1]
    for package in MOST_ENTRIES:
        rooms = {each.stem for each in (ROOT / package).iterdir() if each.suffix == ".py" or each.is_dir()}
        shown = {room for room in rooms if re.search(rf"\b{room}\b", house)}
        assert rooms - shown - {"__init__", "__main__", "__pycache__"} == set()
