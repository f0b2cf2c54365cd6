"""The loop where steps vary: ``python tests/loop_schedules.py [COUNT]`` counts how many loads are lost (some minutes).

Random manoeuvres of any crane, with 5 % mass error and a gust. Steps are between a longest one and a share of it:
anywhere between, or one or the other.
"""

from __future__ import annotations

import sys

import numpy as np
from loops import Case, deviation_over, fastest, random_case

from crane_fmu.build.native import LARGEST_TURN

LONGEST, FACTORS = (0.1, 0.05, 0.01), (2, 3, 10, 30)
KINDS = {
    "between": "anywhere between, by a constant density of their logarithm",
    "either": "half of them long, half short",
    "rarely": "one in fifty long",
    "events": "long, one in ten divided into a short one and the rest",
}


def schedule(rng: np.random.Generator, kind: str, longest: float, factor: float, time: float) -> np.ndarray:
    """Return steps that last until a time."""
    steps: list[float] = []
    short = longest / factor
    while time > 0.0:
        by_chance = rng.uniform()
        if kind == "between":
            more = [longest * factor**-by_chance]
        elif kind == "events":
            more = [short, longest - short] if by_chance < 0.1 else [longest]
        else:
            more = [longest if by_chance < {"either": 0.5, "rarely": 0.02}[kind] else short]
        steps += more
        time -= sum(more)
    return np.array(steps)


def distances(count: int, kind: str, longest: float, factor: float, at: str) -> np.ndarray:
    """Return the largest distances in mm of loads by chance; infinite where a load is lost."""
    rng, found = np.random.default_rng(3), list[float]()
    while len(found) < count:
        case: Case = random_case(rng, any_crane=True, disturbed=True)
        if fastest(case) * longest <= LARGEST_TURN:
            steps = schedule(rng, kind, longest, factor, case.reference.duration + 1.0)
            try:
                found.append(deviation_over(case, steps, at))
            except AssertionError:  # the plant has refused to go on, or the load was left to the feedforward
                found.append(np.inf)
    return np.array(found)


def main() -> int:
    """Print a line for each kind of schedule, and return whether loads were lost."""
    count, all_lost = int(sys.argv[1]) if len(sys.argv) > 1 else 20, 0
    for at, master in (("start", "Jacobi"), ("end", "Gauss-Seidel")):
        for kind, text in KINDS.items():
            for longest in LONGEST:
                for factor in FACTORS:
                    found = distances(count, kind, longest, factor, at)
                    lost = int(np.isinf(found).sum())
                    all_lost += lost
                    print(f"{master}, steps of {longest / factor:.3g} to {longest:g} s, {text}: {lost} of {count} lost,"
                          f" median {np.median(found):.2g}, largest {found.max():.2g} mm", flush=True)  # fmt: skip
    return int(all_lost > 0)


if __name__ == "__main__":
    sys.exit(main())
