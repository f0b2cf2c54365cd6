"""SDF: links and joints of a model of Gazebo or Drake. Meshes are not opened.

Links without a joint to a parent are free, unless the model is static. A joint whose child already has a parent closes
a loop: it becomes a constraint.
"""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

import numpy as np

from servocore.importers.tree import GROUND, IDENTITY, ZERO, Body, Closure, Frame, Joint, Tree
from servocore.importers.xml_files import XmlFile, rotation_of
from servocore.numerics.compiled_calls import Array

_AXES = {"revolute": 1, "continuous": 1, "prismatic": 1, "universal": 2, "ball": 0, "fixed": 0}
_LOOPS = {"revolute": "hinge", "continuous": "hinge", "ball": "connect", "fixed": "weld"}
_GRAVITY = (0.0, 0.0, -9.8)
_WORLD = "world"

Pose = tuple[Array, Array]


def read_sdf(file: XmlFile) -> Tree:
    """Return the tree of an SDF file.

    Parameters
    ----------
    file : XmlFile
        With the root ``sdf``, and one model in it.

    Returns
    -------
    Tree
        With loops as constraints.

    Raises
    ------
    InvalidModel
        If there is no model or more than one, poses are relative to other frames, or a joint cannot be represented.
    """
    return _Reader(file).tree()


