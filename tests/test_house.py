"""The house stays one that a newcomer finds the way in: what a default solve runs, what stays in its file, the map."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("servocore", "crane_fmu")
SOURCES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
MOST_MODULES = 80
"""Modules of servocore that a cold default solve of the rotary crane imports or runs."""


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(path): path for path in SOURCES}


def imported(path: Path) -> Iterator[tuple[str, str]]:
    """Yield (module, name) of what a file imports from this project, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in PACKAGES:
            for each in node.names:
                whole = f"{node.module}.{each.name}"
                yield (whole, "") if whole in MODULES else (node.module or "", each.name)


TRACED = """
import sys
import servocore as sc

scene, ran = sc.scenes.rotary_crane(), set()


def watch(frame, event, argument):
    if event == "call" and frame.f_code.co_flags & 2:  # the body of a function, and not of a module or class
        ran.add(frame.f_globals.get("__name__", ""))


sys.setprofile(watch)
sc.solve(scene)
sys.setprofile(None)
print(*sorted(name for name in ran if name.startswith("servocore")))
"""


def test_a_default_solve_runs_few_modules() -> None:
    run = subprocess.run([sys.executable, "-c", TRACED], cwd=ROOT, capture_output=True, text=True, check=True)
    modules = run.stdout.split()
    assert "servocore.solvers.solve" in modules
    assert len(modules) <= MOST_MODULES, modules


def test_names_with_an_underscore_stay_in_their_file() -> None:
    strangers = [
        f"{path.relative_to(ROOT)} imports {name} from {module}"
        for path in SOURCES
        for module, name in imported(path)
        if name.startswith("_") and not name.startswith("__")
    ]
    assert strangers == []


def test_the_map_of_the_documentation_shows_every_room() -> None:
    page = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    house = page.split("## The house")[1]
    for package in PACKAGES:
        rooms = {each.stem for each in (ROOT / package).iterdir() if each.suffix == ".py" or each.is_dir()}
        shown = {room for room in rooms if re.search(rf"\b{room}\b", house)}
        assert rooms - shown - {"__init__", "__main__", "__pycache__"} == set()
