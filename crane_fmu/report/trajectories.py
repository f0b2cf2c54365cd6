"""Figures over time: reference function, motion of the crane, its inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import servocore as sc
from crane_fmu.report.study import INPUTS, LoadRun
from crane_fmu.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LABELS,
    PURPLE,
    VERMILLION,
    Array,
    Trajectories,
    panels,
    styled,
)

Look = Mapping[str, Any]
"""How `Axes.plot` draws a curve; curves on top of each other differ in more than colour."""

EXACT: Look = {"color": BLACK, "linewidth": 0.9}
REDUNDANT: Look = {
    "color": VERMILLION,
    "linestyle": "none",
    "marker": "o",
    "markersize": 5.0,
    "markerfacecolor": "none",
    "markeredgewidth": 1.1,
}
PAPER_LINE: Look = {"color": VERMILLION, "linestyle": "--", "linewidth": 1.6}
COMPUTED: Look = {"color": BLUE, "linestyle": "--", "linewidth": 2.2}
DEFAULT_LINE: Look = {"color": BLUE, "linewidth": 2.6, "alpha": 0.45}
SIMULATED: tuple[Look, ...] = (
    {"color": BLUE, "linestyle": "--", "linewidth": 1.6},
    {"color": BLUE, "linewidth": 1.2},
    {"color": VERMILLION, "linestyle": "-.", "linewidth": 1.6},
    {"color": VERMILLION, "linestyle": ":", "linewidth": 1.8},
)
"""Forward simulations: one colour a route, blue for the default, orange for the scheme of the paper."""
CONNECTED: tuple[Look, ...] = (
    {"color": BLACK, "linestyle": "--", "linewidth": 1.4},
    {"color": GREEN, "linewidth": 1.4},
    {"color": PURPLE, "linestyle": "-.", "linewidth": 1.6},
)
"""Connected FMUs: one route in all runs, so other colours."""

LEAST_ERROR = 1e-6
"""In mm; a smaller distance is drawn as this one, since a logarithm needs something."""


@dataclass(frozen=True)
class Curve:
    """Trajectories by name over time, and how they are drawn."""

    label: str
    t: Array
    values: Trajectories
    look: Look


def _keep_rounding_flat(axes: Axes) -> None:
    """Widen the axis of a quantity that is constant but for rounding."""
    low, high = axes.dataLim.intervaly
    slightest = 1e-6 * max(1.0, abs(low), abs(high))
    if high - low < slightest:
        axes.set_ylim((low + high) / 2 - 1e4 * slightest, (low + high) / 2 + 1e4 * slightest)


@styled
def stack(names: Sequence[str], curves: Sequence[Curve], height: float = 1.75) -> Figure:
    """Return a figure with one panel a quantity, angles in degrees."""
    figure, axes = panels([LABELS[name] for name in names], height)
    for axis, name in zip(axes, names, strict=True):
        for curve in curves:
            values = np.degrees(curve.values[name]) if name == "phi" else curve.values[name]
            axis.plot(curve.t, values, label=curve.label, markevery=max(1, len(values) // 25), **curve.look)
        axis.margins(x=0.01)
        _keep_rounding_flat(axis)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(curves))
    return figure


@styled
def reference_function(reference: sc.Reference) -> Figure:
    """Return the share of a straight line that the load has travelled, and its second derivative.

    Parameters
    ----------
    reference : Reference
        A path along a straight line, from its start to its end.
    """
    t = np.linspace(reference.start_time, reference.end_time, 801)
    jets = reference.jet(t, 2)
    start, way = jets[0, 0].copy(), jets[-1, 0] - jets[0, 0]
    jets[:, 0] -= start
    share = jets @ way / (way @ way)
    figure, axes = panels(["share of the line", "its second derivative (1/s²)"], height=1.9)
    for axis, order in zip(axes, (0, 2), strict=True):
        axis.plot(t, share[:, order], color=BLUE)
        axis.margins(x=0.01)
    return figure


def inputs_compared(redundant: sc.Solution, generalized: sc.Solution, default: sc.Solution) -> Figure:
    """Return the inputs of both sets of coordinates on top of each other, by one scheme, with those by the default."""
    curves = (
        Curve("default: exact inversion", default.t, default, DEFAULT_LINE),
        Curve("generalized coordinates (GEN)", generalized.t, generalized, PAPER_LINE),
        Curve("redundant coordinates (RED)", redundant.t, redundant, REDUNDANT),
    )
    return stack(INPUTS, curves, height=2.1)


def closed_form(scene: sc.Scene) -> Curve:
    """Return the closed form of a scene on a fine grid."""
    t = np.linspace(scene.reference.start_time, scene.reference.end_time, 1601)
    return Curve("closed form", t, scene.exact(t), EXACT)


def beside_closed_form(names: Sequence[str], solution: sc.Solution, scene: sc.Scene) -> Figure:
    """Return some quantities of a run by the default, computed and in closed form."""
    return stack(names, (Curve("exact inversion", solution.t, solution, COMPUTED), closed_form(scene)))


@styled
def strayed(runs: Sequence[LoadRun], shown: Sequence[LoadRun], looks: Sequence[Look] = SIMULATED) -> Figure:
    """Return where the load should be and where it goes in some runs, and its distance from its path in all runs.

    Parameters
    ----------
    runs : sequence of LoadRun
        At most as many as there are looks, on one path.
    shown : sequence of LoadRun
        Those of them whose positions are drawn.
    looks : sequence of Look
        How each run is drawn.
    """
    figure, (above, below) = panels(["position of the load (m)", "distance from the path (mm)"], height=2.5)
    t = runs[0].t
    for name, values in zip("xyz", runs[0].wanted.T, strict=True):
        above.plot(t, values, color=GREY, linewidth=4.0, label="path" if name == "x" else None)
        above.annotate(f"${name}$", (t[0], values[0]), (-6, 0), textcoords="offset points", va="center", ha="right")
    for run, look in zip(runs, looks, strict=False):
        if run in shown:
            above.plot(run.t, run.driven, **look)
        below.semilogy(run.t, np.maximum(1e3 * run.error, LEAST_ERROR), label=run.label, **look)
    below.margins(x=0.03)
    figure.legend(loc="outside upper center", ncols=2)
    return figure
