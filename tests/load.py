"""Many instances and many steps in one process: ``python load.py FMU INSTANCES STEPS [THREADS]``, figures as JSON.

All instances are made, a tenth of the steps warms up; what the process holds then is compared with the end.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import tempfile
import threading
from pathlib import Path

import casadi  # noqa: F401 -- what a host may have imported already
from fmpy import extract
from hostile_fmu import OK, Fmu, Instance

ROUND = 50  # steps of an instance before it is the next one's turn


def resident() -> int:
    """Bytes of memory that the process holds."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


class Driven:
    """An instance that swings its load gently, or has nothing connected."""

    def __init__(self, fmu: Fmu, k: int) -> None:
        self.fmu, self.instance, self.steps = fmu, Instance(fmu, lambda _: None), 0
        self.size = 0.1 + 0.01 * (k % 50)  # each instance has another
        for call in (("setup", 0.0), ("enter",), ("leave",)):
            assert self.instance.do(call) == OK, self.instance.messages

    def advance(self, count: int) -> None:
        for _ in range(count):
            t = self.steps * 0.01
            if self.fmu.follows_a_path:
                self.instance.set_reals(self.fmu.inputs, self.fmu.swinging(t, self.size))
            assert self.instance.step(t, 0.01) == OK, self.instance.messages[-1:]
            self.steps += 1
        self.instance.everything()


def load(fmu: Fmu, instances: int, steps: int) -> dict[str, float]:
    """Step all instances in turn and report growth."""
    before = resident()
    all_driven = [Driven(fmu, k) for k in range(instances)]
    each = steps // instances
    warm = each // 10
    grown: list[int] = []
    for goal in (warm, each):
        while all_driven[-1].steps < goal:
            for driven in all_driven:
                driven.advance(min(ROUND, goal - driven.steps))
        gc.collect()
        grown.append(resident())
    for driven in all_driven:
        driven.instance.free()
    return {
        "steps": float(sum(driven.steps for driven in all_driven)),
        "resident": float(grown[0]),
        "growth": grown[1] / grown[0] - 1.0,
        "an instance": (grown[0] - before) / instances,
    }


def in_threads(fmu: Fmu, threads: int, steps: int) -> dict[str, float]:
    """Step instances in a thread each; they must give what they give one after the other."""

    def results(*, together: bool) -> list[object]:
        all_driven = [Driven(fmu, k) for k in range(threads)]
        runs = [threading.Thread(target=driven.advance, args=(steps,)) for driven in all_driven]
        for run in runs:
            run.start()
            if not together:
                run.join()
        for run in runs:
            run.join()
        return [driven.instance.everything() for driven in all_driven]

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        return {"equal": float(results(together=True) == results(together=False))}
    finally:
        sys.setswitchinterval(interval)


def main(file: str, instances: str, steps: str, threads: str = "0") -> None:
    """Print the figures."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        fmu = Fmu(Path(str(extract(file, folder))))
        found = in_threads(fmu, int(threads), int(steps)) if int(threads) else load(fmu, int(instances), int(steps))
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
