"""What a sweep costs beside its compiled function: `python -m benchmarks.sweep [CASES]` (a million when not given).

The same cases of the rotary crane, 201 instants each: by `sc.sweep` into a Zarr store, and by two processes that call
the compiled function on arrays in memory and keep nothing.
Printed are cases a second, their ratio, and the peak of memory.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import servocore as sc

INSTANTS = 201
PROCESSES = 2
LIMITS = {"M_b": 400.0, "F": 40.0}
_AT_ONCE = 64


def ranges(cases: int) -> dict[str, np.ndarray]:
    """Return two rows of parameters whose product has so many cases, nearly."""
    side = round(cases**0.5)
    return {"load_mass": np.linspace(50.0, 150.0, side), "trolley_mass": np.linspace(5.0, 15.0, side)}


def bare(share: tuple[np.ndarray, np.ndarray]) -> float:
    """Call the compiled function for all cases of a share; return the time it took."""
    batch = sc.Batch(sc.scenes.rotary_crane(), ("M_b", "F", "M_w", "swing"), native=True)
    t = np.linspace(0.0, 20.0, INSTANTS)
    loads, trolleys = share
    batch(t, {"load_mass": loads[:1], "trolley_mass": trolleys[:1]})
    begin = time.perf_counter()
    for first in range(0, len(loads), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        batch(t, {"load_mass": loads[some], "trolley_mass": trolleys[some]})
    return time.perf_counter() - begin


def main() -> None:
    """Run both and print."""
    varied = ranges(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
    loads, trolleys = (each.ravel() for each in np.meshgrid(*varied.values(), indexing="ij"))
    parts = np.array_split(np.arange(len(loads)), PROCESSES)
    with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as pool:
        slowest = max(pool.map(bare, [(loads[part], trolleys[part]) for part in parts]))
    crane = sc.scenes.rotary_crane()
    sc.sweep(crane, {"load_mass": [90.0, 110.0]}, limits=LIMITS, instants=INSTANTS, native=True)  # compiled once
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        sc.sweep(crane, varied, limits=LIMITS, instants=INSTANTS, store=Path(folder) / "sweep.zarr", native=True)
        seconds = time.perf_counter() - begin
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{len(loads)} cases of {INSTANTS} instants")
    print(f"compiled function, {PROCESSES} processes: {len(loads) / slowest:.0f} cases/s")
    print(f"sweep into a store: {len(loads) / seconds:.0f} cases/s, {slowest / seconds:.2f} of it")
    print(f"peak of memory: {memory:.0f} MB")


if __name__ == "__main__":
    main()
