"""What a step of the energy-momentum scheme costs and keeps: `python benchmarks/energy_momentum.py [steps]`.

For the mechanisms of `tests/conserved.py`: microseconds of the processor a step (the smallest of several runs) as
expressions, as machine code, and as machine code with rotations as unknowns; Newton iterations a step, the drift of
energy (of the first kinetic energy) and of angular momentum (of its size), and how far constraints and their rates are
from zero at the instants.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

import servocore as sc

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import conserved

MECHANISMS = {
    conserved.free_body: (0.1, 0.01),
    conserved.heavy_top: (0.01,),
    conserved.crane: (0.1, 0.01),
    conserved.braked_crane: (0.1, 0.01),
    conserved.four_bar: (0.03, 0.01),
    conserved.floating_loop: (0.1, 0.01),
}
METHODS = {
    "expressions": sc.EnergyMomentum(native=False),
    "machine code": sc.EnergyMomentum(native=True),
    "rotations": sc.EnergyMomentum(sc.RotationUpdate(), native=True),
}
REPEATS = 5


def timed(motion: conserved.Motion, step: float, steps: int, method: sc.EnergyMomentum) -> tuple[float, sc.Solution]:
    """Return the smallest time a step in microseconds, and the solution."""
    times = []
    motion.run(step, 10, method=method)  # compiled before it is timed
    for _ in range(REPEATS):
        began = time.process_time()
        found = motion.run(step, steps, every=steps // 10, method=method)
        times.append(time.process_time() - began)
    return min(times) / steps * 1e6, found


def main(steps: int) -> None:
    """Print the table."""
    table = Table(title=f"energy-momentum, us a step over {steps} steps")
    for heading in ("mechanism", "coordinates", "step, s", *METHODS, "Newton", "energy", "momentum", "g", "G v"):
        table.add_column(heading, justify="left" if heading == "mechanism" else "right")
    for make, sizes in MECHANISMS.items():
        motion = make()
        for step in sizes:
            runs = [timed(motion, step, steps, method) for method in METHODS.values()]
            found = runs[1][1]
            energy, momentum = motion.drift(found)
            table.add_row(
                motion.system.name,
                str(len(motion.system.coordinates)),
                f"{step:g}",
                *(f"{cost:.3g}" for cost, _ in runs),
                f"{found.statistics.newton_iterations / steps:.2f}",
                f"{energy:.1e}",
                f"{momentum:.1e}" if motion.axes else "-",
                f"{found.statistics.constraint_violation:.1e}",
                f"{found.statistics.constraint_rate_violation:.1e}",
            )
    Console(width=130).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
