"""Row 10: constraints that say the same twice, and constraints whose rank drops on the way."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.optimize import brentq

import servocore as sc
from benchmarks.atlas.linkages import (
    BASE,
    CRANK,
    UP,
    antiparallelogram_angles,
    bricard,
    bricard_torque,
    crossed_torque,
    parallelogram,
    parallelogram_torque,
)
from benchmarks.atlas.record import FAILS, REFUSED, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import march, quietly, relative_error, slope
from benchmarks.atlas.style import BAD, GOOD, OTHER, label, panels
from servocore.numerics.constraint_ranks import assembled, scaled_rows, unit_rows
from servocore.problem import without_constraints
from servocore.rotationless import turned

NAME = "redundant-constraints"
SHORT_OF = (0.6, 0.2, 0.05, 0.01)
"""How far from the stretched position, crank and coupler in line, a motion ends, in rad."""
APART = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""How far from its closed configurations the Bricard linkage is looked at, in m and as parts of directors."""


@cache
def doubled_crane() -> sc.MechanicalSystem:
    """Return the rotary crane with a fifth constraint that is a combination of the others."""
    base = sc.scenes.rotary_crane().model()
    g = base.constraints
    return replace(
        base,
        constraints=ca.vertcat(g, g[0] + 2 * (g[1] + g[3])),
        multipliers=ca.vertcat(base.lam, ca.SX.sym("lam_again")),
    )


def turning(end: float) -> sc.Scene:
    """Return the parallelogram whose crank turns from 0.3 rad to `end`."""
    return sc.Scene(
        name="parallelogram",
        models={"bodies": parallelogram},
        reference=sc.rest_to_rest((0.3,), (end,), 4.0),
        closed_form=lambda reference, _: parallelogram_torque(reference),
        closed_form_order=2,
    )


def measure(quick: bool) -> Findings:
    """Look at a doubled constraint, linkages with too many hinges, and one that passes its stretched position."""
    found = Findings(NAME)
    _doubled(found)
    _too_many_hinges(found)
    _bricard(found, quick)
    _towards_stretched(found, quick)
    _through_stretched(found)
    return found


def _doubled(found: Findings) -> None:
    crane, raw = sc.scenes.rotary_crane(), doubled_crane()
    scene = replace(crane, models={"doubled": doubled_crane})
    p = raw.parameters.values()
    for form in (sc.Original(), sc.Projected(), sc.Reduced()):
        seen = found.facts["raw"] = _refusal(raw, form)
        found.add("rotary_crane, g_5 redundant", f"{form.name}, as it stands", "writing the form",
                  "5 constraints, rank 4", "InvalidModel", seen.partition(":")[0], REFUSED)  # fmt: skip
    report = sc.analyse(scene)
    found.add("rotary_crane, g_5 redundant", "analyse", "remedy", "5 constraints, rank 4",
              "redundant constraints left out: g_5", report.remedy, SURVIVES)  # fmt: skip
    by_hand = replace(crane, models={"less": lambda: kept})
    kept = without_constraints(raw, raw.constraint_rank(p).redundant)
    for route, subject in (("solve", scene), ("without_constraints, then solve", by_hand)):
        error = relative_error(crane, quietly(subject))
        found.add("rotary_crane, g_5 redundant", route, "relative input error", "5 constraints, rank 4", at_most(1e-12),
                  error, SURVIVES)  # fmt: skip
        found.facts["doubled"] = error


def _refusal(system: sc.MechanicalSystem, form: sc.Formulation) -> str:
    """Return the error of writing a form of a system as it stands."""
    try:
        form.dae(system)
    except sc.InvalidModel as error:
        return f"{type(error).__name__}: {error}"
    return "written"


