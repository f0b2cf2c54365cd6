"""Whatever tree comes by chance: its inputs are right by MuJoCo's inverse dynamics, warned of, or truly refused.

`make nightly` takes five hundred.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from outside.test_random_mechanisms import BATCH, COUNT, DIFFERENCE
from robots import mujoco_model, peer

import servocore as sc
from servocore.checks.before_run import FLAT, NON_MINIMUM_PHASE

STEP = 0.005
RIGHT = 1e-6  # of the largest force: differences of order eight, and Radau where internal dynamics remain


def random_tree(rng: np.random.Generator) -> tuple[str, list[str], list[str]]:
    """Return a tree of one to four bodies as MJCF, its driven joints, and those that follow the path."""
    count = int(rng.integers(1, 5))
    parents = [int(rng.integers(-1, k)) if rng.random() > 0.2 else -1 for k in range(count)]
    names = [f"j{k}_{j}" for k in range(count) for j in range(int(rng.integers(1, 3)))]

    def row(low: float, high: float, size: int = 3) -> str:
        return " ".join(map(repr, rng.uniform(low, high, size).tolist()))

    def body(k: int) -> str:
        joints = "".join(
            f"<joint name='{name}' type='{rng.choice(['hinge', 'hinge', 'slide'])}' axis='{row(-1.0, 1.0)}'"
            f" pos='{row(-0.2, 0.2)}' stiffness='{row(20.0, 200.0, 1)}' springref='{row(-0.2, 0.2, 1)}'"
            f" damping='{row(1.0, 5.0, 1)}' armature='{rng.choice([0.0, 0.1])}' ref='{rng.choice([0.0, 0.3])}'/>"
            for name in names
            if name.startswith(f"j{k}_")
        )
        inertia = f"<inertial pos='{row(-0.2, 0.2)}' mass='{row(0.5, 3.0, 1)}' diaginertia='{row(0.1, 0.19)}'/>"
        below = "".join(body(child) for child in range(count) if parents[child] == k)
        return f"<body pos='{row(-0.4, 0.4)}' quat='{row(-1.0, 1.0, 4)}'>{joints}{inertia}{below}</body>"

    roots = "".join(body(k) for k in range(count) if parents[k] < 0)
    driven, other = (rng.permutation(names).tolist() for _ in range(2))
    size = int(rng.integers(1, len(names) + 1))
    text = f"<mujoco><compiler angle='radian'/><worldbody>{roots}</worldbody></mujoco>"
    return text, driven[:size], driven[:size] if rng.random() < 0.7 else other[:size]


def error_of(solution: sc.Solution, path: Path) -> float:
    """Return the difference of the inputs from MuJoCo's inverse dynamics of the motion, relative to the largest."""
    mujoco, model = peer("mujoco"), mujoco_model(path)
    data, step = mujoco.MjData(model), np.diff(solution.t)[0]
    names = [model.joint(k).name for k in range(model.njnt)]
    jet = [np.stack([solution[name] for name in names])]
    for _ in range(2):
        jet.append(np.stack([np.convolve(row, DIFFERENCE[::-1], "valid") / step for row in jet[-1]]))
    u = np.zeros(jet[0].shape)
    for name in solution.names:
        if name.endswith((".torque", ".force")):
            u[names.index(name.rpartition(".")[0])] = solution[name]
    worst = size = 0.0
    for k in range(0, jet[2].shape[1], 5):
        data.qpos[:], data.qvel[:], data.qacc[:] = jet[0][:, k + 8], jet[1][:, k + 4], jet[2][:, k]
        mujoco.mj_inverse(model, data)
        worst = max(worst, float(np.abs(data.qfrc_inverse - u[:, k + 8]).max()))
        size = max(size, float(np.abs(data.qfrc_inverse).max()), float(np.abs(data.qfrc_bias).max()))
    return worst / size


def solved(scene: sc.Scene, kind: str, step: float) -> tuple[sc.Solution, bool]:
    """Return the solution, and whether a warning tells that it is off."""
    how = (sc.Reduced(), sc.RadauIIA(3)) if kind == NON_MINIMUM_PHASE else ()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        solution = sc.solve(scene, *how, step=step)
    return solution, any("is off by" in str(each.message) or "may be wrong" in str(each.message) for each in told)


@pytest.mark.parametrize("batch", range(0, COUNT, BATCH))
def test_a_random_tree_is_right_or_refused(batch: int, tmp_path: Path) -> None:
    peer("mujoco")
    refused, path = 0, tmp_path / "tree.xml"
    for seed in range(batch, min(batch + BATCH, COUNT)):
        text, driven, outputs = random_tree(np.random.default_rng(seed))
        path.write_text(text)
        scene = sc.scenes.from_file(path, outputs, inputs=driven)
        kind = sc.analyse(scene).classification
        try:
            solution, warned = solved(scene, kind, STEP)
            error = error_of(solution, path)
            if not (warned or error < RIGHT):  # internal dynamics that are driven far away take smaller steps
                assert error_of(solved(scene, kind, STEP / 4)[0], path) < error / 8, f"tree {seed}"
        except (sc.InvalidModel, sc.IntegrationFailed):
            # With the driven joints as outputs the system Jacobian is positive definite: nothing can be singular.
            true = kind != FLAT and outputs != driven
            refused += 1
            if not true:
                raise
    assert refused <= BATCH // 2
