"""What a sweep costs beside its compiled functions: `python -m benchmarks.sweep_cost [CASES]`, by default a million.

The same cases of the rotary crane, 201 instants each: by `sc.sweep` into a Zarr store, and in memory by two processes
that call a compiled function on the same arrays and keep nothing. That function is `sc.Batch`, which gives inputs and
swing at all instants, or the sweep's own, of which only peaks and margins come back. They take turns; imports and
machine code are made before. Printed are the best of the turns, cases a second by the clock and microseconds of the
processor a case, and the peak of memory of the process that sweeps.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import servocore as sc
from servocore.planning.sweep_cases import Cases, evaluated, work_of
from servocore.planning.sweep_settings import checked_settings

INSTANTS = 201
PROCESSES = 2
TURNS = 3
LIMITS = {"M_b": 400.0, "F": 40.0}
_AT_ONCE = 64

Rows = tuple[np.ndarray, np.ndarray]
Times = tuple[float, float]


def timed(run: Callable[[], object]) -> Times:
    """Return the time that something takes, and that of the processor."""
    begin, busy = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - begin, time.process_time() - busy


def batch(share: Rows) -> Times:
    """Call `sc.Batch` for the cases of a share."""
    compiled = sc.Batch(sc.scenes.rotary_crane(), ("M_b", "F", "M_w", "swing"), native=True)
    t, (loads, trolleys) = np.linspace(0.0, 20.0, INSTANTS), share

    def run(last: int) -> None:
        for first in range(0, last, _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            compiled(t, {"load_mass": loads[some], "trolley_mass": trolleys[some]})

    run(_AT_ONCE)
    return timed(lambda: run(len(loads)))


def reduced(share: Rows) -> Times:
    """Call the function of a sweep for the cases of a share."""
    swept = checked_settings(sc.scenes.rotary_crane(), {"load_mass": [90.0]}, None, LIMITS, INSTANTS, False, None)
    problem, path = swept.problem, swept.references[0]
    jets = path.jet(np.linspace(path.start_time, path.end_time, INSTANTS), problem.array.reference_order)
    jets *= path.duration ** np.arange(jets.shape[1])[:, None]  # as of the path in a second
    numbers = np.tile([path.duration, *problem.p], (len(share[0]), 1))
    for name, values in zip(("load_mass", "trolley_mass"), share, strict=True):
        numbers[:, 1 + problem.system.parameters.names.index(name)] = values
    work = work_of(problem, swept.limits, False, True)
    of_path = {0: np.ascontiguousarray(jets.reshape(INSTANTS, -1).T)}

    def run(last: int) -> None:
        evaluated(work, Cases(of_path, np.zeros(last, dtype=int), numbers[:last]))

    run(_AT_ONCE)
    return timed(lambda: run(len(numbers)))


def in_memory(pool: Executor, call: Callable[[Rows], Times], loads: np.ndarray, trolleys: np.ndarray) -> Times:
    """Have two processes do what one of the above does."""
    shares = zip(np.array_split(loads, PROCESSES), np.array_split(trolleys, PROCESSES), strict=True)
    clock, busy = zip(*pool.map(call, shares), strict=True)
    return max(clock), sum(busy)


def swept_into_a_store(varied: dict[str, np.ndarray]) -> Times:
    """Sweep the cases into a store."""
    with tempfile.TemporaryDirectory() as folder:
        crane, store = sc.scenes.rotary_crane(), Path(folder) / "s.zarr"
        return timed(lambda: sc.sweep(crane, varied, limits=LIMITS, instants=INSTANTS, native=True, store=store))


def main() -> None:
    """Run all and print."""
    side = round((int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000) ** 0.5)
    varied = {"load_mass": np.linspace(50.0, 150.0, side), "trolley_mass": np.linspace(5.0, 15.0, side)}
    loads, trolleys = (each.ravel() for each in np.meshgrid(*varied.values(), indexing="ij"))
    swept_into_a_store({name: values[:2] for name, values in varied.items()})  # imports, machine code
    found: dict[str, list[Times]] = {"sc.Batch": [], "the sweep's own function": [], "sc.sweep into a store": []}
    with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as pool:
        for _ in range(TURNS):
            found["sc.Batch"].append(in_memory(pool, batch, loads, trolleys))
            found["the sweep's own function"].append(in_memory(pool, reduced, loads, trolleys))
            found["sc.sweep into a store"].append(swept_into_a_store(varied))
    print(f"{len(loads)} cases of {INSTANTS} instants")
    clock, busy = (min(times) for times in zip(*found["sc.sweep into a store"], strict=True))
    for name, times in found.items():
        own, own_busy = (min(each) for each in zip(*times, strict=True))
        print(
            f"{name:25}: {len(loads) / own:.0f} cases/s, {1e6 * own_busy / len(loads):.2f} us of the processor a case;"
            f" the sweep has {own / clock:.2f} of its rate, by processor time {own_busy / busy:.2f}"
        )
    print(f"peak of memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
