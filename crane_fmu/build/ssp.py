"""``Crane.ssp``: trajectory, inverse model and plant connected, in the form of SSP 1.0 that all masters read.

A zip with ``SystemStructure.ssd`` and ``resources/*.fmu``; no connectors of the system; a user's own
parameters are bound inline.
"""

from __future__ import annotations

import io
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import fmpy
import numpy as np

import servocore as sc
from crane_fmu.build.archive import Progress
from crane_fmu.build.crosscheck import cross_check
from crane_fmu.build.fmu import build_fmu
from crane_fmu.build.native import native_fmu
from crane_fmu.catalogue import (
    CRANE_PLANT,
    DIMENSION,
    FEEDBACK_INPUTS,
    FROM_FILE,
    KINDS,
    LOAD_TRAJECTORY,
    NO_STARTS,
    ORDERS,
    PATH_INPUTS,
    PROFILES,
    ROTARY_CRANE,
    Starts,
    chosen,
    components,
)
from crane_fmu.files import filled_folder, put
from servocore.files import xml_document, zipped

SYSTEM_FILE, _STRUCTURE = "Crane.ssp", "SystemStructure.ssd"
COMPONENTS: Mapping[str, str] = {
    LOAD_TRAJECTORY.name: "trajectory",
    ROTARY_CRANE.name: "crane",
    CRANE_PLANT.name: "plant",
}
"""Names of the components by those of their FMUs."""

_START_ORDERS = 4  # position to jerk say where the crane and its load are at the start, and how fast
_INSTANTS, _ROUND_OFF = 101, 1e-12  # of the peak of a derivative

_SPACES = {
    f"xmlns:{prefix}": f"http://ssp-standard.org/SSP1/SystemStructure{part}"
    for prefix, part in (("ssd", "Description"), ("ssc", "Common"), ("ssv", "ParameterValues"))
}


@dataclass(frozen=True)
class SystemOptions:
    """What a user wants of a system in place of the defaults.

    Attributes
    ----------
    path : Reference, optional
        The path of the load that the trajectory shall carry.
    profile : str, optional
        Time law of the straight line, in place of a path.
    parameters : mapping of str to float
        Of the crane.
    native : bool
        Whether the FMUs shall be in C, without Python.
    targets : str, optional
        Platforms of native FMUs, as of `sc.export_fmu`.

    Raises
    ------
    InvalidSetting
        If there is no such time law, or a path is given beside it.
    """

    path: sc.Reference | None = None
    profile: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    native: bool = False
    targets: str | None = None

    def __post_init__(self) -> None:
        """Refuse what excludes each other."""
        if self.profile is not None:
            chosen(PROFILES, self.profile, "profile")
            if self.path is not None:
                raise sc.InvalidSetting("a path has its own time law: give either a path or a profile")


def build_ssp(
    directory: Path,
    progress: Progress = lambda _: None,
    options: SystemOptions = SystemOptions(),
) -> tuple[Path, ...]:
    """Build the three FMUs, those with Python with their cross-check files, and pack them.

    Parameters
    ----------
    directory : Path
        Where they go; made if it does not exist.
    progress : callable
        Called with a phrase for every stage.
    options : SystemOptions
        A path, a time law and a crane of the user's own.

    Returns
    -------
    tuple of Path
        The FMUs, then the system.

    Raises
    ------
    ServocoreError
        If a file cannot be written, the crane cannot follow the path, the path moves where it starts after the run, or
        an FMU fails its check.

    Warns
    -----
    ServocoreWarning
        If the path ends in motion.
    """
    reference = played = options.path
    starts: dict[str, float | str] = dict(options.parameters)
    duration = 20.0
    if options.profile is not None:
        starts["profile"] = options.profile
    if reference is not None:
        _require_start(reference)
        duration = reference.end_time
    inverse = _inverse(reference, options.parameters)
    if reference is not None:
        starts |= path_starts(reference, inverse)
        _tell_end(reference)
        played = read_again(sc.path_to_csv(reference))
    with filled_folder(directory) as draft:
        for kind in KINDS.values():
            if options.native:
                put(draft, {kind.file_name: native_fmu(kind, played, starts, options.targets, progress)})
            else:
                build_fmu(draft, progress, kind, played, starts, options.targets)
        if not options.native:
            progress("writing the cross-check files")
            for kind in KINDS.values():
                cross_check(draft / kind.file_name, reference, starts)
        fmus = {kind.name: (draft / kind.file_name).read_bytes() for kind in KINDS.values()}
        members = {f"resources/{name}.fmu": fmu for name, fmu in fmus.items()}
        put(draft, {SYSTEM_FILE: zipped({_STRUCTURE: description(fmus, starts, duration), **members}, _STRUCTURE)})
    return tuple(directory / name for name in (*(kind.file_name for kind in KINDS.values()), SYSTEM_FILE))


