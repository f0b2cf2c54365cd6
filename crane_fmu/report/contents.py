"""What the demo's page says: its sections with their tables and illustrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import degrees

from crane_fmu.report import convergence, postures, trajectories
from crane_fmu.report.page import UNITS, Illustration, Part, Table, number, parameter_table
from crane_fmu.report.study import INPUTS, MOTION, STEPS, Cycle, Errors, LoadRun, Study, largest
from crane_fmu.report.style import Array

_PERCENT = tuple(f"{name} (%)" for name in INPUTS)
TITLE = "The inputs of a rotary crane whose load follows a prescribed path"


def sections(
    study: Study, fmu: Mapping[str, Array], loop: Sequence[LoadRun], cycle: Cycle | None
) -> dict[str, list[Part]]:
    """Return the whole page by headings.

    Parameters
    ----------
    study : Study
        The default manoeuvre.
    fmu : mapping of str to ndarray
        The same by the FMU: its outputs, and ``time``.
    loop : sequence of LoadRun
        The same by trajectory, inverse model and plant as connected FMUs.
    cycle : Cycle or None
        The working cycle; None if the examples are not at hand.
    """
    written = {
        "": _introduction(study),
        "The manoeuvre": _reference(study),
        "The motion of the crane": _motion(study),
        "The inputs": _inputs(study),
        "The postures": _postures(study),
        "Errors": _errors(study),
        "The FMU": _fmu(study, fmu),
        "Does the load go where it should?": _tracking(study),
        "The loop of FMUs": _loop(loop),
    }
    return written if cycle is None else {**written, "A working cycle": _cycle(cycle)}


def _introduction(study: Study) -> list[Part]:
    return [
        "A slewing bridge carries a trolley with a winch; a load hangs on the rope. The path of the load is"
        " prescribed, and the bridge torque M_b, the trolley force F and the winch torque M_w that make it follow"
        " that path are computed: a servo-constraint problem with five degrees of freedom and three inputs"
        " (Betsch, Uhlar and Quasem 2009). Their projected formulation is stepped in time by backward Euler,"
        " with three models of the same crane: points (9 coordinates), bodies (their 42 redundant coordinates,"
        " RED) and generalized (their 5 coordinates, GEN).",
        "The crane is differentially flat in the position of its load, so motion and inputs are also known in"
        " closed form, and every number on this page is judged by it. The tables of the paper were not at hand:"
        " the data below are a declared assumption, and no figure here claims to reproduce a printed curve.",
        parameter_table(study.scene),
        Illustration(
            "crane",
            "The crane and its coordinates",
            "Bridge angle φ, trolley position s, rope length l; the trolley runs in the plane z = 0 and the load"
            " hangs below. Each input is positive in the direction of its coordinate; the winch torque pays out"
            " rope, so it is negative at rest.",
            postures.sketch(study.scene),
        ),
    ]


def _reference(study: Study) -> list[Part]:
    reference = study.scene.reference
    ends = reference.jet([reference.start_time, reference.end_time], 0)[:, 0]
    way = " to ".join("(" + ", ".join(f"{value:g}".replace("-", "−") for value in point) + ") m" for point in ends)
    return [
        f"The load moves along the straight line from {way} in {reference.duration:g} s, from rest to rest.",
        Illustration(
            "reference_function",
            "Reference function s(t) and its second derivative",
            "The fraction of the line that the load has travelled: a polynomial of degree 9 whose first four"
            " derivatives vanish at both ends, so that the inputs start and end without a jump.",
            trajectories.reference_function(reference),
        ),
    ]


def _motion(study: Study) -> list[Part]:
    return [
        "Bridge angle, trolley position and rope length follow from the path of the load and the equations of"
        " motion of the load alone. They are exact for every step, up to rounding.",
        Illustration(
            "motion",
            "Bridge angle, trolley position and rope length",
            f"Computed with the model {study.models[0]} and a step of {study.steps[0]:g} s, and in closed form.",
            trajectories.beside_closed_form(MOTION, study.base, study.scene),
        ),
    ]


def _inputs(study: Study) -> list[Part]:
    step = study.steps[0]
    redundant, generalised = study.solutions["bodies", step], study.solutions["generalized", step]
    return [
        "Redundant and generalised coordinates give the same inputs up to the error of the step. That error is of"
        " the first order and seen here as a delay against the closed form; the tables below say how large it is.",
        Illustration(
            "inputs",
            "Slewing torque and trolley force",
            f"Step {step:g} s; redundant coordinates: model bodies, generalised ones: model generalized.",
            trajectories.inputs_compared(redundant, generalised, study.scene),
        ),
    ]


def _postures(study: Study) -> list[Part]:
    slewed = f"The bridge has slewed by {degrees(study.base['phi'][-1]):.0f}°."
    first, last = postures.posture(study.base, 0), postures.posture(study.base, -1)
    return [
        Illustration("initial_posture", "Initial posture", "The load hangs at rest.", first),
        Illustration("final_posture", "Final posture", f"{slewed} Dotted: the path seen from above.", last),
    ]


def _errors(study: Study) -> list[Part]:
    return [
        "The error of every input halves with the step, in every model; so does the difference between any two"
        " models. The motion is exact. The reduced formulation inverts the equations at every instant and has no"
        " error of a step at all.",
        error_table(study),
        difference_table(study),
        Illustration(
            "error_against_step",
            "Error of the inputs against the step",
            "Both axes are logarithmic; a line of slope one is an error of the first order.",
            convergence.error_against_step(study.errors),
        ),
    ]


def error_table(study: Study, factors: bool = True) -> Table:
    """Return the largest errors against the closed form, with the factors by which they fall if wanted."""
    coarser = dict(zip(study.steps[1:], study.steps, strict=False)) if factors else {}
    runs = [
        (*run, errors, study.errors.get((run[0], coarser.get(run[1], 0.0)))) for run, errors in study.errors.items()
    ]
    rows = [
        (label, f"{step:g}", *_percent(errors, before), *(number(errors[name], 1) for name in MOTION))
        for label, step, errors, before in [*runs, ("reduced", study.steps[0], study.reduced, None)]
    ]
    explained = " After ÷: the factor by which the error fell when the step was halved." if factors else ""
    return Table(
        "Largest errors against the closed form",
        ("model", "h (s)", *_PERCENT, "φ (rad)", "s (m)", "l (m)"),
        tuple(rows),
        f"h is the step. Inputs: relative to the largest value of each.{explained} Motion: absolute. The last row is"
        f" the reduced formulation with the model {study.scene.default_model}, all others are the projected one.",
    )


def _percent(errors: Errors, before: Errors | None = None) -> list[str]:
    """Return the errors of the inputs, with the factors by which they are smaller than those before."""
    factors = {} if before is None else {name: f" ÷{before[name] / errors[name]:.2f}" for name in INPUTS}
    return [number(100 * errors[name]) + factors.get(name, "") for name in INPUTS]


def difference_table(study: Study) -> Table:
    """Return the largest differences between the models' inputs."""
    return Table(
        "Largest differences between the models' inputs",
        ("models", "h (s)", *_PERCENT),
        tuple((models, f"{step:g}", *_percent(errors)) for (models, step), errors in study.differences.items()),
        "Relative to the largest value of each input.",
    )


