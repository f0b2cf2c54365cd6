"""Row 7: very small and very large steps, gentle and violent manoeuvres, for every form and method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import servocore as sc
from benchmarks.atlas.record import FAILS, REFUSED, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, quietly, relative_error
from benchmarks.atlas.style import panels

NAME = "stability-map"
DIVISIONS = (10, 30, 100, 300, 1000, 3000, 10_000, 30_000)
"""Steps in a manoeuvre."""
VIOLENCE = (0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.05)
"""Largest downward acceleration of the load as a fraction of g: at one the rope goes slack."""
GRAVITY, DROP = 9.81, 3.0
FAILED, OUT = np.inf, np.nan
ONE_PER_CENT = 1e-2


@dataclass(frozen=True)
class Panel:
    """A form and a method of a model; `good` is the least error that it must reach somewhere, None for a control."""

    form: sc.Formulation
    method: sc.Method
    model: str = "points"
    good: float | None = None

    @property
    def title(self) -> str:
        """What the panel is called."""
        name = self.form.name if self.form == sc.Reduced() else f"{self.form.name}, {self.method.name}"
        return name + (" (gen.)" if self.model == "generalized" else "")


ORIGINAL, PROJECTED, REDUCED = sc.Original(), sc.Projected(), sc.Reduced()
PANELS = (
    Panel(REDUCED, sc.BackwardEuler(), good=1e-12),
    Panel(PROJECTED, sc.BackwardEuler(), good=2e-3),
    Panel(PROJECTED, sc.BDF(2), good=1e-3),
    Panel(PROJECTED, sc.BDF(4), good=1e-3),
    Panel(PROJECTED, sc.RadauIIA(2), good=1e-3),
    Panel(PROJECTED, sc.RadauIIA(3), good=1e-6),
    Panel(PROJECTED, sc.GeneralizedAlpha(0.8), good=2e-3),
    Panel(PROJECTED, sc.BackwardEuler(), "generalized", good=2e-3),
    Panel(REDUCED, sc.BackwardEuler(), "generalized", good=1e-12),
    Panel(PROJECTED, sc.Trapezoidal()),
    Panel(PROJECTED, sc.Gauss(1)),
    Panel(PROJECTED, sc.Gauss(2)),
    Panel(ORIGINAL, sc.BackwardEuler()),
    Panel(ORIGINAL, sc.BDF(2)),
    Panel(ORIGINAL, sc.RadauIIA(3)),
    Panel(ORIGINAL, sc.BackwardEuler(), "generalized"),
)


def manoeuvre(violence: float) -> sc.Scene:
    """Move the load 5 m sideways and 3 m down so fast that its largest downward acceleration is `violence` g."""
    T = np.linspace(0.0, 1.0, 20_001)
    peak = float(np.abs(sc.DEGREE9.jet(T, 1.0 - T, 1.0, 2)[:, 2]).max())
    duration = float(np.sqrt(DROP * peak / (violence * GRAVITY)))
    return sc.scenes.overhead_crane().with_reference(sc.rest_to_rest((0.0, -1.0), (5.0, -1.0 - DROP), duration))


def error_of(panel: Panel, scene: sc.Scene, division: int) -> float:
    """Return the largest relative input error of a run, `FAILED` or `OUT`."""
    try:
        step = scene.reference.duration / division
        solution = quietly(scene, panel.form, panel.method, step=step, model=panel.model)
    except sc.InvalidReference:
        return OUT
    except (sc.IntegrationFailed, sc.InconsistentStart):
        return FAILED
    return relative_error(scene, solution)


def measure(quick: bool) -> Findings:
    """Fill the maps."""
    found = Findings(NAME)
    divisions, violence = ((30, 300, 3000), (0.05, 0.5, 1.05)) if quick else (DIVISIONS, VIOLENCE)
    scenes = [manoeuvre(each) for each in violence]
    found.facts["cells"] = len(divisions) * (len(violence) - 1)
    for panel in (PANELS[0], PANELS[5], PANELS[9]) if quick else PANELS:
        table = np.array([[error_of(panel, scene, division) for division in divisions] for scene in scenes])
        found.curves[panel.title] = (divisions, violence, table)
        _judge(found, panel, table)
    return found


def _judge(found: Findings, panel: Panel, table: Array) -> None:
    inside, best = table[:-1], float(np.nanmin(table))
    share = float((inside < ONE_PER_CENT).mean())
    key = panel.title.replace(", ", "_").replace("-", "_").replace(" ", "_").replace("(", "").replace(".)", "")
    found.facts.update({f"{key}_share": share, f"{key}_worst": float(inside.max()), f"{key}_failed":
                        int(np.isinf(inside).sum())})  # fmt: skip
    if panel.good is not None:
        found.add("overhead_crane", panel.title, "least relative input error on the map", f"{inside.size} runs",
                  at_most(panel.good), best, SURVIVES)  # fmt: skip
        found.add("overhead_crane", panel.title, "share of runs within 1 %", f"{inside.size} runs",
                  at_least(0.99 if panel == PANELS[0] else 0.25), share, SURVIVES)  # fmt: skip
    else:
        lost = at_most(0.55 if panel.form == ORIGINAL else 0.1)
        found.add("overhead_crane", panel.title, "share of runs within 1 %", f"{inside.size} runs", lost, share, FAILS)
        finest = inside[:, -1]
        found.add("overhead_crane", panel.title, "least relative input error, finest step", "of all manoeuvres",
                  at_least(ONE_PER_CENT if panel.form != ORIGINAL else 1e-5), float(finest.min()), FAILS)  # fmt: skip
    if panel != PANELS[0]:
        return
    refused = int(np.isnan(table[-1]).sum())
    found.add("overhead_crane", panel.title, "runs refused where the rope would go slack", "1.05 g",
              about(table.shape[1], 0.1), refused, REFUSED)  # fmt: skip


def draw(found: Findings) -> Figure:
    """Small multiples: error over step and violence."""
    figure, axes = panels(4, 4, width=7.4, height=1.8, sharex=True, sharey=True)
    colours = mpl.colormaps["cividis_r"].with_extremes(bad="white", over="black")
    image: Any = None
    for ax, (title, (divisions, violence, table)) in zip(axes.flat, found.curves.items(), strict=True):
        shown = np.log10(np.clip(table, 1e-16, 1e30))
        image = ax.imshow(shown, origin="lower", aspect="auto", cmap=colours, vmin=-8, vmax=0, interpolation="nearest")
        for row, column in np.argwhere(np.isinf(table)):
            ax.text(column, row, "×", color="white", ha="center", va="center", fontsize=7)
        for row, column in np.argwhere(np.isnan(table)):
            ax.text(column, row, "r", color="black", ha="center", va="center", fontsize=6)
        ax.set_title(title, fontsize=6.5)
        ax.grid(visible=False)
        ax.set_xticks(range(len(divisions)), [f"{d:g}" if d < 1000 else f"{d // 1000}k" for d in divisions],
                      fontsize=5.5)  # fmt: skip
        ax.set_yticks(range(len(violence)), [f"{v:g}" for v in violence], fontsize=5.5)
    bar = figure.colorbar(image, ax=axes, shrink=0.6, extend="both", ticks=[-8, -6, -4, -2, 0])
    bar.set_label("log$_{10}$ (largest input error / peak)", fontsize=7)
    figure.suptitle("Overhead crane: which steps each route can take, by how hard the load is let fall", fontsize=9)
    for ax in axes[-1]:
        ax.set_xlabel("steps in the manoeuvre", fontsize=7)
    figure.supylabel("largest downward acceleration / g", fontsize=8)
    figure.legend(handles=_key(colours), loc="outside lower center", ncols=5, fontsize=7, handlelength=1.2)
    return figure


def _key(colours: Any) -> list[Patch]:
    """Return what the colours and letters of a cell mean."""
    patches = [
        Patch(facecolor=colours(0.0), label="exact to 1e-8"),
        Patch(facecolor=colours(0.5), label="1e-4"),
        Patch(facecolor=colours(1.0), label="as large as the peak"),
        Patch(facecolor="black", label="larger; with ×: failed with an error"),
    ]
    return [*patches, Patch(facecolor="white", edgecolor="0.5", label="r: refused in advance")]


ROW = Row(
    name=NAME,
    title="Very small and very large steps: the stability map",
    avoid="choosing a step by trial on the original form; undamped methods at any step",
    do="`Reduced()` at any step; `Projected()` with `RadauIIA(3)` or `BDF(4)` at hundreds to thousands of steps",
    theory="Large steps miss the manoeuvre, small steps divide round-off by h² (projected) or h⁴ (original). A window"
    " of usable steps remains, narrower for a higher index and a more violent manoeuvre.",
    survivor="The reduced form is right in all of its {cells:d} runs, the worst to {reduced_worst:.0e}. Radau IIA(3)"
    " on the projected form is within 1 % in {projected_radau3_share:.0%} of them, backward Euler in"
    " {projected_backward_euler_share:.0%}.",
    limit="In generalized coordinates the reduced form fails in {reduced_gen_failed:d} of {cells:d} runs. Every route"
    " refuses a path that needs a slack rope.",
    caption="Overhead crane, 5 m sideways and 3 m down: error by number of steps and by the largest downward"
    " acceleration; gen.: generalized coordinates.",
    measure=measure,
    draw=draw,
)
