"""Links and joints as URDF and SDF write them: URDF in attributes, SDF in the text of children."""

from __future__ import annotations

import math
from collections.abc import Collection
from xml.etree.ElementTree import Element

import numpy as np

from servocore.importers.tree import Joint
from servocore.importers.xml_files import XmlFile
from servocore.numerics.compiled_calls import Array

_NO_LIMIT = 1e15  # SDF writes 1e16 for none

Pose = tuple[Array, Array]
"""Position (m), shape (3,), and rotation, shape (3, 3)."""


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
        return np.array([x, y, z]), rotation_of(np.array(rpy))

    def inertia(self, link: Element, missing: float = 0.0) -> tuple[float, Array, Array]:
        """Return mass, centre of mass and inertia about it in a link's axes; `missing` stands for a missing one."""
        tensor = np.zeros((3, 3))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            path = f"inertial/inertia/i{'xyz'[i]}{'xyz'[j]}"
            tensor[i, j] = tensor[j, i] = self.file.value(link, path, missing * (i == j))
        centre, turned = self.pose(link.find("inertial"), link)
        return self.file.value(link, self._mass, missing), centre, turned @ tensor @ turned.T

    def end(self, joint: Element, which: str, links: Collection[str]) -> str:
        """Return the parent or the child of a joint; raises `InvalidModel` if it is no link."""
        element = self.file.child(joint, which)
        name = element.get("link") or (element.text or "").strip()
        if name not in links:
            raise self.file.fault(joint, f"joins the link {name}, which does not exist")
        return name

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
        if kind == "continuous" or ends[0] == ends[1]:
            ends = [-math.inf, math.inf]
        lower, upper = (end if abs(end) < _NO_LIMIT else math.copysign(math.inf, end) for end in ends)
        largest = []
        for which in ("velocity", "effort"):
            value = file.value(holder, f"limit/{which}", math.inf)
            if not value > 0.0:  # many files leave it out in this way
                self.left_out.append(f"{which} limit of joint {name}: {value:g} is taken for none")
            largest.append(value if value > 0.0 else math.inf)
        if file.value(holder, "dynamics/friction", 0.0):
            self.left_out.append(f"dry friction of joint {name}")
        stiffness, rest, damping = (
            file.value(holder, f"dynamics/{which}", 0.0)
            for which in ("spring_stiffness", "spring_reference", "damping")
        )
        moves = "slide" if kind == "prismatic" else "hinge"
        return Joint(name, moves, axis, anchor, lower, upper, largest[0], largest[1], stiffness, rest, damping)


def rotation_of(rpy: Array) -> Array:
    """Return the rotation of roll, pitch and yaw (rad) about fixed axes x, y, z, shape (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip
