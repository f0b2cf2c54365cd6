"""Reports of all cases as rows for a table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import servocore as sc
from benchmarks.effects.cases import DURATIONS, LOOPS, Case
from servocore.effects.report import ESTIMATED, REFUSED
from servocore.effects.study import smooth_enough
from servocore.problem import Problem

LINES = (1.0, 10.0, 100.0)
"""In mm."""
NEAR = 0.1
"""What an estimate may be off, as a fraction."""
_SHARE, _FEWEST = 0.95, 72
_NEVER = 1e-9  # m: a tolerance near which nothing is, so that all rows are estimated


@dataclass(frozen=True)
class Pair:
    """An effect of a crane over a duration: estimated and simulated errors and swings, mm.

    `how` says what `effects` shows where no tolerance is near: estimates, or simulations where those may be weak.
    """

    crane: str
    duration: float
    effect: str
    index: int
    law: str
    how: str
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


def pairs(case: Case, loops: sc.PositionLoops | None = LOOPS, durations: Sequence[float] = DURATIONS) -> Iterator[Pair]:
    """Yield all effects of a crane over some durations."""
    for duration in durations:
        scene = case.over(duration)
        estimated, simulated = (
            sc.effects(scene, loops=loops, tolerance=_NEVER, parameters=case.parameters, simulate=each)
            for each in (False, True)
        )
        for row in simulated.rows:
            guess = estimated[row.name]
            if row.how == REFUSED:
                raise sc.InvalidModel(f"{case.name}, {duration:g} s, {row.name}: {row.reason}")
            swing = guess.swing if guess.how == ESTIMATED else None
            values = [row.estimate, row.error, swing, row.swing]
            yield Pair(
                case.name,
                duration,
                row.name,
                row.index or 0,
                row.law,
                guess.how,
                100 * (row.input_change or math.nan),
                *(1e3 * (each or math.nan) for each in values),
            )


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


def all_pairs(found: Iterable[tuple[Case, Sequence[float]]]) -> list[Pair]:
    """Return the pairs of some cranes, each over some durations."""
    known: list[Pair] = []
    for case, durations in found:
        for each in pairs(case, durations=durations):
            print(f"{each.crane}, {each.duration:.3g} s, {each.effect}: {each.ratio:.3f}", flush=True)
            known.append(each)
    return known


@dataclass(frozen=True)
class Verdict:
    """How many of some pairs agree."""

    count: int
    near: int
    same: int

    @classmethod
    def of(cls, pairs: Sequence[Pair]) -> Verdict:
        """Count."""
        near = sum(abs(each.ratio - 1) <= NEAR for each in pairs)
        return cls(len(pairs), near, sum(each.same_side for each in pairs))

    @property
    def kept(self) -> bool:
        """Whether enough are within a tenth, and all on the same side of all lines."""
        return self.count >= _FEWEST and self.near >= _SHARE * self.count and self.same == self.count

    def __str__(self) -> str:
        return (
            f"within 10 %: {self.near} of {self.count} ({100 * self.near / self.count:.1f} %);"
            f" on the same side of 1, 10 and 100 mm: {self.same} of {self.count}"
        )


def shown_estimates(pairs: Iterable[Pair]) -> list[Pair]:
    """Return the pairs whose estimates `effects` shows."""
    return [each for each in pairs if each.how == ESTIMATED]
