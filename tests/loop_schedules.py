"""The loop where steps vary.

Random manoeuvres of any crane, with 5 % mass error and a gust. Steps are between a longest one and a share of it:
anywhere between, or one or the other.
"""

from __future__ import annotations

import numpy as np
from loops import Case, deviation_over, fastest, random_case

from crane_fmu.build.native import LARGEST_TURN

KINDS = ("between", "either", "rarely", "events")
"""Anywhere between; half of them long, half short; one in fifty long; long, one in ten divided into two."""


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
