"""Processor seconds of every test file, children included, beside the budget that `budgets.toml` gives it.

A run ends with the files that are over theirs; ``--most-of-budget 2`` makes it fail where one takes more than twice.
FMUs that many files run are built by the first that needs them and counted apart. ``--write-slow`` writes the list of
cases that ``--quick`` leaves out, from what they have just taken; with ``--quick`` it adds those that took long there.
"""

from __future__ import annotations

import resource
import tomllib
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

TABLE = Path(__file__).with_name("budgets.toml")
SLOW = Path(__file__).with_name("slow_cases.txt")
FURTHER = Path(__file__).with_name("further_cases.txt")
"""Cases beside the first of their functions, of little cost, that run lines which few others of `--quick` run;
functions of which each case claims something of its own, as refusals do."""
UNLISTED = 2.0
"""Processor seconds of a file that the table does not list."""
A_MOMENT = 0.3
"""Processor seconds of a case that `--quick` may take."""
A_SECOND = 1.0
"""Processor seconds that such a case may take where it is the first to prepare what others of its file prepared."""
LONG_FIXTURES = {"client", "default_plan", "done", "drawings", "smoke"}
"""Of a module each, and seconds long: `--quick` leaves out what uses them."""
BUILT = "FMUs for all files"
_TAKEN, _SHARED = "processor_seconds", "shared_seconds"
_shared = [0.0]  # since the last report of this process


def processor_seconds() -> float:
    """Return what this process and those of its children that have ended have computed."""
    of = (resource.getrusage(each) for each in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in of)


@cache
def budgets(table: Path = TABLE) -> dict[str, float]:
    """Return the processor seconds that each listed file may take, by its path below the folder of the tests."""
    return {name: float(seconds) for name, seconds in tomllib.loads(table.read_text())["seconds"].items()}


def over_budget(taken: Mapping[str, float], allowed: Mapping[str, float], times: float = 1.0) -> list[str]:
    """Return a line for every file that took more than so many times its budget, the worst first."""
    worst = sorted(taken, key=lambda name: taken[name] - times * allowed.get(name, UNLISTED), reverse=True)
    return [
        f"{name} took {taken[name]:.1f} s, its budget is {allowed.get(name, UNLISTED):g} s"
        for name in worst
        if taken[name] > times * allowed.get(name, UNLISTED)
    ]


@contextmanager
def shared_by_all_files() -> Iterator[None]:
    """Count what is computed within as that of all files."""
    before = processor_seconds()
    yield
    _shared[0] += processor_seconds() - before


def function_of(case: str) -> str:
    """Return the test function of a case."""
    return case.partition("[")[0]


def budget_of(item: pytest.Item) -> float:
    """Return the budget of a test's file: the longest begin, so that both processes end together."""
    return budgets().get(item.nodeid.partition("::")[0].removeprefix("tests/"), UNLISTED)


def representatives(items: Sequence[pytest.Item]) -> list[pytest.Item]:
    """Return of every test function the first case that is not listed as slow, and those that are listed besides.

    A function that is listed there without a case is listed with all. What prepares something for seconds is left out.
    """
    slow, further = listed(SLOW), listed(FURTHER)
    first: dict[str, pytest.Item] = {}
    for item in items:
        if item.nodeid not in slow and LONG_FIXTURES.isdisjoint(getattr(item, "fixturenames", ())):
            listed_too = further & {item.nodeid, function_of(item.nodeid)}
            first.setdefault(item.nodeid if listed_too else function_of(item.nodeid), item)
    return list(first.values())


def listed(table: Path) -> set[str]:
    """Return the cases of a list."""
    return set(table.read_text(encoding="utf-8").splitlines())


def slow_cases(taken: Mapping[str, float]) -> list[str]:
    """Return the cases that take more than a moment and stand before one of their function that does not.

    The shortest case of a file without such a one is not among them: every file is asked something.
    """
    functions, files = grouped(taken, function_of), grouped(taken, lambda case: case.partition("::")[0])
    found: set[str] = set()
    for cases in functions.values():
        quick = next((k for k, case in enumerate(cases) if taken[case] <= A_MOMENT), len(cases))
        found.update(cases[:quick])
    shortest = {min(cases, key=lambda case: taken[case]) for cases in files.values() if found.issuperset(cases)}
    return sorted(found - shortest)


def slow_alone(taken: Mapping[str, float]) -> list[str]:
    """Return the cases of a quick run that took more than a second, but for the only ones of their files."""
    files = grouped(taken, lambda case: case.partition("::")[0])
    return [case for cases in files.values() for case in cases if taken[case] > A_SECOND and len(cases) > 1]


def grouped(cases: Iterable[str], key: Callable[[str], str]) -> dict[str, list[str]]:
    """Return cases in their order, by a part of their names."""
    found: defaultdict[str, list[str]] = defaultdict(list)
    for case in cases:
        found[key(case)].append(case)
    return found


class Meter:
    """Adds up what the phases of every test take: in the process that runs them, or in the one that hears of them."""

    def __init__(self, times: float | None, writes: bool, quick: bool) -> None:
        self.times, self.writes, self.quick = times, writes, quick
        self.files: defaultdict[str, float] = defaultdict(float)
        self.cases: defaultdict[str, float] = defaultdict(float)
        self._before = processor_seconds()

    def pytest_collection_finish(self) -> None:
        """Count from here: no test is to blame for what finding all of them took."""
        self._before = processor_seconds()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Write into the report of a phase, which travels between processes, what was computed since the last."""
        report = yield
        now = processor_seconds()
        setattr(report, _SHARED, _shared[0])
        setattr(report, _TAKEN, now - self._before - _shared[0])
        self._before, _shared[0] = now, 0.0
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the phase to its case and file."""
        file = report.nodeid.partition("::")[0]
        taken = float(getattr(report, _TAKEN, 0.0))
        self.cases[report.nodeid] += taken
        self.files[file.removeprefix("tests/")] += taken
        self.files[BUILT] += float(getattr(report, _SHARED, 0.0))

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """List the files over budget."""
        terminalreporter.section(f"{sum(self.files.values()):.0f} processor seconds in tests")
        for line in over_budget(self.files, budgets()) or ["no file is over its budget"]:
            terminalreporter.write_line(line)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a run with a file that took too many times its budget; write what was slow."""
        if hasattr(session.config, "workerinput"):
            return
        if self.writes:
            slow = {*listed(SLOW), *slow_alone(self.cases)} if self.quick else slow_cases(self.cases)
            SLOW.write_text("".join(f"{case}\n" for case in sorted(slow)), encoding="utf-8")
        beyond = self.times is not None and over_budget(self.files, budgets(), self.times)
        if beyond and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