def _require_start(path: sc.Reference) -> None:
    """Refuse a path beside which the load would begin: the run starts at 0 s."""
    start = path.start_time
    if start < 0.0:
        raise sc.InvalidReference(
            f"the path starts at t = {start:g} s, but the system's run at 0 s: let it start then or later"
        )
    motion = _motion(path, start)
    if start > 0.0 and motion:
        raise sc.InvalidReference(
            f"the path starts in motion at t = {start:g} s, with {motion}, but the system's run at 0 s: let it start"
            " then, or from rest"
        )


def _tell_end(path: sc.Reference) -> None:
    """Warn of a path that ends in motion: a tool that runs on finds no path there."""
    motion = _motion(path, path.end_time)
    if motion:
        warnings.warn(
            f"the path ends in motion at t = {path.end_time:g} s, with {motion}: run the system until then only, for"
            " later the load is sent on along the path's last polynomial",
            sc.ServocoreWarning,
            stacklevel=3,
        )


def _motion(path: sc.Reference, time: float) -> str:
    """Return the lowest derivative that a path from a table has at one of its ends, empty where it rests."""
    peaks = np.linalg.norm(path.jet(np.linspace(path.start_time, path.end_time, _INSTANTS), 4), axis=-1).max(axis=0)
    sizes = np.linalg.norm(path.jet(time, 4), axis=-1)
    found = [order for order in range(1, len(ORDERS)) if sizes[order] > _ROUND_OFF * peaks[order]]
    if not found:
        return ""
    name, power = ORDERS[found[0]], found[0] if found[0] > 1 else ""
    return f"{'an' if name[0] == 'a' else 'a'} {name} of {sizes[found[0]]:.3g} m/s{power}"


def path_starts(path: sc.Reference, inverse: sc.ExactInversion) -> dict[str, float | str]:
    """Return start values of all FMUs with which the load begins on its path, in the motion that the path has there.

    Parameters
    ----------
    path : Reference
        From a table.
    inverse : ExactInversion
        Of the crane on it.

    Returns
    -------
    dict of str to float or str
        By the names of variables, inputs among them: some masters pass connected values on after the first step only.
    """
    jet = path.jet(path.start_time, len(ORDERS) - 1)
    moves = jet[1:].any()
    orders = len(ORDERS) if moves else 1  # what rests begins with brakes, as by default
    numbers = dict(zip(PATH_INPUTS[: orders * DIMENSION], jet[:orders].ravel().tolist(), strict=True))
    starts = components(*(f"start.{order}" for order in ORDERS[: min(orders, _START_ORDERS)]))
    numbers |= dict(zip(starts, jet.ravel().tolist(), strict=False))
    if moves:
        forces = [each.name for each in sc.scenes.rotary_crane().model().inputs]
        numbers |= dict(zip(forces, inverse(path.start_time).tolist(), strict=True))
    return {"profile": FROM_FILE, **numbers}


