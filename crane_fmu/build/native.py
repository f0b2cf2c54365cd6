"""The FMUs in C, which need no Python: what `servocore` exports, with the crane's own feedback and names."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca

import servocore as sc
from crane_fmu.build.estimates import estimate_functions, in_motion, too_rough
from crane_fmu.build.feedback_law import LAW_MODEL, feedback_functions
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
    ORDERS,
    ROTARY_CRANE,
    FmuKind,
    Starts,
)

_COORDINATES = "generalized"  # of the plant: without constraints
_DISTANCE = 0.5  # m, from the path

LARGEST_TURN = 1.0
"""Of the fastest pendulum in a step, in rad: beyond it the feedback is left out."""


@dataclass(frozen=True)
class NativeWishes:
    """What a native FMU shall be.

    Attributes
    ----------
    reference : Reference, optional
        The path that the trajectory carries.
    starts : mapping of str to float or str
        Start values of parameters in place of defaults.
    targets : str, optional
        Platforms, as `sc.export_fmu` takes them.
    judged_late : bool
        Whether it is for a slave of PythonFMU, whose setters cannot fail.
    """

    reference: sc.Reference | None = None
    starts: Starts = field(default_factory=lambda: NO_STARTS)
    targets: str | None = None
    judged_late: bool = False


def native_fmu(kind: FmuKind, wishes: NativeWishes, tell: Callable[[str], None] = lambda _: None) -> bytes:
    """Return the archive of trajectory, inverse model or plant, FMI 2, with the variables of that with PythonFMU.

    Parameters
    ----------
    kind : FmuKind
        Which of them.
    wishes : NativeWishes
        Path, start values, platforms.
    tell : callable
        Told what is being done.
    """
    crane = sc.scenes.rotary_crane()
    own = {name: value for name, value in wishes.starts.items() if name in crane.model().parameters.names}
    crane = crane.with_parameters(**{name: float(value) for name, value in own.items()})
    with tempfile.TemporaryDirectory(prefix="crane_fmu_") as folder:
        return _WRITERS[kind.name](crane, Path(folder, kind.file_name), wishes, tell).read_bytes()


def _trajectory(crane: sc.Scene, file: Path, wishes: NativeWishes, tell: Callable[[str], None]) -> Path:
    tell("compiling the trajectory")
    profile = wishes.starts.get("profile")
    named = None if profile in (None, FROM_FILE) else str(profile)
    given = {name: float(value) for name, value in wishes.starts.items() if not isinstance(value, str)}
    line = sc.TrajectoryWishes(wishes.reference, named, given, LOAD_TRAJECTORY.name, offers_file=wishes.judged_late)
    late, targets = wishes.judged_late, wishes.targets
    return sc.export_trajectory(crane, file, line, fmi=2, targets=targets, judged_late=late, tell=tell)


def _inverse(crane: sc.Scene, file: Path, wishes: NativeWishes, tell: Callable[[str], None]) -> Path:
    on_path = crane if wishes.reference is None else crane.with_reference(wishes.reference)
    estimates = estimates_of(crane, str(wishes.starts.get("connected", ORDERS[-1])))
    return sc.export_fmu(
        on_path, file, fmi=2, targets=wishes.targets, feedback=feedback_of(crane), estimates=estimates,
        start=wishes.starts, judged_late=wishes.judged_late, routes=ROUTES if wishes.judged_late else None, tell=tell,
    )  # fmt: skip


def _plant(crane: sc.Scene, file: Path, wishes: NativeWishes, tell: Callable[[str], None]) -> Path:
    plant = sc.PlantWishes(
        errors={"mass_error": "load_mass"},
        offsets={"start.swing": ("swing_in", "swing_out")},
        ranges={"start.swing": (-1.5, 1.5)},
        start=wishes.starts,
        identifier=CRANE_PLANT.name,
        reasons={"tension": "the rope goes slack: its"},
    )
    late, targets = wishes.judged_late, wishes.targets
    return sc.export_plant(crane, file, plant, fmi=2, model=_COORDINATES, targets=targets, judged_late=late, tell=tell)


ROUTES = sc.SteppedRoutes(MODELS, FORMULATIONS, METHODS["backward-euler"])
"""What RotaryCrane.fmu offers beside the exact inversion of every instant."""

_WRITERS = {LOAD_TRAJECTORY.name: _trajectory, ROTARY_CRANE.name: _inverse, CRANE_PLANT.name: _plant}


def feedback_of(crane: sc.Scene) -> sc.SampledFeedback:
    """Return the crane's feedback as an exported inverse model carries it: the same functions as in the PythonFMU."""
    return sc.SampledFeedback(
        measured=_measured(crane),
        laws=feedback_functions(crane.model(LAW_MODEL)),
        judge=_judge(),
        not_measured="the measured rope length is %g m and the measured height of the load %g m: the feedback needs the"
        " length above 0 m, the height below 0 m and all measured values connected; feedback = 0 does without",
        shown=(FEEDBACK_INPUTS.index("measured.l"), FEEDBACK_INPUTS.index("measured.position[3]")),
        largest_turn=LARGEST_TURN,
        too_long="with this load, trolley and rope it",
        distance=_DISTANCE,
    )


def estimates_of(crane: sc.Scene, connected: str = ORDERS[-1]) -> sc.SampledEstimates:
    """Return the estimation of what is not connected, also of the same functions; `connected` is the start value."""
    outputs = len(crane.model().inputs) + len(crane.model().observables)
    orders = range(len(ORDERS) - 1)
    return sc.SampledEstimates(
        functions=estimate_functions(outputs),
        unknown=tuple(in_motion(order) for order in orders),
        rough=tuple(too_rough(order) for order in orders),
        start=ORDERS.index(connected),
    )


def _measured(crane: sc.Scene) -> tuple[tuple[sc.Quantity, int | None], ...]:
    """Return what is measured with the sizes of vectors, in the order in which the law takes it."""
    units = {each.name: each.unit for each in crane.model().observables}
    motion = [(name, units[name]) for name in ("phi", "s", "l")]
    rates = [(f"{name}_dot", f"{unit}/s") for name, unit in motion]
    load = [
        (sc.Quantity(*each, f"{each[0]} of the load"), DIMENSION) for each in (("position", "m"), ("velocity", "m/s"))
    ]
    return *((sc.Quantity(*each, each[0]), None) for each in (*motion, *rates)), *load


def _judge() -> ca.Function:
    """Return (path before, measured, p, h) -> whether it makes sense, distance from the path, turn of the pendulum."""
    path, measured, p, h = ca.SX.sym("path", 15), ca.SX.sym("measured", 12), ca.SX.sym("p", 6), ca.SX.sym("h")
    length, height = measured[2], measured[8]
    sensible = ca.logic_and(length > 0, height < 0)
    distance = ca.norm_2(measured[6:9] - path[:3])
    rate = ca.sqrt(ca.fmax(p[5] + path[8], 0) / length * (1 + p[2] / p[1]))  # as of `fastest_pendulum`
    return ca.Function("judge", [path, measured, p, h], [ca.vertcat(sensible, distance, rate * h)])
