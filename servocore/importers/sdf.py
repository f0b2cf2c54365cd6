"""SDF: links and joints of a model of Gazebo or Drake. Meshes are not opened.

Links without a joint to a parent are free, unless the model is static. A joint whose child already has a parent closes
a loop: it becomes a constraint.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from xml.etree.ElementTree import Element

import numpy as np

from servocore.importers.recursion import Place
from servocore.importers.tree import GROUND, IDENTITY, ZERO, Body, Closure, Joint, Tree
from servocore.importers.xml_files import LinkReader, XmlFile
from servocore.numerics.compiled_calls import Array

_AXES = {"revolute": 1, "continuous": 1, "prismatic": 1, "universal": 2, "ball": 0, "fixed": 0}
_LOOPS = {"revolute": "hinge", "continuous": "hinge", "ball": "connect", "fixed": "weld"}
_GRAVITY = (0.0, 0.0, -9.8)
_IN_MODEL = ("1.0", "1.2", "1.3", "1.4")  # versions whose axes are in the axes of the model
_UNREAD = ("visual", "collision", "sensor", "plugin", "gui", "light")
_ATTRIBUTES = ("placement_frame", "expressed_in", "degrees", "rotation_format", "auto")
_USUAL = ("", "0", "false", "euler_rpy", "__model__")  # values that change nothing, or are read


def _read(element: Element) -> Iterator[Element]:
    """Yield the elements below one that have a part in the motion."""
    for child in element:
        if child.tag not in _UNREAD:
            yield child
            yield from _read(child)


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
    return _Reader(file, "inertial/mass", math.inf).tree()


class _Reader(LinkReader):
    def tree(self) -> Tree:
        file, models = self.file, [*self.file.root.iter("model")]
        for element in _read(file.root):
            if element.get("relative_to") or element.get("frame") or element.tag == "include":
                raise file.fault(element, "refers to another frame or file, which is not supported")
            for name, value in element.items():
                if name in _ATTRIBUTES and value not in _USUAL:
                    why = f"has {name}={value!r}, which is not supported: write numbers in m and rad"
                    raise file.fault(element, why)
        if len(models) != 1:
            raise file.fault(file.root, f"has {len(models)} models, one is read")
        (model,) = models
        links = {file.required(link, "name"): link for link in model.findall("link")}
        self.model = Place(-1, *self.pose(model, model))
        self.places = {name: self.model.moved(*self.pose(link, link)) for name, link in links.items()}
        self.places[GROUND] = Place(-1, ZERO, IDENTITY)
        ends = {name: name for name in links} | {"world": GROUND}
        self.static = self._flag(model, "static")
        self.left_out += [f"frame {frame.get('name')}: links are frames" for frame in model.findall("frame")]
        self.frames, self.closures, hung = list[Body](), list[Closure](), dict[str, tuple[Element, str]]()
        for joint in model.findall("joint"):
            child, parent = (self.end(joint, which, ends) for which in ("child", "parent"))
            if child in hung:
                self._close(joint, parent, child)
            hung.setdefault(child, (joint, parent))
        bodies = [self._body(name, link, *hung.get(name, (None, GROUND))) for name, link in links.items()]
        bodies += self.frames
        gravity = file.numbers(file.root, file.root.findtext("world/gravity"), _GRAVITY).tolist()
        name = file.required(model, "name")
        return Tree(name, file.path.name, bodies, (), {}, self.closures, gravity, self.left_out)

    def _body(self, name: str, link: Element, joint: Element | None, parent: str) -> Body:
        here = self.places[name]
        free = [] if self.static else Joint.free(name, here.rotation, here.position)
        joints = free if joint is None else self._joints(joint, name)
        for tag, usual in (("gravity", True), ("kinematic", False)):
            if self._flag(link, tag, usual) != usual:
                raise self.file.fault(link, f"has <{tag}> {str(not usual).lower()}, which cannot be represented")
        mass, centre, inertia = self.inertia(link, 1.0)  # mass and inertia of a link that states none
        return Body(name, parent, *here.within(self.places[parent]), mass, centre, inertia, joints)

    def _flag(self, element: Element, tag: str, default: bool = False) -> bool:
        """Return a truth value in the text of a child."""
        text = (element.findtext(tag) or str(default)).strip().lower()
        if text not in ("0", "1", "false", "true"):
            raise self.file.fault(element, f"holds {text!r} in <{tag}> where true or false belongs")
        return text in ("1", "true")

    def _kind(self, joint: Element) -> str:
        kind = self.file.required(joint, "type")
        if kind not in _AXES:
            raise self.file.fault(joint, f"has the type {kind}; {', '.join(_AXES)} are supported")
        return kind

    def _axis(self, joint: Element, axis: Element, child: str) -> Array:
        """Return the axis of a joint in the axes of its child."""
        of_model = self._flag(axis, "use_parent_model_frame", self.file.root.get("version") in _IN_MODEL)
        of_model |= axis.find("xyz[@expressed_in='__model__']") is not None
        turned = self.places[child].rotation.T @ self.model.rotation if of_model else self.pose(joint, joint)[1]
        return np.asarray(turned @ self.direction(joint, axis, (0.0, 0.0, 1.0)))

    def _joints(self, joint: Element, child: str) -> Sequence[Joint]:
        """Return the elementary joints of a joint."""
        name, kind, anchor = self.file.required(joint, "name"), self._kind(joint), self.pose(joint, joint)[0]
        if kind == "ball":
            return (Joint(name, "ball", anchor=anchor),)
        axes = [self.file.child(joint, tag) for tag in ("axis", "axis2")[: _AXES[kind]]]
        found = zip((name, f"{name}.2"), axes, strict=False)
        return tuple(
            self.single(joint, axis, each, kind, self._axis(joint, axis, child), anchor) for each, axis in found
        )

    def _close(self, joint: Element, parent: str, child: str) -> None:
        """Add the constraint of a joint whose child already has a parent."""
        name, kind, (anchor, rotation) = self.file.required(joint, "name"), self._kind(joint), self.pose(joint, joint)
        if kind not in _LOOPS:
            raise self.file.fault(joint, f"closes a loop by the type {kind}; {', '.join(_LOOPS)} are supported")
        if _AXES[kind]:
            axis = self._axis(joint, self.file.child(joint, "axis"), child)
            rotation = np.linalg.svd(axis[:, None])[0][:, [1, 2, 0]]  # its last column is along the axis
        same = self.places[child].moved(anchor, rotation).within(self.places[parent])
        self.frames += [Body(f"{name}.1", child, anchor, rotation), Body(f"{name}.2", parent, *same)]
        self.closures.append(Closure(name, _LOOPS[kind], f"{name}.1", f"{name}.2"))
