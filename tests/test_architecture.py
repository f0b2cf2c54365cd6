"""Rules of the architecture: modules of a default solve, direction of calls, single places, the map of the page."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from processes import python

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("servocore", "crane_fmu")
SOURCES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
MOST_MODULES = 60
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


LAYERS = next(
    contract["layers"]
    for contract in tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    if contract.get("containers") == ["servocore"]
)
HEIGHT = {package.strip(): -k for k, line in enumerate(LAYERS) for package in line.split("|")}
TRACED = """
import sys
import servocore as sc

scene, ran = sc.scenes.REGISTRY[sys.argv[1]](), set()


def name_of(frame):
    name = frame.f_globals.get("__name__", "")
    return name if name.startswith("servocore") else ""


def watch(frame, event, argument):
    if event != "call" or not frame.f_code.co_flags & 2 or not name_of(frame):  # bodies of functions, not of modules
        return
    caller = frame.f_back
    while caller and not name_of(caller):
        caller = caller.f_back
    ran.add((name_of(caller) if caller else "servocore", name_of(frame)))


sys.setprofile(watch)
sc.solve(scene)
sys.setprofile(None)
for pair in sorted(ran):
    print(*pair)
"""


@cache
def calls(scene: str) -> list[tuple[str, str]]:
    """Return pairs of modules, of a cold default solve, the first of which calls the second."""
    run = python("-W", "ignore", "-c", TRACED, scene, folder=ROOT)
    assert run.returncode == 0, run.stderr
    return [(each.split()[0], each.split()[1]) for each in run.stdout.splitlines()]


def test_a_default_solve_runs_few_modules() -> None:
    modules = {called for _, called in calls("rotary_crane")}
    assert "servocore.solvers.solve" in modules
    assert len(modules) <= MOST_MODULES, modules


@pytest.mark.parametrize("scene", ["rotary_crane", "mass_on_car", "passive_joint_arm"])
def test_no_package_runs_code_of_a_higher_layer(scene: str) -> None:
    """Scenes are exempt: lower layers call the factories and limits that a scene passes to them."""
    packages = [(below.split(".")[1:2], above.split(".")[1:2]) for below, above in calls(scene)]
    known = {(below[0], above[0]) for below, above in packages if below and above}
    assert len(known) > 20
    assert {(below, above) for below, above in known if above != "scenes" and HEIGHT[above] > HEIGHT[below]} == set()


def test_one_module_of_the_library_starts_compilers() -> None:
    """The command line is exempt: it stops processes that it started."""
    starts = {name for name, path in MODULES.items() if "subprocess" in path.read_text(encoding="utf-8")}
    own = {name for name in starts if name.startswith("servocore.") and name.split(".")[1] != "cli"}
    assert own == {"servocore.numerics.machine_code"}


def test_one_module_assembles_exact_inversion() -> None:
    whole = {name for name, path in MODULES.items() if ".search_from_guess" in path.read_text(encoding="utf-8")}
    assert whole == {"servocore.structure.inversion", "servocore.stepping.exact_evaluation"}


def test_one_decorator_keeps_results() -> None:
    kept = re.compile(r"^\s*@(?:functools\.)?(?:lru_)?cache\b|\blru_cache\(", re.MULTILINE)
    own = {name for name, path in MODULES.items() if kept.search(path.read_text(encoding="utf-8"))}
    own -= {
        name
        for name in own
        if not name.startswith("servocore") or name.startswith(("servocore.export", "servocore.cli"))
    }
    assert own == {"servocore", "servocore.numerics.memoization"}


def test_data_classes_are_values_but_those_that_count_or_collect() -> None:
    changing = re.compile(r"^@dataclass(?!.*frozen=True).*\nclass (\w+)", re.MULTILINE)
    found = [name for path in SOURCES for name in changing.findall(path.read_text(encoding="utf-8"))]
    assert found == ["Stage", "KnownValues", "WrittenOut", "CompiledValues", "Use", "_Processes"]


OF_A_FILE = re.compile(r"^\s*from [\w.]+ import (?:.*|\([^)]*)\b_\w", re.MULTILINE)
"""Imports names with an underscore: to look for it takes a hundredth of parsing every file."""


def test_names_with_an_underscore_stay_in_their_file() -> None:
    assert all(map(OF_A_FILE.search, ("from a.b import c, _d", "    from a import (\n    b,\n    _c,\n)")))
    private = [
        f"{path.relative_to(ROOT)} imports {name} from {module}"
        for path in SOURCES
        if OF_A_FILE.search(path.read_text(encoding="utf-8"))
        for module, name in imported(path)
        if name.startswith("_") and not name.startswith("__")
    ]
    assert private == []


def test_the_map_of_the_documentation_shows_every_package() -> None:
    page = (ROOT / "docs" / "development.md").read_text(encoding="utf-8")
    chapter = page.split("## Architecture")[1]
    for package in PACKAGES:
        names = {path.stem for path in (ROOT / package).iterdir() if path.suffix == ".py" or path.is_dir()}
        shown = {name for name in names if re.search(rf"\b{name}\b", chapter)}
        assert names - shown - {"__init__", "__main__", "__pycache__"} == set()
