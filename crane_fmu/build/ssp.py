"""``Crane.ssp``: trajectory, inverse model and plant connected, see `servocore.export.system`.

Cross-check files of its FMUs lie beside it: inputs, results and options of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import floor
from pathlib import Path

import fmpy
import numpy as np

import servocore as sc
from crane_fmu.build.fmu import build_fmu
from crane_fmu.build.native import native_model
from crane_fmu.catalogue import (
    CRANE_PLANT,
    FEEDBACK_INPUTS,
    FROM_FILE,
    KINDS,
    LOAD_TRAJECTORY,
    ORDERS,
    PATH_INPUTS,
    ROTARY_CRANE,
    Starts,
    components,
    crane_with,
)
from crane_fmu.files import filled_folder, put
from crane_fmu.run import input_rows, nothing_left
from servocore.export.fmu import written
from servocore.export.system import Element, Wire, packed_system, require_played, wires_by_name
from servocore.files import cross_check_texts

SYSTEM_FILE = "Crane.ssp"
COMPONENTS: Mapping[str, str] = {
    LOAD_TRAJECTORY.name: "trajectory",
    ROTARY_CRANE.name: "crane",
    CRANE_PLANT.name: "plant",
}
"""Names of the components by those of their FMUs."""

STEP = 0.01
"""Communication step in s that suits each FMU, and the system of all."""

_STOP, _SHORT_STOP = 20.0, 2.0  # s, of cross-check runs; a plant without feedback goes far
_START_ORDERS = 4  # position to jerk determine the motion of crane and load at the start
_FORCES = ("M_b", "F", "M_w")


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
    drives : mapping of str to Drive
        Its motors and transmissions.
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
    drives: Mapping[str, sc.Drive] = field(default_factory=dict)
    native: bool = False
    targets: str | None = None

    def __post_init__(self) -> None:
        """Refuse options that exclude each other."""
        if self.profile is not None:
            if self.profile not in sc.TIME_LAWS:
                raise sc.InvalidSetting(f"there is no profile {self.profile!r}; there are {', '.join(sc.TIME_LAWS)}")
            if self.path is not None:
                raise sc.InvalidSetting("a path has its own time law: give either a path or a profile")


def build_ssp(
    directory: Path,
    progress: Callable[[str], None] = lambda _: None,
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
    path, crane = options.path, crane_with(options.parameters, options.drives)
    if path is not None:
        require_played(path)
    inverse = sc.ExactInversion(crane if path is None else crane.with_reference(path), native=False)
    starts = start_values(options, inverse)
    with filled_folder(directory) as draft:
        for kind in KINDS.values():
            given = (kind, path, starts[kind.name])
            if options.native:
                model = native_model(*given, options.drives, progress)
                written(model, draft / kind.file_name, 2, options.targets, progress)
            else:
                fmu = build_fmu(draft, progress, *given, options.targets, options.drives)
                progress(f"writing the cross-check files of {fmu.name}")
                _cross_check(fmu, path, inverse)
        fmus = {kind.name: (draft / kind.file_name).read_bytes() for kind in KINDS.values()}
        elements = elements_of(fmus, starts)
        duration = _STOP if path is None else path.end_time
        put(draft, {SYSTEM_FILE: packed_system("Crane", elements, connections(elements), duration)})
    return tuple(directory / name for name in (*(kind.file_name for kind in KINDS.values()), SYSTEM_FILE))


def elements_of(fmus: Mapping[str, bytes], starts: Mapping[str, Starts]) -> list[Element]:
    """Return the FMUs by the names of their kinds as elements of the system."""
    return [Element(name, kind, fmus[kind], starts.get(kind, {})) for kind, name in COMPONENTS.items()]


def connections(elements: Sequence[Element]) -> list[Wire]:
    """Return the connections: outputs with inputs of their names, and the plant's motion with the feedback."""
    crane, plant = (COMPONENTS[kind.name] for kind in (ROTARY_CRANE, CRANE_PLANT))
    wires = wires_by_name(elements)
    for name in FEEDBACK_INPUTS:
        output = name.removeprefix("measured.")
        wires.append(((plant, f"load.{output}" if "[" in output else output), (crane, name)))
    return wires


def start_values(options: SystemOptions, inverse: sc.ExactInversion) -> dict[str, Starts]:
    """Return start values by the names of kinds that put the load on its path, in the motion of the path at its start.

    Parameters
    ----------
    options : SystemOptions
        Path, profile and parameters.
    inverse : ExactInversion
        That of the crane on this path.

    Returns
    -------
    dict of str to mapping
        By the names of variables, inputs included: some masters pass connected values on after the first step only.
    """
    starts = {kind: dict[str, float | str](options.parameters) for kind in KINDS}
    if options.profile is not None:
        starts[LOAD_TRAJECTORY.name]["profile"] = options.profile
    if (path := options.path) is not None:
        jet = path.jet(path.start_time, len(ORDERS) - 1)
        numbers = jet.ravel().tolist() if jet[1:].any() else jet[0].tolist()  # at rest the rest is as by default
        names = components(*(f"start.{order}" for order in ORDERS[:_START_ORDERS]))
        starts[LOAD_TRAJECTORY.name]["profile"] = FROM_FILE
        starts[ROTARY_CRANE.name] |= zip(PATH_INPUTS, numbers, strict=False)
        starts[CRANE_PLANT.name] |= zip(names, numbers, strict=False)
        if jet[1:].any():  # else it begins with brakes, as by default
            starts[CRANE_PLANT.name] |= zip(_FORCES, inverse(path.start_time).tolist(), strict=True)
    return dict(starts)


def _cross_check(fmu: Path, path: sc.Reference | None, inverse: sc.ExactInversion) -> None:
    """Run an FMU along the path and write its inputs, its results and the options of the run beside it."""
    stop = _SHORT_STOP if fmu.stem == CRANE_PLANT.name else _STOP
    if path is not None and path.jet(path.end_time, 4)[1:].any():  # there is no path later
        stop = min(stop, STEP * floor(path.end_time / STEP))
    given = None
    if fmu.stem == ROTARY_CRANE.name:
        given = input_rows(path or sc.scenes.rotary_crane().reference, STEP)
    elif fmu.stem == CRANE_PLANT.name:
        t = np.linspace(0.0, stop, round(stop / STEP) + 1)
        columns = [(each, np.float64) for each in ("time", *_FORCES)]
        given = np.rec.fromarrays([t, *inverse(t).T], dtype=columns)
    with nothing_left():
        found = fmpy.simulate_fmu(str(fmu), stop_time=stop, output_interval=STEP, input=given)
    inputs, results = (
        None if rows is None else {name: rows[name] for name in rows.dtype.names or ()} for rows in (given, found)
    )
    put(fmu.parent, cross_check_texts(fmu.stem, inputs, results, (0.0, stop, STEP)))
