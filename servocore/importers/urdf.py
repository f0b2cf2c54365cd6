"""URDF: links and joints of a robot. Meshes are not opened.

A root link stands on the ground. An effort or a velocity of zero means that there is no limit, as in many files that
leave it out.
"""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

import numpy as np

from servocore.importers.tree import GROUND, IDENTITY, ZERO, Body, Joint, Tree
from servocore.importers.xml_files import XmlFile, rotation_of
from servocore.numerics.compiled_calls import Array

_KINDS = ("revolute", "continuous", "prismatic", "fixed", "planar", "floating")


def read_urdf(file: XmlFile) -> Tree:
    """Return the tree of a URDF file.

    Parameters
    ----------
    file : XmlFile
        With the root ``robot``.

    Returns
    -------
    Tree
        With a drive on every joint that moves and mimics none.

    Raises
    ------
    InvalidModel
        If links or joints are missing, doubled, or contradict each other; with file and element.
    """
    return _Reader(file).tree()


class _Reader:
    def __init__(self, file: XmlFile) -> None:
        self.file, self.left_out = file, list[str]()

    def tree(self) -> Tree:
        file, root = self.file, self.file.root
        for element in root:
            if not isinstance(element.tag, str) or "xacro:" in element.tag:
                raise file.fault(element, "is xacro: run xacro on the file first")
        links, hung = self._links(), dict[str, Element]()
        for joint in root.findall("joint"):
            child = file.required(file.child(joint, "child"), "link")
            for end in (child, file.required(file.child(joint, "parent"), "link")):
                if end not in links:
                    raise file.fault(joint, f"joins the link {end}, which does not exist")
            if child in hung:
                other = hung[child].get("name")
                raise file.fault(joint, f"gives {child} a second parent, beside joint {other}: a URDF is a tree")
            hung[child] = joint
        roots = [name for name in links if name not in hung]
        if len(roots) > 1:
            listed = ", ".join(roots[:4])
            raise file.fault(root, f"has {len(roots)} root links, {listed}: all but one need a joint to a parent")
        if roots and self._inertia(links[roots[0]])[0]:
            self.left_out.append(f"mass of {roots[0]}: the root stands on the ground")
        self._list_left_out()
        bodies = [self._body(name, link, hung.get(name)) for name, link in links.items()]
        name = root.get("name") or file.path.stem
        return Tree(name, file.path.name, bodies, left_out=tuple(self.left_out))

    def _links(self) -> dict[str, Element]:
        """Return the links by name."""
        links = dict[str, Element]()
        for link in self.file.root.findall("link"):
            if self.file.required(link, "name") in links:
                raise self.file.fault(link, "stands twice")
            links[str(link.get("name"))] = link
        if not links:
            raise self.file.fault(self.file.root, "has no <link>")
        return links

    def _body(self, name: str, link: Element, hung: Element | None) -> Body:
        mass, centre, inertia = self._inertia(link)
        if hung is None:
            return Body(name, GROUND, mass=mass, centre=centre, inertia=inertia)
        position, rotation = self._pose(hung)
        parent = self.file.required(self.file.child(hung, "parent"), "link")
        return Body(name, parent, position, rotation, mass, centre, inertia, self._joints(hung))

    def _pose(self, element: Element) -> tuple[Array, Array]:
        """Return position and rotation of the origin of an element, zero and identity without one."""
        origin = element.find("origin")
        if origin is None:
            return ZERO, IDENTITY
        xyz, rpy = (self.file.numbers(element, origin.get(name), (0.0, 0.0, 0.0)) for name in ("xyz", "rpy"))
        return xyz, rotation_of(rpy)

    def _inertia(self, link: Element) -> tuple[float, Array, Array]:
        """Return mass, centre of mass and inertia about it in the axes of the link."""
        inertial = link.find("inertial")
        if inertial is None:
            return 0.0, ZERO, np.zeros((3, 3))
        file, tensor = self.file, np.zeros((3, 3))
        mass = file.numbers(link, self.file.required(file.child(inertial, "mass"), "value"), (0.0,))[0]
        entries = inertial.find("inertia")
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)) if entries is not None else ():
            text = entries.get(f"i{'xyz'[i]}{'xyz'[j]}") if entries is not None else None
            tensor[i, j] = tensor[j, i] = file.numbers(link, text, (0.0,))[0]
        centre, turned = self._pose_of(inertial, link)
        return float(mass), centre, turned @ tensor @ turned.T

    def _pose_of(self, inertial: Element, link: Element) -> tuple[Array, Array]:
        """Return the pose of the inertia; refusals name the link."""
        inertial.set("name", str(link.get("name")))
        return self._pose(inertial)

    def _joints(self, joint: Element) -> tuple[Joint, ...]:
        """Return the elementary joints of a joint."""
        file, name = self.file, self.file.required(joint, "name")
        kind = file.required(joint, "type")
        if kind not in _KINDS:
            raise file.fault(joint, f"has the type {kind}; there are {', '.join(_KINDS)}")
        if kind == "fixed":
            return ()
        if kind == "floating":
            slides = (Joint(f"{name}.{'xyz'[k]}", "slide", IDENTITY[k]) for k in range(3))
            return (*slides, Joint(name, "ball"))
        given = joint.find("axis")
        axis = file.numbers(joint, None if given is None else given.get("xyz"), (1.0, 0.0, 0.0))
        if not np.linalg.norm(axis) > 0.0:
            raise file.fault(joint, "has an axis of length zero")
        axis = axis / np.linalg.norm(axis)
        if kind == "planar":
            first = np.cross(axis, IDENTITY[int(np.abs(axis).argmin())])
            first /= np.linalg.norm(first)
            across = (first, np.cross(axis, first))
            slides = (Joint(f"{name}.{'xy'[k]}", "slide", across[k]) for k in range(2))
            return (*slides, Joint(name, "hinge", axis))
        return (self._single(joint, name, kind, axis),)

    def _single(self, joint: Element, name: str, kind: str, axis: Array) -> Joint:
        """Return a revolute, continuous or prismatic joint."""
        file, limits = self.file, joint.find("limit")
        if kind != "continuous" and limits is None:
            raise file.fault(joint, f"is {kind} and has no <limit>")
        lower, upper = (file.number(limits, which, 0.0) for which in ("lower", "upper"))
        if lower > upper:
            raise file.fault(joint, f"has the lower limit {lower:g} above the upper {upper:g}")
        if kind == "continuous" or lower == upper:
            lower, upper = -math.inf, math.inf
        dynamics, follows, mimic = joint.find("dynamics"), joint.find("mimic"), None
        if file.number(dynamics, "friction", 0.0):
            self.left_out.append(f"dry friction of joint {name}")
        if follows is not None:
            factor, offset = file.number(follows, "multiplier", 1.0), file.number(follows, "offset", 0.0)
            mimic = (file.required(follows, "joint"), factor, offset)
        return Joint(
            name,
            "slide" if kind == "prismatic" else "hinge",
            axis,
            lower=lower,
            upper=upper,
            velocity=self._magnitude(joint, limits, "velocity"),
            effort=self._magnitude(joint, limits, "effort"),
            damping=file.number(dynamics, "damping", 0.0),
            mimic=mimic,
        )

    def _magnitude(self, joint: Element, limits: Element | None, which: str) -> float:
        """Return a limit of a velocity or an effort; zero means none."""
        value = self.file.number(limits, which, 0.0)
        if value < 0.0:
            raise self.file.fault(joint, f"has the negative {which} {value:g}")
        if limits is not None and value == 0.0:
            self.left_out.append(f"{which} limit of joint {joint.get('name')}: zero is taken for none")
        return value or math.inf

    def _list_left_out(self) -> None:
        """List elements without a part in the model."""
        root = self.file.root
        if root.find("link/collision") is not None:
            self.left_out.append("contact between <collision> geometries")
        names = [str(each.get("name")) for each in root.findall("transmission")]
        if names:
            self.left_out.append(f"transmissions {', '.join(names)}: inputs act on the joints")
