"""A hundred random jobs of the rotary crane: each certified or refused with a true reason, none slower than known laws.

`python -m benchmarks.planning.jobs` (`make jobs`) writes docs/planning/jobs.csv.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import servocore as sc

TARGET = Path(__file__).parents[2] / "docs" / "planning" / "jobs.csv"
WEIGHT = -98.1
HEADER = ("job", "waypoints", "T", "T9", "T3", "violation", "seconds", "refused")


def job(seed: int) -> tuple[np.ndarray, dict[str, Any]]:
    """Return waypoints around the axis, and limits that the load at rest keeps."""
    random = np.random.default_rng(seed)
    count = int(random.choice([2, 2, 3, 4, 5]))
    angle = random.uniform(-np.pi, np.pi) + np.linspace(0.0, random.uniform(0.3, 2.5) * random.choice([-1, 1]), count)
    radius = random.uniform(2.5, 7.0) + np.append(0.0, np.cumsum(random.uniform(-0.8, 0.8, count - 1)))
    height = random.uniform(-5.0, -2.5) + np.append(0.0, np.cumsum(random.uniform(-0.6, 0.6, count - 1)))
    limits: dict[str, Any] = {
        "M_b": float(np.exp(random.uniform(np.log(150.0), np.log(3000.0)))),
        "F": float(np.exp(random.uniform(np.log(30.0), np.log(500.0)))),
        "swing": float(np.radians(random.uniform(2.0, 15.0))),
    }
    if random.random() < 0.5:
        room = random.uniform(2.0, 20.0)
        limits["M_w"] = (WEIGHT - room, WEIGHT + room)
    if random.random() < 0.4:
        limits["s.rate"] = random.uniform(0.4, 2.0)
    if random.random() < 0.3:
        limits["tension"] = (random.uniform(850.0, 960.0), random.uniform(1000.0, 1100.0))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height]), limits


def row(seed: int, waypoints: np.ndarray, limits: Mapping[str, Any], intervals: int) -> tuple[str, ...]:
    """Plan a job and return its row of the table."""
    begun = time.process_time()
    try:
        _, report = sc.fastest(sc.scenes.rotary_crane(), waypoints, limits, intervals=intervals)
    except sc.ServocoreError as error:
        return (str(seed), str(len(waypoints)), "", "", "", "", f"{time.process_time() - begun:.1f}", str(error))
    numbers = (report.duration, report.degree9, report.three_phase)
    seconds = time.process_time() - begun
    found = [*(f"{each:.4f}" for each in numbers), f"{report.violation:.1e}", f"{seconds:.1f}"]
    return (str(seed), str(len(waypoints)), *found, "")


def main(arguments: list[str] | None = None) -> int:
    """Plan all jobs; returns 1 if a plan is slower than a built-in law."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planning.jobs", description=__doc__)
    parser.add_argument("--out", type=Path, default=TARGET, help="file to write")
    parser.add_argument("--count", type=int, default=100, help="how many jobs")
    parser.add_argument("--intervals", type=int, default=80, help="of the grid")
    chosen = parser.parse_args(arguments)
    rows = []
    for seed in range(chosen.count):
        rows.append(row(seed, *job(seed), chosen.intervals))
        print(", ".join(rows[-1]), flush=True)
    with chosen.out.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])
    slow = [each for each in rows if each[2] and float(each[2]) > min(float(each[3]), float(each[4]))]
    return 1 if slow else 0


if __name__ == "__main__":
    sys.exit(main())