class _Reader:
    def __init__(self, file: XmlFile) -> None:
        models = [*file.root.iter("model")]
        for element in file.root.iter():
            if element.get("relative_to") or element.get("frame") or element.tag == "include":
                raise file.fault(element, "refers to another frame or file, which is not supported")
        if len(models) != 1:
            raise file.fault(file.root, f"has {len(models)} models, one is read")
        self.file, self.model = file, models[0]
        self.poses: dict[str, Pose] = {_WORLD: (ZERO, IDENTITY)}
        self.frames, self.closures, self.left_out = dict[str, Frame](), list[Closure](), list[str]()

    def tree(self) -> Tree:
        file, model = self.file, self.model
        links = {file.required(link, "name"): link for link in model.findall("link")}
        self.poses |= {name: self._pose(link, link) for name, link in links.items()}
        hung: dict[str, Element] = {}
        for joint in model.findall("joint"):
            child, parent = (file.text(joint, end) for end in ("child", "parent"))
            for end in (child, parent):
                if end not in self.poses:
                    raise file.fault(joint, f"joins the link {end}, which does not exist")
            if child in hung:
                self._close(joint, parent, child)
            else:
                hung[child] = joint
        if model.find("link/collision") is not None:
            self.left_out.append("contact between <collision> geometries")
        bodies = [self._body(name, link, hung.get(name)) for name, link in links.items()]
        x, y, z = file.numbers(file.root, file.root.findtext("world/gravity"), _GRAVITY).tolist()
        return Tree(
            file.required(model, "name"), file.path.name, bodies, self.frames, closures=self.closures,
            gravity=(x, y, z), left_out=tuple(self.left_out),
        )  # fmt: skip

    def _pose(self, element: Element, named: Element) -> Pose:
        """Return position and rotation of an element, zero and identity without a pose."""
        values = self.file.numbers(named, element.findtext("pose"), (0.0,) * 6)
        return values[:3], rotation_of(values[3:])

    def _body(self, name: str, link: Element, joint: Element | None) -> Body:
        parent = GROUND if joint is None else self.file.text(joint, "parent")
        (position, rotation), (origin, axes) = self.poses[name], self.poses[parent or _WORLD]
        joints: tuple[Joint, ...] = ()
        if joint is not None:
            joints = self._joints(joint, name)
        elif self.file.value(self.model, "static", 0.0) == 0.0:
            slides = (Joint(f"{name}.{'xyz'[k]}", "slide", rotation[k], zero=float(position[k])) for k in range(3))
            joints = (*slides, Joint(name, "ball"))
        inertial = link.find("inertial")
        centre, turned = (ZERO, IDENTITY) if inertial is None else self._pose(inertial, link)
        tensor = np.zeros((3, 3))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            tensor[i, j] = tensor[j, i] = self.file.value(
                link, f"inertial/inertia/i{'xyz'[i]}{'xyz'[j]}", float(i == j)
            )
        return Body(
            name, parent if parent != _WORLD else GROUND, axes.T @ (position - origin), axes.T @ rotation,
            self.file.value(link, "inertial/mass", 1.0), centre, turned @ tensor @ turned.T, joints,
        )  # fmt: skip

    def _kind(self, joint: Element) -> str:
        kind = self.file.required(joint, "type")
        if kind not in _AXES:
            raise self.file.fault(joint, f"has the type {kind}; {', '.join(_AXES)} are supported")
        return kind

    def _axis(self, joint: Element, axis: Element, child: str) -> Array:
        """Return the axis of a joint in the axes of its child."""
        file = self.file
        values = file.numbers(joint, axis.findtext("xyz"), (0.0, 0.0, 1.0))
        if not np.linalg.norm(values) > 0.0:
            raise file.fault(joint, "has an axis of length zero")
        of_model = file.value(axis, "use_parent_model_frame", 0.0) != 0.0
        turned = self.poses[child][1].T if of_model else self._pose(joint, joint)[1]
        return np.asarray(turned @ values / np.linalg.norm(values))

    def _joints(self, joint: Element, child: str) -> tuple[Joint, ...]:
        """Return the elementary joints of a joint."""
        file, name, kind = self.file, self.file.required(joint, "name"), self._kind(joint)
        anchor, _ = self._pose(joint, joint)
        if kind == "ball":
            return (Joint(name, "ball", anchor=anchor),)
        joints = list[Joint]()
        for tag in ("axis", "axis2")[: _AXES[kind]]:
            axis = file.child(joint, tag)
            lower, upper = (
                file.value(axis, f"limit/{end}", sign * 1e16) for end, sign in (("lower", -1), ("upper", 1))
            )
            velocity, effort = (file.value(axis, f"limit/{which}", -1.0) for which in ("velocity", "effort"))
            if file.value(axis, "dynamics/friction", 0.0):
                self.left_out.append(f"dry friction of joint {name}")
            joints.append(
                Joint(
                    name if tag == "axis" else f"{name}.2",
                    "slide" if kind == "prismatic" else "hinge",
                    self._axis(joint, axis, child),
                    anchor,
                    lower if abs(lower) < 1e15 else -math.inf,
                    upper if abs(upper) < 1e15 else math.inf,
                    velocity if velocity > 0.0 else math.inf,
                    effort if effort > 0.0 else math.inf,
                    file.value(axis, "dynamics/spring_stiffness", 0.0),
                    file.value(axis, "dynamics/spring_reference", 0.0),
                    file.value(axis, "dynamics/damping", 0.0),
                )
            )
        return tuple(joints)

    def _close(self, joint: Element, parent: str, child: str) -> None:
        """Add the constraint of a joint whose child already has a parent."""
        name, kind = self.file.required(joint, "name"), self._kind(joint)
        if kind not in _LOOPS:
            raise self.file.fault(joint, f"closes a loop by the type {kind}; {', '.join(_LOOPS)} are supported")
        anchor, rotation = self._pose(joint, joint)
        if _AXES[kind]:
            axis = self._axis(joint, self.file.child(joint, "axis"), child)
            rotation = np.linalg.svd(axis[:, None])[0][:, [1, 2, 0]]  # its last column is along the axis
        position, axes = self.poses[child]
        origin, other = self.poses[parent]
        at = other.T @ (position + axes @ anchor - origin)
        self.frames[f"{name}.1"] = Frame(child, anchor, rotation)
        self.frames[f"{name}.2"] = Frame(parent if parent != _WORLD else GROUND, at, other.T @ axes @ rotation)
        self.closures.append(Closure(name, _LOOPS[kind], f"{name}.1", f"{name}.2"))
