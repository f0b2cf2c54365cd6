"""Native FMUs, in C and without Python: exports of `servocore` with the feedback and the names of the crane."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

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
from servocore.export.building import inverse_model
from servocore.export.fmu import described
from servocore.export.native_model import NativeModel
from servocore.export.plant_model import plant_model
from servocore.export.routes import with_routes
from servocore.export.trajectory_model import trajectory_model

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


def native_model(
    kind: FmuKind,
    path: sc.Reference | None = None,
    starts: Starts = NO_STARTS,
    drives: Mapping[str, sc.Drive] | None = None,
    progress: Callable[[str], None] = lambda _: None,
    host: sc.HostRules | None = None,
) -> NativeModel:
    """Return trajectory, inverse model or plant, ready to become an FMU.

    Parameters
    ----------
    kind : FmuKind
        Which one.
    path : Reference, optional
        The path in the trajectory.
    starts : mapping of str to float or str
        Start values of variables in place of defaults, parameters of the crane among them.
    drives : mapping of str to Drive, optional
        Motors and transmissions of the crane.
    progress : callable
        Called with a phrase for every stage.
    host : HostRules, optional
        Rules of its hosts: `OF_PYTHONFMU`, with which the inverse model has all formulations and methods.
    """
    crane = crane_with(starts, drives)
    if kind is LOAD_TRAJECTORY:
        progress("compiling the trajectory")
        law, others = starts.get("profile"), ("profile", *crane.parameter_values())
        own = {name: float(value) for name, value in starts.items() if name not in others}
        named = None if law in (None, FROM_FILE) else str(law)
        options = sc.TrajectoryOptions(path, named, own, kind.name, host == OF_PYTHONFMU)
        return described(trajectory_model(crane, None, options), host)
    if kind is CRANE_PLANT:
        progress("compiling the forward dynamics")
        return described(plant_model(crane, "generalized", replace(PLANT, start=starts)), host)
    progress("analysing")
    along = crane if path is None else crane.with_reference(path)
    made = inverse_model(along, None, feedback_of(crane), estimates_of(crane, starts))
    if host == OF_PYTHONFMU:
        made = with_routes(made, along, ROUTES)
    return described(made.with_starts(starts), host)


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