def _too_many_hinges(found: Findings) -> None:
    name, value = "parallelogram, four revolutes", "39 constraints, rank 36"
    system, p = parallelogram("revolute"), np.zeros(0)
    kept = without_constraints(system, system.constraint_rank(p).redundant)
    for route, subject, expected, verdict in (
        ("all rows kept", system, at_least(1e14), FAILS),
        ("redundant rows left out", kept, at_most(1e3), SURVIVES),
    ):
        rows = scaled_rows(subject.constraints, subject.q, subject.p, p, np.ones(len(subject.coordinates)))
        values = np.linalg.svd(rows(subject.home_configuration()[0])[1], compute_uv=False)
        found.add(name, route, "condition of the constraint Jacobian", value, expected, values[0] / values[-1], verdict)
    found.facts["hinges"] = _refusal(system, sc.Reduced()).partition(": ")[2]
    found.add(name, "reduced, as it stands", "writing the form", value, "InvalidModel",
              _refusal(system, sc.Reduced()).partition(":")[0], REFUSED)  # fmt: skip
    scene = replace(turning(2.5), models={"hinges": lambda: system})
    found.add(name, "analyse", "remedy", value, "redundant constraints left out: C 3, C 4, C 5",
              sc.analyse(scene).remedy, SURVIVES)  # fmt: skip
    error = found.facts["four"] = relative_error(scene, quietly(scene))
    found.add(name, "solve", "relative input error", value, at_most(1e-12), error, SURVIVES)
    try:
        parallelogram("revolute", extra_input=True)
        seen = "nothing"
    except sc.InvalidModel as refusal:
        seen, found.facts["overactuated"] = type(refusal).__name__, str(refusal)
    found.add(name, "two inputs", "building the system", value, "InvalidModel", seen, REFUSED)


def _bricard(found: Findings, quick: bool) -> None:
    """Close six hinges: as many rows as coordinates, and yet it moves."""
    system, p = bricard(), np.zeros(0)
    rows = scaled_rows(system.constraints, system.q, system.p, p, np.ones(len(system.coordinates)))
    closed = assembled(rows, system.home_configuration()[0])
    assert closed is not None
    directions = np.sin(1.0 + np.arange(len(closed)))
    smallest = [_singular_values(rows(closed + each * directions)[1])[-1] for each in APART]
    last, first = _singular_values(rows(closed)[1])[-1:-3:-1]
    name, count = "Bricard linkage, six revolutes", "61 constraints, 61 coordinates"
    full = int(np.linalg.matrix_rank(rows(closed + APART[0] * directions)[1]))
    found.add(name, "rank where the loop is open by 1e-2", "rank", count, about(61, 0.0), full, FAILS)
    found.add(name, "rank of all rows, closed to a distance", "exponent of the distance in the smallest singular value",
              "1e-2 to 1e-6", about(1.0, 0.05), slope(np.array(APART), np.array(smallest)), FAILS)  # fmt: skip
    found.add(name, "constraint_rank", "rank", count, about(60, 0.0), system.constraint_rank().rank, SURVIVES)
    found.add(name, "constraint_rank", "smallest singular value", "closed", at_most(1e-13), last, SURVIVES)
    scene = bricard_scene()
    solution = quietly(scene, sc.Reduced(), sc.BackwardEuler(), step=scene.reference.duration / (40 if quick else 200))
    exact = scene.exact(solution.t)
    error = relative_error(scene, solution)
    angle = float(np.abs(solution["cos_theta_2"] - exact["cos_theta_2"]).max())
    violation = solution.statistics.constraint_violation
    for parameter, bound, value in (
        ("relative input error", 1e-12, error),
        ("error of cos theta_2 in the closed relation", 1e-13, angle),
        ("constraint violation", 1e-13, violation),
    ):
        found.add(name, "solve", parameter, count, at_most(bound), value, SURVIVES)
    found.curves["rank"] = (np.array(APART), np.array(smallest), first)
    found.curves["bricard"] = (solution.t, solution["torque"], exact["torque"])
    found.facts.update(bricard=error, bricard_violation=violation, last=last, first=first)


def _singular_values(jacobian: np.ndarray) -> np.ndarray:
    return np.linalg.svd(unit_rows(jacobian), compute_uv=False)


def bricard_scene() -> sc.Scene:
    """Return the Bricard linkage whose first joint turns from -0.5 to 1.8 rad."""
    return sc.Scene(
        name="bricard",
        models={"bodies": bricard},
        reference=sc.rest_to_rest((-0.5,), (1.8,), 2.0),
        closed_form=lambda reference, _: bricard_torque(reference),
        closed_form_order=2,
    )


