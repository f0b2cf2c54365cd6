"""URDF and SDF: links and joints of a robot, in attributes of URDF, in the text of children of SDF. No mesh is opened.

The root link of a URDF stands on the ground. An effort or a velocity of zero means that there is no limit, as in many
files that leave it out.

Links of an SDF, of Gazebo or Drake, without a joint to a parent are free, unless the model is static. A joint whose
child already has a parent closes a loop: it becomes a constraint.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np

from servocore.importers.recursion import Place
from servocore.importers.tree import GROUND, IDENTITY, LARGEST, ZERO, Body, Closure, Joint, Tree
from servocore.importers.xml_files import XmlFile
from servocore.numerics.compiled_calls import Array

Pose = tuple[Array, Array]
"""Position (m), shape (3,), and rotation, shape (3, 3)."""

_TYPES = ("revolute", "continuous", "prismatic", "fixed", "planar", "floating")
_AXES = {"revolute": 1, "continuous": 1, "prismatic": 1, "universal": 2, "ball": 0, "fixed": 0}
_LOOPS = {"revolute": "hinge", "continuous": "hinge", "ball": "connect", "fixed": "weld"}
_GRAVITY = (0.0, 0.0, -9.8)
_IN_MODEL = ("1.0", "1.2", "1.3", "1.4")  # versions whose axes are in the axes of the model
_UNREAD = ("visual", "collision", "sensor", "plugin", "gui", "light")
_ATTRIBUTES = ("placement_frame", "expressed_in", "degrees", "rotation_format", "auto")
_USUAL = ("", "0", "false", "euler_rpy", "__model__")  # values that change nothing, or are read


class LinkReader:
    """The common part of the readers of URDF and SDF.

    Parameters
    ----------
    file : XmlFile
        The file.
    mass : str
        Path of the mass below a link.
    open_limit : float
        Magnitude of a missing limit of place.
    """

    def __init__(self, file: XmlFile, mass: str, open_limit: float) -> None:
        self.file, self.left_out, self._mass, self._open = file, list[str](), mass, open_limit
        if file.root.find(".//link/collision") is not None:
            self.left_out.append("contact between <collision> geometries")

    def pose(self, element: Element | None, named: Element) -> Pose:
        """Return position and rotation of an element, zero and identity without any; refusals name the other one."""
        origin = None if element is None else element.find("origin")
        text = None if element is None else element.findtext("pose")
        if origin is not None:
            text = f"{origin.get('xyz', '0 0 0')} {origin.get('rpy', '0 0 0')}"
        x, y, z, *rpy = self.file.numbers(named, text, (0.0,) * 6)
        return np.array([x, y, z]), _rotation(rpy)

    def inertia(self, link: Element, missing: float = 0.0) -> tuple[float, Array, Array]:
        """Return mass, centre of mass and inertia about it in a link's axes; `missing` stands for a missing one."""
        tensor = np.zeros((3, 3))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            path = f"inertial/inertia/i{'xyz'[i]}{'xyz'[j]}"
            tensor[i, j] = tensor[j, i] = self.file.value(link, path, missing * (i == j))
        centre, turned = self.pose(link.find("inertial"), link)
        return self.file.value(link, self._mass, missing), centre, turned @ tensor @ turned.T

    def end(self, joint: Element, which: str, links: Mapping[str, str]) -> str:
        """Return the parent or the child of a joint by its name; raises `InvalidModel` if it is no link."""
        element = self.file.child(joint, which)
        name = element.get("link") or (element.text or "").strip()
        if name not in links:
            raise self.file.fault(joint, f"joins the link {name}, which does not exist")
        return links[name]

    def direction(self, joint: Element, axis: Element | None, default: tuple[float, float, float]) -> Array:
        """Return the axis of a joint, of unit length."""
        text = None if axis is None else axis.get("xyz") or axis.findtext("xyz")
        values = self.file.numbers(joint, text, default)
        if not values.any():
            raise self.file.fault(joint, "has an axis of length zero")
        values = values / np.abs(values).max()  # whose square may be beyond the largest number
        return np.asarray(values / np.linalg.norm(values))

    def single(self, joint: Element, holder: Element, name: str, kind: str, axis: Array, anchor: Array) -> Joint:
        """Return a hinge or a slide, whose limits and dynamics are below `holder`."""
        file = self.file
        ends = [file.value(holder, f"limit/{end}", sign * self._open) for end, sign in (("lower", -1), ("upper", 1))]
        if ends[0] > ends[1]:
            raise file.fault(joint, f"has the lower limit {ends[0]:g} above the upper {ends[1]:g}")
        if kind != "continuous" and ends[0] == ends[1]:
            self.left_out.append(f"limits of joint {name}, both {ends[0]:g}, are taken for none")
        if kind == "continuous" or ends[0] == ends[1]:
            ends = [-math.inf, math.inf]
        limits = [end if abs(end) < LARGEST else math.copysign(math.inf, end) for end in ends]  # SDF writes 1e16
        for which in ("velocity", "effort"):
            value = file.value(holder, f"limit/{which}", math.inf)
            if not value > 0.0:  # many files leave it out in this way
                self.left_out.append(f"{which} limit of joint {name}: {value:g} is taken for none")
            limits.append(value if value > 0.0 else math.inf)
        if file.value(holder, "dynamics/friction", 0.0):
            self.left_out.append(f"dry friction of joint {name}")
        names = ("spring_stiffness", "spring_reference", "damping")
        stiffness, rest, damping = (file.value(holder, f"dynamics/{which}", 0.0) for which in names)
        lower, upper, velocity, effort = limits
        moves = "slide" if kind == "prismatic" else "hinge"
        return Joint(name, moves, axis, anchor, lower, upper, velocity, effort, stiffness, rest, damping)


