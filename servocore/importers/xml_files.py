"""XML of robot files: read without entities, with sentences that name file and element."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from servocore.errors import InvalidModel
from servocore.numerics.compiled_calls import Array

_LARGEST = 2**23  # bytes; robot files have less than a tenth


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
            wanted = f"{len(default)} finite number{'s' * (len(default) > 1)}"
            raise self.fault(element, f"holds {text!r} where {wanted} belong")
        return values
