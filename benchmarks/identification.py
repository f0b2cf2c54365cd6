"""Identification of random cranes from synthetic logs: coverage, errors, warnings, stray, wrong plants."""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

import servocore as sc
from servocore.effects.closed_loop import Driven, run_loop
from servocore.effects.model_inversion import inverted
from servocore.effects.position_loops import gains_of
from servocore.errors import ServocoreError
from servocore.identification.stray import Stray

PAGE = Path("docs/identification")
COMMON = ("trolley_mass", "load_mass", "winch_inertia", "trolley_friction", "winch_friction", "viscous_share")
KINDS = {
    "rotary_crane": ("bridge_inertia", "bridge_friction", *COMMON),
    "overhead_crane": COMMON,
    "gantry_crane": ("bridge_mass", "bridge_friction", *COMMON),
}
WRONG = ("none", "no friction", "wind", "elastic rope", "hook")
_GOOD = 1.96


@dataclass
class Row:
    """A log: errors by standard errors, relative errors and standard errors, and what was said."""

    kind: str
    family: str
    seed: int
    z: list[float]
    errors: list[float]
    seconds: float
    doubts: list[str]
    wrong: str = "none"
    stray: float = np.nan
    predicted: float = np.nan
    believed: float = np.nan


def multisine(scene: sc.Scene, random: np.random.Generator, duration: float = 20.0) -> sc.Reference:
    """Return seven random harmonics about home, from rest to rest, at most 1.2 m and 0.9 m/s^2 in every direction."""
    home = np.array(scene.model().home)
    t = np.arange(0.0, duration + 1e-9, 0.02)
    grown = np.clip(np.minimum(t, duration - t) / 2.0, 0.0, 1.0)
    window = grown**5 * (126 - 420 * grown + 540 * grown**2 - 315 * grown**3 + 70 * grown**4)
    positions = np.tile(home, (len(t), 1))
    for k in range(len(home)):
        order = np.arange(1, 8)
        size, phase = random.uniform(0.3, 1.0, 7) / order**0.7, random.uniform(0, 2 * np.pi, 7)
        sway = window * (size[:, None] * np.sin(2 * np.pi * order[:, None] * t / duration + phase[:, None])).sum(axis=0)
        faster = np.gradient(np.gradient(sway, t), t)
        positions[:, k] += sway * min(1.2 / np.abs(sway).max(), 0.9 / np.abs(faster).max())
    return sc.sampled(t[::2], positions[::2])


def crane(kind: str, random: np.random.Generator) -> tuple[sc.Scene, sc.Scene]:
    """Return a random plant, parameters times 1/1.5 to 1.5, and the scene as it is believed, wrong by up to 22 %."""
    base: sc.Scene = getattr(sc.scenes, kind)().with_effects("friction")
    default = base.parameter_values()
    true = {name: default[name] * 1.5 ** random.uniform(-1, 1) for name in KINDS[kind]}
    believed = {name: value * (1 + random.uniform(-0.22, 0.22)) for name, value in true.items()}
    return base.with_parameters(**true), base.with_parameters(**believed)


def sensors(family: str, random: np.random.Generator) -> dict[str, Any]:
    """Return the sensors of a family: good ones (A) or coarse ones (B)."""
    if family == "A":
        return {"step": float(random.choice([0.001, 0.002, 0.005])), "noise": random.uniform(0.003, 0.02)}
    faults = {"resolution": 2e-4, "delay": random.uniform(0.0, 0.008), "outliers": 0.01, "missing": 0.03}
    return {"step": float(random.choice([0.005, 0.01])), "noise": random.uniform(0.005, 0.03), **faults}


def changed(plant: sc.Scene, wrong: str) -> sc.Scene:
    """Return a plant with an effect that the model lacks."""
    if wrong in ("none", "no friction"):
        return plant
    return plant.with_effects(wrong)


def one(kind: str, family: str, seed: int, wrong: str = "none", stray: bool = False) -> Row:
    """Identify a random crane."""
    random = np.random.default_rng(seed)
    plant, believed = crane(kind, random)
    path = multisine(believed, random)
    loops = sc.PositionLoops(random.uniform(5.0, 8.0))
    moved, real = believed.with_reference(path), changed(plant, wrong)
    log = sc.measured(moved, plant=real, loops=loops, seed=seed, **sensors(family, random))
    began, names = time.process_time(), KINDS[kind]
    if wrong == "no friction":
        own: sc.Scene = getattr(sc.scenes, kind)()
        names = tuple(name for name in names if name in own.model().parameters.names)
        moved = own.with_parameters(**{name: believed.parameter_values()[name] for name in names})
    found = sc.identify(moved, log, names, loops=loops)
    seconds, true = time.process_time() - began, plant.parameter_values()
    errors = np.array([found.values[name] / true[name] - 1.0 for name in names])
    z = errors * np.array([true[name] / found.standard_errors[name] for name in names])
    row = Row(kind, family, seed, z.tolist(), errors.tolist(), seconds, list(found.doubts), wrong)
    if stray:
        home = believed.model().home
        job = sc.rest_to_rest(home, [each + 1.5 for each in home], random.uniform(8.0, 15.0))
        predicted: Stray = found.stray(job)
        row.predicted = predicted.by_parameters if wrong == "none" else predicted.total
        row.stray, row.believed = (_strayed(real, scene, job, loops) for scene in (found.scene(), believed))
    return row


def _strayed(plant: sc.Scene, scene: sc.Scene, job: sc.Reference, loops: sc.PositionLoops) -> float:
    """Return how far a plant without sensors strays under the feedforward of a scene, in mm."""
    model, real = (sc.Problem.of(each.with_reference(job)) for each in (scene, plant))
    drives = scene.effects.measured
    motion, own = (inverted(each, drives, 600) for each in (model, real))
    gains = gains_of(model.system, drives, motion.end, model.p, loops)
    return 1e3 * run_loop(real, Driven(motion, motion.inputs, gains), own, drives).error


