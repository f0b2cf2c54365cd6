"""``Crane.ssp``: trajectory, inverse model and plant connected, in the form of SSP 1.0 that all masters read.

A zip with ``SystemStructure.ssd`` and ``resources/*.fmu``; no connectors of the system; a user's own
parameters are bound inline.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

import servocore as sc
from crane_fmu.build.archive import zipped
from crane_fmu.build.bundle import Progress
from crane_fmu.build.crosscheck import cross_check
from crane_fmu.build.description import document
from crane_fmu.build.fmu import build_fmu
from crane_fmu.build.native import NativeWishes, native_fmu
from crane_fmu.catalogue import CRANE_PLANT, KINDS, LOAD_TRAJECTORY, NO_STARTS, PROFILES, ROTARY_CRANE, Starts, chosen
from crane_fmu.files import filled_folder, put
from crane_fmu.slave.interface import (
    DIMENSION,
    FEEDBACK_INPUTS,
    FROM_FILE,
    ORDERS,
    PATH_INPUTS,
    START_ORDERS,
    Variable,
    components,
)

SYSTEM_FILE, _STRUCTURE = "Crane.ssp", "SystemStructure.ssd"
COMPONENTS: Mapping[str, str] = {
    LOAD_TRAJECTORY.name: "trajectory",
    ROTARY_CRANE.name: "crane",
    CRANE_PLANT.name: "plant",
}
"""Names of the components by those of their FMUs."""

_A = ("a position", "a velocity", "an acceleration", "a jerk", "a snap")
_INSTANTS, _ROUND_OFF = 101, 1e-12  # of the peak of a derivative

_SSD, _SSC, _SSV = (
    f"http://ssp-standard.org/SSP1/SystemStructure{each}" for each in ("Description", "Common", "ParameterValues")
)


@dataclass(frozen=True)
class Wishes:
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
    wishes: Wishes = Wishes(),
) -> tuple[Path, ...]:
    """Build the three FMUs, those with Python with their cross-check files, and pack them.

    Parameters
    ----------
    directory : Path
        Where they go; made if it does not exist.
    progress : callable
        Called with a phrase for every stage.
    wishes : Wishes
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
    reference = wishes.path
    starts: dict[str, float | str] = dict(wishes.parameters)
    duration = 20.0
    if wishes.profile is not None:
        starts["profile"] = wishes.profile
    if reference is not None:
        _require_start(reference)
        duration = reference.end_time
    inverse = _inverse(reference, wishes.parameters)
    if reference is not None:
        starts |= path_starts(reference, inverse)
        _tell_end(reference)
    with filled_folder(directory) as draft:
        played = None if reference is None else read_again(sc.csv_of(reference))
        own = NativeWishes(played, starts, wishes.targets)
        if wishes.native:
            fmus = [native_fmu(draft, kind, own, progress) for kind in KINDS.values()]
        else:
            fmus = _python_fmus(draft, reference, own, progress)
        members = {f"resources/{fmu.name}": fmu.read_bytes() for fmu in fmus}
        system = zipped({_STRUCTURE: description(starts, duration), **members}, _STRUCTURE)
        put(draft, {SYSTEM_FILE: system})
        names = [*(fmu.name for fmu in fmus), SYSTEM_FILE]
    return tuple(directory / name for name in names)


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
    units = {each.name: each.unit for each in ROTARY_CRANE.interface().variables}
    return f"{_A[found[0]]} of {sizes[found[0]]:.3g} {units[f'load.{ORDERS[found[0]]}[1]']}" if found else ""


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
    orders = len(ORDERS) if jet[1:].any() else 1  # what rests begins with brakes, as by default
    numbers = dict(zip(PATH_INPUTS[: orders * DIMENSION], jet[:orders].ravel().tolist(), strict=True))
    for order, values in zip(START_ORDERS[:orders], jet.tolist(), strict=False):
        numbers |= dict(zip(components(f"start.{order}"), values, strict=True))
    if orders > 1:
        forces = [each.name for each in CRANE_PLANT.interface().of("input")]
        numbers |= dict(zip(forces, inverse(path.start_time).tolist(), strict=True))
    return {"profile": FROM_FILE, **numbers}


def _inverse(reference: sc.Reference | None, parameters: Mapping[str, float]) -> sc.ExactInversion:
    """Return the inputs of the crane; a path that it cannot follow is refused by this before anything is built."""
    crane = sc.scenes.rotary_crane()
    own = crane.model().parameters.names  # others are those of the FMUs: what is connected, where a line starts
    crane = crane.with_parameters(**{name: value for name, value in parameters.items() if name in own})
    return sc.ExactInversion(crane if reference is None else crane.with_reference(reference), native=False)


def _python_fmus(draft: Path, reference: sc.Reference | None, wishes: NativeWishes, progress: Progress) -> list[Path]:
    own = wishes.reference, wishes.starts, wishes.targets
    fmus = [build_fmu(draft, progress, kind, *own) for kind in KINDS.values()]
    progress("writing the cross-check files")
    for fmu in fmus:
        cross_check(fmu, reference, wishes.starts)
    return fmus


def description(starts: Starts = NO_STARTS, duration: float = 20.0) -> bytes:
    """Return the system's description.

    Parameters
    ----------
    starts : mapping of str to float or str
        Start values that the FMUs have in place of defaults; numbers are bound here too, for all to see.
    duration : float
        Time to simulate in s.
    """
    for prefix, space in (("ssd", _SSD), ("ssc", _SSC), ("ssv", _SSV)):
        ET.register_namespace(prefix, space)
    root = ET.Element(f"{{{_SSD}}}SystemStructureDescription", version="1.0", name="Crane")
    system = _child(root, "System", name="Crane")
    elements, wires = _child(system, "Elements"), connections()
    fed = {sink for _, sink in wires}
    for name, component in COMPONENTS.items():
        source = f"resources/{name}.fmu"
        element = _child(elements, "Component", name=component, type="application/x-fmu-sharedlibrary", source=source)
        connectors = _child(element, "Connectors")
        variables = KINDS[name].interface().variables
        for variable in variables:  # what is connected, and what is worth watching: all outputs
            if variable.causality == "output" or (component, variable.name) in fed:
                place = _child(connectors, "Connector", name=variable.name, kind=variable.causality)
                ET.SubElement(place, f"{{{_SSC}}}Real", unit=variable.unit)
        _bind(element, [each for each in variables if each.causality == "parameter"], starts)
    joints = _child(system, "Connections")
    for (source, output), (sink, given) in wires:
        _child(joints, "Connection", startElement=source, startConnector=output, endElement=sink, endConnector=given)
    _child(root, "DefaultExperiment", startTime="0", stopTime=repr(float(duration)))
    return document(root)


def _bind(element: ET.Element, parameters: Sequence[Variable], starts: Starts) -> None:
    """Bind numbers to the parameters of a component."""
    bound = {
        parameter.name: starts[parameter.name]
        for parameter in parameters
        if parameter.name in starts and not parameter.is_choice
    }
    if not bound:
        return
    values = _child(_child(_child(element, "ParameterBindings"), "ParameterBinding"), "ParameterValues")
    table = ET.SubElement(values, f"{{{_SSV}}}ParameterSet", version="1.0", name="own")
    rows = ET.SubElement(table, f"{{{_SSV}}}Parameters")
    for name, value in bound.items():
        ET.SubElement(ET.SubElement(rows, f"{{{_SSV}}}Parameter", name=name), f"{{{_SSV}}}Real", value=repr(value))


def _child(parent: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, f"{{{_SSD}}}{tag}", attributes)


Wire = tuple[tuple[str, str], tuple[str, str]]


def connections() -> list[Wire]:
    """Return the connections as ((element, output), (element, input))."""
    trajectory, crane, plant = COMPONENTS.values()
    path = [variable.name for variable in LOAD_TRAJECTORY.interface().of("output")]
    forces = [variable.name for variable in CRANE_PLANT.interface().of("input")]
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
