"""Row 8: internal dynamics that grow, integrated forward and solved as a boundary value problem."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, SURVIVES, Findings, Row, about, at_most
from benchmarks.atlas.runs import Array, march, quietly
from benchmarks.atlas.style import GOOD, label, legend_below, panels
from benchmarks.route_styles import line_style

NAME = "unstable-internal-dynamics"
TOLERABLE_RATE = 0.1
TRACKING = 1e-4


@dataclass(frozen=True, eq=False)
class Case:
    """A scene of non-minimum phase: its internal coordinate, a step, and the times of a clean exponential."""

    key: str
    title: str
    scene: sc.Scene
    coordinate: str
    step: float
    window: tuple[float, float]


def cases() -> tuple[Case, ...]:
    """Return the arm tracked at its tip, turning a little, and the mass that its support pushes away."""
    arm = sc.scenes.passive_joint_arm(tip=True)
    small = arm.with_reference(sc.rest_to_rest((0.0,), (1e-4,), 2.0))
    car = sc.scenes.mass_on_car().with_parameters(stiffness=-5.0)
    return (
        Case("arm", "arm, tip, 0.1 mrad", small, "b", 2e-3, (0.3, 0.45)),
        Case("car", "mass on car, k < 0", car, "s", 0.01, (1.5, 4.0)),
    )


def measure(quick: bool) -> Findings:
    """Let forward integrations blow up and fit the rate; then solve for the bounded answer and judge it."""
    found = Findings(NAME)
    for case in cases():
        _forward(found, case, quick)
    _refused_forward(found)
    arm = sc.scenes.passive_joint_arm(tip=True)
    _bounded(found, "arm", arm, "passive_joint_arm")
    car = sc.scenes.mass_on_car().with_parameters(stiffness=-5.0)
    _bounded(found, "car", car, "mass_on_car")
    _tip_arrives(found, arm)
    _open_loop(found, car)
    return found


def growth_rate(t: Array, size: Array, window: tuple[float, float]) -> float:
    """Fit the exponent of exp(rate t) within a window of times."""
    inside = (t >= window[0]) & (t <= window[1]) & (size > 0.0)
    return float(np.polyfit(t[inside], np.log(size[inside]), 1)[0])


def _forward(found: Findings, case: Case, quick: bool) -> None:
    eigenvalue = max(each.real for each in sc.analyse(case.scene).eigenvalues)
    found.facts[f"{case.key}_eigenvalue"] = eigenvalue
    routes = ((sc.Reduced(), sc.RadauIIA(3)), (sc.Projected(), sc.RadauIIA(3)), (sc.Reduced(), sc.BDF(2)))
    for form, method in routes[:1] if quick else routes:
        stepper = sc.Stepper(case.scene, form, method, case.step)
        run = march(stepper, round(case.window[1] / case.step))
        exact = case.scene.exact(run.t)
        size = np.abs(run[case.coordinate] - exact[case.coordinate])
        rate = growth_rate(run.t, size, case.window)
        route = f"{form.name}, {method.name}, forward"
        found.add(case.scene.name, route, "rate of growth (1/s)", case.title,
                  about(eigenvalue, TOLERABLE_RATE * eigenvalue), rate, FAILS)  # fmt: skip
        found.curves[case.key, route] = (run.t, size)
        found.facts[f"{case.key}_rate"] = rate
    found.curves[case.key, "eigenvalue"] = eigenvalue


def _refused_forward(found: Findings) -> None:
    """Integrate the whole manoeuvre of the arm forward: a warning first, then an error."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            sc.solve(sc.scenes.passive_joint_arm(tip=True), sc.Reduced(), sc.RadauIIA(3), step=0.01)
            seen = "nothing"
        except sc.IntegrationFailed as error:
            seen, found.facts["failure"] = type(error).__name__, str(error).split(";")[0]
    found.add("passive_joint_arm", "reduced, radau3, forward", "the whole manoeuvre, 90°", "2 s", "IntegrationFailed",
              seen, FAILS)  # fmt: skip
    warned = [str(each.message) for each in said if issubclass(each.category, sc.ServocoreWarning)]
    found.add("passive_joint_arm", "solve, in advance", "what is said of a forward method", "2 s", "ServocoreWarning",
              "ServocoreWarning" if warned else "nothing", FAILS)  # fmt: skip


def _bounded(found: Findings, key: str, scene: sc.Scene, name: str) -> None:
    solution = quietly(scene)
    exact = scene.exact(solution.t)
    error = max(float(np.abs(solution[u] - exact[u]).max() / np.abs(exact[u]).max()) for u in exact)
    found.add(name, "solve as it comes: reduced, boundary-value", "largest error / peak against exact",
              "all quantities", at_most(1e-9), error, SURVIVES)  # fmt: skip
    found.facts.update({f"{key}_error": error, f"{key}_pre": scene.reference.start_time - solution.t[0],
                    f"{key}_post": solution.t[-1] - scene.reference.end_time})  # fmt: skip
    found.curves[key, "input"] = (solution.t, solution[scene.model().inputs[0].name])


