"""The model description as a checker wants it: what PythonFMU writes, completed from the table of variables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

if TYPE_CHECKING:
    from collections.abc import Mapping

    from crane_fmu.slave.interface import Interface, Variable


@dataclass(frozen=True)
class Unit:
    """A unit by exponents of SI base units, with units in which tools may show it: name -> factor from SI."""

    kg: int = 0
    m: int = 0
    s: int = 0
    rad: int = 0
    display: tuple[tuple[str, float], ...] = ()


UNITS: Mapping[str, Unit] = {
    "1": Unit(),
    "s": Unit(s=1, display=(("ms", 1e3),)),
    "m": Unit(m=1, display=(("mm", 1e3),)),
    "m/s": Unit(m=1, s=-1),
    "m/s2": Unit(m=1, s=-2),
    "m/s3": Unit(m=1, s=-3),
    "m/s4": Unit(m=1, s=-4),
    "kg": Unit(kg=1, display=(("t", 1e-3),)),
    "kg.m2": Unit(kg=1, m=2),
    "N": Unit(kg=1, m=1, s=-2, display=(("kN", 1e-3),)),
    "N.m": Unit(kg=1, m=2, s=-2, display=(("kN.m", 1e-3),)),
    "J": Unit(kg=1, m=2, s=-2, display=(("kJ", 1e-3),)),
    "rad": Unit(rad=1, display=(("deg", 57.295779513082323),)),
    "rad/s": Unit(rad=1, s=-1, display=(("deg/s", 57.295779513082323),)),
}
"""All units that variables may have, spelled as FMI spells them."""

_TOOL = "servocore"


def complete(written: bytes, interface: Interface, notes: Mapping[str, str]) -> bytes:
    """Return a model description with units, bounds, dependencies and initial unknowns.

    Parameters
    ----------
    written : bytes
        What PythonFMU wrote.
    interface : Interface
        Its variables.
    notes : mapping of str to str
        Attributes of the vendor annotation, such as the versions of what was compiled.
    """
    root = ET.fromstring(written)
    root.attrib.pop("generationDateAndTime", None)  # two builds of one source shall be equal
    root.set("generationTool", f"{_TOOL} with {root.get('generationTool')}")
    root.insert(_position(root, "CoSimulation"), _unit_definitions(interface))
    for element, variable in zip(root.iter("ScalarVariable"), interface.variables, strict=True):
        _complete_variable(element, variable)
    annotations = ET.Element("VendorAnnotations")
    ET.SubElement(ET.SubElement(annotations, "Tool", name=_TOOL), "Build", dict(notes))
    root.insert(_position(root, "DefaultExperiment"), annotations)
    structure = root.find("ModelStructure")
    if structure is None:
        raise ValueError("the model description has no ModelStructure")
    _complete_structure(structure, interface)
    return document(root)


def document(root: ET.Element) -> bytes:
    """Return a whole XML document, indented."""
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, "unicode")}\n'.encode()


def _position(root: ET.Element, tag: str) -> int:
    """Place just behind the child called `tag`."""
    return [child.tag for child in root].index(tag) + 1


def _unit_definitions(interface: Interface) -> ET.Element:
    definitions = ET.Element("UnitDefinitions")
    used = {variable.unit for variable in interface.variables if variable.unit}
    for name, unit in UNITS.items():
        if name not in used:
            continue
        element = ET.SubElement(definitions, "Unit", name=name)
        exponents = {base: getattr(unit, base) for base in ("kg", "m", "s", "rad")}
        ET.SubElement(element, "BaseUnit", {base: str(n) for base, n in exponents.items() if n})
        for display, factor in unit.display:
            ET.SubElement(element, "DisplayUnit", name=display, factor=repr(factor))
    return definitions


def _complete_variable(element: ET.Element, variable: Variable) -> None:
    if element.get("name") != variable.name or len(element) != 1:
        raise ValueError(f"the model description has {element.get('name')} in place of {variable.name}")
    value = element[0]
    if variable.is_text:
        return
    attributes = {
        "unit": variable.unit,
        "displayUnit": variable.display_unit,
        "min": variable.minimum,
        "max": variable.maximum,
        "nominal": variable.nominal,
        "start": variable.start,
    }
    value.attrib.clear()
    for name, content in attributes.items():
        if content not in (None, ""):
            value.set(name, str(content))  # of a float: as many digits as it takes


def _complete_structure(structure: ET.Element, interface: Interface) -> None:
    """Say what depends on what: outputs change in doStep only, so no input feeds through then."""
    indices = {variable.name: str(k + 1) for k, variable in enumerate(interface.variables)}
    sources = [
        indices[each.name]
        for each in interface.variables
        if each.causality == "input" or (each.causality == "parameter" and not each.is_text)
    ]
    for unknown in structure.iter("Unknown"):
        unknown.set("dependencies", "")
        unknown.set("dependenciesKind", "")
    initial = ET.SubElement(structure, "InitialUnknowns")
    for variable in interface.of("output"):
        attributes = {
            "index": indices[variable.name],
            "dependencies": " ".join(sources),
            "dependenciesKind": " ".join(["dependent"] * len(sources)),
        }
        ET.SubElement(initial, "Unknown", attributes)
