"""URDF: links and joints of a robot. Meshes are not opened.

The root link stands on the ground. An effort or a velocity of zero means that there is no limit, as in many files that
leave it out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np

from servocore.importers.tree import GROUND, IDENTITY, ZERO, Body, Joint, Tree
from servocore.importers.xml_files import LinkReader, XmlFile

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
        Its links and joints.

    Raises
    ------
    InvalidModel
        If links or joints are missing, doubled, or contradict each other; with file and element.
    """
    for element in file.root:
        if "xacro:" in element.tag:
            raise file.fault(element, "is xacro: run xacro on the file first")
    return _Reader(file, "inertial/mass/value", 0.0).tree()


class _Reader(LinkReader):
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
        transmissions = [str(each.get("name")) for each in root.findall("transmission")]
        if transmissions:
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
        if kind not in _KINDS:
            raise file.fault(joint, f"has the type {kind}; there are {', '.join(_KINDS)}")
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
