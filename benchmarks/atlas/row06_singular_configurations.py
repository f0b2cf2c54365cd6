"""Row 6: configurations near which a model, or the problem itself, loses its meaning."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, NO_PREDICTION, REFUSED, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, quietly
from benchmarks.atlas.style import BAD, FOURTH, GOOD, label, panels

NAME = "singular-configurations"
MODELS = ("points", "generalized", "bodies")
ROUTES = tuple((model, form) for form in (sc.Reduced(), sc.Projected()) for model in MODELS)
QUICK_ROUTES = (*ROUTES[:2], ROUTES[-1])
RIGHT, WARNED, FAILED, OUT, WRONG = "right", "warning", "failed", "refused", "wrong without warning"
STEPS = {"reduced": 200, "projected": 1000}
JUDGED = 4000  # instants of the exact answer, more than steps: its angle is made continuous there
MOTION = ("phi", "s", "l")
"""Exact in every form at every step: a wrong branch shows here, an error of the method does not."""
TOLERANCE = 1e-4
INPUT_TOLERANCE = {"reduced": TOLERANCE, "projected": 1.0}
"""Of an input's peak. The inputs of a projected run err by the step; off by more than their peak they are wrong."""
WINCH_MARGIN = 1.0
"""Smallest g + z'' in m/s2 of the run in which the torque of direction cosines is looked at."""
GRAVITY = 9.81


@dataclass(frozen=True, eq=False)
class Approach:
    """A way towards a singular configuration: what is small, where it starts, and the scene at a distance."""

    name: str
    quantity: str
    unit: str
    distances: tuple[float, ...]
    scene: Callable[[float], sc.Scene]
    nearest: float
    """Down to this distance the default model's reduced form must be right."""


def _peak_acceleration() -> float:
    T = np.linspace(0.0, 1.0, 20_001)
    return float(np.abs(sc.DEGREE9.jet(T, 1.0 - T, 1.0, 2)[:, 2]).max())


def near_slack(margin: float) -> sc.Scene:
    """Lower the load by 3 m so fast that g + z'' comes down to `margin`."""
    duration = float(np.sqrt(3.0 * _peak_acceleration() / (GRAVITY - margin)))
    return _crane((5, 0, -2), (5, 1, -5), duration)


def near_axis(distance: float) -> sc.Scene:
    """Pass the slewing axis on a straight line."""
    return _crane((5, distance, -5), (-5, distance, -5), 20.0)


def near_girder(depth: float) -> sc.Scene:
    """Lift the load to `depth` below the girder."""
    return _crane((5, 0, -5), (4, 1, -depth), 20.0)


def near_horizontal(angle: float) -> sc.Scene:
    """Swing the rope to `angle` degrees short of the horizontal, across the bridge, in weak gravity."""
    duration = 6.0
    acceleration = 4.0 * _peak_acceleration() / duration**2
    scene = _crane((6, -2, -5), (6, 2, -5), duration)
    return scene.with_parameters(gravity=acceleration * float(np.tan(np.radians(angle))))


def _crane(start: tuple[float, ...], end: tuple[float, ...], duration: float) -> sc.Scene:
    return sc.scenes.rotary_crane().with_reference(sc.rest_to_rest(start, end, duration))


APPROACHES = (
    Approach("slack rope", "smallest g + z''", "m/s2", (3.0, 1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, -1e-3),
             near_slack, 1e-6),
    Approach("slewing axis", "distance of trolley", "m", (1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1.1e-3, 9e-4), near_axis,
             1.1e-3),
    Approach("girder height", "depth of load", "m", (1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6, -1e-6), near_girder, 1e-6),
    Approach("rope horizontal", "90° less swing", "deg", (60.0, 30.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2), near_horizontal,
             0.2),
)  # fmt: skip


def outcome(scene: sc.Scene, model: str, form: sc.Formulation) -> tuple[str, float]:
    """Return what became of a run, and the largest error of what must be exact in relation to each quantity's peak."""
    step = scene.reference.duration / STEPS[form.name]
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            solution = sc.solve(scene, form, sc.BackwardEuler(), step=step, model=model)
        except sc.InvalidReference:
            return OUT, np.inf
        except (sc.IntegrationFailed, sc.InconsistentStart):
            return FAILED, np.inf
    motion, inputs = (_error(scene, solution, names) for names in (MOTION, _inputs(scene)))
    said = [str(each.message) for each in heard if issubclass(each.category, sc.ServocoreWarning)]
    right = motion < TOLERANCE and inputs < INPUT_TOLERANCE[form.name]
    # A run may be right although its configuration is warned of; inputs off by half their peak are not.
    if right and not (solution.error.largest or 0.0) > 0.5:
        return RIGHT, max(motion, inputs) if form == sc.Reduced() else motion
    return (WARNED if said else WRONG), motion