def _towards_stretched(found: Findings, quick: bool) -> None:
    distances = SHORT_OF[::2] if quick else SHORT_OF
    errors, conditions = [], []
    for distance in distances:
        scene = turning(float(np.pi) - distance)
        errors.append(relative_error(scene, sc.solve(scene, sc.Reduced(), sc.BackwardEuler(), step=0.02)))
        report = sc.analyse(scene)
        conditions.append(report.condition)
        value = f"{distance:g} rad short of stretched"
        found.add("parallelogram", "reduced, loop closed by on_line", "relative input error", value, at_most(1e-9),
                  errors[-1], SURVIVES)  # fmt: skip
        found.add("parallelogram", "analyse", "loss of rank", value, "none", report.rank_loss or "none", SURVIVES)
    found.curves["short"] = (np.array(distances), np.array(errors), np.array(conditions))
    found.facts.update(short=max(errors), nearest=distances[-1], condition=conditions[-1])


def _through_stretched(found: Findings) -> None:
    """Turn the crank through the position in which parallelogram and antiparallelogram meet."""
    value, scene = "through stretched", turning(float(np.pi) + 0.6)
    misled = replace(scene, models={"misled": _misled})
    reference = scene.reference
    meeting = brentq(lambda t: float(reference.jet(t, 0)[0, 0]) - np.pi, reference.start_time, reference.end_time)
    report = sc.analyse(scene)
    seen = float(report.rank_loss.split("t = ")[1].split(" s")[0]) if report.rank_loss else np.nan
    found.add(
        "parallelogram", "analyse", "instant of the loss of rank (s)", value, about(meeting, 1e-4), seen, SURVIVES
    )
    _pointwise(found, misled, meeting)
    for route, subject, form, expected in (
        ("reduced", scene, sc.Reduced(), at_most(1e-6)),
        ("reduced, guess of the other branch after", misled, sc.Reduced(), at_most(1e-6)),
        ("original", scene, sc.Original(), at_most(0.05)),
    ):
        solution = quietly(subject, form, sc.BackwardEuler(), step=0.016)
        error = relative_error(subject, solution)
        found.add("parallelogram", route, "relative input error", value, expected, error, SURVIVES)
        found.facts["reduced_followed" if "guess" in route else route] = error
    found.curves["followed"] = (solution.t, scene.exact(solution.t)["torque"])


def _pointwise(found: Findings, misled: sc.Scene, meeting: float) -> None:
    """March the exact inversion instant by instant from the guess, which nothing checks."""
    steps = 250
    marched = march(sc.Stepper(misled, sc.Reduced(), sc.BackwardEuler(), misled.reference.duration / steps), steps)
    jets = misled.reference.jet(marched.t, 2)
    right, crossed = (each(jets)["torque"] for each in (parallelogram_torque, crossed_torque))
    after = marched.t > meeting
    peak = np.abs(right).max()
    for parameter, exact, expected in (
        ("relative input error", right, at_least(0.1)),
        ("distance from the crossed assembly's torque after", np.where(after, crossed, right), at_most(1e-8)),
    ):
        error = float(np.abs(marched["torque"] - exact).max() / peak)
        found.add("parallelogram", "pointwise, guess of the other branch after", parameter, "through stretched",
                  expected, error, FAILS)  # fmt: skip
        found.facts.setdefault("misled", error)
    found.curves["pointwise"] = (marched.t, marched["torque"], np.where(after, crossed, np.nan), right)


@cache
def _misled() -> sc.MechanicalSystem:
    """Return the parallelogram with a first guess that takes the crossed assembly after the stretched position."""
    system = parallelogram()
    y = system.gamma[0, 0]
    joint = CRANK * ca.vertcat(ca.cos(y), ca.sin(y), 0)
    crossed = [
        ca.if_else(y > ca.pi, each, other)
        for each, other in zip(antiparallelogram_angles(y), (ca.SX(0), y), strict=True)
    ]
    columns = [
        ca.vertcat(0, 0, 0, ca.vec(turned(UP, y))),
        ca.vertcat(joint, ca.vec(turned(UP, crossed[0]))),
        ca.vertcat(BASE, 0, 0, ca.vec(turned(UP, crossed[1]))),
        y,
    ]
    return replace(system, guess=ca.densify(ca.vertcat(*columns)))


