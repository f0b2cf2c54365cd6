"""Row 13: an elastic bar as a chain stepped in time, and marched in space."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

import servocore as sc
from benchmarks.atlas.record import FAILS, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, amplified, error_at, slope
from benchmarks.atlas.style import BAD, GOOD, label, legend_below, panels
from benchmarks.route_styles import line_style
from servocore.references.profiles import polynomial
from servocore.scenes.bar_marching import march_bar
from servocore.scenes.elastic_bar import dalembert

NAME = "elastic-bar"
DURATION = 0.6
"""Of the fast path in s: six times what a wave needs from end to end."""
COUNTS = (2, 3, 4, 6, 8, 10, 12)
STEPPED = {
    2: (2000, 5000, 10_000, 20_000, 40_000, 80_000),
    3: (400, 800, 1600, 2400, 3200, 4800, 6400),
    4: (200, 400, 600, 800, 1000, 1300, 1600, 2000, 2400),
}
"""Numbers of masses stepped on the original form, with numbers of steps on both sides of the least error."""


def measure(quick: bool) -> Findings:
    """Compare chains of masses and the march in space with d'Alembert's solution."""
    found = Findings(NAME)
    path = sc.rest_to_rest((0.0,), (1.0,), DURATION, sc.DEGREE9)
    values = sc.scenes.elastic_bar().parameter_values()
    delay = values["length"] * float(np.sqrt(values["line_mass"] / values["axial_stiffness"]))  # L/c
    t = np.linspace(-2.0 * delay, DURATION + 2.0 * delay, 1601)
    exact = dalembert(t, path, values)["u"]
    found.curves["exact"] = (t, exact)
    found.facts.update(delay=delay)
    _chains(found, t, exact, delay, quick)
    _marched(found, path, values)
    _stepped(found, quick)
    return found


def _chains(found: Findings, t: Array, exact: Array, delay: float, quick: bool) -> None:
    """Give each chain its own exact inversion: what is wrong then is the chain, not the method."""
    path = sc.rest_to_rest((0.0,), (1.0,), DURATION, sc.DEGREE9)
    peak = float(np.abs(exact).max())
    before = (t < 0.0) & (t > -delay)
    inside = (t > 1.2 * delay) & (t < DURATION - 1.2 * delay)
    needed = float(np.abs(exact[before]).max()) / peak
    errors = []
    counts = COUNTS[:4] if quick else COUNTS
    for count in counts:
        scene = sc.scenes.elastic_bar(count).with_reference(path)
        u = scene.exact(t)["u"]
        errors.append(float(np.abs(u - exact)[inside].max()) / peak)
        found.curves["chain", count] = (t, u)
        if count in (2, 3, 6):
            given = float(np.abs(u[before]).max()) / peak
            found.add("elastic_bar", f"chain of {count} masses, exact inversion", "force before the path / peak",
                      f"bar needs {needed:.2g}", at_most(0.0), given, FAILS)  # fmt: skip
            late = float(np.abs(u - exact)[before | ((t > DURATION) & (t < DURATION + delay))].max()) / peak
            found.add("elastic_bar", f"chain of {count} masses, exact inversion", "error outside the path / peak",
                      "within L/c of it", at_least(0.1), late, FAILS)  # fmt: skip
            found.facts["outside"] = late
    found.curves["inside"] = (np.array(counts), np.array(errors))
    few = np.array(counts[:4])
    rate = slope(few - 1.0, np.array(errors[:4]))
    found.add("elastic_bar", "chain, exact inversion", "exponent of the error in 1/(N - 1), inside", "N = 2 ... 6",
              about(-2.0, 0.5), rate, SURVIVES)  # fmt: skip
    found.facts.update(needed=needed, inside=errors[-1], inside_count=counts[-1])


def _marched(found: Findings, path: sc.Reference, values: dict[str, float]) -> None:
    for pieces in (1, 10, 1000):
        bar = march_bar(path, **values, pieces=pieces)
        exact = dalembert(bar.t, path, values)["u"]
        error = float(np.abs(bar.input - exact).max() / np.abs(exact).max())
        found.add("elastic_bar", "marched in space", "largest input error / peak", f"{pieces} pieces", at_most(1e-12),
                  error, SURVIVES)  # fmt: skip
        found.facts["marched"] = max(found.facts.get("marched", 0.0), error)
    found.curves["marched"] = (bar.t, bar.input)
    acting = bar.t[np.abs(bar.input) > 1e-9 * np.abs(bar.input).max()]
    found.add("elastic_bar", "marched in space", "force begins before the path (s)", "1000 pieces",
              about(found.facts["delay"], 0.005), path.start_time - acting[0], SURVIVES)  # fmt: skip


def _stepped(found: Findings, quick: bool) -> None:
    """Step chains in time on their original form, of index 2 N + 1."""
    for count, steps in STEPPED.items():
        if quick and count == 2:
            continue
        scene = sc.scenes.elastic_bar(count)
        smooth = scene.with_reference(sc.rest_to_rest((0.0,), (1.0,), 2.0, polynomial(4 * count + 1)))
        h = 2.0 / np.array(steps)
        errors = np.array([error_at(smooth, sc.Original(), sc.BackwardEuler(), each) for each in steps])
        found.curves["stepped", count] = (h, errors)
        grown = amplified(errors)
        rate = slope(h[grown], errors[grown])
        found.add("elastic_bar", f"original, backward-euler, {count} masses",
                  "exponent of the input error in h, small h",
                  f"index {2 * count + 1}", about(-2.0 * count, 1.2), rate, FAILS)  # fmt: skip


def draw(found: Findings) -> Figure:
    """Show forces over time, errors of chains, and errors of stepping."""
    figure, (left, middle, right) = panels(3, height=2.9, width=7.4)
    t, exact = found.curves["exact"]
    delay = found.facts["delay"]
    left.axvspan(0.0, DURATION, color="0.93", zorder=0)
    left.plot(t, exact, color="black", lw=2.6, alpha=0.35, label="exact (d'Alembert)")
    left.plot(*found.curves["marched"], color=GOOD, lw=1, label="bar, marched in space")
    for count, dash in ((2, ":"), (3, "--")):
        left.plot(*found.curves["chain", count], color=BAD, ls=dash, lw=1, label=f"chain of {count} masses, inverted")
    left.set(xlim=(-1.5 * delay, DURATION + 1.5 * delay))
    label(left, "time (s), path in grey", "force on the driven end (N)", "Force before and after the path")
    counts, errors = found.curves["inside"]
    middle.loglog(counts - 1, errors, color="#7f7f7f", marker="o", label="chain, farther than L/c from the ends")
    middle.axhline(found.facts["outside"], color=BAD, ls="-.", label="chain, within L/c of the ends")
    middle.axhline(max(found.facts["marched"], 1e-17), color=GOOD)
    middle.set_xticks(counts - 1, [f"{k - 1:d}" if k < 9 else "" for k in counts])
    middle.xaxis.set_minor_formatter(NullFormatter())
    label(middle, "springs $N - 1$", "force error / peak", "Chains of N masses, inverted")
    stepped = [(key[1], values) for key, values in found.curves.items() if key[0] == "stepped"]
    for (count, (h, values)), dash, mark in zip(stepped, DASHES, "ovx", strict=False):
        line = line_style("original", ls=dash, marker=mark)
        right.loglog(h, values, label=f"chain of {count} masses, stepped (index {2 * count + 1})", **line)
    label(right, "step $h$ (s)", "force error / peak", "Backward Euler, original form")
    legend_below(figure, left, middle, right, fontsize=6.5)
    return figure


DASHES = ("-", "--", ":")


ROW = Row(
    name=NAME,
    title="Elastic bodies: the index grows with the mesh",
    avoid="chains of masses (or finite elements) stepped in time, for paths that are fast compared with a wave",
    do="`servocore.scenes.bar_marching.march_bar`: solve in space over the whole horizon",
    theory="A chain of N masses tracked at its free end has index 2 N + 1: stepping in time divides round-off by h²ᴺ."
    " And its input depends on one instant of the path, so it cannot begin earlier, while the bar needs its force"
    " L/c before: the time of a wave.",
    survivor="Marching in space from the tracked end is exact on characteristics: {marched:.0e} of the peak against"
    " d'Alembert's solution with 1, 10 and 1000 pieces, with a pre-actuation of L/c = {delay:.2g} s.",
    limit="Before the path the bar needs up to {needed:.0%} of the peak force and a chain gives none: an error of"
    " {outside:.0%} near the ends, whatever N. Farther than L/c from both ends a chain of {inside_count:d} is"
    " accurate to {inside:.1e}. `march_bar` is for uniform bars and paths from rest to rest.",
    caption="Left: force on the driven end. Middle: error of exactly inverted chains. Right: error of chains stepped"
    " in time by backward Euler.",
    measure=measure,
    draw=draw,
)
