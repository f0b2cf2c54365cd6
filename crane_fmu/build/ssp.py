"""``Crane.ssp``: trajectory, inverse model and plant connected, in the subset of SSP 1.0 that all masters read.

A zip with ``SystemStructure.ssd`` and ``resources/*.fmu``; the system has no connectors, and a user's own
parameters are bound inline. Cross-check files of its FMUs lie beside it: inputs, results and options of a run.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import floor
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import numpy.typing as npt

import servocore as sc
from crane_fmu.build.archive import Progress
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
    at_rest,
    components,
    crane_with,
)
from crane_fmu.files import filled_folder, put
from crane_fmu.run import input_rows, nothing_left
from servocore.files import cross_check_texts, xml_document, zipped

SYSTEM_FILE, _STRUCTURE = "Crane.ssp", "SystemStructure.ssd"
COMPONENTS: Mapping[str, str] = {
    LOAD_TRAJECTORY.name: "trajectory",
    ROTARY_CRANE.name: "crane",
    CRANE_PLANT.name: "plant",
}
"""Names of the components by those of their FMUs."""

STEP = 0.01
"""Communication step in s that suits each FMU, and the system of all."""

_STOP, _SHORT_STOP = 20.0, 2.0  # s, of cross-check runs; a pushed plant goes far
_START_ORDERS = 4  # position to jerk determine the motion of crane and load at the start
_FORCES = ("M_b", "F", "M_w")
_INSTANTS, _ROUND_OFF = 101, 1e-12  # of the peak of a derivative

_SPACES = {
    f"xmlns:{prefix}": f"http://ssp-standard.org/SSP1/SystemStructure{part}"
    for prefix, part in (("ssd", "Description"), ("ssc", "Common"), ("ssv", "ParameterValues"))
}


@dataclass(frozen=True)
class SystemOptions:
    """A user's options of a system, in place of the defaults.

    Attributes
    ----------
    path : Reference, optional
        The path of the load in the trajectory.
    profile : str, optional
        Time law of the straight line, in place of a path.
    parameters : mapping of str to float
        Parameters of the crane.
    native : bool
        Whether the FMUs are native: in C, without Python.
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
        """Refuse options that exclude each other."""
        if self.profile is not None:
            if self.profile not in PROFILES:
                raise sc.InvalidSetting(f"there is no profile {self.profile!r}; there are {', '.join(PROFILES)}")
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
    path = options.path
    starts: dict[str, float | str] = dict(options.parameters)
    if options.profile is not None:
        starts["profile"] = options.profile
    if path is not None:
        _require_start(path)
    crane = crane_with(options.parameters)
    inverse = sc.ExactInversion(crane if path is None else crane.with_reference(path), native=False)
    if path is not None:
        starts |= path_starts(path, inverse)
        _warn_of_end(path)
    with filled_folder(directory) as draft:
        for kind in KINDS.values():
            if options.native:
                put(draft, {kind.file_name: native_fmu(kind, path, starts, options.targets, progress)})
            else:
                build_fmu(draft, progress, kind, path, starts, options.targets)
        if not options.native:
            progress("writing the cross-check files")
            for kind in KINDS.values():
                _cross_check(draft / kind.file_name, path, starts, inverse)
        fmus = {kind.name: (draft / kind.file_name).read_bytes() for kind in KINDS.values()}
        members = {f"resources/{name}.fmu": fmu for name, fmu in fmus.items()}
        members[_STRUCTURE] = description(fmus, starts, _STOP if path is None else path.end_time)
        put(draft, {SYSTEM_FILE: zipped(members, _STRUCTURE)})
    return tuple(directory / name for name in (*(kind.file_name for kind in KINDS.values()), SYSTEM_FILE))


def _require_start(path: sc.Reference) -> None:
    """Refuse a path that the load is not on at 0 s, the start of the run."""
    start = path.start_time
    if start < 0.0:
        raise sc.InvalidReference(
            f"the path starts at t = {start:g} s, but the run of the system starts at 0 s: shift the path to start then"
            " or later"
        )
    motion = _motion(path, start)
    if start > 0.0 and motion:
        raise sc.InvalidReference(
            f"the path starts in motion at t = {start:g} s, with {motion}, but the run of the system starts at 0 s:"
            " shift the path to start then, or start it from rest"
        )


def _warn_of_end(path: sc.Reference) -> None:
    """Warn of a path that does not end at rest: its last segment is extrapolated."""
    motion = _motion(path, path.end_time)
    if motion:
        warnings.warn(
            f"the path does not end at rest, but at t = {path.end_time:g} s with {motion}: run the system until then"
            " only; later the last segment of the path is extrapolated",
            sc.ServocoreWarning,
            stacklevel=3,
        )


def _motion(path: sc.Reference, time: float) -> str:
    """Return the lowest derivative of a path that is not zero at one of its ends, empty where it rests."""
    peaks = np.linalg.norm(path.jet(np.linspace(path.start_time, path.end_time, _INSTANTS), 4), axis=-1).max(axis=0)
    sizes = np.linalg.norm(path.jet(time, 4), axis=-1)
    found = [order for order in range(1, len(ORDERS)) if sizes[order] > _ROUND_OFF * peaks[order]]
    if not found:
        return ""
    name, power = ORDERS[found[0]], found[0] if found[0] > 1 else ""
    return f"{'an' if name[0] == 'a' else 'a'} {name} of {sizes[found[0]]:.3g} m/s{power}"


def path_starts(path: sc.Reference, inverse: sc.ExactInversion) -> dict[str, float | str]:
    """Return start values of all FMUs that put the load on its path, in the motion of the path at its start.

    Parameters
    ----------
    path : Reference
        The path in the trajectory.
    inverse : ExactInversion
        That of the crane on this path.

    Returns
    -------
    dict of str to float or str
        By the names of variables, inputs included: some masters pass connected values on after the first step only.
    """
    jet = path.jet(path.start_time, len(ORDERS) - 1)
    moves = jet[1:].any()
    orders = len(ORDERS) if moves else 1  # a load at rest begins with brakes, as by default
    numbers = dict(zip(PATH_INPUTS[: orders * DIMENSION], jet[:orders].ravel().tolist(), strict=True))
    starts = components(*(f"start.{order}" for order in ORDERS[: min(orders, _START_ORDERS)]))
    numbers |= dict(zip(starts, jet.ravel().tolist(), strict=False))
    if moves:
        numbers |= dict(zip(_FORCES, inverse(path.start_time).tolist(), strict=True))
    return {"profile": FROM_FILE, **numbers}


def _cross_check(fmu: Path, path: sc.Reference | None, starts: Starts, inverse: sc.ExactInversion) -> None:
    """Run an FMU and write its inputs, its results and the options of the run beside it."""
    stop = _SHORT_STOP if fmu.stem == CRANE_PLANT.name else _STOP
    if path is not None and path.jet(path.end_time, 4)[1:].any():  # there is no path later
        stop = min(stop, STEP * floor(path.end_time / STEP))
    given = None
    if fmu.stem == ROTARY_CRANE.name:
        given = input_rows(path or sc.scenes.rotary_crane().reference, STEP)
    elif fmu.stem == CRANE_PLANT.name:
        given = _plant_inputs(stop, starts, inverse)
    with nothing_left():
        found = fmpy.simulate_fmu(str(fmu), stop_time=stop, output_interval=STEP, input=given)
    inputs, results = (
        None if rows is None else {name: rows[name] for name in rows.dtype.names or ()} for rows in (given, found)
    )
    put(fmu.parent, cross_check_texts(fmu.stem, inputs, results, (0.0, stop, STEP)))


def _plant_inputs(stop: float, starts: Starts, inverse: sc.ExactInversion) -> npt.NDArray[Any]:
    """Return inputs that push a plant from rest, or those of the motion in which it starts."""
    t = np.linspace(0.0, stop, round(stop / STEP) + 1)
    if _FORCES[0] in starts:
        forces = list(inverse(t).T)
    else:
        push = np.sin(np.pi * t) ** 2
        forces = [50.0 * push, -5.0 * push, np.full_like(t, at_rest(starts)["M_w"])]
    return np.rec.fromarrays([t, *forces], dtype=[(each, np.float64) for each in ("time", *_FORCES)])


def described(fmus: Mapping[str, bytes]) -> dict[str, list[Any]]:
    """Return the variables in the model descriptions of FMUs, by the names of their components."""
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
        Start values of the FMUs in place of defaults; numbers are also bound here, where tools show them.
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
        for variable in tables[component]:  # connected inputs, and all outputs
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
