"""The model description: that of the native FMU, whose variables the FMU has, with what PythonFMU makes different."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree as ET

DATE, AUTHOR = "2026-01-01T00:00:00Z", "The authors of servocore"
"""Of every FMU: two builds of one source shall be equal."""

_TOOL = "servocore"


def wrapped(native: bytes, name: str, notes: Mapping[str, str]) -> bytes:
    """Return the model description of an FMU that hands its calls to a native one.

    It has all of its variables. Outputs change in doStep only, so no input feeds through then, and no derivatives of
    them are offered.

    Parameters
    ----------
    native : bytes
        That of the native FMU.
    name : str
        Of the FMU and its binaries.
    notes : mapping of str to str
        Attributes of the vendor annotation.
    """
    root = ET.fromstring(native)
    root.attrib |= {"generationDateAndTime": DATE, "author": AUTHOR, "license": "MIT"}
    root.set("generationTool", f"{_TOOL} with PythonFMU {notes['pythonfmu']}")
    root.set("guid", root.get("guid", "").strip("{}"))  # as PythonFMU writes it
    (simulation,) = root.iter("CoSimulation")
    root.set("modelName", name)
    simulation.attrib |= {"modelIdentifier": name, "needsExecutionTool": "true"}
    simulation.attrib.pop("providesDirectionalDerivative", None)
    for sources in simulation.findall("SourceFiles"):
        simulation.remove(sources)
    for unknown in root.iterfind("ModelStructure/Outputs/Unknown"):
        unknown.attrib |= {"dependencies": "", "dependenciesKind": ""}
    annotations = ET.Element("VendorAnnotations")
    ET.SubElement(ET.SubElement(annotations, "Tool", name=_TOOL), "Build", dict(notes))
    root.insert(_position(root, "DefaultExperiment"), annotations)
    return document(root)


def document(root: ET.Element) -> bytes:
    """Return a whole XML document, indented."""
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, "unicode")}\n'.encode()


def _position(root: ET.Element, tag: str) -> int:
    """Place just behind the child called `tag`."""
    return [child.tag for child in root].index(tag) + 1
