"""Row 10: constraints that say the same twice, and constraints whose rank drops on the way."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, REFUSED, SURVIVES, Findings, Row, at_least, at_most
from benchmarks.atlas.runs import quietly, relative_error
from benchmarks.atlas.style import label, looks, panels
from servocore.redundancy import redundant_constraints, without_constraints
from servocore.rotationless import GROUND, Assembly, RigidBody, angle, on_line, revolute, turned
from servocore.stepper import compile_program

NAME = "redundant-constraints"
CRANK, BASE = 0.5, 1.1
"""Lengths of crank and rocker, and of coupler and base, in m: a parallelogram."""
DENSITY, GRAVITY = 5.0, 9.81
ALONG, UP, HERE = (1, 0, 0), (0, 0, 1), (0, 0, 0)
SHORT_OF = (0.6, 0.2, 0.05, 0.01)
"""How far from the stretched position, crank and coupler in line, a motion ends, in rad."""


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


@cache
def parallelogram(closed_by: str = "on_line") -> sc.MechanicalSystem:
    """Return a parallelogram of thin bars in space; the last hinge is a pin (`on_line`) or a full `revolute`."""
    none = sc.Parameters()
    bars = [_bar("crank", CRANK), _bar("coupler", BASE), _bar("rocker", CRANK)]
    linkage = Assembly((*bars, sc.Quantity("theta", "rad")), none, (0, -GRAVITY, 0))
    crank, coupler, rocker = (linkage.body(name) for name in ("crank", "coupler", "rocker"))
    pivot = GROUND.at(HERE, axis=UP, normal=ALONG), crank.at(HERE, axis=UP, normal=ALONG)
    last = rocker.at((CRANK, 0, 0)), coupler.at((BASE, 0, 0))
    theta = linkage.augmented("theta")

    def near(y: ca.SX) -> dict[str, object]:
        joint = CRANK * ca.vertcat(ca.cos(y), ca.sin(y), 0)
        base = ca.vertcat(BASE, 0, 0)
        directors = turned(UP, y)
        return {"crank": (HERE, directors), "coupler": (joint, ca.DM.eye(3)), "rocker": (base, directors), "theta": y}

    return linkage.system(
        "parallelogram",
        constraints={
            "A": revolute(*pivot),
            "B": revolute(crank.at((CRANK, 0, 0)), coupler.at(HERE)),
            "D": revolute(GROUND.at((BASE, 0, 0)), rocker.at(HERE)),
            "C": revolute(*last) if closed_by == "revolute" else on_line(*last),
            "theta": angle(*pivot, theta),
        },
        inputs={sc.Quantity("torque", "N.m"): theta},
        outputs={sc.Quantity("y", "rad"): theta},
        guess=near,
        home=(1.0,),
    )


def _bar(name: str, length: float) -> RigidBody:
    mass, across = DENSITY * length, DENSITY * length**3 / 12
    return RigidBody(name, mass, (0.02 * across, across, across), (length / 2, 0, 0))


def torque(reference: np.ndarray) -> dict[str, np.ndarray]:
    """Return the exact torque: cranks turn, the coupler is carried around without turning."""
    y = reference[:, :, 0].T
    crank, coupler = DENSITY * CRANK, DENSITY * BASE
    inertia = 2 * crank * CRANK**2 / 3 + coupler * CRANK**2
    return {"torque": inertia * y[2] + (crank + coupler) * GRAVITY * CRANK * np.cos(y[0])}


def turning(end: float) -> sc.Scene:
    """Return the parallelogram whose crank turns from 0.3 rad to `end`."""
    return sc.Scene(
        name="parallelogram",
        models={"bodies": parallelogram},
        reference=sc.rest_to_rest((0.3,), (end,), 4.0),
        closed_form=lambda reference, _: torque(reference),
        closed_form_order=2,
    )


def measure(quick: bool) -> Findings:
    """Look at a doubled constraint, a linkage with too many hinges, and one that passes its stretched position."""
    found = Findings(NAME)
    _doubled(found)
    _too_many_hinges(found)
    _towards_stretched(found, quick)
    _through_stretched(found)
    return found


def _doubled(found: Findings) -> None:
    crane, raw = sc.scenes.rotary_crane(), doubled_crane()
    scene = replace(crane, models={"doubled": doubled_crane})
    p = raw.parameters.values()
    for form in (sc.Original(), sc.Projected(), sc.Reduced()):
        try:
            compile_program(raw, form, sc.BackwardEuler())
            seen = "compiled"
        except sc.InvalidModel as error:
            seen, found.facts["raw"] = type(error).__name__, str(error)
        found.add("rotary_crane, g_5 redundant", f"{form.name}, as it stands", "compiling a step",
                  "5 constraints, rank 4", "InvalidModel", seen, REFUSED)  # fmt: skip
    report = sc.analyse(scene)
    found.add("rotary_crane, g_5 redundant", "analyse", "remedy", "5 constraints, rank 4",
              "redundant constraints left out: g_5", report.remedy, SURVIVES)  # fmt: skip
    by_hand = replace(crane, models={"less": lambda: kept})
    kept = without_constraints(raw, redundant_constraints(raw, p))
    for route, subject in (("solve", scene), ("without_constraints, then solve", by_hand)):
        error = relative_error(crane, quietly(subject))
        found.add("rotary_crane, g_5 redundant", route, "relative input error", "5 constraints, rank 4", at_most(1e-12),
                  error, SURVIVES)  # fmt: skip
        found.facts["doubled"] = error


def _too_many_hinges(found: Findings) -> None:
    try:
        parallelogram("revolute")
        seen = "nothing"
    except sc.InvalidModel as error:
        seen, found.facts["hinges"] = type(error).__name__, str(error)
    found.add("parallelogram", "four revolutes in space", "building the system", "3 rows too many", "InvalidModel",
              seen, REFUSED)  # fmt: skip


def _towards_stretched(found: Findings, quick: bool) -> None:
    distances = SHORT_OF[::2] if quick else SHORT_OF
    errors, conditions = [], []
    for distance in distances:
        scene = turning(float(np.pi) - distance)
        errors.append(relative_error(scene, quietly(scene, sc.Reduced(), sc.BackwardEuler(), step=0.02)))
        conditions.append(sc.analyse(scene).condition)
        found.add("parallelogram", "reduced, loop closed by on_line", "relative input error",
                  f"{distance:g} rad short of stretched", at_most(1e-9), errors[-1], SURVIVES)  # fmt: skip
    found.curves["short"] = (np.array(distances), np.array(errors), np.array(conditions))
    found.facts.update(short=max(errors), nearest=distances[-1], condition=conditions[-1])


def _through_stretched(found: Findings) -> None:
    """Turn the crank through the position in which parallelogram and antiparallelogram meet."""
    scene = turning(float(np.pi) + 0.6)
    condition = sc.analyse(scene).condition
    found.add("parallelogram", "analyse", "condition of the system Jacobian along the path", "through stretched",
              at_least(1e4), condition, SURVIVES)  # fmt: skip
    exact = None
    for form, method, expected in (
        (sc.Reduced(), sc.BackwardEuler(), at_most(1e-6)),
        (sc.Original(), sc.BackwardEuler(), at_most(0.05)),
    ):
        solution = quietly(scene, form, method, step=0.016)
        error = relative_error(scene, solution)
        found.add("parallelogram", form.name, "relative input error", "through stretched", expected, error,
                  SURVIVES if error < 0.05 else FAILS)  # fmt: skip
        found.curves["through", form.name] = (solution.t, solution["torque"])
        found.facts[f"through_{form.name}"] = error
        exact = scene.exact(solution.t)["torque"] if exact is None else exact
    misled = replace(scene, models={"misled": _misled})
    solution = quietly(misled, sc.Reduced(), sc.BackwardEuler(), step=0.016)
    error = float(np.abs(solution["torque"] - exact).max() / np.abs(exact).max())
    found.add("parallelogram", "reduced, first guess on the other branch after", "relative input error",
              "through stretched", at_least(0.1), error, FAILS)  # fmt: skip
    found.curves["through", "reduced, guess of C always above"] = (solution.t, solution["torque"])
    found.curves["exact"] = (solution.t, exact)
    found.facts.update(condition=condition, misled=error)


@cache
def _misled() -> sc.MechanicalSystem:
    """Return the parallelogram with a first guess that always takes the upper intersection of two circles."""
    system = parallelogram()
    y = system.gamma[0, 0]
    joint = CRANK * ca.vertcat(ca.cos(y), ca.sin(y))
    gap = ca.vertcat(BASE, 0) - joint
    cosine = (ca.sumsqr(gap) + BASE**2 - CRANK**2) / (2 * BASE * ca.norm_2(gap))
    tilt = ca.atan2(gap[1], gap[0]) + ca.acos(ca.fmin(1.0, cosine))
    end = joint + BASE * ca.vertcat(ca.cos(tilt), ca.sin(tilt)) - ca.vertcat(BASE, 0)
    columns = [
        ca.vertcat(0, 0, 0, ca.vec(turned(UP, y))),
        ca.vertcat(joint, 0, ca.vec(turned(UP, tilt))),
        ca.vertcat(BASE, 0, 0, ca.vec(turned(UP, ca.atan2(end[1], end[0])))),
        y,
    ]
    return replace(system, guess=ca.densify(ca.vertcat(*columns)))


def draw(found: Findings) -> Figure:
    """Left: condition and error towards the stretched position. Right: torque through it."""
    figure, (left, right) = panels(2, height=2.7)
    distance, errors, conditions = found.curves["short"]
    left.loglog(distance, conditions, color="#b3260a", marker="o", label="condition of the Jacobian")
    left.loglog(distance, np.maximum(errors, 1e-17), color="#0b3c68", marker="s", label="input error / peak, reduced")
    left.set_xlim(distance.max() * 1.3, distance.min() / 1.3)
    left.set_ylim(1e-17, 1e12)
    label(
        left, "distance from the stretched position [rad]", "", "parallelogram, motion ends short of it", "upper left"
    )
    t, exact = found.curves["exact"]
    right.plot(t, exact, color="0.6", lw=3, label="exact")
    shown = [(k[1], v) for k, v in found.curves.items() if k[0] == "through"]
    for (name, (times, values)), look in zip(shown, looks(), strict=False):
        right.plot(times, values, label=name, markevery=0.1, **{**look, "markersize": 3})
    right.set_ylim(-60, 130)
    label(right, "time [s]", "torque [N m]", "parallelogram, through it", "upper left", fontsize=6)
    return figure


ROW = Row(
    name=NAME,
    title="Redundant constraints and rank drops",
    avoid="more joint rows than the mechanism needs; motions through positions where two assemblies meet",
    do="`analyse`, which names redundant rows; `on_line` for the hinge that closes a planar loop",
    theory="Redundant rows leave multipliers undetermined: the system Jacobian is singular for good. Where rank"
    " drops on"
    " the way (a parallelogram stretched out) two motions go on from one position, and only the first guess decides"
    " which one a pointwise solution takes.",
    survivor="`analyse` names the redundant row, `solve` leaves it out: {doubled:.0e} of the peak. A loop"
    " closed by a pin"
    " instead of a fourth hinge has no redundant row: {short:.0e} up to {nearest:g} rad before the stretched position.",
    limit="As it stands, a system with redundant rows is refused: “{raw}”. Four hinges in space are refused by their"
    " count: “{hinges}”. Through the stretched position `analyse` sees a condition of {condition:.0e} and does not"
    " refuse; with a first guess that prefers the other assembly the reduced form changes over without an error"
    " ({misled:.0%} of the peak), with a good one its error is {through_reduced:.0e}, that of the original form"
    " {through_original:.1%}.",
    caption="Left: towards the stretched position. Right: torque through it; a guess on the wrong branch is followed.",
    measure=measure,
    draw=draw,
)
