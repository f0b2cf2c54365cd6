"""What size costs: `make bench`, or `python -m benchmarks.size_cost [numbers of cranes]`.

Gantry cranes of 6 coordinates each stand side by side in one system, independent of one another. What they cost
together should be what they cost one by one: an exponent of one. Times are processor times, the smallest of several;
`analyse` and what is compiled before the first solve are done once a system, so once here.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

import servocore as sc
from benchmarks.copies import cranes

SIZES = (1, 4, 16, 40, 160)
STEPS = 200
INSTANTS = 1000
REPEATS = 5


def seconds(run: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the smallest processor time of several runs."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return min(times)


def measure(count: int) -> dict[str, float]:
    """Return times of one system in the units that the table names."""
    scene, _ = cranes(count)
    scene.model()
    step = scene.reference.duration / STEPS
    times = np.linspace(scene.reference.start_time, scene.reference.end_time, INSTANTS)
    found = {"analyse, s": seconds(lambda: sc.analyse(scene), 1)}
    inputs = sc.ExactInversion(scene)
    inputs(times)
    found["ExactInversion, us an instant"] = seconds(lambda: inputs(times)) / INSTANTS * 1e6
    for name, run in (
        ("solve", partial(sc.solve, scene, step=step)),
        ("projected backward Euler", partial(sc.solve, scene, sc.Projected(), sc.BackwardEuler(), step=step)),
    ):
        found[f"{name}: first, s"] = seconds(run, 1)
        found[f"{name}: {STEPS} steps, ms"] = seconds(run) * 1e3
    return found


def exponent(sizes: list[int], times: list[float]) -> float:
    """Return the slope of time over size in logarithms, from four cranes on: below, what is fixed shows."""
    kept = [k for k, size in enumerate(sizes) if size >= 4]
    if len(kept) < 2:
        return float("nan")
    return float(np.polyfit(np.log([sizes[k] for k in kept]), np.log([times[k] for k in kept]), 1)[0])


def main() -> None:
    """Measure and print."""
    sizes = [int(each) for each in sys.argv[1:]] or list(SIZES)
    sc.analyse(sc.scenes.gantry_crane())  # what is imported when first needed
    found = [measure(size) for size in sizes]
    table = Table(title="Gantry cranes in one system")
    for heading in ("", *map(str, sizes), "exponent"):
        table.add_column(heading, justify="right" if heading else "left")
    for name in found[0]:
        times = [each[name] for each in found]
        table.add_row(name, *(f"{each:.3g}" for each in times), f"{exponent(sizes, times):.2f}")
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
