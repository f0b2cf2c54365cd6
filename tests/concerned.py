"""Which test files concern a module: `concerned.toml`, which this file writes, and the cases that `--quick` adds.

``.venv/newest/bin/python tests/concerned.py`` runs every test file once and notes the lines of the packages that it
runs (half an hour; needs `sys.monitoring` of Python 3.12). The first file of a module is the one that runs most of its
lines that few other files run.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Set
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from heapq import nlargest
from itertools import chain, zip_longest
from pathlib import Path
from types import CodeType
from typing import Any

import pytest

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
TABLE = TESTS / "concerned.toml"
PACKAGES = ("servocore", "crane_fmu")
MOST_FILES = 8
"""Test files of a module."""
_watch: Any = getattr(sys, "monitoring", None)


def changed() -> list[str]:
    """Return the files of packages and tests that differ from the last commit.

    Of a clean tree those that its branch changes, or the last commit on the main branch; none outside of a git clone.
    """
    for since in ("HEAD", "main...HEAD", "HEAD~1"):
        files = git("diff", "--name-only", since)
        if since == "HEAD":
            files += git("ls-files", "--others", "--exclude-standard")
        if files:
            return files
    return []


def git(*words: str) -> list[str]:
    """Return the lines that git prints about packages and tests, none where it fails."""
    command = ["git", *words, "--", *PACKAGES, "tests"]
    try:
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.splitlines()
    except OSError:
        return []


@cache
def table() -> Mapping[str, list[str]]:
    """Return the test files of every module, those that concern it most first."""
    return tomllib.loads(TABLE.read_text(encoding="utf-8"))


def files_of(path: str) -> list[str]:
    """Return the test files that concern a changed file, by its package where it is new or no module of Python's."""
    if path.startswith("tests/"):
        return [path.removeprefix("tests/")] if Path(path).name.startswith("test_") else []
    for part in (path, *(f"{parent.as_posix()}/" for parent in Path(path).parents)):
        if found := [files for module, files in table().items() if module.startswith(part)]:
            return in_turn(found)
    return []


def in_turn(ranked: Iterable[Iterable[str]]) -> list[str]:
    """Return the first of each, then the second of each and so on, each one once."""
    return list(dict.fromkeys(each for each in chain.from_iterable(zip_longest(*ranked)) if each is not None))


# The table -----------------------------------------------------------------------------------------------------------


class Watch:
    """Notes the lines of the packages that a run executes."""

    def __init__(self) -> None:
        self.lines: set[tuple[str, int]] = set()

    def pytest_configure(self) -> None:
        """Begin before the tests import the packages: lines of an import are run by all files, and weigh little."""
        _watch.use_tool_id(_watch.COVERAGE_ID, "concerned")
        _watch.register_callback(_watch.COVERAGE_ID, _watch.events.LINE, self.line)
        _watch.set_events(_watch.COVERAGE_ID, _watch.events.LINE)

    def line(self, code: CodeType, number: int) -> object:
        """Note a line the first time that it is run."""
        name = code.co_filename.removeprefix(f"{ROOT}/")
        if name.startswith(PACKAGES):
            self.lines.add((name, number))
        return _watch.DISABLE


def lines_of(file: str) -> set[tuple[str, int]]:
    """Return the lines of the packages, by module and number, that a test file runs in a process of its own."""
    with ProcessPoolExecutor(1) as process:
        return process.submit(watched, file).result()


def watched(file: str) -> set[tuple[str, int]]:
    """Run a test file and return the lines of the packages that it runs."""
    watch = Watch()
    pytest.main(["-q", "-n", "0", str(TESTS / file)], plugins=[watch])
    return watch.lines


def weighed(lines: Mapping[str, Set[tuple[str, int]]]) -> dict[str, list[str]]:
    """Return the test files of every module from the lines of each file.

    The weight of a line is divided among the files that run it.
    """
    counts = Counter(chain.from_iterable(lines.values()))
    weights: defaultdict[str, defaultdict[str, float]] = defaultdict(lambda: defaultdict(float))
    for file, run in lines.items():
        for module, number in run:
            weights[module][file] += 1 / counts[module, number]
    return {module: nlargest(MOST_FILES, found, key=found.__getitem__) for module, found in sorted(weights.items())}


if __name__ == "__main__":
    names = sorted(path.relative_to(TESTS).as_posix() for path in TESTS.rglob("test_*.py"))
    rows = weighed({name: lines_of(name) for name in names}).items()
    head = "# Test files that concern a module, most first: tests/concerned.py writes them.\n\n"
    TABLE.write_text(head + "".join(f"{json.dumps(module)} = {json.dumps(files)}\n" for module, files in rows), "utf-8")
