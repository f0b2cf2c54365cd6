"""Whatever tree comes by chance: its inputs are right by MuJoCo's inverse dynamics, or refused with a true reason.

`make nightly` takes five hundred.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from outside.random_trees import as_mjcf, random_tree
from outside.test_random_mechanisms import BATCH, COUNT, DIFFERENCE
from robots import mujoco_model, peer

import servocore as sc
from servocore.checks.internal_stability import FLAT, NON_MINIMUM_PHASE
from servocore.importers.from_file import scene_of
from servocore.importers.options import Options
from servocore.importers.tree import Tree

STEP = 0.005
RIGHT = 1e-6  # of the largest force: differences of order eight, and Radau where internal dynamics remain


def chosen(tree: Tree, seed: int) -> Options:
    """Return driven joints by chance, and as many joints that follow the path, mostly the same."""
    rng, names = np.random.default_rng(seed + 1000), list(tree.joints)
    driven = rng.permutation(names)[: rng.integers(1, len(names) + 1)].tolist()
    other = rng.permutation(names)[: len(driven)].tolist()
    return Options(driven if rng.random() < 0.7 else other, driven)


def error_of(tree: Tree, solution: sc.Solution, path: Path) -> float:
    """Return the difference of the inputs from MuJoCo's inverse dynamics of the motion, relative to the largest."""
    mujoco, model = peer("mujoco"), mujoco_model(path)
    data, step = mujoco.MjData(model), np.diff(solution.t)[0]
    names = [model.joint(k).name for k in range(model.njnt)]
    jet = [np.stack([solution[name] for name in names])]
    for _ in range(2):
        jet.append(np.stack([np.convolve(row, DIFFERENCE[::-1], "valid") / step for row in jet[-1]]))
    u = np.zeros(jet[0].shape)
    for k, name in enumerate(names):
        unit = "torque" if tree.joints[name].kind == "hinge" else "force"
        u[k] = solution[f"{name}.{unit}"] if f"{name}.{unit}" in solution.names else 0.0
    worst = size = 0.0
    for k in range(0, jet[2].shape[1], 5):
        data.qpos[:], data.qvel[:], data.qacc[:] = jet[0][:, k + 8], jet[1][:, k + 4], jet[2][:, k]
        mujoco.mj_inverse(model, data)
        worst = max(worst, float(np.abs(data.qfrc_inverse - u[:, k + 8]).max()))
        size = max(size, float(np.abs(data.qfrc_inverse).max()), float(np.abs(data.qfrc_bias).max()))
    return worst / size


def solved(scene: sc.Scene, kind: str, step: float) -> sc.Solution:
    how = (sc.Reduced(), sc.RadauIIA(3)) if kind == NON_MINIMUM_PHASE else ()
    return sc.solve(scene, *how, step=step)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("batch", range(0, COUNT, BATCH))
def test_a_random_tree_is_right_or_refused(batch: int, tmp_path: Path) -> None:
    peer("mujoco")
    refused, path = 0, tmp_path / "tree.xml"
    for seed in range(batch, min(batch + BATCH, COUNT)):
        tree = random_tree(seed)
        scene = scene_of(tree, options := chosen(tree, seed))
        kind = sc.analyse(scene).classification
        path.write_text(as_mjcf(tree))
        # With the driven joints as outputs the system Jacobian is positive definite: nothing can be singular.
        if sorted(options.outputs) == sorted(options.inputs or ()):
            solution = solved(scene, kind, STEP)
        else:
            try:
                solution = solved(scene, kind, STEP)
            except (sc.InvalidModel, sc.IntegrationFailed):
                refused += 1
                assert kind != FLAT, f"tree {seed}"
                continue
        error = error_of(tree, solution, path)
        # Internal dynamics that are driven far away take smaller steps, with which the error vanishes.
        assert error < RIGHT or error_of(tree, solved(scene, kind, STEP / 4), path) < error / 8, f"tree {seed}"
    assert refused <= BATCH // 2
