"""Systems of connected FMUs as SSP: 1.0 with FMI 2, in the subset that all masters read, or 2.0 with arrays of FMI 3.

A zip with ``SystemStructure.ssd`` and ``resources/*.fmu``; the system has no connectors, and start values in place of
defaults are bound inline. Parameters that components have in common are a set (SSV) with a mapping (SSM) for each.
"""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from xml.etree import ElementTree as ET

import numpy as np

from servocore.errors import InvalidReference, ServocoreWarning
from servocore.export.parameter_sets import NUMBER, SPACES, SSP, add, declare_units, parameter_mapping, parameter_set
from servocore.export.variables import Variable, order_name
from servocore.files import xml_document, zipped
from servocore.references.base import Reference

_STRUCTURE, _SET = "SystemStructure.ssd", "resources/parameters.ssv"
_INSTANTS, _ROUND_OFF = 101, 1e-12  # of the peak of a derivative
_HIGHEST = 4
Wire = tuple[tuple[str, str], tuple[str, str]]
"""A connection as ((element, output), (element, input))."""


@dataclass(frozen=True)
class Element:
    """An FMU in a system.

    Attributes
    ----------
    name : str
        Of the component.
    model : str
        Name of the FMU's file, without its ending.
    fmu : bytes
        The archive.
    starts : mapping of str to float or str
        Start values with which the FMU was built; numbers are also bound in the system, where tools show them.
    """

    name: str
    model: str
    fmu: bytes = field(repr=False)
    starts: Mapping[str, float | str] = field(default_factory=dict)

    @cached_property
    def description(self) -> ET.Element:
        """The model description."""
        with zipfile.ZipFile(io.BytesIO(self.fmu)) as archive:
            return ET.fromstring(archive.read("modelDescription.xml"))

    @cached_property
    def ports(self) -> list[dict[str, str]]:
        """Its numbers with their attributes, such as name, causality and unit; of a vector also the size."""
        if self.fmi == 2:
            every = self.description.iter("ScalarVariable")
            return [{**each.attrib, **each[0].attrib} for each in every if each[0].tag == "Real"]
        vectors = self.description.iter("Float64")
        return [{**each.attrib, **({"size": each[0].attrib["start"]} if len(each) else {})} for each in vectors]

    @property
    def fmi(self) -> int:
        """Version of FMI."""
        return int(self.description.attrib["fmiVersion"][0])

    def named(self, causality: str) -> list[str]:
        """Return the names of its numbers of one causality."""
        return [each["name"] for each in self.ports if each["causality"] == causality]


def wires_by_name(elements: Sequence[Element]) -> list[Wire]:
    """Connect each input with the output of that name of the nearest element before."""
    wires = []
    for k, element in enumerate(elements):
        for name in element.named("input"):
            sources = [each for each in elements[:k] if name in each.named("output")]
            wires += [((each.name, name), (element.name, name)) for each in sources[-1:]]
    return wires


def packed_system(
    title: str, elements: Sequence[Element], wires: Sequence[Wire], duration: float, shared: Sequence[Variable] = ()
) -> bytes:
    """Return the archive of a system.

    Parameters
    ----------
    title : str
        Name of the system.
    elements : sequence of Element
        In the order in which signals pass through them.
    wires : sequence of Wire
        The connections.
    duration : float
        Time to simulate in s.
    shared : sequence of Variable, optional
        Parameters with their values for all components that have them: to be changed in one place.
    """
    fmi, members = elements[0].fmi, {f"resources/{each.model}.fmu": each.fmu for each in elements}
    if shared:
        members[_SET] = parameter_set(title, shared, fmi)
    root = ET.Element("ssd:SystemStructureDescription", {**SPACES, "version": SSP[fmi], "name": title})
    system = add(root, "ssd:System", name=title)
    parts, fed, units = add(system, "ssd:Elements"), {sink for _, sink in wires}, {"s"}
    for element in elements:
        source = f"resources/{element.model}.fmu"
        part = add(parts, "ssd:Component", name=element.name, type="application/x-fmu-sharedlibrary", source=source)
        connectors = add(part, "ssd:Connectors")
        for port in element.ports:  # connected inputs, and all outputs
            if port["causality"] == "output" or (element.name, port["name"]) in fed:
                place = add(connectors, "ssd:Connector", name=port["name"], kind=port["causality"])
                add(place, f"ssc:{NUMBER[fmi]}", unit=port["unit"])
                if "size" in port:
                    add(place, "ssc:Dimension", size=port["size"])
                units.add(port["unit"])
        declared = element.named("parameter")
        if common := [each.name for each in shared if each.name in declared]:
            mapping = f"resources/{element.name}.ssm"
            members[mapping] = parameter_mapping(common, fmi)
            binding = add(add(part, "ssd:ParameterBindings"), "ssd:ParameterBinding", source=_SET)
            add(binding, "ssd:ParameterMapping", source=mapping)
        _bind(part, {name: element.starts[name] for name in declared if name in element.starts})
    joints = add(system, "ssd:Connections")
    for (begin, output), (end, given) in wires:
        add(joints, "ssd:Connection", startElement=begin, startConnector=output, endElement=end, endConnector=given)
    declare_units(root, "ssd:Units", units)
    add(root, "ssd:DefaultExperiment", startTime="0", stopTime=repr(float(duration)))
    return zipped(members | {_STRUCTURE: xml_document(root)}, _STRUCTURE)


def _bind(part: ET.Element, bound: Mapping[str, float | str]) -> None:
    """Bind numbers to parameters of a component."""
    if not bound:
        return
    values = part
    for tag in ("ParameterBindings", "ParameterBinding", "ParameterValues"):
        values = add(values, f"ssd:{tag}")
    rows = add(add(values, "ssv:ParameterSet", version="1.0", name="own"), "ssv:Parameters")
    for name, value in bound.items():
        add(add(rows, "ssv:Parameter", name=name), "ssv:Real", value=repr(value))


# Paths of systems ----------------------------------------------------------------------------------------------------


def require_played(path: Reference) -> None:
    """Refuse a path that its object is not on at 0 s, the start of the run; warn of one that does not end at rest."""
    start = path.start_time
    if start < 0.0:
        raise InvalidReference(
            f"the path starts at t = {start:g} s, but the run of the system starts at 0 s: shift the path to start then"
            " or later"
        )
    motion = _motion(path, start)
    if start > 0.0 and motion:
        raise InvalidReference(
            f"the path starts in motion at t = {start:g} s, with {motion}, but the run of the system starts at 0 s:"
            " shift the path to start then, or start it from rest"
        )
    motion = _motion(path, path.end_time)
    if motion:
        warnings.warn(
            f"the path does not end at rest, but at t = {path.end_time:g} s with {motion}: run the system until then"
            " only; later the last segment of the path is extrapolated",
            ServocoreWarning,
            stacklevel=3,
        )


def _motion(path: Reference, time: float) -> str:
    """Return the lowest derivative of a path that is not zero at one of its ends, empty where it rests."""
    highest = min(_HIGHEST, path.max_order)
    instants = np.linspace(path.start_time, path.end_time, _INSTANTS)
    peaks = np.linalg.norm(path.jet(instants, highest), axis=-1).max(axis=0)
    sizes = np.linalg.norm(path.jet(time, highest), axis=-1)
    found = [order for order in range(1, highest + 1) if sizes[order] > _ROUND_OFF * peaks[order]]
    if not found:
        return ""
    name, power = order_name(found[0]), found[0] if found[0] > 1 else ""
    return f"{'an' if name[0] == 'a' else 'a'} {name} of {sizes[found[0]]:.3g} m/s{power}"
