"""Robot files that others published: dynamics of Pinocchio and MuJoCo, the elastic closed form, MuJoCo as a plant.

`make nightly` runs all; the packages are the extra ``robots``.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from outside.test_random_mechanisms import DIFFERENCE
from robots import apart_from_mujoco, apart_from_pinocchio, peer, published, simulated_stray, stripped

import servocore as sc
from servocore.importers.from_file import read_tree

pytestmark = pytest.mark.nightly

URDFS = published("cmeel", "cmeel.prefix/share/example-robot-data/robots", ".urdf")
BARE = ("lqr.xml", "materials.xml", "skybox.xml", "visual.xml")
"""Files without joints, which others include or complete."""
FOLDERS = {"dm_control": "dm_control/suite", "gymnasium": "gymnasium/envs/mujoco/assets"}
MODELS = [path for each in FOLDERS for path in published(each, FOLDERS[each], ".xml") if path.name not in BARE]
REFUSED = {
    "alex_psyonic_hands.urdf": "mimics index_q1, which is no joint of the file",
    "romeo_small.urdf": "no distribution of mass",
    "romeo_laas_small.urdf": "no distribution of mass",
    "ur3.urdf": "no <link>",
}
"""Published files that are refused, and why."""


def test_the_packages_with_robots_are_installed() -> None:
    for name in ("pinocchio", "mujoco", "dm_control", "gymnasium"):
        assert find_spec(name), f"{name} is missing: pip install -e .[robots]"
    assert len(URDFS) - len(REFUSED) >= 40
    assert len(MODELS) >= 30


@pytest.mark.parametrize("path", [*URDFS, *MODELS], ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_dynamics_are_those_of_pinocchio_or_mujoco(path: Path) -> None:
    compared = apart_from_pinocchio if path in URDFS else apart_from_mujoco
    if path.name in REFUSED:
        with pytest.raises(sc.InvalidModel, match=REFUSED[path.name]):
            compared(path)
    else:
        assert compared(path) < 1e-11


ARMS = {
    "ur5_robot": "", "ur10_robot": "", "ur3_robot": "", "xarm7": "", "talos_left_arm": "", "panda": "finger",
    "z1": "ripper", "kinova": "finger", "double_pendulum": "", "TwoDofs": "", "hextilt_flying_arm_5": "",
    "baxter": "right head gripper",
}  # fmt: skip
"""Arms, and parts of the names of joints that are held."""


def arm(name: str, K: float | None, **more: Any) -> tuple[Path, list[str], sc.Scene]:
    """Return the file of an arm, the joints that are held, and its scene in a posture by chance."""
    path = next((path for path in URDFS if path.stem == name), None)
    if path is None:
        pytest.skip("example-robot-data is missing: pip install -e .[robots]")
    joints, rng = read_tree(path).joints, np.random.default_rng(1)
    held = [each for each in joints if joints[each].mimic or any(part in each for part in ARMS[name].split())]
    posture = dict[str, float]()
    for each in [each for each in joints if each not in held]:
        turn, joint = rng.uniform(0.3, 0.8) * rng.choice([-1, 1]), joints[each]
        posture[each] = float(np.clip(turn, max(joint.lower, -3) * 0.8, min(joint.upper, 3) * 0.8))
    elastic = {each: sc.Elastic(K, motor_inertia=0.3) for each in posture} if K else {}
    locked = [each for each in held if not joints[each].mimic]
    scene = sc.scenes.from_file(path, posture=posture, elastic=elastic, locked=locked, limits=False, **more)
    return path, held, scene


@pytest.mark.parametrize("K", [1e3, 1e4, 1e5])
@pytest.mark.parametrize("name", list(ARMS)[:8])
def test_elastic_inputs_are_the_closed_form_by_pinocchios_newton_euler(name: str, K: float) -> None:
    pin = peer("pinocchio")
    path, held, scene = arm(name, K)
    names = [each.name for each in scene.model().outputs]
    rng, m = np.random.default_rng(5), len(names)
    turns = np.array(scene.model().home) + np.vstack([np.zeros(m), rng.uniform(-0.4, 0.4, (3, m))])
    scene = scene.with_reference(sc.through(turns, [0.0, 1.1, 1.9, 3.0], rest_order=8))
    model = pin.buildModelFromUrdf(str(path))
    model = pin.buildReducedModel(model, [model.getJointId(each) for each in held], pin.neutral(model))
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    data = model.createData()
    places = [model.joints[model.getJointId(each)] for each in names]
    damping = np.array([read_tree(path).joints[each].damping for each in names])

    def torques(t: float) -> np.ndarray:
        q, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for joint, (x, dx, ddx) in zip(places, scene.reference.jet(np.array([t]), 2)[0].T, strict=True):
            q[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
            v[joint.idx_v], a[joint.idx_v] = dx, ddx
        found = pin.rnea(model, data, q, v, a)[[joint.idx_v for joint in places]]
        return np.asarray(found + damping * scene.reference.jet(np.array([t]), 1)[0, 1])

    step = 4e-3
    times = np.array([0.21, 0.8, 1.4, 2.3])
    ours = sc.ExactInversion(scene)(times)
    around = np.array([[torques(t + k * step) for t in times] for k in range(-8, 9)])
    second = np.tensordot(np.convolve(DIFFERENCE, DIFFERENCE), around, 1) / step**2
    exact = around[8] + 0.3 * (scene.reference.jet(times, 2)[:, 2] + second / K)
    assert np.abs(ours - exact).max() < 1e-9 * np.abs(ours).max()


# The kinova is unstable: it leaves its path in a second.
RUNS: list[tuple[str, float | None, str]] = [(name, None, "") for name in ARMS if name != "kinova"]
RUNS += [(name, 1e4, "") for name in list(ARMS)[:8]]
RUNS += [("ur5_robot", 1e4, "tool0"), ("z1", 1e4, "link06")]


@pytest.mark.parametrize(("name", "K", "tool"), RUNS)
def test_mujoco_follows_the_path_under_the_inputs(name: str, K: float | None, tool: str, tmp_path: Path) -> None:
    more: dict[str, Any] = {"outputs": [tool, *(f"{tool}.r{axis}" for axis in "xyz")]} if tool else {}
    path, held, scene = arm(name, K, **more)
    if tool:  # towards the axis of the base, where it is in reach
        home = np.array(scene.model().home)
        target = np.concatenate([0.85 * home[:3], [0.2, -0.1, 0.1]])
        scene = scene.with_reference(sc.rest_to_rest(home.tolist(), target.tolist(), 2.0, profile=sc.DEGREE13))
    assert simulated_stray(stripped(path, tmp_path, held), scene) < 1e-3