def _fmu(study: Study, outputs: Mapping[str, Array]) -> list[Part]:
    t = outputs["time"]
    return [
        "The same crane as a Functional Mock-up Unit (FMI 2.0, co-simulation) was run by FMPy along the same path:"
        f" {len(t)} rows up to t = {t[-1]:g} s with a communication step of {t[1] - t[0]:g} s.",
        "Beside this page lie the FMU, the inputs of the manoeuvre as a table (inputs.csv) and the figures.",
        fmu_table(study, outputs),
    ]


def fmu_table(study: Study, outputs: Mapping[str, Array]) -> Table:
    """Return the largest differences between the FMU's outputs and the library's, and the closed form."""
    judges = study.base, study.scene.exact(outputs["time"])
    rows = []
    for name in (*INPUTS, *MOTION):
        unit = study.base.unit(name)
        apart = [f"{number(largest(outputs[name] - judge[name]), 2)} {UNITS.get(unit, unit)}" for judge in judges]
        rows.append((name.replace("phi", "φ"), *apart))
    return Table(
        "Largest differences of the FMU's outputs",
        ("output", "from the library", "from the closed form"),
        tuple(rows),
        "A simulation tool hands over the path at the start of a communication step; the FMU continues it to the end of"
        " the step by its Taylor polynomial. That is the difference from the library.",
    )