def _inverse(reference: sc.Reference | None, parameters: Mapping[str, float]) -> sc.ExactInversion:
    """Return the inputs of the crane; a path that it cannot follow is refused by this before anything is built."""
    crane = sc.scenes.rotary_crane()
    own = crane.model().parameters.names  # others are those of the FMUs: what is connected, where a line starts
    crane = crane.with_parameters(**{name: value for name, value in parameters.items() if name in own})
    return sc.ExactInversion(crane if reference is None else crane.with_reference(reference), native=False)


def described(fmus: Mapping[str, bytes]) -> dict[str, list[Any]]:
    """Return the variables of FMUs as their model descriptions have them, by the names of their components."""
    return {
        COMPONENTS[name]: fmpy.read_model_description(io.BytesIO(fmu), validate=False).modelVariables
        for name, fmu in fmus.items()
    }


def description(fmus: Mapping[str, bytes], starts: Starts = NO_STARTS, duration: float = 20.0) -> bytes:
    """Return the system's description.

    Parameters
    ----------
    fmus : mapping of str to bytes
        The archives of the FMUs, by the names of their kinds.
    starts : mapping of str to float or str
        Start values that the FMUs have in place of defaults; numbers are bound here too, for all to see.
    duration : float
        Time to simulate in s.
    """
    root = ET.Element("ssd:SystemStructureDescription", {**_SPACES, "version": "1.0", "name": "Crane"})
    system = _add(root, "ssd:System", name="Crane")
    elements, tables = _add(system, "ssd:Elements"), described(fmus)
    wires = connections(tables)
    fed = {sink for _, sink in wires}
    for name, component in COMPONENTS.items():
        source = f"resources/{name}.fmu"
        element = _add(elements, "ssd:Component", name=component, type="application/x-fmu-sharedlibrary", source=source)
        connectors = _add(element, "ssd:Connectors")
        for variable in tables[component]:  # what is connected, and what is worth watching: all outputs
            if variable.causality == "output" or (component, variable.name) in fed:
                place = _add(connectors, "ssd:Connector", name=variable.name, kind=variable.causality)
                _add(place, "ssc:Real", unit=variable.unit)
        numbers = (each.name for each in tables[component] if each.causality == "parameter" and each.type == "Real")
        _bind(element, {each: starts[each] for each in numbers if each in starts})
    joints = _add(system, "ssd:Connections")
    for (begin, output), (end, given) in wires:
        _add(joints, "ssd:Connection", startElement=begin, startConnector=output, endElement=end, endConnector=given)
    _add(root, "ssd:DefaultExperiment", startTime="0", stopTime=repr(float(duration)))
    return xml_document(root)


def _bind(element: ET.Element, bound: Starts) -> None:
    """Bind numbers to parameters of a component."""
    if not bound:
        return
    values = element
    for tag in ("ParameterBindings", "ParameterBinding", "ParameterValues"):
        values = _add(values, f"ssd:{tag}")
    rows = _add(_add(values, "ssv:ParameterSet", version="1.0", name="own"), "ssv:Parameters")
    for name, value in bound.items():
        _add(_add(rows, "ssv:Parameter", name=name), "ssv:Real", value=repr(value))


def _add(parent: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, tag, attributes)


Wire = tuple[tuple[str, str], tuple[str, str]]


def connections(tables: Mapping[str, Sequence[Any]]) -> list[Wire]:
    """Return the connections as ((element, output), (element, input)), given the variables of each element."""
    trajectory, crane, plant = COMPONENTS.values()
    path = [each.name for each in tables[trajectory] if each.causality == "output"]
    forces = [each.name for each in tables[plant] if each.causality == "input"]
    wires = [((trajectory, name), (crane, name)) for name in path]
    wires += [((crane, name), (plant, name)) for name in forces]
    for name in FEEDBACK_INPUTS:
        output = name.removeprefix("measured.")
        wires.append(((plant, f"load.{output}" if "[" in output else output), (crane, name)))
    return wires


def read_again(table: str) -> sc.Reference:
    """Return the path in a table as LoadTrajectory.fmu reads it, to the last digit of its snap."""
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        file = Path(folder) / "path.csv"
        file.write_text(table)
        return sc.from_csv(file)
