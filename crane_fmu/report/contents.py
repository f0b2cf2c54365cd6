"""Sections of the demo's page, with their tables and illustrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from crane_fmu.report import figures
from crane_fmu.report.page import UNITS, Fact, Illustration, Part, Table, number, parameter_table
from crane_fmu.report.study import DEFAULT, INPUTS, MOTION, PAPER, STEPS, Array, Cycle, Errors, LoadRun, Study, largest

_PERCENT = tuple(f"{name} (%)" for name in INPUTS)
_MOTION = ("φ (rad)", "s (m)", "l (m)")
_FMUS = f"FMUs with their defaults: {DEFAULT.replace('instant', 'communication step')}"
TITLE = "The inputs of a rotary crane whose load follows a prescribed path"


def sections(study: Study, fmu: Mapping[str, Array], loop: Sequence[LoadRun], cycle: Cycle) -> dict[str, list[Part]]:
    """Return the whole page by headings.

    Parameters
    ----------
    study : Study
        The default manoeuvre.
    fmu : mapping of str to ndarray
        The same by the FMU: its outputs, and ``time``.
    loop : sequence of LoadRun
        The same by trajectory, inverse model and plant as connected FMUs.
    cycle : Cycle
        The working cycle.
    """
    return {
        "": list(summary(study)),
        "The crane": _introduction(study),
        "The manoeuvre": _reference(study),
        "The inputs": _inputs(study),
        "The FMU": _fmu(study, fmu),
        "Forward simulation": _tracking(study),
        "The loop of FMUs": _loop(loop),
        "A working cycle": _cycle(cycle),
        "The scheme of the paper": _paper(study),
    }


def facts(study: Study) -> tuple[Fact, ...]:
    """Return the headline numbers: residuals of the default route, then errors of the scheme of the paper."""
    step, (inverted, *_, coarse, _) = study.steps[0], study.tracking
    paper = study.paper_errors[study.models[0], step]["M_b"]
    return (
        Fact(
            number(exact_error(study), 1),
            "numerical residual of the inputs by exact inversion, relative to their peaks",
        ),
        Fact(f"{number(1e6 * inverted.largest, 1)} µm", "largest tracking error in a simulation (numerical residual)"),
        Fact(f"{number(100 * paper)} %", f"error of M_b by the scheme of the paper, step {step:g} s", True),
        Fact(f"{number(1e3 * coarse.largest)} mm", "largest tracking error under its inputs", True),
    )


def exact_error(study: Study) -> float:
    """Return the largest error of the inputs by the default, relative to the peak of each."""
    return max(study.errors[study.models[0]][name] for name in INPUTS)


def summary(study: Study) -> tuple[str, str]:
    """Return the results of the default and of the scheme of the paper, a sentence or two each."""
    model, step = study.models[0], study.steps[0]
    paper = study.paper_errors[model, step]
    inverted, *_, first, last = study.tracking
    return (
        "By default the inputs are computed by exact inversion at every instant (form reduced): they agree with the"
        f" closed form to {number(exact_error(study), 1)} of their peaks, and in a forward simulation of the same"
        f" model the tracking error is {number(1e6 * inverted.largest, 1)} µm. Both are numerical residuals, and"
        " contain no errors of data, path fitting or unmodelled effects.",
        "For comparison, the scheme of the paper (form projected, method backward Euler): with a step of"
        f" {step:g} s its M_b is off by {number(100 * paper['M_b'])} % of its peak, F by {number(100 * paper['F'])} %"
        f" and M_w by {number(100 * paper['M_w'])} %, and the tracking error is {number(1e3 * first.largest)} mm. The"
        f" errors halve with the step; at {study.steps[-1]:g} s the tracking error is {number(1e3 * last.largest)} mm.",
    )


def _introduction(study: Study) -> list[Part]:
    return [
        "A slewing bridge carries a trolley with a winch; a load hangs on the rope. The path of the load is"
        " prescribed, and the bridge torque M_b, the trolley force F and the winch torque M_w that make it follow"
        " that path are computed: a servo-constraint problem with five degrees of freedom and three inputs"
        " (Betsch, Uhlar and Quasem 2009).",
        "There are three models of the same crane: points (9 coordinates, the default), bodies (the 42 redundant"
        " coordinates of the paper, RED) and generalized (its 5 coordinates, GEN). The crane is differentially flat in"
        " the position of its load, so motion and inputs are also known in closed form, the reference of every error on"
        " this page. The tables of the paper were not available: the data below are a declared assumption, and no"
        " figure reproduces a printed curve.",
        parameter_table(study.scene),
        Illustration(
            "crane",
            "The crane and its coordinates",
            DEFAULT,
            "Bridge angle φ, trolley position s, rope length l; the trolley runs in the plane z = 0 and the load"
            " hangs below. Each input is positive in the direction of its coordinate; the winch torque pays out"
            " rope, so it is negative at rest.",
            figures.sketch(study.base),
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
            "The share of the line that the load has travelled, and its second derivative",
            "the path itself, nothing is solved",
            "The paper calls it reference function s(t). It is a polynomial of degree 9 whose first four derivatives"
            " vanish at both ends, so that the inputs start and end without a jump.",
            figures.reference_function(reference),
        ),
    ]


def _inputs(study: Study) -> list[Part]:
    return [
        "Inputs and motion are shown at the top of this page. Every row of inputs.csv is an exact inversion at its"
        " instant: the spacing of the rows is no integration step, and no error comes from it.",
        *([f"Certificate: {study.certificate}."] if study.certificate else []),
        error_table(study),
    ]


def error_table(study: Study) -> Table:
    """Return the largest errors of the default against the closed form."""
    return Table(
        "Largest errors against the closed form",
        DEFAULT,
        ("model", *_PERCENT, *_MOTION),
        tuple((model, *_both(errors)) for model, errors in study.errors.items()),
        "Inputs: relative to the peak of each. Motion: absolute. All are numerical residuals.",
    )


def _paper(study: Study) -> list[Part]:
    step = study.steps[0]
    redundant, generalized = study.paper["bodies", step], study.paper["generalized", step]
    return [
        "The scheme of the paper (form projected, method backward Euler): redundant and generalized coordinates give"
        " the same inputs up to the discretization error. It is of first order and appears as a delay against the"
        " default; it halves with the step in every model, and so does the difference between any two models. The"
        " motion is exact.",
        Illustration(
            "inputs_paper",
            "The inputs by the scheme of the paper, over those by the default",
            f"{PAPER}, step {step:g} s; and {DEFAULT}",
            "Redundant coordinates: model bodies, generalized ones: model generalized. The scale of M_w is enlarged:"
            f" 2 N m about the {study.base['M_w'][0]:.1f} N m that hold the load at rest.",
            figures.inputs_compared(redundant, generalized, study.base),
        ),
        paper_table(study),
        difference_table(study),
        Illustration(
            "error_against_step",
            "Error of the inputs by the scheme of the paper against the step",
            PAPER,
            "Both axes are logarithmic; a line of slope one is an error of the first order.",
            figures.error_against_step(study.paper_errors),
        ),
    ]


def paper_table(study: Study, factors: bool = True) -> Table:
    """Return the largest errors of the scheme of the paper, with the factors by which they fall if `factors`."""
    coarser = dict(zip(study.steps[1:], study.steps, strict=False)) if factors else {}
    rows = [
        (model, f"{step:g}", *_both(errors, study.paper_errors.get((model, coarser.get(step, 0.0)))))
        for (model, step), errors in study.paper_errors.items()
    ]
    explained = " After ÷: the factor by which the error fell when the step was halved." if factors else ""
    return Table(
        "The scheme of the paper: largest errors against the closed form",
        PAPER,
        ("model", "h (s)", *_PERCENT, *_MOTION),
        tuple(rows),
        f"h is the step. Inputs: relative to the peak of each.{explained} Motion: absolute.",
    )


def _both(errors: Errors, before: Errors | None = None) -> list[str]:
    """Return the errors of inputs and motion."""
    return [*_percent(errors, before), *(number(errors[name], 1) for name in MOTION)]


def _percent(errors: Errors, before: Errors | None = None) -> list[str]:
    """Return the errors of the inputs, with the factors by which they are smaller than those before."""
    factors = {} if before is None else {name: f" ÷{before[name] / errors[name]:.2f}" for name in INPUTS}
    return [number(100 * errors[name]) + factors.get(name, "") for name in INPUTS]


def difference_table(study: Study) -> Table:
    """Return the largest differences between the models' inputs."""
    return Table(
        "The scheme of the paper: largest differences between the models' inputs",
        PAPER,
        ("models", "h (s)", *_PERCENT),
        tuple((models, f"{step:g}", *_percent(errors)) for (models, step), errors in study.differences.items()),
        "Relative to the peak of each input.",
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
    """Return the largest differences between the FMU's outputs and the closed form."""
    exact, rows = study.scene.exact(outputs["time"]), []
    for name in (*INPUTS, *MOTION):
        unit, apart = study.base.unit(name), largest(outputs[name] - exact[name])
        share = f"{number(100 * apart / largest(exact[name]), 2)} %"
        rows.append((name.replace("phi", "φ"), f"{number(apart, 2)} {UNITS.get(unit, unit)}", share))
    return Table(
        "Largest differences of the FMU's outputs",
        f"FMU with its defaults: model {study.models[0]}, {DEFAULT.replace('instant', 'communication step')}",
        ("output", "from the closed form", "of its peak"),
        tuple(rows),
        "A co-simulation master sets the path at the start of a communication step; the FMU extrapolates it to the end"
        " of the step by its Taylor polynomial. The differences are those of this extrapolation.",
    )


def _tracking(study: Study) -> list[Part]:
    return [
        "The equations of motion are integrated forward in time under the computed inputs, open loop. Under inputs by"
        " exact inversion at every instant the load follows its path; a table of them is interpolated by a cubic"
        " spline, whose error remains. An error of the inputs is integrated twice: under those of the scheme of the"
        " paper the tracking error is of first order in the step.",
        tracking_table(study.tracking),
        Illustration(
            "tracking",
            "The load in forward simulations",
            f"inputs: {DEFAULT}; and {PAPER}",
            "Above: its position under the inputs of the paper's scheme with the largest step and, in grey, the path."
            " Below: its distance from the path in all runs; distances below 1 µm are drawn as 1 µm.",
            figures.strayed(study.tracking, study.tracking[2:3]),
        ),
    ]


def tracking_table(runs: Sequence[LoadRun]) -> Table:
    """Return the tracking errors in forward simulations."""
    return _strayed("Forward simulation", f"inputs: {DEFAULT}; and {PAPER}", "under inputs by", runs)


def _strayed(title: str, by: str, of_runs: str, runs: Sequence[LoadRun]) -> Table:
    rows = tuple((run.label, f"{number(1e3 * run.largest)} mm") for run in runs)
    return Table(title, by, (of_runs, "largest tracking error"), rows)


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
            _FMUS,
            f"Above: the prescribed position, in grey, and the simulated one ({runs[-1].label}). Below: the tracking"
            " error of all runs; errors below 1 µm are drawn as 1 µm. Shaded: the gust.",
            figures.strayed(runs, runs[-1:], figures.CONNECTED),
        ),
    ]


def loop_table(runs: Sequence[LoadRun]) -> Table:
    """Return the tracking errors of the connected FMUs."""
    return _strayed("The connected FMUs", _FMUS, "run", runs)


def _cycle(cycle: Cycle) -> list[Part]:
    return [
        f"A path through {len(cycle.waypoints)} waypoints, from rest to rest in"
        f" {cycle.scene.reference.duration:g} s, as a spline of degree 9. The same path read from a file of samples"
        f" is at most {number(cycle.apart, 1)} m away.",
        cycle_table(cycle),
        Illustration(
            "cycle_path",
            "The working cycle",
            DEFAULT,
            "The crane half-way; the load is lifted, swung round and lowered.",
            figures.posture(cycle.solution, len(cycle.solution.t) // 2),
        ),
    ]


def cycle_table(cycle: Cycle) -> Table:
    """Return the errors of the working cycle."""
    return Table(
        "Working cycle: largest errors of the inputs",
        f"{DEFAULT}; and {PAPER}",
        ("inputs by", *_PERCENT),
        (
            ("exact inversion", *_percent(cycle.errors)),
            (f"scheme of the paper, step {STEPS[0]:g} s", *_percent(cycle.paper)),
        ),
    )
