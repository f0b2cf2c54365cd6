"""Reports of all cases as rows for a table."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import servocore as sc
from benchmarks.effects.cases import DRIVES, DURATIONS, Case, cases
from servocore.effects.study import smooth_enough
from servocore.problem import Problem

LINES = (1.0, 10.0, 100.0)
"""In mm."""
_NEVER = 1e-9  # m: a tolerance near which nothing is, so that all rows are estimated


@dataclass(frozen=True)
class Pair:
    """An effect of a crane over a duration: estimated and simulated errors and swings, mm."""

    crane: str
    duration: float
    effect: str
    index: int
    law: str
    change: float
    estimated: float
    simulated: float
    estimated_swing: float
    simulated_swing: float

    @property
    def ratio(self) -> float:
        """Estimated by simulated error."""
        return self.estimated / self.simulated

    @property
    def same_side(self) -> bool:
        """Whether both are on the same side of all lines."""
        return all((self.estimated > line) == (self.simulated > line) for line in LINES)


def pairs(case: Case, drives: sc.Drives | None = DRIVES) -> Iterator[Pair]:
    """Yield all effects of a crane over all durations."""
    for duration in DURATIONS:
        scene = case.over(duration)
        estimated, simulated = (
            sc.effects(scene, drives=drives, tolerance=_NEVER, parameters=case.parameters, simulate=each)
            for each in (False, True)
        )
        for row in simulated.rows:
            guess = estimated[row.name]
            values = [each.error for each in (guess, row)] + [each.swing or math.nan for each in (guess, row)]
            yield Pair(case.name, duration, row.name, row.index or 0, row.law, 100 * (row.input_change or math.nan),
                       *(1e3 * each for each in values))  # fmt: skip


def own_errors(case: Case, duration: float) -> Iterator[tuple[str, str, float]]:
    """Yield (crane, effect, error in mm) of plants that their own exact inputs drive without loops."""
    for effect in case.scene.effects.declared:
        if not effect.listed:
            continue
        added, left_out = ((), (effect.name,)) if effect.left_out else ((effect.name,), ())
        scene = case.over(duration).with_effects(*added, without=left_out)
        known = scene.model().parameters.names
        scene = scene.with_parameters(**{name: each for name, each in case.parameters.items() if name in known})
        scene = scene.with_reference(smooth_enough(scene.reference, Problem.of(scene).array.reference_order + 2))
        t = np.linspace(0.0, duration, 101)
        motion = sc.simulate(scene, sc.ExactInversion(scene), t=t, rtol=1e-12, atol=1e-12)
        yield case.name, effect.name, 1e3 * float(motion["tracking_error"].max())


def all_pairs() -> list[Pair]:
    """Return the pairs of all cranes."""
    found: list[Pair] = []
    for case in cases():
        for each in pairs(case):
            print(f"{each.crane}, {each.duration:g} s, {each.effect}: {each.ratio:.3f}", flush=True)
            found.append(each)
    return found
