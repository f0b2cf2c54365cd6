"""The whole study of the loop: ``make loop``, or ``python tests/loop_study.py [COUNT [FOLDER]]``.

Native FMUs run random manoeuvres. Distributions and the loop's stability go to the standard output, every run into
feedback.csv, the picture beside it.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from called import laws
from loop_information import smallest_distance
from loop_stability import sensitivity, transition_norms
from loops import BOUNDS, STEPS, Case, PlantRefusedError, deviation, fastest, random_case

from crane_fmu.build.native import LARGEST_TURN

TARGET = Path(__file__).parents[1] / "docs" / "pictures"
MASTERS = {"start": "Jacobi", "end": "Gauss-Seidel"}
NOMINAL, ANY, HARD, DISTURBED = "default crane", "any crane", "any crane, any snap", "5 % mass error and gust"
DISTURBED_ANY = "any crane, 5 % mass error and gust"
BOUND_OF_OTHERS, BOUND_DISTURBED, DISTURBED_STEP = 3.0, 10.0, 0.01


@dataclass(frozen=True)
class Run:
    """A manoeuvre at a step, and the largest distance of its load in mm, with and without feedback."""

    kind: str
    master: str
    step: float
    manoeuvre: str
    jump: float
    distance: float
    without: float


def is_disturbed(kind: str) -> bool:
    return kind in (DISTURBED, DISTURBED_ANY)


def cases_of(kind: str, count: int) -> list[Case]:
    rng = np.random.default_rng(7)
    choice: dict[str, Any] = {"any_crane": kind in (ANY, HARD, DISTURBED_ANY), "disturbed": is_disturbed(kind)}
    if kind == HARD:
        choice["snap"] = np.inf
    return [random_case(rng, **choice) for _ in range(count)]


def jump(case: Case) -> float:
    """Largest jump of the fifth derivative of a path, in m/s5: at rest's ends and where phases meet."""
    path = case.reference
    inner = np.array(getattr(path, "knots", ())[1:-1])
    ends = path.jet(np.array([path.start_time, path.end_time]), 5)[:, 5]
    both = path.jet(np.concatenate([inner - 1e-9, inner + 1e-9]), 5)[:, 5].reshape(2, -1, 3)
    return float(np.linalg.norm(np.concatenate([ends, both[1] - both[0]]), axis=1).max())


def measured(case: Case, h: float, at: str, share: float = 1.0) -> float:
    """Return the largest distance of the load from its path in mm; infinite where the plant refuses to go on."""
    try:
        return deviation(case, h, at, feedback=share)
    except PlantRefusedError:
        return float("inf")


def runs(count: int) -> Iterator[list[Run]]:
    """Yield the runs of each kind, master and step."""
    for kind in (NOMINAL, ANY, HARD, DISTURBED, DISTURBED_ANY):
        cases = cases_of(kind, count)
        jumps = [jump(each) for each in cases]
        for at, master in MASTERS.items():
            steps = (DISTURBED_STEP,) if is_disturbed(kind) else STEPS[:2] if kind == HARD else STEPS
            for h in steps if (kind, at) != (HARD, "end") else ():
                found = []
                for case, jumped in zip(cases, jumps, strict=True):
                    if fastest(case) * h <= LARGEST_TURN:
                        distance = measured(case, h, at)
                        without = measured(case, h, at, 0.0) if is_disturbed(kind) else np.nan
                        found.append(Run(kind, master, h, case.name, jumped, distance, without))
                yield found


def broken(found: Sequence[Run]) -> bool:
    """Return whether runs of a kind break what must hold."""
    first, largest = found[0], max(each.distance for each in found)
    if first.kind == HARD:
        return not np.isfinite(largest)
    worse = is_disturbed(first.kind) and any(each.distance > each.without for each in found)
    return worse or largest > bound(first.kind, first.step)


def bound(kind: str, h: float) -> float:
    """Return the largest distance in mm that runs of a kind may have."""
    if is_disturbed(kind):
        return BOUND_DISTURBED
    return BOUNDS[h] * (BOUND_OF_OTHERS if kind == ANY else 1.0)


