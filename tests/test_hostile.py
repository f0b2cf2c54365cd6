"""Hostile use: random sequences of FMI calls, in a process of their own, so that a crash is one failed test.

`make hostile` runs ten thousand sequences (`python tests/hostile.py FMU 10000`), these are a sample.
"""

from __future__ import annotations

import os
import sys
from functools import partial

import pytest
from fmu_host import fmu_file, in_a_process

from crane_fmu.catalogue import KINDS

FILES = {name: partial(fmu_file, name) for name in KINDS}
SEQUENCES = int(os.environ.get("SERVOCORE_HOSTILE_SEQUENCES", "100"))
SEED = os.environ.get("SERVOCORE_HOSTILE_SEED", "0")

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the calls are made through the Linux binary")


def last_sequence(said: str) -> str:
    """Calls of the sequence that was running, and what followed."""
    return said[said.rfind("--- a new sequence") :] if "Traceback" not in said else said[said.rfind("Traceback") :]


@pytest.mark.parametrize("name", FILES)
def test_no_sequence_of_calls_ends_the_process_or_leaves_a_trace(name: str) -> None:
    sequences = str(SEQUENCES if name == "RotaryCrane" or SEQUENCES > 1000 else SEQUENCES // 4)
    done = in_a_process(
        "import sys, hostile; hostile.main(*sys.argv[1:])",
        FILES[name](),
        sequences,
        SEED,
        seconds=120 + SEQUENCES,
    )
    assert done.returncode == 0, f"ended with {done.returncode}:\n{last_sequence(done.stderr)[-8000:]}"
    print(f"{name}: {done.stdout.strip()}")
    assert done.stdout.startswith(f"{sequences} sequences survived")


FAULTS = {
    "a state that is not restored": "Instance.set_state = lambda self, state: 0",
    "an input that is lost": "set_reals = Instance.set_reals\n"
    "Instance.set_reals = lambda self, r, v: set_reals(self, r[:3], v[:3]) if self.messages else set_reals(self, r, v)",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_machine_is_not_blind(fault: str) -> None:
    code = f"import sys, hostile\nfrom hostile_fmu import Instance\n{FAULTS[fault]}\nhostile.main(*sys.argv[1:])"
    done = in_a_process(code, fmu_file(), "300", SEED, "no", seconds=100)
    assert done.returncode == 1, done.stdout
    assert "AssertionError" in done.stderr