def _inputs(scene: sc.Scene) -> tuple[str, ...]:
    return tuple(each.name for each in scene.model().inputs)


def _error(scene: sc.Scene, solution: sc.Solution, names: tuple[str, ...]) -> float:
    steps = len(solution.t) - 1
    parts = max(1, JUDGED // steps)
    exact = scene.exact(np.interp(np.arange(steps * parts + 1) / parts, np.arange(steps + 1), solution.t))
    return max(float(np.abs(solution[name] - exact[name][::parts]).max() / np.abs(exact[name]).max()) for name in names)


def torque_of_cosines(turns: Array, inertia: float, step: float) -> Array:
    """Torque that backward Euler finds in direction cosines beyond that in the angle, for turns a step one by one.

    A director d turns by Delta_1 after Delta_0. Its second difference, projected on the direction in which it moves,
    is 2 sin Delta_1 - sin(Delta_1 + Delta_0) instead of Delta_1 - Delta_0: at constant speed about Delta^3 too much.
    """
    now, before = turns[1:], turns[:-1]
    found: Array = inertia / step**2 * (2 * np.sin(now) - np.sin(now + before) - (now - before))
    return found


def _look_at_the_winch(found: Findings) -> None:
    """Compare the winch torque of `bodies` with what its direction cosines add to that of `points`."""
    scene = near_slack(WINCH_MARGIN)
    step, p = scene.reference.duration / STEPS["projected"], scene.parameter_values()
    cosines, angle = (
        quietly(scene, sc.Projected(), sc.BackwardEuler(), step=step, model=model) for model in ("bodies", "points")
    )
    turns = np.diff(scene.exact(angle.t)["l"]) / p["winch_radius"]
    peak = float(np.abs(scene.exact(angle.t)["M_w"]).max())
    predicted = float(np.abs(torque_of_cosines(turns, p["winch_inertia"], step)).max()) / peak
    seen = float(np.abs(cosines["M_w"] - angle["M_w"]).max()) / peak
    found.add("rotary_crane", "projected, bodies", "M_w beyond that of `points`, of its peak", f"{WINCH_MARGIN:g} m/s2",
              about(predicted, 0.02 * predicted), seen, FAILS)  # fmt: skip
    found.facts.update({"winch_turn": float(np.abs(turns).max()), "winch_predicted": predicted, "winch_seen": seen})
    found.facts["winch_half"] = found.facts["winch_turn"] * 0.5 / seen


def measure(quick: bool) -> Findings:
    """Approach every singular configuration with all models, on the reduced and the projected form."""
    found = Findings(NAME)
    silent, warned = dict.fromkeys(MODELS, 0), dict.fromkeys(MODELS, 0)
    for approach in APPROACHES:
        distances = approach.distances[:4:3] + approach.distances[-2:] if quick else approach.distances
        routes = QUICK_ROUTES if quick else ROUTES
        table = {
            (model, form.name): [outcome(approach.scene(d), model, form) for d in distances] for model, form in routes
        }
        found.curves[approach.name] = (approach, distances, table)
        for (model, form), results in table.items():
            silent[model] += sum(each == WRONG for each, _ in results)
            warned[model] += sum(each == WARNED for each, _ in results)
            _judge(found, approach, f"{form}, {model}", np.array(distances), results)
    for model, count in silent.items():
        found.add("rotary_crane", f"both forms, {model}", "wrong answers without an error or a warning",
                  "all distances", about(0.0, 0.1), count, FAILS if count else SURVIVES)  # fmt: skip
        found.facts[f"silent_{model}"] = count
    found.add("rotary_crane", "projected, bodies", "runs with a warning of wrong inputs", "all distances",
              at_least(1.0), warned["bodies"], REFUSED)  # fmt: skip
    found.facts["warned"] = sum(warned.values())
    _look_at_the_winch(found)
    return found


def _judge(found: Findings, approach: Approach, route: str, distances: Array, results: list[tuple[str, float]]) -> None:
    outcomes = [each for each, _ in results]
    until = next((k for k, each in enumerate(outcomes) if each != RIGHT), len(outcomes))
    nearest = float(distances[until - 1]) if until else np.inf
    default = route == "reduced, points"
    gives_up = until < len(outcomes) and outcomes[until] != OUT
    found.add("rotary_crane", route, f"{approach.name}: nearest {approach.quantity} solved", f"({approach.unit})",
              at_most(approach.nearest * 1.01) if default else NO_PREDICTION, nearest,
              FAILS if gives_up else SURVIVES)  # fmt: skip
    key = approach.name.replace(" ", "_")
    found.facts[f"{key}_{route.replace(', ', '_')}"] = nearest
    if default:
        errors = [error for each, error in results if each == RIGHT]
        found.add("rotary_crane", route, f"{approach.name}: largest error there", f"{nearest:g} {approach.unit}",
                  at_most(1e-6), max(errors), SURVIVES)  # fmt: skip
        found.facts[f"{key}_error"] = max(errors)
        if approach.name != "rope horizontal":
            seen = "InvalidReference" if outcomes[-1] == OUT else outcomes[-1]
            found.add("rotary_crane", route, f"{approach.name}: beyond", f"{distances[-1]:g} {approach.unit}",
                      "InvalidReference", seen, REFUSED)  # fmt: skip


def draw(found: Findings) -> Figure:
    """Draw the result of each run, one panel for each approach: routes over distances, evenly spaced."""
    figure, axes = panels(2, 2, width=6.8, height=1.85)
    marks = {RIGHT: ("o", GOOD), WARNED: ("^", FOURTH), FAILED: ("x", BAD), OUT: ("s", "white"), WRONG: ("*", "black")}
    for ax, approach in zip(axes.flat, APPROACHES, strict=True):
        _, distances, table = found.curves[approach.name]
        limited = distances[-1] <= approach.nearest and approach.name != "rope horizontal"
        places = np.arange(len(distances))  # evenly spaced: the labels give the distances
        for row, results in enumerate(table.values()):
            for k, (each, _) in enumerate(results):
                mark, colour = marks[each]
                edge = "black" if each == OUT else colour
                ax.plot(places[k], row, marker=mark, color=colour, markeredgecolor=edge, ls="", ms=5)
        ax.set_yticks(range(len(table)), [f"{form}, {model}" for model, form in table])
        texts = [f"{d:g}" for d in distances]
        ax.set_xticks(places, [*texts[:-1], "beyond"] if limited else texts, rotation=35)
        ax.set(ylim=(len(table) - 0.5, -0.5), xlim=(-0.4, len(distances) - 0.6))
        label(ax, f"{approach.quantity} ({approach.unit.replace('m/s2', 'm/s²').replace('deg', '°')})", "",
              approach.name, None)  # fmt: skip
    for text, (mark, colour) in marks.items():
        axes[0, 0].plot([], [], mark, color=colour, markeredgecolor="black" if text == OUT else colour, label=text)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return figure


ROW = Row(
    name=NAME,
    title="Singular configurations",
    avoid="projected forms near slack ropes and near the slewing axis; `bodies` where the winch turns fast",
    do="the default model `points` with `Reduced()`; heed the warning of inputs that are off by half their peak",
    theory="With z'' → −g the rope force vanishes, and with it its direction; on the slewing axis the bridge angle is"
    " undefined; with the load at girder height the rope is horizontal. Beyond there is no solution. At a swing of"
    " 90° only the generalized coordinates are singular. Where a director turns by Δ₁ after Δ₀, backward Euler finds"
    " 2 sin Δ₁ − sin(Δ₁ + Δ₀) in place of Δ₁ − Δ₀: a torque of about J Δ³/h² too much.",
    survivor="The reduced form with `points` is right at the smallest distances: slack rope"
    " {slack_rope_reduced_points:g} m/s² (error {slack_rope_error:.0e}), axis {slewing_axis_reduced_points:g} m,"
    " girder {girder_height_reduced_points:g} m (error {girder_height_error:.0e}),"
    " {rope_horizontal_reduced_points:g}° short of 90°. Beyond a limit it refuses with quantity and time. Wrong"
    " answers without error or warning (`points`, `generalized`, `bodies`): {silent_points:d},"
    " {silent_generalized:d}, {silent_bodies:d}.",
    limit="{warned:d} projected runs end with the warning that an input is off by more than half of its peak. In"
    " `bodies` a winch that turns by {winch_turn:.2g} rad a step makes M_w wrong by {winch_seen:.1f} of its peak"
    " ({winch_predicted:.1f} predicted); half a peak is reached at {winch_half:.1g} rad.",
    caption="Result of runs at ever smaller distances, by route. Projected runs (1000 steps) are judged by φ, s and"
    " l, and count as wrong if an input is off by more than its peak.",
    measure=measure,
    draw=draw,
)
