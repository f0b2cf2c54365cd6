"""The model descriptions of FMI 2 and 3, the build description, and terminals: XML made from a `NativeModel`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

from servocore.export.about import tool
from servocore.export.native_model import NativeModel
from servocore.export.parameter_sets import add
from servocore.export.sources import compiled_files
from servocore.export.units import base_units
from servocore.export.variables import INTERNAL_STEP, Variable
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
_ABILITIES = {
    2: ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate"),
    3: ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUState", "canSerializeFMUState"),
}  # fmt: skip
_DERIVATIVES = {
    2: ("providesDirectionalDerivative",),
    3: ("providesDirectionalDerivatives", "providesAdjointDerivatives"),
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
    abilities = _ABILITIES[fmi] + (_DERIVATIVES[fmi] if model.differentiable else ())
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
        each = add(parent, "Tool", name=name) if fmi == 2 else add(parent, "Annotation", type=name)
        for key, value in values.items():
            add(each, "Entry", name=key, value=str(value))


def _variables(table: ET.Element, model: NativeModel, fmi: int) -> None:
    for reference, (variable, places) in enumerate(_numbered(model, fmi)):
        name, text, starts = variable.name, variable.description, variable.starts
        if fmi == 2 and variable.size is not None:
            k = places.start - variable.place
            name, text, starts = variable.scalar_names[k], f"{text}; component {k + 1}", starts[k : k + 1]
        common = {"name": name, "valueReference": str(reference), "description": text, **_causality(variable, fmi)}
        if fmi == 2:
            number = add(add(table, "ScalarVariable", **common), "Real", **_attributes(variable))
        else:
            number = add(table, "Float64", **common, **_attributes(variable))
        if starts:
            number.set("start", " ".join(map(repr, starts)))
        if fmi == 3 and variable.size is not None:
            add(number, "Dimension", start=str(variable.size))
    for reference, choice in enumerate(model.choices, start=len(_numbered(model, fmi))):
        common = {"name": choice.name, "valueReference": str(reference), "description": choice.description,
                  "causality": "parameter", "variability": choice.variability}  # fmt: skip
        kind = {"declaredType": choice.type_name, "start": str(choice.start)}
        if fmi == 2:
            add(add(table, "ScalarVariable", **common), "Enumeration", **kind)
        else:
            add(table, "Enumeration", **common, **kind)
    if fmi == 3:
        last = len(model.variables) + len(model.choices)
        add(table, "Float64", name="time", valueReference=str(last), causality="independent",
            variability="continuous", unit="s")  # fmt: skip


def _numbered(model: NativeModel, fmi: int) -> list[tuple[Variable, range]]:
    """Return variables with their places in the order of their references: FMI 2 has one for each component."""
    every = [(each, range(each.place, each.place + (each.size or 1))) for each in model.variables]
    return every if fmi == 3 else [(each, range(k, k + 1)) for each, places in every for k in places]


# Outputs change in doStep only, not when inputs are set. By what an output does not depend on, its derivative is zero
# (FMI 3.0.2, 2.4.8): models with directional derivatives, which are those of the last step, list its inputs, others
# none, so that they declare no algebraic loop. Measured values have no effect before the first step.


def _structure(structure: ET.Element, model: NativeModel, fmi: int) -> None:
    every, first_output = _numbered(model, fmi), model.numbers("input")
    of = {k: places for k, (variable, places) in enumerate(every) if variable.causality == "input"}
    parameters = [k for k, (variable, _) in enumerate(every)
                  if variable.causality == "parameter" and variable.name != INTERNAL_STEP]  # fmt: skip
    parameters += range(len(every), len(every) + len(model.choices))
    time = [len(every) + len(model.choices)] if model.timed and fmi == 3 else []
    listed = dict[int, tuple[list[int], list[int]]]()
    for k, (variable, places) in enumerate(every):
        if variable.causality == "output":
            rows = slice(places.start - first_output, places.stop - first_output)
            used = [j for j, columns in of.items() if model.depends[rows, columns].any()]
            awaited = [j for j in used if of[j].start < first_output - model.measured]
            listed[k] = [*(used if model.differentiable else ()), *time], [*awaited, *parameters, *time]
    # FMI 2 counts from 1.
    parents = [add(structure, tag) for tag in ("Outputs", "InitialUnknowns")] if fmi == 2 else [structure] * 2
    for which, (parent, tag) in enumerate(zip(parents, ("Output", "InitialUnknown"), strict=True)):
        for k, on in listed.items():
            if fmi == 2:
                add(parent, "Unknown", index=str(k + 1), **_dependencies([j + 1 for j in on[which]]))
            else:
                add(parent, tag, valueReference=str(k), **_dependencies(on[which]))


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
    for name, (causality, text) in model.terminals.items():
        terminal = add(every, "Terminal", name=name, matchingRule="bus", description=text)
        for variable in model.variables:
            if variable.causality == causality:
                add(terminal, "TerminalMemberVariable", variableName=variable.name, memberName=variable.name,
                              variableKind="signal")  # fmt: skip
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


def _causality(variable: Variable, fmi: int) -> dict[str, str]:
    if variable.causality in ("output", "local"):
        return {"causality": variable.causality, "variability": "continuous", "initial": "calculated"}
    if variable.causality == "input":
        return {"causality": "input", "variability": "continuous"}
    attributes = {"causality": "parameter", "variability": "fixed" if variable.fixed else "tunable"}
    return attributes | ({"initial": "exact"} if fmi == 2 else {})


def _attributes(variable: Variable) -> dict[str, str]:
    attributes = {"unit": variable.unit, **{name: repr(value) for name, value in variable.bounds.items()}}
    if variable.unit in _SHOWN:
        attributes["displayUnit"] = _SHOWN[variable.unit]
    if variable.nominal:
        attributes["nominal"] = repr(float(variable.nominal))
    return attributes


def _dependencies(on: Sequence[int]) -> dict[str, str]:
    return {"dependencies": " ".join(map(str, on)), "dependenciesKind": " ".join(["dependent"] * len(on))}
