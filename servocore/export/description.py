"""The model descriptions of FMI 2 and 3, the build description, and terminals: XML made from a `NativeModel`."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree as ET

import numpy as np

from servocore.export.about import tool
from servocore.export.native_model import NativeModel
from servocore.export.parameter_sets import add, base_units
from servocore.export.sources import compiled_files
from servocore.export.variables import INTERNAL_STEP, Causality, Choice, Variable, listed
from servocore.files import xml_document

_DISPLAY_UNITS: Mapping[str, Mapping[str, float]] = {
    "m": {"mm": 1e3},
    "rad": {"deg": 57.295779513082323},
    "rad/s": {"deg/s": 57.295779513082323},
    "kg": {"t": 1e-3},
    "N": {"kN": 1e-3},
    "N.m": {"kN.m": 1e-3},
}
_SHOWN = {"rad": "deg", "rad/s": "deg/s"}  # default display units
_CATEGORIES = {
    "logStatusWarning": "Possible mistakes: a path whose derivatives are not connected.",
    "logStatusDiscard": "Refused steps: a path beyond the limits of the model, inputs that are not finite.",
    "logStatusError": "Invalid calls: unknown variables, values outside bounds, inconsistent times.",
}
_DERIVATIVES = {
    2: ("providesDirectionalDerivative",),
    3: ("providesDirectionalDerivatives", "providesAdjointDerivatives"),
}
_TERMINALS: Mapping[str, Mapping[str, tuple[Causality, str]]] = {  # of each kernel
    "inverse": {
        "path": ("input", "the path to follow with its derivatives"),
        "result": ("output", "inputs of the drives, and the resulting motion"),
    },
    "plant": {"drives": ("input", "inputs of the drives"), "motion": ("output", "motion of the plant")},
    "trajectory": {"path": ("output", "the path with its derivatives")},
}
_FASTEST_STEPS = 1000  # of a default experiment: FMPy doubles the step of longer ones


def model_description(model: NativeModel, token: str, fmi: int) -> bytes:
    """Return modelDescription.xml of a version of FMI."""
    naming = {"variableNamingConvention": "structured"} | ({"numberOfEventIndicators": "0"} if fmi == 2 else {})
    root = ET.Element(
        "fmiModelDescription",
        {"fmiVersion": f"{fmi}.0", "modelName": model.title, "guid" if fmi == 2 else "instantiationToken": token,
         "description": model.about.description or model.description, **model.about.attributes,
         "generationTool": tool(), **naming},
    )  # fmt: skip
    state, derivatives = "FMUstate" if fmi == 2 else "FMUState", _DERIVATIVES[fmi] if model.differentiable else ()
    abilities = "canHandleVariableCommunicationStepSize", f"canGetAndSet{state}", f"canSerialize{state}", *derivatives
    simulation = add(root, "CoSimulation", modelIdentifier=model.identifier, **dict.fromkeys(abilities, "true"))
    if fmi == 2:
        files = add(simulation, "SourceFiles")
        for name in compiled_files(model, 2):
            add(files, "File", name=name)
    _unit_definitions(root, model)
    types = add(root, "TypeDefinitions")
    for choice in model.choices:
        tag = "SimpleType" if fmi == 2 else "EnumerationType"
        kind = add(types, tag, name=choice.type_name, description=choice.description)
        items = add(kind, "Enumeration") if fmi == 2 else kind
        for value, (name, text) in enumerate(choice.items, start=1):
            add(items, "Item", name=name, value=str(value), description=text)
    categories = add(root, "LogCategories")
    for name, text in _CATEGORIES.items():
        add(categories, "Category", name=name, description=text)
    stop, step = model.start_time + model.duration, model.duration / _FASTEST_STEPS
    add(root, "DefaultExperiment", startTime=repr(model.start_time), stopTime=repr(stop), stepSize=repr(step))
    if fmi == 2:
        _annotations(root, model, fmi)
    _variables(add(root, "ModelVariables"), model, fmi)
    _structure(add(root, "ModelStructure"), model, fmi)
    if fmi == 3:
        _annotations(root, model, fmi)
    return xml_document(root)


def _annotations(root: ET.Element, model: NativeModel, fmi: int) -> None:
    if not model.about.annotations:
        return
    parent = add(root, "VendorAnnotations" if fmi == 2 else "Annotations")
    for name, values in model.about.annotations.items():
        # FMI 2 allows a tool one element only.
        each = add(add(parent, "Tool", name=name), "Entries") if fmi == 2 else add(parent, "Annotation", type=name)
        for key, value in values.items():
            add(each, "Entry", name=key, value=str(value))


def _variables(table: ET.Element, model: NativeModel, fmi: int) -> None:
    every: list[Variable | Choice] = [*listed(model.variables, fmi), *model.choices]
    for reference, each in enumerate(every):
        common = {"name": each.name, "valueReference": str(reference), "description": each.description,
                  "causality": each.causality, "variability": each.variability}  # fmt: skip
        if isinstance(each, Choice):
            kind, own = "Enumeration", {"declaredType": each.type_name, "start": str(each.start)}
        else:
            kind, own = "Real" if fmi == 2 else "Float64", _attributes(each)
        parent, own = (add(table, "ScalarVariable", **common), own) if fmi == 2 else (table, common | own)
        number = add(parent, kind, **own)
        if isinstance(each, Variable) and each.size is not None:
            add(number, "Dimension", start=str(each.size))
    if fmi == 3:
        add(table, "Float64", name="time", valueReference=str(len(every)), causality="independent",
            variability="continuous", unit="s")  # fmt: skip


# Outputs change in doStep only, not when inputs are set. By what an output does not depend on, its derivative is zero
# (FMI 3.0.2, 2.4.8): models with directional derivatives, which are those of the last step, list its inputs, others
# none, so that they declare no algebraic loop. Measured values have no effect before the first step.


def _structure(structure: ET.Element, model: NativeModel, fmi: int) -> None:
    every, first_output = listed(model.variables, fmi), model.numbers("input")
    of = {k: each.places for k, each in enumerate(every) if each.causality == "input"}
    parameters = [k for k, each in enumerate(every) if each.causality == "parameter" and each.name != INTERNAL_STEP]
    parameters += range(len(every), len(every) + len(model.choices))
    time = [len(every) + len(model.choices)] if model.timed and fmi == 3 else []
    known = dict[int, tuple[list[int], list[int]]]()
    for k, variable in enumerate(every):
        if variable.causality == "output":
            rows = [place - first_output for place in variable.places]
            used = [j for j, columns in of.items() if model.depends[np.ix_(rows, columns)].any()]
            awaited = [j for j in used if not every[j].role]
            known[k] = [*(used if model.differentiable else ()), *time], [*awaited, *parameters, *time]
    # FMI 2 counts from 1.
    number, first = ("index", 1) if fmi == 2 else ("valueReference", 0)
    for which, group in enumerate(("Output", "InitialUnknown")):
        parent, tag = (add(structure, f"{group}s"), "Unknown") if fmi == 2 else (structure, group)
        for k, on in known.items():
            dependencies = " ".join(str(j + first) for j in on[which])
            kinds = " ".join(["dependent"] * len(on[which]))
            add(parent, tag, **{number: str(k + first)}, dependencies=dependencies, dependenciesKind=kinds)


def build_description(model: NativeModel) -> bytes:
    """Return buildDescription.xml of FMI 3, for tools that compile the sources themselves."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = add(root, "BuildConfiguration", modelIdentifier=model.identifier)
    sources = add(configuration, "SourceFileSet", language="C99")
    for name in compiled_files(model, 3):
        add(sources, "SourceFile", name=name)
    add(sources, "PreprocessorDefinition", name="FMI3_FUNCTION_PREFIX", value=f"{model.identifier}_")
    return xml_document(root)


