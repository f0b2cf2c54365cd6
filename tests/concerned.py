"""Tests that concern a module, of which `--quick` adds some (`concerned.json`), and slow ones (`slow_cases.txt`).

``.venv/newest/bin/python tests/concerned.py`` writes both. It runs every test file once and notes which lines of the
packages each case runs, and for how long (half an hour; needs `sys.monitoring` of Python 3.12). The first file of a
module is the one that runs most of its lines that few other files run. Cases stand before the files for lines that
hardly any other case of the quick run executes.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from heapq import nlargest
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any, TypeAlias

import budgets
import pytest

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
TABLE = TESTS / "concerned.json"
PACKAGES = ("servocore", "crane_fmu")
MOST_FILES, LEAST_CASES = 8, 2
"""Test files of a module, and cases that a quick run asks about a line of it where there are as many."""
Lines: TypeAlias = set[tuple[str, int]]
_watch: Any = getattr(sys, "monitoring", None)


def changed() -> list[str]:
    """Return the files of packages and tests, and the pages, that differ from the last commit.

    Of a clean tree those that its branch changes, or the last commit on the main branch; none outside of a git clone.
    """
    # a clone of a branch knows the main branch by its remote name alone, a shallow one by none
    for since in ("HEAD", "main...HEAD", "origin/main...HEAD", "HEAD~1"):
        files = git("diff", "--name-only", since)
        if since == "HEAD":
            files += git("ls-files", "--others", "--exclude-standard")
        if files:
            return files
    return []


def git(*words: str) -> list[str]:
    """Return the lines that git prints about packages, tests and pages, none where it fails."""
    command = ["git", *words, "--", *PACKAGES, "tests", "docs/*.md", "README.md"]
    try:
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.splitlines()
    except OSError:
        return []


@cache
def table() -> dict[str, list[str]]:
    """Return cases and test files of every module, those that concern it most first."""
    return dict(json.loads(TABLE.read_text(encoding="utf-8")))


def tests_of(path: str) -> list[str]:
    """Return what concerns a changed file, by its package where the table does not list it."""
    if path.startswith("tests/"):
        return [path.removeprefix("tests/")] if Path(path).name.startswith("test_") else []
    if path.endswith(".md"):
        blocks = f"test_pages.py::test_python_blocks_of_a_page_run_one_after_another[{path}]"
        return [blocks, "test_documented_lines.py"]
    for part in (path, *(f"{parent.as_posix()}/" for parent in Path(path).parents)):
        if found := [files for module, files in table().items() if module.startswith(part)]:
            return in_turn(found)
    return []


def in_turn(ranked: Iterable[Iterable[str]]) -> list[str]:
    """Return the first of each, then the second of each and so on, each one once."""
    return list(dict.fromkeys(each for each in chain.from_iterable(zip_longest(*ranked)) if each is not None))


# The table -----------------------------------------------------------------------------------------------------------


class Watch:
    """Notes the lines of the packages, by module and number, that every case of a run executes."""

    def __init__(self) -> None:
        self.cases: dict[str, Lines] = {}
        self.seconds: Counter[str] = Counter()
        self.lines: Lines = set()
        _watch.use_tool_id(_watch.COVERAGE_ID, "concerned")
        _watch.register_callback(_watch.COVERAGE_ID, _watch.events.LINE, self.line)
        _watch.set_events(_watch.COVERAGE_ID, _watch.events.LINE)

    def line(self, code: Any, number: int) -> object:
        """Note a line the first time that a case runs it."""
        name = code.co_filename.removeprefix(f"{ROOT}/")
        if name.startswith(PACKAGES):
            self.lines.add((name, number))
        return _watch.DISABLE

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Begin a case."""
        self.lines = self.cases[nodeid] = set()
        _watch.restart_events()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the processor seconds of a phase."""
        self.seconds[report.nodeid] += getattr(report, budgets.TAKEN)


def watched(file: str) -> tuple[dict[str, Lines], Counter[str]]:
    """Run a test file and return the lines and processor seconds of its cases."""
    watch = Watch()
    pytest.main(["-q", "-n", "0", file], plugins=[watch])
    return watch.cases, watch.seconds


def table_of(lines: Mapping[str, Lines]) -> dict[str, list[str]]:
    """Return cases and test files of every module, given the lines that each case runs.

    The weight of a line is divided among the files that run it. Where the quick run would ask a line of fewer than
    `LEAST_CASES` cases, the shortest that run it are listed.
    """
    always = budgets.representatives(lines)
    modules: defaultdict[str, defaultdict[int, list[str]]] = defaultdict(lambda: defaultdict(list))
    for case, run in lines.items():
        for module, number in run:
            modules[module][number].append(case)
    table = {}
    for module, found in sorted(modules.items()):
        weights: Counter[str] = Counter()
        for cases in found.values():
            files = set(map(budgets.file_of, cases))
            weights.update({file: 1 / len(files) for file in files})
        named = nlargest(MOST_FILES, sorted(weights), key=weights.__getitem__)
        asked, rare = {*always, *budgets.besides(lines, always, named)}, []
        for cases in found.values():
            further = sorted(set(cases) - asked, key=lambda case: (budgets.seconds_of(case), case))
            rare += further[: max(LEAST_CASES + len(further) - len(cases), 0)]
            asked.update(rare)
        table[module] = [case.removeprefix("tests/") for case in rare] + named
    return table


if __name__ == "__main__":
    lines: dict[str, Lines] = {}
    seconds = Counter[str]()
    with ProcessPoolExecutor(2, max_tasks_per_child=1) as processes:
        for ran, took in processes.map(watched, sorted(map(str, TESTS.rglob("test_*.py")))):
            lines |= ran
            seconds.update(took)
    # What is listed is what a quick run measured. Here lines take longer, and the first of a file prepares for all.
    slow = {case: float(seconds[case]) for case in lines if seconds[case] > 2.0 * budgets.A_MOMENT}
    slow |= {case: known for case, known in budgets.slow().items() if case in lines}
    budgets.SLOW.write_text("".join(f"{slow[case]:.2f} {case}\n" for case in sorted(slow)), encoding="utf-8")
    budgets.slow.cache_clear()
    TABLE.write_text(json.dumps(table_of(lines), indent=0, ensure_ascii=False) + "\n", encoding="utf-8")
