"""Native FMUs, in C and without Python: exports of `servocore` with the feedback and the names of the crane."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import casadi as ca

import servocore as sc
from crane_fmu.build.estimates import estimates_of
from crane_fmu.build.feedback_law import LAW_MODEL, feedback_functions
from crane_fmu.build.sampling import fastest_pendulum
from crane_fmu.catalogue import (
    CRANE_PLANT,
    DIMENSION,
    FEEDBACK_INPUTS,
    FORMULATIONS,
    FROM_FILE,
    LOAD_TRAJECTORY,
    METHODS,
    MODELS,
    NO_STARTS,
    FmuKind,
    Starts,
    crane_with,
)

ROUTES = sc.SteppedRoutes(MODELS, FORMULATIONS, METHODS["backward-euler"])
"""Formulations and methods of RotaryCrane.fmu besides the exact inversion."""

OF_PYTHONFMU = sc.HostRules(deferred_refusals=True)
"""Its setters cannot fail."""

PLANT = sc.PlantOptions(
    errors={"mass_error": "load_mass"},
    offsets={"start.swing": ("swing_in", "swing_out")},
    ranges={"start.swing": (-1.5, 1.5)},
    identifier=CRANE_PLANT.name,
    reasons={"tension": "the rope goes slack: its"},
)
"""Differences of CranePlant.fmu from the model of the crane."""

LARGEST_TURN = 1.0
"""Largest turn of the fastest pendulum in a step, in rad, with which the feedback is used."""


def native_fmu(
    kind: FmuKind,
    path: sc.Reference | None = None,
    starts: Starts = NO_STARTS,
    targets: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
    host: sc.HostRules | None = None,
    drives: Mapping[str, sc.Drive] = MappingProxyType({}),
) -> bytes:
    """Return the archive of trajectory, inverse model or plant, FMI 2.

    Parameters
    ----------
    kind : FmuKind
        Which one.
    path : Reference, optional
        The path in the trajectory.
    starts : mapping of str to float or str
        Start values of variables in place of defaults, parameters of the crane among them.
    targets : str, optional
        Platforms, as `sc.export_fmu` takes them.
    progress : callable
        Called with a phrase for every stage.
    host : HostRules, optional
        Rules of its hosts: `OF_PYTHONFMU`, with which the inverse model has all formulations and methods.
    drives : mapping of str to Drive
        Motors and transmissions of the crane.
    """
    crane = crane_with(starts, drives)
    common: dict[str, Any] = {"fmi": 2, "targets": targets, "progress": progress, "host": host}
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        file = Path(folder, kind.file_name)
        if kind is LOAD_TRAJECTORY:
            progress("compiling the trajectory")
            law, others = starts.get("profile"), ("profile", *crane.parameter_values())
            own = {name: float(value) for name, value in starts.items() if name not in others}
            named = None if law in (None, FROM_FILE) else str(law)
            options = sc.TrajectoryOptions(path, named, own, kind.name, host == OF_PYTHONFMU)
            sc.export_trajectory(crane, file, options, **common)
        elif kind is CRANE_PLANT:
            sc.export_plant(crane, file, replace(PLANT, start=starts), model="generalized", **common)
        else:
            along = crane if path is None else crane.with_reference(path)
            common |= {"feedback": feedback_of(crane), "estimates": estimates_of(crane, starts)}
            sc.export_fmu(along, file, start=starts, routes=ROUTES if host == OF_PYTHONFMU else None, **common)
        return file.read_bytes()


def feedback_of(crane: sc.Scene) -> sc.SampledFeedback:
    """Return the feedback of the crane for the export of its inverse model."""
    units = {each.name: each.unit for each in crane.model().observables}
    motion = [sc.Quantity(name, units[name], name) for name in ("phi", "s", "l")]
    rates = [sc.Quantity(f"{each.name}_dot", f"{each.unit}/s", f"rate of {each.name}") for each in motion]
    load = [sc.Quantity(name, unit, f"{name} of the load") for name, unit in (("position", "m"), ("velocity", "m/s"))]
    path, measured, p, h = (ca.SX.sym(*each) for each in (("path", 15), ("measured", 12), ("p", 6), ("h",)))
    turn = fastest_pendulum(path, measured[2], p) * h
    distance = ca.norm_2(measured[6:9] - path[:3])
    sensible = ca.logic_and(measured[2] > 0, measured[8] < 0)  # length of the rope, and height of the load
    return sc.SampledFeedback(
        measured=(*((each, None) for each in (*motion, *rates)), *((each, DIMENSION) for each in load)),
        laws=feedback_functions(crane.model(LAW_MODEL)),
        judge=ca.Function("judge", [path, measured, p, h], [ca.vertcat(sensible, distance, turn)]),
        not_measured="the measured rope length is %g m and the measured height of the load %g m: the feedback needs the"
        " length above 0 m, the height below 0 m and all measured values connected; feedback = 0 does without",
        shown=(FEEDBACK_INPUTS.index("measured.l"), FEEDBACK_INPUTS.index("measured.position[3]")),
        largest_turn=LARGEST_TURN,
        too_long="with this load, trolley and rope it",
        distance=0.5,  # m, from the path
    )