def sentence(found: Sequence[Run]) -> str:
    """Return the distribution of runs of a kind."""
    first, sizes = found[0], np.sort([each.distance for each in found])
    worst = max(found, key=lambda each: each.distance)
    said = (
        f"{first.kind}, {first.master}, {first.step:g} s: {len(found)} runs, median {np.median(sizes):.2e},"
        f" 90 % {sizes[int(0.9 * len(sizes))]:.2e}, largest {sizes[-1]:.2e} mm ({worst.manoeuvre})"
    )
    if first.kind == HARD:
        rows = [1e-3 * each.distance / (each.jump * each.step**5) for each in found if each.jump > 1.0]
        said += f"; {np.median(rows):.3g} J h^5 in the median, {max(rows):.3g} at most, no less than"
        said += f" {smallest_distance():.3g} J h^5 for any"
        said += f"; {sum(each.distance > 3 * BOUNDS[first.step] for each in found)} beyond the bound"
    if is_disturbed(first.kind):
        share = max(each.distance / each.without for each in found)
        said += f"; at most {share:.2g} of what feedforward alone leaves"
    return said + (" BROKEN" if broken(found) else "")


def stability() -> bool:
    """Print norms of transition matrices and sensitivities at every step, and return whether the norms decay."""
    decays = True
    for at, master in MASTERS.items():
        for h in STEPS:
            norms = list(transition_norms(laws()[at], at, h))
            decays &= norms[-1] < 1e-10 * max(norms)
            places = Case().reference.jet(np.linspace(0.0, 20.0, 5), 0)[:, 0]
            grown = max(sensitivity(laws()[at], at, h, place) for place in places)
            fallen = norms[-1] / max(norms)
            print(f"stability, {master}, {h:g} s: the transition matrix falls to {fallen:.0e} of"
                  f" its largest norm; a disturbance at the inputs grows {grown:.2g} times", flush=True)  # fmt: skip
    return decays


LEAST_SHOWN, LARGEST_SHOWN = 1e-3, 1e6
"""In mm: a micrometre, below which the distance is a numerical residual, and a kilometre."""


def draw(found: Sequence[Run], file: Path) -> None:
    """Draw the share of runs that stay within a distance."""
    style: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
                  "grid.alpha": 0.25, "savefig.dpi": 160}  # fmt: skip
    with plt.rc_context(style):
        figure, axes = plt.subplots(2, 3, figsize=(9.0, 5.2), sharey=True, layout="constrained")
        for row, master in zip(axes, MASTERS.values(), strict=True):
            for axis, kind in zip(row, (NOMINAL, ANY, DISTURBED), strict=True):
                _draw_kind(axis, [each for each in found if (each.kind, each.master) == (kind, master)])
                axis.set_title(f"{kind}, {master}", loc="left", fontsize=9)
            row[0].set_ylabel("share of manoeuvres")
        figure.supxlabel("largest distance of the load from its path (mm), at least 1 µm; bars: bounds of the study",
                         fontsize=9)  # fmt: skip
        figure.savefig(file, metadata={"Software": None})
        plt.close(figure)


def _draw_kind(axis: Any, found: Sequence[Run]) -> None:
    disturbed = found[0].kind == DISTURBED
    colours = dict(zip(STEPS, plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(STEPS))), strict=True))
    for h in dict.fromkeys(each.step for each in found):
        sizes = np.array([each.distance for each in found if each.step == h])
        small = " (below 1 µm)" * bool(sizes.max() < LEAST_SHOWN)
        axis.ecdf(np.maximum(sizes, LEAST_SHOWN), color=colours[h], label=f"{h:g} s{small}", lw=1.5)
        axis.axvline(bound(found[0].kind, h), 0.9, color=colours[h], lw=2.5)
    if disturbed:  # without feedback most loads are lost: a distance beyond the scale
        lost = [min(each.without, 10.0 * LARGEST_SHOWN) for each in found]
        axis.ecdf(lost, color="0.5", label="feedforward alone", lw=1.5)
    axis.set(xscale="log", xlim=(1.0, LARGEST_SHOWN) if disturbed else (LEAST_SHOWN, 10.0))
    axis.legend(loc="center" if disturbed else "lower right", fontsize=7, frameon=False)


def main(count: int, folder: Path) -> int:
    """Run, print and draw everything; returns 1 if a bound is broken."""
    everything: list[Run] = []
    status = 0
    for found in runs(count):
        print(sentence(found), flush=True)
        status |= broken(found)
        everything += found
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "feedback.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow([each.name for each in fields(Run)])
        table.writerows([[f"{value:.3e}" if isinstance(value, float) else value for value in vars(each).values()]
                         for each in everything])  # fmt: skip
    draw(everything, folder / "feedback.png")
    return status | (not stability())


if __name__ == "__main__":
    count, *folder = sys.argv[1:] or ["200"]
    sys.exit(main(int(count), Path(*folder) if folder else TARGET))