def _tracking(study: Study) -> list[Part]:
    return [
        "The equations of motion are integrated forward in time under the computed inputs, without any control."
        " An error of the inputs is integrated twice, so the load strays, by an amount of the first order in the"
        " step; under the inputs of the closed form it stays on its path.",
        tracking_table(study.tracking),
        Illustration(
            "tracking",
            "The load in forward simulations",
            "Above: its position and, in grey, the path. Below: its distance from the path; errors below a"
            " nanometre are drawn as one.",
            trajectories.strayed(study.tracking, study.tracking),
        ),
    ]


def tracking_table(runs: Sequence[LoadRun]) -> Table:
    """Return how far the load strays in forward simulations."""
    return _strayed("Forward simulation", "under", runs)


def _strayed(title: str, of_runs: str, runs: Sequence[LoadRun]) -> Table:
    rows = tuple((run.label, f"{number(1e3 * run.largest)} mm") for run in runs)
    return Table(title, (of_runs, "load off its path by at most"), rows)


def _loop(runs: Sequence[LoadRun]) -> list[Part]:
    return [
        "Three FMUs, a load trajectory, the inverse model and the crane as a plant, are connected (Crane.ssp) and"
        f" run by FMPy with a communication step of {runs[0].t[1] - runs[0].t[0]:g} s. Bridge angle, trolley position,"
        " rope length and load of the plant are fed back: a linear-quadratic regulator about the path, with an"
        " estimate of the force that disturbs the load, corrects the inputs.",
        loop_table(runs),
        Illustration(
            "closed_loop",
            "The load under trajectory, inverse model and plant",
            f"Above: the position wanted, in grey, and driven ({runs[-1].label}). Below: the distance of the load"
            " from where it should be; errors below a nanometre are drawn as one.",
            trajectories.strayed(runs, runs[-1:]),
        ),
    ]


def loop_table(runs: Sequence[LoadRun]) -> Table:
    """Return how far the load strays under the connected FMUs."""
    return _strayed("The connected FMUs", "run", runs)


def _cycle(cycle: Cycle) -> list[Part]:
    errors = ", ".join(f"{name} {error} %" for name, error in zip(INPUTS, _percent(cycle.errors), strict=True))
    return [
        f"A path through {len(cycle.waypoints)} waypoints, from rest to rest in"
        f" {cycle.scene.reference.duration:g} s, as a spline of degree 9. The same path read from a file of samples"
        f" is at most {number(cycle.apart, 1)} m away. Largest errors of the inputs with a step of"
        f" {STEPS[0]:g} s: {errors}.",
        Illustration(
            "cycle_path",
            "The working cycle",
            "The crane half-way; the load is lifted, swung round and lowered.",
            postures.posture(cycle.solution, len(cycle.solution.t) // 2),
        ),
        Illustration(
            "cycle_inputs",
            "Inputs of the working cycle",
            f"Step {STEPS[0]:g} s.",
            trajectories.beside_closed_form(INPUTS, cycle.solution, cycle.scene),
        ),
    ]


def cycle_table(cycle: Cycle) -> Table:
    """Return the errors of the working cycle."""
    row = (f"{STEPS[0]:g}", *_percent(cycle.errors))
    return Table("Working cycle: largest errors of the inputs", ("h (s)", *_PERCENT), (row,))
