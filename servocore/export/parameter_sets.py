"""Start values as parameter sets of SSP (SSV) and their mappings (SSM), cross-check files, and FMI-LS-REF in an FMU."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from xml.etree import ElementTree as ET

from servocore.errors import InvalidSetting
from servocore.export.native_model import NativeModel
from servocore.export.variables import Variable, listed
from servocore.files import cross_check_texts, xml_document
from servocore.model.scene import Scene
from servocore.numerics.units import dimension
from servocore.solution import Solution

STEPS = 1000
"""Communication steps of the cross-check run."""

_PARTS = {"ssd": "Description", "ssc": "Common", "ssv": "ParameterValues", "ssm": "ParameterMapping"}
SPACES = {f"xmlns:{key}": f"http://ssp-standard.org/SSP1/SystemStructure{part}" for key, part in _PARTS.items()}
"""Names of the parts of SSP, in all its versions."""

SSP = {2: "1.0", 3: "2.0"}
"""Versions of SSP by those of FMI: the first has scalars only."""

NUMBER = {2: "Real", 3: "Float64"}
"""Names of the type of a number in SSP, by the version of FMI."""

_RELATED = "extra/org.fmi-standard.fmi-ls-ref/"
_SET = "parameters.ssv"
_MANIFEST = {
    "xmlns:fmi-ls": "http://fmi-standard.org/fmi-ls-manifest",
    "fmi-ls:fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    "fmi-ls:fmi-ls-version": "1.0.0-alpha.1",
    "fmi-ls:fmi-ls-description": "Layered Standard providing information on related files included in an FMU.",
}
_ROLES = {  # of the files of a run, by the ends of their names
    "_in.csv": ("text/csv", "experiment/smoke-test", "inputs at the instants of a run along the path of the scene"),
    "_ref.csv": ("text/csv", "result", "outputs at these instants, computed without the FMU, for input_time = end"),
    "_ref.opt": ("text/csv", "configuration", "start, end and communication step of that run, in s"),
}  # fmt: skip


def base_units(unit: str) -> dict[str, int] | None:
    """Return the exponents of SI base units; None for a unit with unknown parts, or one that is a multiple of these.

    All factors after the slash are divisors: ``N/m.s`` is N/(m s).
    """
    try:
        factor, exponents = dimension(unit or "1", "a unit")
    except InvalidSetting:
        return None
    return exponents if factor == 1.0 else None


def add(parent: ET.Element, tag: str, /, **attributes: str) -> ET.Element:
    """Add an element to another one."""
    return ET.SubElement(parent, tag, attributes)


def declare_units(parent: ET.Element, tag: str, units: Iterable[str]) -> None:
    """Declare units: those of numbers must be among the names of the top element."""
    declared = add(parent, tag)
    for unit in sorted(set(units)):
        exponents = {base: str(n) for base, n in (base_units(unit) or {}).items()}
        add(add(declared, "ssc:Unit", name=unit), "ssc:BaseUnit", **exponents)


def parameter_set(name: str, variables: Sequence[Variable], fmi: int) -> bytes:
    """Return start values with units as an SSV document, vectors as arrays where SSP has them."""
    root = ET.Element("ssv:ParameterSet", {**SPACES, "version": SSP[fmi], "name": name})
    rows = add(root, "ssv:Parameters")
    for each in listed(variables, fmi):
        row = add(rows, "ssv:Parameter", name=each.name)
        add(row, f"ssv:{NUMBER[fmi]}", value=" ".join(map(repr, each.starts)), unit=each.unit)
        if len(each.starts) > 1:
            add(row, "ssc:Dimension", size=str(each.size))
    declare_units(root, "ssv:Units", (each.unit for each in variables))
    return xml_document(root)


def parameter_mapping(names: Iterable[str], fmi: int) -> bytes:
    """Return an SSM document by which the parameters of these names, and no others, are taken from a set."""
    root = ET.Element("ssm:ParameterMapping", {**SPACES, "version": SSP[fmi]})
    for name in names:
        add(root, "ssm:MappingEntry", source=name, target=name)
    return xml_document(root)


def related_files(model: NativeModel, fmi: int) -> dict[str, bytes]:
    """Return the files of FMI-LS-REF, a layered standard of both versions of FMI, by their path in the FMU.

    Parameters
    ----------
    model : NativeModel
        The exported model: its parameters are a set, its cross-check files a smoke test with its results.
    fmi : int
        Version of FMI.
    """
    root = ET.Element("fmiReferences", _MANIFEST)
    members = {_SET: parameter_set(model.title, model.of("parameter"), fmi)}
    described = {_SET: ("application/x-ssp-parameter-set", "parameter", "start values of all parameters")}
    for name, text in model.cross_check.items():
        described[name] = next(role for end, role in _ROLES.items() if name.endswith(end))
        members[name] = text.encode()
    for name, (kind, role, description) in described.items():
        add(root, "Related", type=kind, source=name, role=role, description=description)
    return {_RELATED + name: each for name, each in (members | {"fmi-ls-manifest.xml": xml_document(root)}).items()}


def cross_check_files(scene: Scene, model: NativeModel, solution: Solution, stem: str, fmi: int) -> dict[str, str]:
    """Return inputs along a scene's path, the results of a solution, and the options of a run, by file name.

    Inputs have the times of their instants: a run with `input_time` = start extrapolates them over each step, and
    differs from the reference by that.

    Parameters
    ----------
    scene : Scene
        The scene of the path.
    model : NativeModel
        Its exported model.
    solution : Solution
        The reference in `STEPS` steps, computed without the FMU.
    stem : str
        Prefix of the names of the files.
    fmi : int
        Version of FMI, which determines the names of variables: in the third a vector is one of them.
    """
    path, t, begin = scene.reference, solution.t, model.start_time
    jets = path.jet(t, model.own["orders"] - 1).reshape(len(t), -1)
    since = {"time": t - path.start_time + begin}
    inputs = since | {each.name: jets[:, each.places] for each in listed(model.of("input"), fmi)}
    results = since | {variable.name: solution[variable.name] for variable in model.of("output")}
    return cross_check_texts(stem, inputs, results, (begin, begin + path.duration, float(t[1] - t[0])))
