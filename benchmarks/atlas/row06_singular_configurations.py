"""Row 6: configurations near which a model, or the problem itself, loses its meaning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, NO_PREDICTION, REFUSED, SURVIVES, Findings, Row, about, at_most
from benchmarks.atlas.runs import Array, quietly
from benchmarks.atlas.style import BAD, GOOD, label, panels

NAME = "singular-configurations"
MODELS = ("points", "generalized", "bodies")
ROUTES = tuple((model, form) for form in (sc.Reduced(), sc.Projected()) for model in MODELS)
RIGHT, FAILED, OUT, WRONG = "right", "failed", "refused", "wrong"
STEPS = {"reduced": 200, "projected": 1000}
MOTION = ("phi", "s", "l")
"""Exact in every form at every step: a wrong branch shows here, an error of the method does not."""
TOLERANCE = 1e-4
KNOWN_GAP = (
    "`bodies` without an error: near slack the reduced form's bridge angle is off by whole or half turns (inputs are"
    " right); near the axis a projected run may turn the bridge the wrong way round (inputs are wrong)"
)
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
    Approach("slack rope", "smallest g + z''", "m/s2", (3.0, 1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-6, -1e-3), near_slack,
             1e-6),
    Approach("slewing axis", "distance of trolley", "m", (1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1.1e-3, 9e-4), near_axis,
             1.1e-3),
    Approach("girder height", "depth of load", "m", (1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6, -1e-6), near_girder, 1e-6),
    Approach("rope horizontal", "90° less swing", "deg", (60.0, 30.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2), near_horizontal,
             0.2),
)  # fmt: skip


def outcome(scene: sc.Scene, model: str, form: sc.Formulation) -> tuple[str, float]:
    """Return what became of a run, and its largest error in relation to each quantity's peak."""
    step = scene.reference.duration / STEPS[form.name]
    try:
        solution = quietly(scene, form, sc.BackwardEuler(), step=step, model=model)
    except sc.InvalidReference:
        return OUT, np.inf
    except (sc.IntegrationFailed, sc.InconsistentStart):
        return FAILED, np.inf
    exact = scene.exact(solution.t)
    judged = (*MOTION, *(each.name for each in scene.model().inputs)) if form == sc.Reduced() else MOTION
    error = max(float(np.abs(solution[name] - exact[name]).max() / np.abs(exact[name]).max()) for name in judged)
    return (RIGHT if error < TOLERANCE else WRONG), error


def measure(quick: bool) -> Findings:
    """Approach every singular configuration with all models, on the reduced and the projected form."""
    found = Findings(NAME)
    silent = dict.fromkeys(MODELS, 0)
    for approach in APPROACHES:
        distances = approach.distances[::3] + approach.distances[-1:] if quick else approach.distances
        routes = ROUTES[:2] if quick else ROUTES
        table = {
            (model, form.name): [outcome(approach.scene(d), model, form) for d in distances] for model, form in routes
        }
        found.curves[approach.name] = (approach, distances, table)
        for (model, form), results in table.items():
            silent[model] += sum(each == WRONG for each, _ in results)
            _judge(found, approach, f"{form}, {model}", np.array(distances), results)
    for model, count in silent.items():
        found.add("rotary_crane", f"both forms, {model}", "wrong answers without an error", "all distances",
                  about(0.0, 0.1), count, FAILS if count else SURVIVES)  # fmt: skip
        if model == "bodies" and count:
            found.gaps[found.records[-1]] = KNOWN_GAP
        found.facts[f"silent_{model}"] = count
    return found


def _judge(found: Findings, approach: Approach, route: str, distances: Array, results: list[tuple[str, float]]) -> None:
    outcomes = [each for each, _ in results]
    until = next((k for k, each in enumerate(outcomes) if each != RIGHT), len(outcomes))
    nearest = float(distances[until - 1]) if until else np.inf
    default = route == "reduced, points"
    gives_up = until < len(outcomes) and outcomes[until] in (FAILED, WRONG)
    found.add("rotary_crane", route, f"{approach.name}: nearest {approach.quantity} solved", f"[{approach.unit}]",
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
    """One panel an approach: routes over distance, with what became of each run."""
    figure, axes = panels(2, 2, width=6.8, height=1.85)
    marks = {RIGHT: ("o", GOOD), FAILED: ("x", BAD), OUT: ("s", "white"), WRONG: ("*", "black")}
    for ax, approach in zip(axes.flat, APPROACHES, strict=True):
        _, distances, table = found.curves[approach.name]
        for row, results in enumerate(table.values()):
            for k, (each, _) in enumerate(results):
                mark, colour = marks[each]
                edge = "black" if each == OUT else colour
                ax.plot(k, row, marker=mark, color=colour, markeredgecolor=edge, ls="", ms=5)
        ax.set_yticks(range(len(table)), [f"{form}, {model}" for model, form in table])
        ax.set_xticks(range(len(distances)), [f"{d:g}" if d > 0 else "beyond" for d in distances], rotation=35)
        ax.set(ylim=(len(table) - 0.5, -0.5))
        label(ax, f"{approach.quantity} [{approach.unit.replace('m/s2', 'm/s²').replace('deg', '°')}]", "",
              approach.name, None)  # fmt: skip
    for text, (mark, colour) in marks.items():
        axes[0, 0].plot([], [], mark, color=colour, markeredgecolor="black" if text == OUT else colour, label=text)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


ROW = Row(
    name=NAME,
    title="Singular configurations",
    avoid="ropes near slack, trolleys near the slewing axis; generalised coordinates where the rope swings far",
    do="the default model `points` with `Reduced()`; limits of a scene, which refuse what has no answer",
    theory="With z'' → −g the rope force and with it every direction vanish; on the slewing axis the bridge angle is"
    " undefined; with the load at girder height the rope lies flat. Beyond, there is no solution. At a swing of 90°"
    " only the generalised coordinates are singular: their angles lose meaning, the points do not.",
    survivor="`points` with the reduced form is right to the last distance tried. What lies beyond a limit is refused"
    " with quantity and time. Wrong answers without an error from `points` and `generalized`:"
    " {silent_points:d} and {silent_generalized:d}.",
    limit="Nearest distances solved: slack rope {slack_rope_reduced_points:g} m/s² (error {slack_rope_error:.0e}), axis"
    " {slewing_axis_reduced_points:g} m, girder {girder_height_reduced_points:g} m (error {girder_height_error:.0e},"
    " growing like the inverse of the depth), swing {rope_horizontal_reduced_points:g}° short of 90°. In generalised"
    " coordinates the reduced form stops {rope_horizontal_reduced_generalized:g}° short of it and at"
    " {slack_rope_reduced_generalized:g} m/s² from slack, because its first guess hangs vertically. `bodies`"
    " gives {silent_bodies:d} wrong answers without an error: near slack its bridge angle is off by whole or"
    " half turns (the"
    " inputs are right), and near the axis the bridge may turn the wrong way round within one projected step.",
    caption="What became of runs at ever smaller distances. Projected runs (1000 steps) are judged by φ, s and l, which"
    " are exact on the right branch.",
    measure=measure,
    draw=draw,
)
