"""Settings of the whole test run. Problems come from `problems`, inherited tests from `suite`."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

import servocore as sc

pytest.register_assert_rewrite("problems", "suite")

BUILT = "SERVOCORE_TEST_FMUS"
"""Environment variable with the folder in which all processes of a run find the FMUs that one of them has built."""


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # the process that starts the others
        os.environ[BUILT] = tempfile.mkdtemp(prefix="fmus of a test run ")
        os.environ["SERVOCORE_CACHE"] = tempfile.mkdtemp(prefix="machine code of a test run ")
        os.environ["SERVOCORE_MACHINE_CODE"] = "off"  # a compiler beside every test would take their time


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        for name in (BUILT, "SERVOCORE_CACHE"):
            shutil.rmtree(os.environ.pop(name), ignore_errors=True)


@pytest.fixture
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the test in a folder of its own, where commands write their files."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def compiler() -> list[str]:
    """Return the command of this machine's C compiler."""
    try:
        return sc.c_compiler()
    except sc.InvalidSetting as error:
        pytest.skip(str(error))


# The same examples every time, and no stop-watch: compilation makes first examples slow.
settings.register_profile("repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")

# Other examples every night, and more of them: `make nightly` gives the seed, and says it.
FRESH, TIMES_AS_MANY = "fresh", 5
settings.register_profile(FRESH, settings.get_profile("repeatable"), derandomize=False, print_blob=True)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--hypothesis-profile", None) != FRESH:
        return
    tests = {getattr(item.obj, "__func__", item.obj) for item in items if hasattr(item, "obj")}
    for test in tests:
        own = getattr(test, "_hypothesis_internal_use_settings", None)
        if own is not None:
            test._hypothesis_internal_use_settings = settings(own, max_examples=TIMES_AS_MANY * own.max_examples)
