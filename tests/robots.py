"""Other implementations of the dynamics of robot files, Pinocchio and MuJoCo; MuJoCo as a plant of computed inputs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import servocore as sc
from servocore.importers.assembly import Assembly
from servocore.importers.coordinates import Layout
from servocore.importers.from_file import read_tree
from servocore.importers.options import Options
from servocore.importers.tree import Tree

OWN = Path(__file__).parent / "mechanisms"
FREE = "CONTACT LIMIT FRICTIONLOSS"
"""What MuJoCo leaves out, as servocore does."""


def peer(name: str) -> Any:
    """Return a module of the extra ``robots``; the test is skipped without it."""
    return pytest.importorskip(name, reason=f"{name} is missing: pip install -e .[robots]")


@cache
def published(package: str, below: str, suffix: str) -> list[Path]:
    """Return the files of a package of robots; none if it is missing."""
    spec = find_spec(package)
    folders = spec.submodule_search_locations if spec is not None else None
    root = Path(next(iter(folders))).parent / below if folders else None
    return sorted(root.rglob(f"*{suffix}")) if root is not None else []


def stripped(path: Path, folder: Path, locked: Collection[str] = ()) -> Path:
    """Return a copy of a URDF without meshes, which MuJoCo would open, and with some joints fixed."""
    tree = ElementTree.parse(path)
    for joint in tree.getroot().findall("joint"):
        if joint.get("name") in locked:
            joint.set("type", "fixed")
    for link in tree.getroot().iter("link"):
        for tag in ("visual", "collision"):
            for each in link.findall(tag):
                link.remove(each)
    copy = folder / path.name
    tree.write(copy)
    return copy


def mujoco_model(path: Path, disabled: str = FREE) -> Any:
    """Return MuJoCo's model of a file, without some effects."""
    mujoco = peer("mujoco")
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    model = mujoco.MjModel.from_xml_path(str(path))
    mujoco.set_mju_user_warning(before)
    for name in disabled.split():
        model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
    model.opt.density = model.opt.viscosity = 0.0
    return model


def taken(model: Any, data: Any, names: Sequence[str], x: np.ndarray) -> np.ndarray:
    """Set MuJoCo's configuration by coordinates of ours; return T of their rates T qvel, shape (coordinates, nv)."""
    T, mujoco = np.zeros((len(names), model.nv)), peer("mujoco")
    data.qpos[:] = model.qpos0
    for j in range(model.njnt):
        body = model.jnt_bodyid[j]
        name = model.joint(j).name or f"{model.body(body).name}.joint{j - model.body_jntadr[body]}"
        at, dof, kind = model.jnt_qposadr[j], model.jnt_dofadr[j], model.jnt_type[j]
        slides = [name] if kind in (2, 3) else [f"{name}.{axis}" for axis in "xyz"] if kind == 0 else []
        for k, slide in enumerate(slides):
            data.qpos[at + k], T[names.index(slide), dof + k] = x[names.index(slide)], 1.0
        if kind in (0, 1):
            rows, at, dof = [names.index(f"{name}.e{k}") for k in range(4)], at + len(slides), dof + len(slides)
            (w, a, b, c), turned = x[rows], np.zeros(4)
            mujoco.mju_mulQuat(turned, model.qpos0[at : at + 4], x[rows])
            data.qpos[at : at + 4] = turned
            T[rows, dof : dof + 3] = np.array([[-a, -b, -c], [w, -c, b], [c, w, -a], [-b, a, w]]) / 2
    return T


def terms(tree: Tree) -> tuple[Layout, ca.Function]:
    """Return the coordinates, and M, inertia forces, weight with springs, dampers as a function of q and v."""
    assembly = Assembly(tree, Options())
    layout, q, v = assembly, assembly.q, assembly.v
    forces = ca.mtimes(layout.reduction.T, layout.motion.inertia_forces())
    weight = ca.gradient(assembly._potential(ca.SX(ca.DM(list(tree.gravity)))), q)
    return layout, ca.Function("terms", [q, v], [assembly.mass, forces, weight, -assembly._damping()])