def _rotation(rpy: Sequence[float]) -> Array:
    """Return the rotation of roll, pitch and yaw (rad) about fixed axes x, y, z, shape (3, 3)."""
    rotation = IDENTITY
    for axis, angle in zip(IDENTITY, rpy, strict=True):
        cross = np.cross(IDENTITY, axis)
        rotation = (IDENTITY + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross) @ rotation
    return rotation


def read_urdf(file: XmlFile) -> Tree:
    """Return the tree of a URDF file.

    Parameters
    ----------
    file : XmlFile
        With the root ``robot``.

    Returns
    -------
    Tree
        Its links and joints.

    Raises
    ------
    InvalidModel
        If links or joints are missing, doubled, or contradict each other; with file and element.
    """
    for element in file.root:
        if "xacro:" in element.tag:
            raise file.fault(element, "is xacro: run xacro on the file first")
    return _Urdf(file, "inertial/mass/value", 0.0).tree()


class _Urdf(LinkReader):
    def tree(self) -> Tree:
        file, root = self.file, self.file.root
        links = [(file.required(link, "name"), link) for link in root.findall("link")]
        ends = {name: name for name, _ in links}
        hung = dict[str, tuple[Element, str]]()
        for joint in root.findall("joint"):
            child, parent = (self.end(joint, which, ends) for which in ("child", "parent"))
            if child in hung:
                other = hung[child][0].get("name")
                raise file.fault(joint, f"gives {child} a second parent, beside joint {other}: a URDF is a tree")
            hung[child] = joint, parent
        roots = [name for name in ends if name not in hung]
        if not links or len(roots) > 1:
            listed = ", ".join(roots[:4])
            why = f"has {len(roots)} root links, {listed}: all but one need a joint to a parent"
            raise file.fault(root, why if links else "has no <link>")
        if transmissions := [str(each.get("name")) for each in root.findall("transmission")]:
            self.left_out.append(f"transmissions {', '.join(transmissions)}: inputs act on the joints")
        bodies = [self._body(name, link, *hung.get(name, (None, GROUND))) for name, link in links]
        return Tree(root.get("name") or file.path.stem, file.path.name, bodies, left_out=self.left_out)

    def _body(self, name: str, link: Element, joint: Element | None, parent: str) -> Body:
        mass, centre, inertia = self.inertia(link)
        if joint is None:
            self.left_out += [f"mass of {name}: the root stands on the ground"] if mass else []
            return Body(name, parent, ZERO, IDENTITY, mass, centre, inertia)
        return Body(name, parent, *self.pose(joint, joint), mass, centre, inertia, self._joints(joint))

    def _joints(self, joint: Element) -> Sequence[Joint]:
        """Return the elementary joints of a joint."""
        file, name, kind = self.file, self.file.required(joint, "name"), self.file.required(joint, "type")
        if kind not in _TYPES:
            raise file.fault(joint, f"has the type {kind}; there are {', '.join(_TYPES)}")
        if kind == "fixed":
            return ()
        if kind == "floating":
            return Joint.free(name, IDENTITY, ZERO)
        axis = self.direction(joint, joint.find("axis"), (1.0, 0.0, 0.0))
        if kind == "planar":
            first = np.linalg.svd(axis[None])[2][1]
            across = (first, np.cross(axis, first))
            return (*(Joint(f"{name}.{'xy'[k]}", "slide", across[k]) for k in range(2)), Joint(name, "hinge", axis))
        if kind != "continuous" and joint.find("limit") is None:
            raise file.fault(joint, f"is {kind} and has no <limit>")
        found, follows = self.single(joint, joint, name, kind, axis, ZERO), joint.find("mimic")
        if follows is None:
            return (found,)
        if math.isfinite(found.upper - found.lower):
            self.left_out.append(f"limits of joint {name}: it follows {follows.get('joint')}")
        factor, offset = file.value(follows, "multiplier", 1.0), file.value(follows, "offset", 0.0)
        return (replace(found, mimic=(file.required(follows, "joint"), factor, offset)),)


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
    return _Sdf(file, "inertial/mass", math.inf).tree()


class _Sdf(LinkReader):
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
        return [self.single(joint, axis, each, kind, self._axis(joint, axis, child), anchor) for each, axis in found]

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