def _tip_arrives(found: Findings, arm: sc.Scene) -> None:
    """Give the computed torque to the arm and watch its tip."""
    solution = quietly(arm, step=0.005)
    moved = sc.simulate(arm, solution, rtol=1e-11, atol=1e-12)
    values = arm.parameter_values()
    # y is the linearized angle of the tip: times its distance from the pivot it is a way.
    length = float(values["first_length"] + values["tracked_distance"])
    way = length * float(np.ptp(arm.reference.jet(np.array([0.0, 2.0]), 0)[:, 0, 0]))
    error = float(moved["tracking_error"].max()) * length / way
    found.add("passive_joint_arm", "boundary-value, then simulate", "tracking error of the tip / length of the path",
              "90° in 2 s", at_most(TRACKING), error, SURVIVES)  # fmt: skip
    found.facts["tip"] = error


def _open_loop(found: Findings, car: sc.Scene) -> None:
    """Simulate a plant that is unstable itself: no feedforward keeps it, however exact."""
    system, p = car.model(), car.model().parameters.values(car.parameters)
    evaluate = ca.Function(
        "plant", [system.q, system.v, system.p],
        [system.mass, ca.jacobian(system.bias, system.q), ca.jacobian(system.bias, system.v)],
    )  # fmt: skip
    M, K, D = (np.asarray(each) for each in evaluate(np.zeros(2), np.zeros(2), p))
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    fastest = float(np.linalg.eigvals(A).real.max())
    solution = quietly(car, step=0.02)
    moved = sc.simulate(car, solution, rtol=1e-11, atol=1e-12)
    rate = growth_rate(moved.t, moved["tracking_error"], (0.0, float(moved.t[-1])))
    found.add("mass_on_car", "boundary-value, then simulate without feedback", "rate of growth (1/s)", "k < 0",
              about(fastest, 0.1 * fastest), rate, FAILS)  # fmt: skip
    found.facts.update({"plant": fastest, "plant_rate": rate, "plant_end": float(moved["tracking_error"][-1])})


def draw(found: Findings) -> Figure:
    """Errors of forward integrations with the predicted rate, and the bounded torque."""
    figure, axes = panels(3, height=2.8, width=7.4)
    for ax, case in zip(axes, cases(), strict=False):
        for key in found.curves:
            if key[0] == case.key and "forward" in key[1]:
                t, size = found.curves[key]
                # Three routes on one line: a wide one, a thinner one, and marks alone.
                line = line_style(key[1], **_LINES[key[1].removesuffix(", forward")])
                ax.semilogy(t[1:], size[1:], label=key[1], markevery=0.15, **line)
        rate = found.curves[case.key, "eigenvalue"]
        ax.semilogy(t, size[-1] * np.exp(rate * (t - t[-1])) * 0.3, "k:", lw=1, label="as predicted")
        ax.annotate(f"exp({rate:.3g} t)", (0.97, 0.06), xycoords="axes fraction", ha="right")
        unit = "rad" if case.key == "arm" else "m"
        label(ax, "time (s)", f"error of ${case.coordinate}$ ({unit})", case.title)
    t, torque = found.curves["arm", "input"]
    shown = (t > -0.6) & (t < 2.6)
    axes[2].plot(t[shown], torque[shown], color=GOOD, label="boundary-value")
    axes[2].axvspan(0.0, 2.0, color="0.9", zorder=0, label="the tip moves")
    label(axes[2], "time (s)", "torque (N m)", "arm, tip, 90°: bounded input")
    legend_below(figure, *axes)
    return figure


_LINES: dict[str, dict[str, Any]] = {
    "reduced, radau3": {"lw": 3.0, "alpha": 0.5, "ls": "-", "marker": ""},
    "projected, radau3": {},
    "reduced, bdf2": {"ls": "", "marker": "s", "markerfacecolor": "none", "ms": 6},
}


ROW = Row(
    name=NAME,
    title="Unstable internal dynamics",
    avoid="forward integration where `analyse` reports non-minimum phase, with any method and any step",
    do="`solve(scene)` with its default route, or `StableInversion()`; allow the input to begin before the path",
    theory="If the zero dynamics have an eigenvalue σ > 0, every error of a forward integration grows like exp(σ t),"
    " whatever the method. The bounded solution is that of a two-point boundary value problem (stable inversion).",
    survivor="`StableInversion`, the default there, agrees with the independent solution to {arm_error:.0e} (arm) and"
    " {car_error:.0e} (mass on car). The simulated tip follows its path to {tip:.0e} of the path's length. The input"
    " begins {arm_pre:.2f} s before the motion and ends {arm_post:.2f} s after it.",
    limit="Forward, the arm's joint angle grows at {arm_rate:.2f}/s (eigenvalue {arm_eigenvalue:.2f}/s), that of the"
    " mass on the car at {car_rate:.3f}/s ({car_eigenvalue:.3f}/s). A plant that is open-loop unstable needs"
    " feedback besides: the mass on the car with a negative spring leaves the exact path at {plant_rate:.2f}/s"
    " (eigenvalue {plant:.2f}/s).",
    caption="Left and middle: error of the internal coordinate, integrated forward from rest. Right: the bounded"
    " torque.",
    measure=measure,
    draw=draw,
)