def apart(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Return the largest difference within pairs, relative to the largest value of all."""
    size = max(float(np.abs(theirs).max(initial=0.0)) for _, theirs in pairs)
    return max(float(np.abs(ours - theirs).max(initial=0.0)) for ours, theirs in pairs) / (size or 1.0)


def apart_from_pinocchio(path: Path) -> float:
    """Return the relative difference of M, inertia forces and weight from Pinocchio at configurations by chance."""
    pin, tree, worst = peer("pinocchio"), read_tree(path), 0.0
    layout, evaluate = terms(tree)
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = np.array(tree.gravity)
    names, data, rng = list(layout.motion.q), model.createData(), np.random.default_rng(3)
    joints = [model.joints[model.getJointId(name)] for name in names]
    order, A = [joint.idx_v for joint in joints], np.asarray(ca.DM(layout.reduction))
    coordinates = ca.vertcat(ca.SX(0, 1), *[layout.motion.q[name] for name in names])
    everywhere = ca.Function("everywhere", [layout.coordinates.q], [coordinates])
    for _ in range(3):
        x, rates = rng.uniform(-1.0, 1.0, (2, len(layout.coordinates)))
        q, v = pin.neutral(model), np.zeros(model.nv)
        v[order] = A @ rates
        for joint, value in zip(joints, np.asarray(everywhere(x)).ravel(), strict=True):
            q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        M = np.triu(pin.crba(model, data, q))
        M = A.T @ (M + np.triu(M, 1).T)[np.ix_(order, order)] @ A
        weight = A.T @ pin.computeGeneralizedGravity(model, data, q)[order]
        forces = A.T @ pin.nonLinearEffects(model, data, q, v)[order] - weight
        mass, inertia, rest, _ = (np.asarray(each) for each in evaluate(x, rates))
        worst = max(worst, apart([(mass, M)]), apart([(inertia.ravel(), forces), (rest.ravel(), weight), (mass, M)]))
    return worst


def apart_from_mujoco(path: Path) -> float:
    """Return the relative difference of M and all other forces from MuJoCo at configurations by chance."""
    mujoco, model, worst = peer("mujoco"), mujoco_model(path, f"{FREE} EQUALITY ACTUATION"), 0.0
    layout, evaluate = terms(read_tree(path))
    data, rng, names = mujoco.MjData(model), np.random.default_rng(3), layout.coordinates.names
    for _ in range(3):
        x, M = rng.uniform(-1.0, 1.0, len(names)), np.zeros((model.nv, model.nv))
        for k in [k for k, name in enumerate(names) if name.endswith(".e0")]:
            x[k : k + 4] /= np.linalg.norm(x[k : k + 4])
        T = taken(model, data, names, x)
        data.qvel[:], data.qacc[:] = rng.uniform(-1.0, 1.0, model.nv), 0.0
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        data.qacc[:] = 0.0
        mujoco.mj_inverse(model, data)
        mass, *forces = (np.asarray(each) for each in evaluate(x, T @ data.qvel))
        masses = (T.T @ mass @ T, M)
        worst = max(worst, apart([masses]), apart([masses, (T.T @ np.sum(forces, axis=0).ravel(), data.qfrc_inverse)]))
    return worst


def simulated_stray(path: Path, scene: sc.Scene) -> float:
    """Return how far (mm) MuJoCo's bodies come from the planned motion under the inputs of a flat scene.

    The inputs of joints act on MuJoCo's joints; springs and rotors of elastic joints are integrated beside it.
    """
    mujoco = peer("mujoco")
    model = mujoco_model(path)
    data, system = mujoco.MjData(model), scene.model()
    names = system.coordinates.names
    links = [model.joint(j).name for j in range(model.njnt)]
    motors = [name.removesuffix(".motor") for name in names if name.endswith(".motor")]
    values = scene.parameter_values()
    K, B = (np.array([values[f"{name}.{what}"] for name in motors]) for what in ("stiffness", "motor_inertia"))
    solution, inputs = sc.solve(scene), sc.ExactInversion(scene)
    dofs = {name: int(model.jnt_dofadr[links.index(name)]) for name in links}
    driven = [name.rpartition(".")[0] for name in inputs.inputs]
    start = {name: solution[name][0] for name in names}

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        q, v, theta, omega = np.split(state, np.cumsum([model.nq, model.nv, len(motors)]))
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, 0.0
        u = dict(zip(driven, inputs(min(t, scene.reference.end_time)), strict=True))
        springs = K * (theta - q[[dofs[name] for name in motors]])
        forces = u | dict(zip(motors, springs, strict=True))
        data.qfrc_applied[[dofs[name] for name in forces]] = list(forces.values())
        mujoco.mj_forward(model, data)
        accelerations = (np.array([u[name] for name in motors]) - springs) / B
        return np.concatenate([v, data.qacc, omega, accelerations])

    q = np.array([start.get(name, 0.0) for name in links])
    theta = np.array([start[f"{name}.motor"] for name in motors])
    begin = np.concatenate([q, np.zeros(model.nv), theta, np.zeros(len(motors))])
    run = solve_ivp(
        rates, (0.0, solution.t[-1]), begin, method="DOP853", rtol=1e-9, atol=1e-11, t_eval=solution.t[::20]
    )
    points = [name.removesuffix(".x") for name in names if name.endswith(".x") and f"{name[:-2]}.z" in names]
    stray = 0.0
    for k, t in enumerate(run.t):
        planned = {name: np.interp(t, solution.t, solution[name]) for name in names}
        places = []
        for configuration in (run.y[: model.nq, k], [planned.get(name, 0.0) for name in links]):
            data.qpos[:] = configuration
            mujoco.mj_kinematics(model, data)
            places.append(data.xpos.copy())
        if points:  # of ropes, whose hinges are not among the coordinates
            places = [places[0][[model.body(each).id for each in points]]]
            places.append(np.array([[planned[f"{each}.{axis}"] for axis in "xyz"] for each in points]))
        stray = max(stray, 1e3 * float(np.abs(places[0] - places[1]).max()))
    return stray
