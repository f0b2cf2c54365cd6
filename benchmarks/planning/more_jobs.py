"""Random jobs of other cranes and of the elastic bar, and jobs that nothing can do, each refused with a true reason.

`python -m benchmarks.planning.more_jobs` (a part of `make jobs`) writes docs/planning/more_jobs.csv.
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import servocore as sc
from benchmarks.planning.jobs import WEIGHT, job

TARGET = Path(__file__).parents[2] / "docs" / "planning" / "more_jobs.csv"
HEADER = ("scene", "job", "T", "T9", "T3", "violation", "seconds", "refused")
COUNT, INTERVALS = 20, 20

Job = tuple[Any, dict[str, Any]]


def overhead(random: np.random.Generator) -> Job:
    """Return two places and limits that the load at rest keeps."""
    way = [(0.0, random.uniform(-6.0, -2.0)), (random.uniform(1.0, 8.0), random.uniform(-6.0, -2.0))]
    return way, {"F": log_uniform(random, 50.0, 500.0), "M_w": around(random), "swing": swing(random)}


def gantry(random: np.random.Generator) -> Job:
    """Return two places and limits that the load at rest keeps."""
    way = [(0.0, 0.0, random.uniform(-6.0, -2.0)), (*random.uniform(1.0, 8.0, 2), random.uniform(-6.0, -2.0))]
    limits = {"F_x": log_uniform(random, 50.0, 500.0), "F_y": log_uniform(random, 50.0, 500.0)}
    return way, {**limits, "M_w": around(random), "swing": swing(random)}


def bar(random: np.random.Generator) -> Job:
    """Return a way of the bar's end and a limit of its force."""
    return [(0.0,), (random.uniform(0.5, 2.0),)], {"u": log_uniform(random, 20.0, 200.0)}


def impossible(random: np.random.Generator) -> tuple[Job, str]:
    """Return a job of the rotary crane with one limit that is broken at rest, and what it is on."""
    way, limits = job(int(random.integers(1000)))
    name = str(random.choice(["M_w", "tension", "l"]))
    broken = {
        "M_w": (WEIGHT + random.uniform(0.5, 20.0), WEIGHT + 40.0),  # it cannot hold the load
        "tension": (800.0, 981.0 - random.uniform(1.0, 100.0)),  # less than the weight, m g = 981 N
        "l": float(-way[:, 2].min() - random.uniform(0.01, 0.5)),  # shorter than the deepest waypoint asks for
    }
    return (way, {**{k: v for k, v in limits.items() if k not in broken}, name: broken[name]}), name


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def around(random: np.random.Generator) -> tuple[float, float]:
    """Return limits of the winch's torque around what holds the load."""
    room = random.uniform(4.0, 25.0)
    return WEIGHT - room, WEIGHT + room


def swing(random: np.random.Generator) -> float:
    """Return a limit in rad."""
    return float(np.radians(random.uniform(3.0, 15.0)))


def row(scene: str, number: int, way: Any, limits: Mapping[str, Any]) -> tuple[str, ...]:
    """Plan a job and return its row of the table."""
    begun = time.process_time()
    try:
        _, report = sc.fastest(sc.scenes.REGISTRY[scene](), way, limits, intervals=INTERVALS)
    except sc.ServocoreError as error:
        return (scene, str(number), "", "", "", "", f"{time.process_time() - begun:.1f}", str(error))
    numbers = [f"{each:.4f}" for each in (report.duration, report.degree9, report.three_phase)]
    return (scene, str(number), *numbers, f"{report.violation:.1e}", f"{time.process_time() - begun:.1f}", "")


def main() -> int:
    """Plan all; returns 1 if a plan is slower than a known law, or a refusal does not name what is broken."""
    rows, wrong = [], 0
    makers: dict[str, Callable[[np.random.Generator], Job]] = {
        "overhead_crane": overhead,
        "gantry_crane": gantry,
        "elastic_bar": bar,
    }
    for number in range(COUNT):
        (way, limits), name = impossible(np.random.default_rng(number))
        rows.append(row("rotary_crane", number, way, limits))
        wrong += f"no law keeps the limit of {name}: even at rest" not in rows[-1][-1]
        print(", ".join(rows[-1]), flush=True)
    for scene, make in makers.items():
        for number in range(COUNT):
            rows.append(row(scene, number, *make(np.random.default_rng(number))))
            known = [float(each) for each in rows[-1][3:5] if each not in {"", "nan"}]
            wrong += bool(rows[-1][2]) and float(rows[-1][2]) > min(known)
            print(", ".join(rows[-1]), flush=True)
    with TARGET.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
