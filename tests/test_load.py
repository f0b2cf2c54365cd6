"""Load: many instances and steps in one process, several threads, and what the FMU costs its host.

A sample of what `make load` runs: 200 instances and a million steps.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from fmu_host import fmu_file, in_a_process
from processes import python

from crane_fmu.catalogue import KINDS

FULL = os.environ.get("SERVOCORE_LOAD") == "full"
INSTANCES, STEPS = (200, 1_000_000) if FULL else (20, 10_000)

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="calls and memory are those of the Linux binary")


def run(*arguments: object) -> dict[str, float]:
    code = "import sys, load; load.main(*sys.argv[1:])"
    done = in_a_process(code, *map(str, arguments), seconds=1800 if FULL else 120)
    assert done.returncode == 0, done.stderr[-4000:]
    found: dict[str, float] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("name", KINDS)
def test_memory_does_not_grow_with_the_steps(name: str) -> None:
    found = run(fmu_file(name), INSTANCES, STEPS)
    print(found)
    assert found["steps"] == STEPS
    assert found["growth"] < 0.05
    assert found["an instance"] < 4e6


@pytest.mark.parametrize("name", KINDS)
def test_instances_may_be_stepped_in_threads(name: str) -> None:
    """CasADi lets other threads run while it evaluates, and its functions are shared by the instances."""
    assert run(fmu_file(name), 0, 500, 4)["equal"] == 1.0


@pytest.mark.skipif(not FULL, reason="times are measured by make load; here what they come from is counted")
def test_a_step_costs_three_times_what_pythonfmu_itself_does_and_an_instance_a_tenth_of_a_second() -> None:
    done = python(Path(__file__).parents[1] / "benchmarks" / "fmu_cost.py", fmu_file(), "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    print(found)
    assert found["ratio"]["points, reduced (default)"] <= 3.0  # measured: 1.9
    assert found["first instance"] < 100.0  # ms; measured: 20 to 70
    assert found["second instance"] < 20.0  # measured: 2
