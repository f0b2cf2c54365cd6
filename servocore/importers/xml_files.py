"""XML of robot files: read without entities, with sentences that name file and element.

Links and joints are read as URDF and SDF write them: URDF in attributes, SDF in the text of children.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from servocore.errors import InvalidModel
from servocore.importers.tree import IDENTITY, LARGEST, Joint
from servocore.numerics.compiled_calls import Array

_LARGEST = 2**23  # bytes; robot files have less than a tenth

Pose = tuple[Array, Array]
"""Position (m), shape (3,), and rotation, shape (3, 3)."""


@dataclass(frozen=True, eq=False)
class XmlFile:
    """A file that has been read.

    Attributes
    ----------
    path : Path
        Of the file.
    root : Element
        The root element.
    """

    path: Path
    root: Element

    @classmethod
    def read(cls, path: Path) -> XmlFile:
        """Read a file.

        A document type is refused: entities can expand without bound, and can name other files.

        Raises
        ------
        InvalidModel
            If it cannot be read, is too large, is no well-formed XML, or declares a document type.
        """
        try:
            content = path.read_bytes()
        except OSError as error:
            raise InvalidModel(f"{path}: cannot be read: {error.strerror or error}") from None
        if len(content) > _LARGEST:
            raise InvalidModel(f"{path}: {len(content) / 1e6:.0f} MB are more than a robot file has")
        builder, parser = TreeBuilder(), expat.ParserCreate()
        parser.StartElementHandler = builder.start
        parser.EndElementHandler = builder.end
        parser.CharacterDataHandler = builder.data

        def refuse(name: str, *_: object) -> None:
            raise InvalidModel(
                f"{path.name}: line {parser.CurrentLineNumber}: <!DOCTYPE {name}> declares a document type; robot files"
                " have none, and its entities are not expanded: delete it"
            )

        parser.StartDoctypeDeclHandler = refuse
        try:
            parser.Parse(content, True)
        except expat.ExpatError as error:
            reason = f"line {error.lineno}, column {error.offset}: {expat.ErrorString(error.code)}"
            raise InvalidModel(f"{path.name} is no well-formed XML: {reason}") from None
        return cls(path, builder.close())

    def fault(self, element: Element, sentence: str) -> InvalidModel:
        """Return the error of a sentence about an element."""
        name = element.get("name")
        return InvalidModel(f"{self.path.name}: <{element.tag}{f' name={name!r}' if name else ''}> {sentence}")

    def required(self, element: Element, attribute: str) -> str:
        """Return an attribute that must not be empty."""
        text = element.get(attribute, "").strip()
        if not text:
            raise self.fault(element, f"has no {attribute}")
        return text

    def child(self, element: Element, tag: str) -> Element:
        """Return the child of a tag that must be there."""
        found = element.find(tag)
        if found is None:
            raise self.fault(element, f"has no <{tag}>")
        return found

    def value(self, element: Element, path: str, default: float) -> float:
        """Return the number in an attribute or the text of a descendant; the default without one."""
        head, _, last = path.rpartition("/")
        holder = element.find(head) if head else element
        text = None if holder is None else holder.get(last) or holder.findtext(last)
        return float(self.numbers(element, text, (default,))[0])

    def numbers(self, element: Element, text: str | None, default: Sequence[float]) -> Array:
        """Return numbers separated by blanks, as many as in the default, which stands for a missing text."""
        if text is None:
            return np.array(default)
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.array([np.nan])
        if len(values) != len(default) or not np.isfinite(values).all():
            raise self.fault(
                element, f"holds {text!r} where {len(default)} finite number{'s' * (len(default) > 1)} belong"
            )
        return values


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
