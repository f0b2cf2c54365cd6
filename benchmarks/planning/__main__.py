"""Plan all cases and write docs/planning/results.csv; seconds are those of the process, whoever else is computing."""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path

import numpy as np

import servocore as sc
from benchmarks.planning.cases import CASES, Case

TARGET = Path(__file__).parents[2] / "docs" / "planning" / "results.csv"
SLOWER = 1.003
"""A plan may take this much longer than the best known."""


def main(arguments: list[str] | None = None) -> int:
    """Measure; returns 1 if a plan is slower than the best known by more than three thousandths, or not clear."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planning", description=__doc__)
    parser.add_argument("--out", type=Path, default=TARGET, help="file to write")
    chosen = parser.parse_args(arguments)
    rows, slow = [], []
    for case in CASES:
        begun = time.process_time()
        path, report = case.plan()
        seconds = time.process_time() - begun
        violation = max(report.violation, by_closed_form(case, path))
        rows.append(
            [
                case.name,
                f"{report.duration:.4f}",
                f"{report.degree9:.4f}",
                f"{report.three_phase:.4f}",
                f"{violation:.1e}",
                f"{seconds:.1f}",
            ]
        )
        print(", ".join(rows[-1]), flush=True)
        if by_hand_clearance(case, path) < 0.0:
            slow.append(f"{case.name}: load or rope comes into a body")
        if report.duration > SLOWER * case.known:
            slow.append(f"{case.name}: {report.duration:.4f} s, best known {case.known:.4f} s")
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    with chosen.out.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([["case", "T", "T9", "T3", "violation", "seconds"], *rows])
    print("\n".join(slow), end="\n" * bool(slow), file=sys.stderr)
    return 1 if slow else 0


def by_closed_form(case: Case, path: sc.Reference) -> float:
    """Return the largest excess over a limit by half its range, by the closed form of the scene, which has no rates."""
    scene = sc.scenes.REGISTRY[case.scene]().with_reference(path).with_limits(**case.limits)
    exact = scene.exact(np.linspace(0.0, path.duration, 20_001))
    excess = [0.0]
    for limit in scene.limits:
        if limit.quantity in exact:
            low, high, values = limit.bound, limit.upper, exact[limit.quantity]
            half = (high - low) / 2.0 if np.isfinite(low) else high
            excess.append(float(np.max(np.maximum(values - high, low - values))) / half)
    return max(excess)


def by_hand_clearance(case: Case, path: sc.Reference) -> float:
    """Return how near load and rope come to what they keep clear of, m: a rope as 401 points, at 20,001 instants."""
    least, jets = np.inf, path.jet(np.linspace(0.0, path.duration, 20_001), 2)
    load, away = jets[:, 0], jets[:, 2] + np.array([0.0] * (path.dimension - 1) + [9.81])
    for body in case.free.keep_out if case.free is not None else ():
        for part in np.linspace(0.0, 1.0, 401):
            point = load - part * (load[:, -1] / away[:, -1])[:, None] * away - np.array(body.centre)
            if isinstance(body, sc.Sphere):
                least = min(least, float(np.linalg.norm(point, axis=1).min()) - body.radius)
            else:
                least = min(least, float((np.abs(point) - np.array(body.half)).max(axis=1).min()))
    return least


if __name__ == "__main__":
    sys.exit(main())
