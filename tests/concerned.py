"""Which tests concern a module: `concerned.toml`, which this file writes, for the cases that `--quick` adds.

``.venv/newest/bin/python tests/concerned.py`` runs every test file once and notes the lines of the packages that each
case runs (half an hour; needs `sys.monitoring` of Python 3.12). The first file of a module is the one that runs most of
its lines that few other files run. Cases are listed before the files for lines that hardly any other of these runs.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Generator, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from heapq import nlargest
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import budgets
import pytest

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
TABLE = TESTS / "concerned.toml"
PACKAGES = ("servocore", "crane_fmu")
MOST_FILES, LEAST_CASES = 8, 2
"""Test files of a module, and cases that a quick run asks about a line of it where there are as many."""
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
    """Return cases and test files of every module, those that concern it most first."""
    return tomllib.loads(TABLE.read_text(encoding="utf-8"))


def tests_of(path: str) -> list[str]:
    """Return what concerns a changed file, by its package where it is new or no module of Python's."""
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


@dataclass
class Case:
    """A test that has run: its name, its fixtures and the lines of the packages, by module and number."""

    nodeid: str
    fixturenames: Sequence[str] = ()
    lines: set[tuple[str, int]] = field(default_factory=set)


class Watch:
    """Notes the lines of the packages that every case of a run executes."""

    def __init__(self) -> None:
        self.cases = [Case("")]
        _watch.use_tool_id(_watch.COVERAGE_ID, "concerned")
        _watch.register_callback(_watch.COVERAGE_ID, _watch.events.LINE, self.line)
        _watch.set_events(_watch.COVERAGE_ID, _watch.events.LINE)

    def line(self, code: Any, number: int) -> object:
        """Note a line the first time that a case runs it."""
        name = code.co_filename.removeprefix(f"{ROOT}/")
        if name.startswith(PACKAGES):
            self.cases[-1].lines.add((name, number))
        return _watch.DISABLE

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Begin a case."""
        self.cases.append(Case(item.nodeid, getattr(item, "fixturenames", ())))
        _watch.restart_events()
        return (yield)


def watched(file: str) -> list[Case]:
    """Run a test file and return its cases."""
    watch = Watch()
    pytest.main(["-q", "-n", "0", file], plugins=[watch])
    return watch.cases[1:]


def table_of(cases: Sequence[Case]) -> dict[str, list[str]]:
    """Return cases and test files of every module.

    The weight of a line is divided among the files that run it. Where the quick run would ask a line of fewer than
    `LEAST_CASES` cases, the shortest that run it are listed.
    """
    always = budgets.representatives(cases)
    lines: defaultdict[str, defaultdict[int, list[Case]]] = defaultdict(lambda: defaultdict(list))
    for case in cases:
        for module, number in case.lines:
            lines[module][number].append(case)
    table = {}
    for module, found in sorted(lines.items()):
        weights: Counter[str] = Counter()
        for runs in found.values():
            files = {budgets.file_of(case) for case in runs}
            weights.update({file: 1 / len(files) for file in files})
        named = nlargest(MOST_FILES, weights, key=weights.__getitem__)
        asked = {case.nodeid for case in (*always, *budgets.besides(cases, always, named))}
        rare: list[str] = []
        for runs in found.values():
            lacking = LEAST_CASES - sum(case.nodeid in asked for case in runs)
            further = sorted((case for case in runs if case.nodeid not in asked), key=budgets.seconds_of)
            rare += [case.nodeid for case in further[: max(lacking, 0)]]
            asked.update(rare)
        table[module] = [*(case.removeprefix("tests/") for case in rare), *named]
    return table


def write(table: Mapping[str, list[str]]) -> None:
    """Write the table, a module a paragraph."""
    rows = (
        f"{json.dumps(module)} = {json.dumps(names, indent=0, ensure_ascii=False)}\n" for module, names in table.items()
    )
    TABLE.write_text(
        "# Cases and files that concern a module: tests/concerned.py writes them.\n\n" + "".join(rows), "utf-8"
    )


if __name__ == "__main__":
    with ProcessPoolExecutor(2, max_tasks_per_child=1) as processes:
        write(table_of(list(chain.from_iterable(processes.map(watched, sorted(map(str, TESTS.rglob("test_*.py"))))))))
