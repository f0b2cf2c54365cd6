"""The model description as a checker wants it: what PythonFMU writes, completed from the table of variables."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from crane_fmu.slave.interface import FEEDBACK_INPUTS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from crane_fmu.slave.interface import Interface, Variable


UNITS: Mapping[str, tuple[Mapping[str, int], Mapping[str, float]]] = {
    "1": ({}, {}),
    "s": ({"s": 1}, {"ms": 1e3}),
    "m": ({"m": 1}, {"mm": 1e3}),
    "m/s": ({"m": 1, "s": -1}, {}),
    "m/s2": ({"m": 1, "s": -2}, {}),
    "m/s3": ({"m": 1, "s": -3}, {}),
    "m/s4": ({"m": 1, "s": -4}, {}),
    "kg": ({"kg": 1}, {"t": 1e-3}),
    "kg.m2": ({"kg": 1, "m": 2}, {}),
    "N": ({"kg": 1, "m": 1, "s": -2}, {"kN": 1e-3}),
    "N.m": ({"kg": 1, "m": 2, "s": -2}, {"kN.m": 1e-3}),
    "J": ({"kg": 1, "m": 2, "s": -2}, {"kJ": 1e-3}),
    "rad": ({"rad": 1}, {"deg": 57.295779513082323}),
    "rad/s": ({"s": -1, "rad": 1}, {"deg/s": 57.295779513082323}),
}
"""All units that variables may have, spelled as FMI spells them: exponents of SI base units, and the units in which
tools may show them with their factors from SI."""

DATE, AUTHOR = "2026-01-01T00:00:00Z", "The authors of servocore"
"""Of every FMU: two builds of one source shall be equal."""

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
    root.set("generationDateAndTime", DATE)
    root.set("author", AUTHOR)
    root.set("generationTool", f"{_TOOL} with {root.get('generationTool')}")
    root.insert(_position(root, "CoSimulation"), _unit_definitions(interface))
    if any(each.is_choice for each in interface.variables):
        root.insert(_position(root, "UnitDefinitions"), _type_definitions(interface))
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


def wrapped(native: bytes, notes: Mapping[str, str]) -> bytes:
    """Return the model description of an FMU that hands its calls to a native one.

    It has all of its variables. Outputs change in doStep only, so no input feeds through then, and no derivatives of
    them are offered.

    Parameters
    ----------
    native : bytes
        That of the native FMU.
    notes : mapping of str to str
        Attributes of the vendor annotation.
    """
    root = ET.fromstring(native)
    root.attrib |= {"generationDateAndTime": DATE, "author": AUTHOR, "license": "MIT"}
    root.set("generationTool", f"{_TOOL} with PythonFMU {notes['pythonfmu']}")
    (simulation,) = root.iter("CoSimulation")
    root.set("modelName", simulation.get("modelIdentifier", ""))
    simulation.set("needsExecutionTool", "true")
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


def _unit_definitions(interface: Interface) -> ET.Element:
    definitions = ET.Element("UnitDefinitions")
    used = {variable.unit for variable in interface.variables if variable.unit}
    for name, (exponents, displays) in UNITS.items():
        if name in used:
            element = ET.SubElement(definitions, "Unit", name=name)
            ET.SubElement(element, "BaseUnit", {base: str(n) for base, n in exponents.items()})
            for display, factor in displays.items():
                ET.SubElement(element, "DisplayUnit", name=display, factor=repr(factor))
    return definitions


def _type_definitions(interface: Interface) -> ET.Element:
    definitions = ET.Element("TypeDefinitions")
    for variable in interface.variables:
        if variable.is_choice:
            simple = ET.SubElement(definitions, "SimpleType", name=_type_name(variable))
            items = ET.SubElement(simple, "Enumeration")
            for k, name in enumerate(variable.choices, start=1):
                ET.SubElement(items, "Item", name=name, value=str(k))
    return definitions


def _type_name(variable: Variable) -> str:
    """Return a name that no variable has."""
    return "".join(part.capitalize() for part in variable.name.split("_"))


def _complete_variable(element: ET.Element, variable: Variable) -> None:
    if element.get("name") != variable.name or len(element) != 1:
        raise ValueError(f"the model description has {element.get('name')} in place of {variable.name}")
    value = element[0]
    if variable.is_choice:
        number = variable.choices.index(str(variable.start)) + 1
        value.tag, value.attrib = "Enumeration", {"declaredType": _type_name(variable), "start": str(number)}
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
    """Say what depends on what: outputs change in doStep only, so no input feeds through then.

    Measured values are not looked at before the first step.
    """
    sources = [
        str(k)
        for k, variable in enumerate(interface.variables, start=1)
        if (variable.causality == "input" and variable.name not in FEEDBACK_INPUTS)
        or (variable.causality == "parameter" and not variable.is_choice)
    ]
    outputs, initial = list(structure.iter("Unknown")), ET.SubElement(structure, "InitialUnknowns")
    for unknown in outputs:
        start = ET.SubElement(initial, "Unknown", unknown.attrib)
        for element, on in ((unknown, []), (start, sources)):
            element.set("dependencies", " ".join(on))
            element.set("dependenciesKind", " ".join("dependent" for _ in on))