def terminals(model: NativeModel) -> bytes:
    """Return terminalsAndIcons.xml of FMI 3: groups of variables that are connected together, such as the path."""
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    every = add(root, "Terminals")
    for name, (causality, text) in _TERMINALS[model.kernel].items():
        terminal = add(every, "Terminal", name=name, matchingRule="bus", description=text)
        for each in model.of(causality):
            add(terminal, "TerminalMemberVariable", variableName=each.name, memberName=each.name, variableKind="signal")
    return xml_document(root)


# Both versions of FMI -----------------------------------------------------------------------------------------------


def _unit_definitions(root: ET.Element, model: NativeModel) -> None:
    definitions = add(root, "UnitDefinitions")
    for unit in sorted({variable.unit for variable in model.variables} | {"s"}):
        element, exponents = add(definitions, "Unit", name=unit), base_units(unit)
        if exponents is not None:
            add(element, "BaseUnit", **{base: str(n) for base, n in exponents.items()})
        for display, factor in _DISPLAY_UNITS.get(unit, {}).items():
            add(element, "DisplayUnit", name=display, factor=repr(factor))


def _attributes(variable: Variable) -> dict[str, str]:
    attributes = {"unit": variable.unit, **{name: repr(value) for name, value in variable.bounds.items()}}
    if variable.unit in _SHOWN:
        attributes["displayUnit"] = _SHOWN[variable.unit]
    if variable.nominal:
        attributes["nominal"] = repr(float(variable.nominal))
    if variable.starts:
        attributes["start"] = " ".join(map(repr, variable.starts))
    return attributes