def attempted(*case: Any) -> Row | str:
    """Return a row, or the sentence of a refusal."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return one(*case)
    except ServocoreError as error:
        return f"{case}: {error}"


def table(rows: list[Row]) -> list[str]:
    """Return coverage, errors and warnings by kind and family as lines of a page."""
    lines = [
        "| cranes | family | logs | coverage of 95 % | largest, standard errors | with doubts | median s | rms error |"
    ]
    lines += ["|---|---|---|---|---|---|---|---|"]
    for kind in (*KINDS, "all"):
        for family in "AB":
            own = [row for row in rows if row.family == family and kind in (row.kind, "all")]
            if not own:
                continue
            z = np.abs(np.concatenate([row.z for row in own]))
            trusted = [np.abs(row.z).max() for row in own if not row.doubts]
            rms = np.sqrt(np.mean(np.square([row.errors for row in own]), axis=0)) if kind != "all" else []
            doubted = sum(bool(row.doubts) for row in own)
            worst, covered = max(trusted, default=np.nan), f"{100 * np.mean(z < _GOOD):.1f} %"
            lines.append(
                f"| {kind} | {family} | {len(own)} | {covered} | {worst:.1f} |"
                f" {doubted} | {np.median([row.seconds for row in own]):.1f} | "
                + ", ".join(
                    f"{name} {100 * each:.2g} %" for name, each in zip(KINDS.get(kind, ()), rms, strict=bool(len(rms)))
                )
                + " |"
            )
    return lines


def page(results: Mapping[str, list[Row]], refusals: list[str]) -> str:
    """Return the page of a study."""
    lines = [
        "# Identification of random cranes",
        "",
        f"Synthetic logs: `sc.measured` simulates {len(results['coverage'])} logs of random cranes (`make"
        " identification` has 50 cranes of each kind and family, and writes the page after each). Parameters"
        " are 1/1.5 to 1.5 times the defaults, believed values wrong by up to 22 %."
        " Family A has samples every 1 to 5 ms, noise of 0.3 to 2 % of half the range of an input, fine encoders;"
        " B has 5 to 10 ms, 0.5 to 3 %,"
        " delays of 0 to 8 ms, 1 % outliers, 3 % missing samples and encoders of 0.2 mm. *With doubts* counts logs with"
        " a warning; the largest error is that of logs without.",
        "",
        *table(results["coverage"]),
        "",
        f"Refused: {len(refusals)}." + "".join(f"\n* {each}" for each in refusals),
        "",
        "## Stray",
        "",
    ]
    strays = [row for row in results["coverage"] if np.isfinite(row.stray)]
    if strays:
        kept = float(np.mean([row.stray <= row.predicted for row in strays]))
        medians = (
            float(np.median([getattr(row, each) for row in strays])) for each in ("believed", "stray", "predicted")
        )
        lines += [
            "Jobs of 8 to 15 s under the feedforward of believed and of identified data, without sensors, so that"
            " parameters alone let the load stray; medians in mm.",
            "",
            "| jobs | believed | identified | predicted, 95 % | kept |",
            "|---|---|---|---|---|",
            "| {} | {:.2g} | {:.2g} | {:.2g} | {:.0%} |".format(len(strays), *medians, kept),
            "",
        ]
    lines += [
        "## Wrong plants",
        "",
        "The model lacks an effect of the plant; *beyond* counts jobs on which the load strays farther than predicted.",
        "",
    ]
    lines += ["| the model lacks | logs | with doubts | beyond | of these with doubts |", "|---|---|---|---|---|"]
    for wrong in WRONG[1:]:
        own = [row for row in results["wrong"] if row.wrong == wrong]
        beyond = [row for row in own if row.stray > row.predicted]
        counts = len(own), *(sum(bool(row.doubts) for row in each) for each in (own, beyond))
        name = wrong.removeprefix("no ")
        lines.append(f"| {name} | {counts[0]} | {counts[1]} | {len(beyond)} | {counts[2]} |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Run the study and write its page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cranes", type=int, default=50, help="of each kind and family")
    parser.add_argument("--wrong", type=int, default=8, help="wrong plants of each kind")
    parser.add_argument("--folder", type=Path, default=PAGE)
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--mixed", action="store_true", help="alternate right and wrong plants")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.cranes)
    cases: list[tuple[Any, ...]] = [
        (kind, family, k, "none", True) for k in seeds for family in "AB" for kind in options.kinds
    ]
    count = len(cases)
    cases += [
        (kind, "A", k, wrong, True) for k in seeds[: options.wrong] for kind in options.kinds for wrong in WRONG[1:]
    ]
    if options.mixed:
        cases = [case for pair in zip_longest(cases[:count], cases[count:]) for case in pair if case]
    rows, refusals = list[Row](), list[str]()
    for case in cases:  # the page holds what was measured when the study is interrupted
        found = attempted(*case)
        if isinstance(found, Row):
            rows.append(found)
            print(case[:4], f"{found.seconds:.1f} s", np.round(found.z, 1), found.doubts, found.stray, found.predicted)
        else:
            refusals.append(found)
            print(found)
        right, wrong = ([row for row in rows if (row.wrong == "none") is good] for good in (True, False))
        text = page({"coverage": right, "wrong": wrong}, refusals)
        (options.folder / "index.md").write_text(text, encoding="utf-8")
        records = json.dumps([asdict(row) for row in rows], indent=0)
        (options.folder / "study.json").write_text(records + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
