"""Cranes, paths and durations by chance: nothing about the estimate was decided by what they show."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

import servocore as sc
from benchmarks.effects.cases import Case, cases

SEED = 20261122
DRAWS = 3
"""Of every crane."""
FACTOR = 1.5
"""Every parameter lies between its value by this and times this, but for `_FIXED`."""
DURATIONS = (5.0, 20.0)
LENGTHS = (3.0, 8.0)
"""How far the load goes, in m; on a rotary crane its path keeps `_CLEAR` from the axis."""
_FIXED = frozenset({"gravity", "air_density", "creep"})
_SPAN, _DEPTHS, _CLEAR = 7.0, (-7.0, -3.5), 1.5  # m: of the load beside the middle, below the rail, from the axis


def fresh_cases(seed: int = SEED) -> Iterator[tuple[Case, float]]:
    """Yield cranes with a path of their own, and its duration in s."""
    rng = np.random.default_rng(seed)
    for case in cases():
        for draw in range(DRAWS):
            effects = {each.name: each.default for each in case.scene.effects.parameters.values()} | case.parameters
            own = {each.name: each.default for each in case.scene.model().parameters.declared}
            own |= dict(case.scene.parameters)
            scene = case.scene.with_parameters(**_scattered(own, rng))
            yield _on_a_path(Case(f"{case.name} {draw + 1}", scene, _scattered(effects, rng)), rng)


def _scattered(values: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    return {name: each * FACTOR ** rng.uniform(-1.0, 1.0) for name, each in values.items() if name not in _FIXED}


def _on_a_path(case: Case, rng: np.random.Generator) -> tuple[Case, float]:
    """Return the crane on a straight path that its limits allow, drawn again until there is one."""
    dimension = len(case.scene.model().outputs)
    while True:
        ends = np.column_stack([rng.uniform(-_SPAN, _SPAN, (2, dimension - 1)), rng.uniform(*_DEPTHS, 2)])
        duration = math.exp(rng.uniform(*np.log(DURATIONS)))
        if not LENGTHS[0] <= np.linalg.norm(ends[1] - ends[0]) <= LENGTHS[1]:
            continue
        if "rotary" in case.name and _nearest(*ends[:, :2]) < _CLEAR:
            continue
        try:
            scene = case.scene.with_reference(sc.rest_to_rest(ends[0], ends[1], duration))
            sc.solve(scene, step=duration / 100)
        except sc.ServocoreError:
            continue
        return Case(case.name, scene, case.parameters), duration


def _nearest(start: np.ndarray, end: np.ndarray) -> float:
    """Return how near the axis a straight line comes, seen from above."""
    way = end - start
    share = np.clip(-start @ way / (way @ way), 0.0, 1.0)
    return float(np.linalg.norm(start + share * way))
