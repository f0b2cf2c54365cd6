"""Mechanisms by chance as trees of bodies and as MJCF, with springs, dampers, and drives on some joints."""

from __future__ import annotations

import numpy as np

from servocore.importers.tree import Body, Joint, Tree


def random_tree(seed: int) -> Tree:
    """Return a tree of one to four bodies; each hangs on the ground or an earlier one by one or two joints."""
    rng = np.random.default_rng(seed)
    bodies = list[Body]()
    for k in range(int(rng.integers(1, 5))):
        joints = []
        for j in range(int(rng.integers(1, 3))):
            axis = rng.normal(size=3)
            joints.append(
                Joint(
                    f"j{k}_{j}",
                    str(rng.choice(["hinge", "hinge", "slide"])),
                    axis / np.linalg.norm(axis),
                    rng.uniform(-0.2, 0.2, 3),
                    stiffness=float(rng.uniform(20.0, 200.0)),
                    rest=float(rng.uniform(-0.2, 0.2)),
                    damping=float(rng.uniform(1.0, 5.0)),
                    armature=float(rng.choice([0.0, 0.1])),
                    zero=float(rng.choice([0.0, 0.3])),
                )
            )
        moments = rng.uniform(0.05, 0.2, 3)
        turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turned *= np.linalg.det(turned)
        parent = "" if not bodies or rng.random() < 0.2 else bodies[int(rng.integers(len(bodies)))].name
        inertia = turned @ np.diag(moments.sum() - moments) @ turned.T
        mass, centre = float(rng.uniform(0.5, 3.0)), rng.uniform(-0.2, 0.2, 3)
        bodies.append(Body(f"b{k}", parent, rng.uniform(-0.4, 0.4, 3), turned, mass, centre, inertia, joints))
    return Tree(f"tree{seed}", f"tree{seed}", bodies)


def as_mjcf(tree: Tree) -> str:
    """Return the same mechanism as MJCF."""
    return f"<mujoco><compiler angle='radian'/><worldbody>{_children(tree, '')}</worldbody></mujoco>"


def _children(tree: Tree, parent: str) -> str:
    text = ""
    for body in tree.bodies:
        if body.parent != parent:
            continue
        entries = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        text += (
            f"<body name='{body.name}' pos='{_row(body.position)}' xyaxes='{_row(body.rotation[:, :2].T)}'><inertial"
            f" pos='{_row(body.centre)}' mass='{body.mass!r}' fullinertia='{_row(entries)}'/>"
        )
        for joint in body.joints:
            text += (
                f"<joint name='{joint.name}' type='{joint.kind}' axis='{_row(joint.axis)}' pos='{_row(joint.anchor)}'"
                f" ref='{joint.zero}' stiffness='{joint.stiffness!r}' springref='{joint.rest!r}'"
                f" damping='{joint.damping!r}' armature='{joint.armature}'/>"
            )
        text += f"{_children(tree, body.name)}</body>"
    return text


def _row(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values.ravel())
