"""Row 5: references that are not smooth enough for inputs that need four derivatives of them."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, REFUSED, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, error_at, quietly, slope
from benchmarks.atlas.style import BAD, label, legend_below, panels, steps_in_ms

NAME = "rough-references"
PROFILES = (sc.DEGREE3, sc.DEGREE5, sc.DEGREE7, sc.DEGREE9, sc.DEGREE13)
NEEDED = 4
"""The crane's inputs contain the fourth derivative of the load's path."""
LEAD = 1.0
"""Time in s that the load hangs at rest before the path begins, in forward simulations."""
TRACKING = {3: (0.01, True), 5: (1e-4, True), 7: (1e-7, False), 9: (1e-7, False), 13: (1e-7, False)}
"""By degree of the path: bound of the tracking error from rest in m, and whether it is a lower one."""


def crane_along(profile: sc.Profile) -> sc.Scene:
    """Return the rotary crane with its default manoeuvre in another time law."""
    crane = sc.scenes.rotary_crane()
    return crane.with_reference(sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 20.0, profile))


def measure(quick: bool) -> Findings:
    """Judge five polynomials on three routes, by the closed form and by forward simulation from rest."""
    found = Findings(NAME)
    steps = (400, 1600, 6400)
    for profile in PROFILES[1::2] if quick else PROFILES:
        scene = crane_along(profile)
        _warning(found, scene, profile)
        _convergence(found, scene, profile, steps)
        _from_rest(found, scene, profile)
    _corners(found)
    return found


def _missing(profile: sc.Profile) -> int:
    return max(0, NEEDED - profile.smoothness)


def _warning(found: Findings, scene: sc.Scene, profile: sc.Profile) -> None:
    missing = _missing(profile)
    expected = "nothing" if not missing else "ServocoreWarning" if missing == 1 else "InvalidReference"
    said = "nothing"
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            sc.solve(scene, step=0.5)
        except sc.InvalidReference:
            said = "InvalidReference"
    sentences = [str(each.message) for each in heard if issubclass(each.category, sc.ServocoreWarning)]
    named = [each for each in sentences if f"derivative of order {NEEDED}" in each]
    if named:
        said, found.facts["sentence"] = "ServocoreWarning", named[0]
    verdict = SURVIVES if not missing else FAILS if missing == 1 else REFUSED
    found.add("rotary_crane", "solve, in advance", "what is said of the path", profile.name, expected, said,
              verdict)  # fmt: skip


def _convergence(found: Findings, scene: sc.Scene, profile: sc.Profile, steps: tuple[int, ...]) -> None:
    h = scene.reference.duration / np.array(steps)
    errors = np.array([error_at(scene, sc.Projected(), sc.BDF(3), count, checks=False) for count in steps])
    rate, missing = slope(h, errors), _missing(profile)
    expected = about(1.0 - missing, 0.2) if missing else at_least(0.9)
    found.add("rotary_crane", "projected, bdf3", "exponent of the input error in h", profile.name, expected, rate,
              FAILS if missing else SURVIVES)  # fmt: skip
    found.curves["errors", profile.name] = (h, errors)
    reduced = error_at(scene, sc.Reduced(), sc.BackwardEuler(), steps[0], checks=False)
    found.add("rotary_crane", "reduced", "relative input error where the path is smooth", profile.name,
              at_most(1e-12), reduced, SURVIVES)  # fmt: skip
    found.facts["reduced"] = max(found.facts.get("reduced", 0.0), reduced)


def _from_rest(found: Findings, scene: sc.Scene, profile: sc.Profile) -> None:
    """Give the exact inputs to a crane that hangs at rest when the path begins."""
    solution = quietly(scene, step=scene.reference.duration / 4000, checks=False)
    t = np.linspace(-LEAD, scene.reference.end_time, 2101)
    names = [each.name for each in scene.model().inputs]
    table = np.column_stack([solution[name] for name in names])
    rest = scene.exact(np.array([-LEAD]))
    before = np.array([rest[name][0] for name in names])

    def inputs(time: float) -> Array:
        if time < 0.0:
            return before
        return np.array([np.interp(time, solution.t, column) for column in table.T])

    moved = sc.simulate(scene, inputs, t=t, rtol=1e-8, atol=1e-10)
    error = float(moved["tracking_error"].max())
    bound, lower = TRACKING[2 * profile.smoothness + 1]
    # Linear interpolation of the inputs between 4001 samples costs some micrometres.
    expected = at_least(bound) if lower else at_most(2e-5)
    found.add("rotary_crane", "reduced, then simulate from rest", "tracking error (m)", profile.name, expected, error,
              FAILS if lower else SURVIVES)  # fmt: skip
    found.curves["tracking", profile.name] = (moved.t, moved["tracking_error"])
    found.curves["input", profile.name] = (solution.t, solution["M_b"])
    found.facts[f"tracking_{2 * profile.smoothness + 1}"] = error
    jump = scene.exact(np.array([0.0]))["M_b"][0]
    found.facts[f"jump_{2 * profile.smoothness + 1}"] = abs(jump) / float(np.abs(solution["M_b"]).max())


def _corners(found: Findings) -> None:
    """Offer `sampled` positions on straight lines with a corner between them."""
    t = np.linspace(0.0, 20.0, 401)
    corner = np.column_stack([5.0 - 0.35 * np.minimum(t, 10.0), 0.2 * np.maximum(t - 10.0, 0.0), -5.0 + 0.1 * t])
    try:
        sc.sampled(t, corner)
        seen = "nothing"
    except sc.InvalidReference as error:
        seen, found.facts["corner"] = type(error).__name__, str(error)
    found.add("rotary_crane", "sampled", "samples with a corner", "t = 10 s", "InvalidReference", seen, REFUSED)
    smooth = crane_along(sc.DEGREE13).reference.jet(t, 0)[:, 0]
    path = sc.sampled(t, smooth)
    scene = sc.scenes.rotary_crane().with_reference(path)
    solution, exact = quietly(scene, step=0.05), crane_along(sc.DEGREE13).exact(np.linspace(0.0, 20.0, 401))
    wrong = float(np.abs(solution["M_b"] - exact["M_b"]).max() / np.abs(exact["M_b"]).max())
    found.add("rotary_crane", "sampled, reduced", "input error / peak, exact samples of degree 13", "401 samples",
              at_most(1e-2), wrong, SURVIVES)  # fmt: skip
    found.facts["sampled"] = wrong


_LOOKS: dict[int, dict[str, Any]] = {
    3: {"color": BAD, "ls": "-", "marker": "x"},
    5: {"color": "#6d0a1f", "ls": "--", "marker": "+"},
    7: {"color": "#7f7f7f", "ls": "-.", "marker": "^"},
    9: {"color": "#3c8fa8", "ls": ":", "marker": "s"},
    13: {"color": "#000000", "ls": (0, (5, 1, 1, 1)), "marker": "v"},
}
"""By degree of the path; reds are not smooth enough."""


def draw(found: Findings) -> Figure:
    """Show inputs at the start, errors over the step, and what a crane at rest makes of the inputs."""
    figure, (left, middle, right) = panels(3, height=2.8, width=7.4)
    for profile, look in zip(PROFILES, _LOOKS.values(), strict=True):
        t, torque = found.curves["input", profile.name]
        shown = t <= 2.0
        line = {**look, "marker": ""}
        left.plot(np.r_[-0.5, 0.0, t[shown]], np.r_[0.0, 0.0, torque[shown]], **line)
        middle.loglog(*found.curves["errors", profile.name], label=profile.name, **look)
        right.semilogy(*found.curves["tracking", profile.name], **line)
    right.set_ylim(bottom=1e-9)
    label(left, "time (s)", "slewing torque $M_b$ (N m)", "exact inputs at the start")
    steps_in_ms(middle, found.curves["errors", PROFILES[0].name][0])
    label(middle, "step $h$ (ms)", "largest input error / peak", "projected, bdf3")
    label(right, "time (s)", "tracking error (m)", "exact inputs, from rest")
    legend_below(figure, middle, columns=5)
    return figure


ROW = Row(
    name=NAME,
    title="References that are not smooth enough",
    avoid="time laws of degree 3, 5 or 7 for a crane, and corners joined by straight lines",
    do="`DEGREE9` and above (or `three_phase`, `through`, `sampled`); heed the warning of `solve`",
    theory="The inputs of a flat system of index 5 contain the fourth derivative of the path. With k < 4 continuous"
    " derivatives they jump (k = 3) or need an impulse (k ≤ 2) at every junction; difference quotients then grow like"
    " h⁰, h⁻¹, h⁻². The reduced form gives the exact inputs on both sides, without the impulse: a crane at rest misses"
    " the path.",
    survivor="From degree 9 on all routes converge (tracking error {tracking_9:.0e} m). With degree 7 the torque jumps"
    " by {jump_7:.1%} of its peak, and `solve` warns in advance. `sampled` refuses a corner.",
    limit="From rest the load misses by {tracking_5:.1e} m with degree 5 and by {tracking_3:.1e} m with degree 3,"
    " whatever the step. Inputs of a path fitted to exact samples are accurate to {sampled:.1e}.",
    caption="Left: torque at the start. Middle: input error over the step. Right: tracking error when the exact"
    " inputs drive a crane at rest.",
    measure=measure,
    draw=draw,
)
