"""Never silent and wrong: whatever mechanism comes by chance, its answer is right, warned of, or refused.

Right means: its accelerations, differences of the velocities that are reported, satisfy Newton's and Euler's equations
written apart from the library, and its inputs drive `simulate` along the same motion where that is stable enough.
`make nightly` takes five hundred.
"""

from __future__ import annotations

import os
import warnings
from collections import Counter

import numpy as np
import pytest
from outside.random_mechanisms import Mechanism

import servocore as sc
from servocore.checks.before_run import NON_MINIMUM_PHASE

COUNT = int(os.environ.get("SERVOCORE_MECHANISMS", "30"))
STEPS = (200, 1600)
DIFFERENCE = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
"""Central difference of order eight."""
BATCH = 4 if COUNT <= 30 else 10  # of a long run shares of right ones and refusals are judged over more


def columns(solution: sc.Solution, letter: str, n: int) -> np.ndarray:
    return np.stack([solution[f"{letter}_{k}"] for k in range(n)])


def residuals(mechanism: Mechanism, solution: sc.Solution) -> tuple[float, float]:
    """What is left of the equations of motion, and of v = q', relative to the largest terms."""
    n, inside, step = len(mechanism.bodies), slice(4, -4), np.diff(solution.t)[0]
    q, v, u = columns(solution, "q", n), columns(solution, "v", n), np.zeros((n, len(solution.t)))
    for k in mechanism.motors:
        u[k] = solution[f"u_{k}"]
    a, q_rate = (np.stack([np.convolve(row, DIFFERENCE[::-1], "valid") / step for row in rows]) for rows in (v, q))
    efforts, size = mechanism.balance(q[:, inside], v[:, inside], a)
    apart = np.abs(q_rate - v[:, inside]).max() / max(np.abs(v).max(), 1e-9)
    return float(np.abs(efforts - u[:, inside]).max() / size), float(apart)


def drift_and_growth(mechanism: Mechanism, scene: sc.Scene, solution: sc.Solution) -> tuple[float, float]:
    """How far a simulation under the inputs ends up, and how much a small push at the start grows."""
    names = [f"q_{k}" for k in range(len(mechanism.bodies))]
    start = {name: float(solution[name][0]) for name in names}
    start |= {f"{name}_dot": float(solution[f"v{name[1:]}"][0]) for name in names}
    pushed = start | {f"{name}_dot": start[f"{name}_dot"] + 1e-6 for name in names}
    runs = [sc.simulate(scene, solution, start=each) for each in (start, pushed)]
    q, there, aside = (columns(each, "q", len(names)) for each in (solution, *runs))
    return float(np.abs(there - q).max()), float(np.abs(aside - there).max() / 1e-6)


def solved(mechanism: Mechanism, scene: sc.Scene, steps: int) -> tuple[sc.Solution, bool]:
    """A solution, and whether it was warned of; unstable internal dynamics are left to grow."""
    unstable = sc.analyse(scene).classification == NON_MINIMUM_PHASE
    how = (sc.Reduced(), sc.RadauIIA(3)) if unstable else ()  # bounded, it would start before the path begins
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        solution = sc.solve(scene, *how, step=mechanism.duration / steps)
    return solution, not unstable and any(issubclass(each.category, sc.ServocoreWarning) for each in said)


def faults(mechanism: Mechanism, scene: sc.Scene, solution: sc.Solution) -> str:
    """What is wrong with a solution; nothing if it is right."""
    left, apart = residuals(mechanism, solution)
    if not left < 1e-5:
        return f"{left:.1e} of the forces are left over"
    if not apart < 1e-5:
        return f"velocities are no rates, by {apart:.1e}"
    drift, growth = drift_and_growth(mechanism, scene, solution)
    return f"driven, it ends {drift:.1e} astray, pushes grow {growth:.1e}-fold" if drift > 1e-5 * growth < 0.1 else ""


def verdict(seed: int) -> str:
    """Solve a mechanism by chance, and judge; where differences are too coarse, once more with smaller steps."""
    mechanism, wrong = Mechanism.by_chance(seed), ""
    for steps in STEPS:
        try:
            scene = mechanism.scene()
            solution, warned = solved(mechanism, scene, steps)
        except sc.ServocoreError:
            return "refused"
        if warned:
            return "warned"
        wrong = faults(mechanism, scene, solution)
        if not wrong:
            return "right"
    raise AssertionError(f"mechanism {seed}: {wrong}")


@pytest.mark.parametrize("first", range(0, COUNT, BATCH))
def test_a_mechanism_by_chance_is_solved_right_warned_of_or_refused(first: int) -> None:
    found = Counter(verdict(seed) for seed in range(first, first + BATCH))
    assert found["right"] >= BATCH // 4, found


@pytest.mark.parametrize(("seed", "said"), [(91, r"\d grow at the start of .* \d at its end"), (8, r"a mode of \S+/s")])
def test_a_bounded_motion_is_refused_where_stability_changes_along_the_path(seed: int, said: str) -> None:
    """Or where a mode is so slow that the horizon has no end."""
    mechanism = Mechanism.by_chance(seed)
    with pytest.raises(sc.IntegrationFailed, match=said):
        sc.solve(mechanism.scene(), None, sc.StableInversion(), step=mechanism.duration / 200)
