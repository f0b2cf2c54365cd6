"""Processor seconds of every test file, children included, beside the budget that `budgets.toml` gives it.

A run ends with the files that are over theirs; ``--most-of-budget 2`` makes it fail where one takes more than twice.
FMUs that many files run are built by the first that needs them and counted apart.
"""

from __future__ import annotations

import resource
import tomllib
from collections import defaultdict
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

TABLE = Path(__file__).with_name("budgets.toml")
SLOW = Path(__file__).with_name("slow_cases.txt")
"""Cases that take more than a moment when their file or a quick run asks them, with their seconds in a quick run, where
others may have prepared what they need: `concerned.py` adds new ones."""
UNLISTED = 2.0
"""Processor seconds of a file that the table does not list."""
A_MOMENT = 0.25
"""Processor seconds of a case that `--quick` runs whatever has changed."""
A_SHORT_CASE = 0.03
"""Processor seconds of a case that is not listed as slow, about."""
BESIDES = 4.0
"""Processor seconds of the cases that `--quick` adds for the modules that have changed."""
LONG_FIXTURES = {"client", "smoke"}
"""Of a module each, and seconds long: `--quick` leaves out what uses them."""
BUILT = "FMUs for all files"
ADDED = ("added", "for changed modules")
"""Property of a case that `--quick` runs besides."""
TAKEN, _SHARED = "processor_seconds", "shared_seconds"
_shared = [0.0]  # since the last report of this process


def processor_seconds() -> float:
    """Return what this process and those of its children that have ended have computed."""
    of = (resource.getrusage(each) for each in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in of)


@cache
def budgets() -> dict[str, float]:
    """Return the processor seconds that each listed file may take, by its path below the folder of the tests."""
    return {name: float(seconds) for name, seconds in tomllib.loads(TABLE.read_text())["seconds"].items()}


@cache
def dear_but_asked() -> set[str]:
    """Return the test functions that a quick run asks though none of their cases takes a moment only."""
    return {f"tests/{name}" for name in tomllib.loads(TABLE.read_text())["quick"]["dear"]}


def over_budget(taken: Mapping[str, float], allowed: Mapping[str, float], times: float = 1.0) -> list[str]:
    """Return a line for every file that took more than so many times its budget, the worst first."""
    beyond = {name: seconds - times * allowed.get(name, UNLISTED) for name, seconds in taken.items()}
    return [
        f"{name} took {taken[name]:.1f} s, its budget is {allowed.get(name, UNLISTED):g} s"
        for name in sorted(beyond, key=beyond.__getitem__, reverse=True)
        if beyond[name] > 0
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


def file_of(case: str) -> str:
    """Return the file of a case below the folder of the tests."""
    return case.partition("::")[0].removeprefix("tests/")


def seconds_of(case: str) -> float:
    """Return the processor seconds that a case takes, about."""
    return slow().get(case, A_SHORT_CASE)


def representatives(cases: Collection[str]) -> list[str]:
    """Return the shortest case of every test function, where it is short or named in the table, and of every file."""
    shortest, of_file = dict[str, str](), dict[str, str]()
    for case in cases:
        for known, key in ((shortest, function_of(case)), (of_file, file_of(case))):
            if seconds_of(case) < seconds_of(known.setdefault(key, case)):
                known[key] = case
    chosen = [case for name, case in shortest.items() if seconds_of(case) <= A_MOMENT or name in dear_but_asked()]
    without = of_file.keys() - set(map(file_of, chosen))
    return [*chosen, *(of_file[file] for file in sorted(without))]


def besides(cases: Iterable[str], chosen: Iterable[str], names: Sequence[str]) -> list[str]:
    """Return further cases, named or of named files, as far as the time allows.

    Cases that are named precede short ones, and these long ones, of which those of the first files count as shorter.
    """
    rank = {name: place for place, name in enumerate(names, 1)}
    weights = {case: seconds_of(case) * rank[file_of(case)] for case in cases if file_of(case) in rank}
    weights |= {case: 0.0 for case in cases if case.removeprefix("tests/") in rank}
    left, found = BESIDES, list[str]()
    for case in sorted(weights.keys() - set(chosen), key=lambda case: (weights[case], case)):
        if seconds_of(case) <= left:
            left -= seconds_of(case)
            found.append(case)
    return found


@cache
def slow() -> dict[str, float]:
    """Return the processor seconds of the cases that `SLOW` lists."""
    rows = (line.partition(" ") for line in SLOW.read_text(encoding="utf-8").splitlines())
    return {case: float(seconds) for seconds, _, case in rows}


class Meter:
    """Adds up what the phases of every test take: in the process that runs them, or in the one that hears of them."""

    def __init__(self, times: float | None) -> None:
        self.times = times
        self.files: defaultdict[str, float] = defaultdict(float)
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
        setattr(report, TAKEN, now - self._before - _shared[0])
        self._before, _shared[0] = now, 0.0
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the phase to its file."""
        self.files[file_of(report.nodeid)] += float(getattr(report, TAKEN, 0.0))
        self.files[BUILT] += float(getattr(report, _SHARED, 0.0))

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """List the files over budget."""
        terminalreporter.section(f"{sum(self.files.values()):.0f} processor seconds in tests")
        for line in over_budget(self.files, budgets()) or ["no file is over its budget"]:
            terminalreporter.write_line(line)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a run with a file that took too many times its budget."""
        if hasattr(session.config, "workerinput"):
            return
        beyond = self.times is not None and over_budget(self.files, budgets(), self.times)
        if beyond and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
