"""Settings of the whole test run. Problems come from `problems`, inherited tests from `suite`."""

from __future__ import annotations

import gc
import math
import os
import shutil
import sys
import tempfile
from collections import defaultdict
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import budgets
import concerned
import kept_compiler
import pytest
from hypothesis import HealthCheck, settings
from present import present

import servocore as sc
from servocore.certificate.chebyshev import machine_code
from servocore.numerics.machine_code import built, c_compiler

pytest.register_assert_rewrite("problems", "suite")

BUILT = "SERVOCORE_TEST_FMUS"
"""Environment variable with the folder in which all processes of a run find the FMUs that one of them has built."""


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("servocore")
    group.addoption(
        "--quick", action="store_true", help="short cases, and cases that concern changed files: make quick"
    )
    group.addoption("--nightly", action="store_true", help="also what takes minutes, and all of families: make nightly")
    group.addoption("--most-of-budget", type=float, help="fail if a file takes more than so many times its budget")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # the process that starts the others
        os.environ[BUILT] = tempfile.mkdtemp(prefix="fmus of a test run ")
        os.environ["SERVOCORE_CACHE"] = tempfile.mkdtemp(prefix="machine code of a test run ")
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small: threads that wait take processor time
        os.environ["SERVOCORE_MACHINE_CODE"] = "off"  # a compiler beside every test would take their time
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes import the same modules
        os.environ.setdefault("CFLAGS", "-O0")  # of exported FMUs: a third of the time, and no digit depends on it
        keep_libraries(config)
    if config.getoption("--quick"):
        gc.disable()  # a run of a minute leaves little garbage, and to look for it takes a tenth of the time
    config.pluginmanager.register(budgets.Meter(config.getoption("--most-of-budget")))


def keep_libraries(config: pytest.Config) -> None:
    """Let the machine's C compiler keep what it builds, from run to run and for all processes."""
    compiler = shutil.which("cc")
    if sys.platform == "win32" or compiler is None or "CC" in os.environ:
        return
    cache = getattr(config, "cache", None)  # switched off by -p no:cacheprovider
    kept = cache.mkdir("libraries") if cache else Path(os.environ[BUILT], "libraries")
    kept.mkdir(exist_ok=True)
    tools = Path(os.environ[BUILT], "tools")
    tools.mkdir()
    (tools / "cc").write_text(kept_compiler.script(compiler), encoding="utf-8")
    (tools / "cc").chmod(0o755)
    os.environ["PATH"] = os.pathsep.join([str(tools), os.environ["PATH"]])
    os.environ[kept_compiler.KEPT] = str(kept)
    if config.getoption("--quick"):
        os.environ[kept_compiler.OPTIONS] = "-O0"


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        for name in (BUILT, "SERVOCORE_CACHE"):
            shutil.rmtree(os.environ.pop(name), ignore_errors=True)


@pytest.fixture(scope="session", autouse=True)
def products_in_machine_code() -> None:
    """Let certificates multiply in machine code, which is built in a moment and saves them a third of their time."""
    products = machine_code()
    with suppress(sc.InvalidSetting), pytest.MonkeyPatch.context() as whole:  # no compiler: by NumPy
        whole.delenv(kept_compiler.OPTIONS, raising=False)  # unoptimized it would take ten times as long
        products._loaded = products._load(built(present(products._make())))


@pytest.fixture
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the test in a folder of its own, where commands write their files."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def compiler() -> list[str]:
    """Return the command of this machine's C compiler."""
    try:
        return c_compiler()
    except sc.InvalidSetting as error:
        pytest.skip(str(error))


# The same examples every time, and no stop-watch: compilation makes first examples slow.
settings.register_profile("repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")

# Other examples every night, and more of them: `make nightly` gives the seed, and says it.
FRESH, TIMES_AS_MANY = "fresh", 5
A_FEW = 0.25
"""The share of examples in a quick run, but of tests that concern what has changed."""
settings.register_profile(FRESH, settings.get_profile("repeatable"), derandomize=False, print_blob=True)


@pytest.hookimpl(tryfirst=True)  # who sorts or marks what is left has less to do
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--nightly"):
        select(config, items, [item for item in items if not item.get_closest_marker("nightly")])
    if config.getoption("--quick"):
        asked = {
            item.nodeid: item for item in items if budgets.LONG_FIXTURES.isdisjoint(getattr(item, "fixturenames", ()))
        }
        chosen = budgets.representatives(asked)
        names = concerned.in_turn(map(concerned.tests_of, concerned.changed()))
        besides = budgets.besides(asked, chosen, names)
        for case in besides:
            asked[case].user_properties.append(budgets.ADDED)
        select(config, items, [asked[case] for case in (*chosen, *besides)])
        ask_examples([item for item in items if budgets.file_of(item.nodeid) not in names], A_FEW)
        of_file = defaultdict[str, float](float)
        for item in items:
            of_file[budgets.file_of(item.nodeid)] += budgets.seconds_of(item.nodeid)
    else:
        of_file = defaultdict(lambda: budgets.UNLISTED, budgets.budgets())
    # the longest files begin, so that both processes end together
    items.sort(key=lambda item: of_file[budgets.file_of(item.nodeid)], reverse=True)
    if config.getoption("--hypothesis-profile", None) == FRESH:
        ask_examples(items, TIMES_AS_MANY)


def pytest_runtest_teardown() -> None:
    """Close the figures of a test: pyplot keeps them, and warns of more than twenty."""
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what was collected: it would look at thousands of cases again and again."""
    gc.freeze()


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Name the changed files and count the cases that a quick run has added for them."""
    if config.getoption("--quick"):
        reports = chain.from_iterable(terminalreporter.stats.values())
        added = {each.nodeid for each in reports if budgets.ADDED in getattr(each, "user_properties", ())}
        files = " ".join(concerned.changed()) or "no file (git knows of none)"
        terminalreporter.write_line(f"{len(added)} cases were added for changes of {files}")


def select(config: pytest.Config, items: list[pytest.Item], chosen: list[pytest.Item]) -> None:
    """Leave the chosen tests among the items."""
    kept = set(chosen)
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = chosen


def ask_examples(items: list[pytest.Item], times: float) -> None:
    """Let Hypothesis try so many times the examples that it tries otherwise."""
    tests = {getattr(item.obj, "__func__", item.obj) for item in items if hasattr(item, "obj")}
    for test in tests:
        own = getattr(test, "_hypothesis_internal_use_settings", None)
        if own is not None:
            test._hypothesis_internal_use_settings = settings(own, max_examples=math.ceil(times * own.max_examples))