def draw(found: Findings) -> Figure:
    """Above: rank and torque of the Bricard linkage. Below: the parallelogram, before and through stretched."""
    figure, ((rank, loop), (left, right)) = panels(2, 2, width=7.4, height=2.4)
    apart, smallest, first = found.curves["rank"]
    rank.loglog(apart, smallest, color="black", marker="o", label="smallest of 61")
    rank.axhline(first, color="black", ls="--", label="second smallest, closed")
    label(rank, "distance from a closed loop", "singular value of $G$", "Bricard: rank drops where the loop closes",
          "lower right")  # fmt: skip
    t, values, exact = found.curves["bricard"]
    loop.plot(t, exact, color="0.75", lw=4, label="closed form")
    loop.plot(t, values, color=GOOD, ls="--", label="solve, one row omitted")
    label(loop, "time (s)", "torque (N m)", "Bricard: driven at one joint", "lower left")
    distance, errors, conditions = found.curves["short"]
    left.loglog(distance, conditions, color="black", marker="o", label="condition number (left)")
    error = left.twinx()
    error.loglog(distance, np.maximum(errors, 1e-17), color=GOOD, marker="s", ls="--")
    left.plot([], [], color=GOOD, marker="s", ls="--", label="input error, reduced (right)")
    error.set(ylim=(1e-16, 1e-10), ylabel="input error / peak")
    error.spines["right"].set_visible(True)
    error.grid(visible=False)
    left.set(xlim=(distance.max() * 1.3, distance.min() / 1.3), ylim=(1e1, 1e7))
    left.xaxis.set_minor_formatter(NullFormatter())
    label(left, "distance from the stretched position (rad)", "condition of the system Jacobian",
          "Parallelogram: ends short of being stretched", "upper left")  # fmt: skip
    t, values, crossed, exact = found.curves["pointwise"]
    right.plot(t, exact, color="0.75", lw=4, label="exact, parallelogram")
    right.plot(*found.curves["followed"], color=GOOD, ls="--", label="solve")
    right.plot(t, values, color=BAD, label="pointwise, wrong guess")
    right.plot(t, crossed, color=OTHER, ls="", marker="^", markevery=8, label="exact, crossed")
    label(right, "time (s)", "torque (N m)", "Parallelogram: through the stretched position", "lower left",
          fontsize=6)  # fmt: skip
    return figure


ROW = Row(
    name=NAME,
    title="Redundant constraints and rank drops",
    avoid="constraint rows in a raw formulation; motions through positions where two assemblies meet",
    do="`solve` and `analyse`, which count by rank and omit redundant rows; `solve` through a loss of rank, since it"
    " follows one branch",
    theory="Redundant rows leave multipliers undetermined: the system Jacobian is singular. In a Bricard linkage (six"
    " hinges, one degree of freedom) rows are dependent only where the loop is closed, so the rank at a guess is"
    " wrong. Where rank drops on the way (a stretched parallelogram) two motions continue from one position, and a"
    " pointwise solution takes that of its first guess.",
    survivor="The rank is taken at configurations that satisfy the constraints. `solve` omits redundant rows: error"
    " {doubled:.0e} of the peak on the crane, {four:.0e} on a parallelogram of four hinges in space, {bricard:.0e}"
    " on the Bricard linkage (61 rows, rank 60; violation {bricard_violation:.0e}). Through the stretched position"
    " `solve` continues smoothly whatever the guess: {reduced_followed:.0e}.",
    limit="A formulation refuses such a system and names the rows; too many inputs are refused by the true count."
    " Multipliers of omitted rows are zero. Within {nearest:g} rad of the stretched position the error is"
    " {short:.0e}; through it `solve` warns. Steps by hand from a wrong guess change over, {misled:.0%} of the peak"
    " off. A loss of rank between two of 201 instants is missed. From a right guess the reduced form errs by"
    " {reduced:.0e}, the original form by {original:.1%}.",
    caption="Top: the smallest singular value of the Bricard linkage's constraints, and its torque. Bottom: towards and"
    " through the stretched position of the parallelogram.",
    measure=measure,
    draw=draw,
)
