"""Figures over time: reference function, motion of the crane, its inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import servocore as sc
from crane_fmu.report.study import INPUTS, MOTION, LoadRun
from crane_fmu.report.style import BLACK, BLUE, GREEN, GREY, LABELS, TIME, VERMILLION, Array, Line, panels, styled

EXACT = Line(BLACK, "-", 0.9)
REDUNDANT = Line(VERMILLION, "none", 0.0, "o")
COMPUTED = Line(BLUE, "--", 2.2)
PLAIN = Line(BLUE, "-", 1.5)
_RUN_LINES = (Line(BLUE, "--", 1.6), Line(BLACK, "-", 1.2), Line(VERMILLION, "-.", 1.6), Line(GREEN, ":", 1.8))

LEAST_ERROR = 1e-6
"""In mm; a smaller distance is drawn as this one, since a logarithm needs something."""


@dataclass(frozen=True)
class Curve:
    """Trajectories by name over time, and how they are drawn."""

    label: str
    t: Array
    values: Mapping[str, Array]
    line: Line


def curve(label: str, solution: sc.Solution, line: Line) -> Curve:
    """Return the inputs and the motion of a solution as a curve."""
    return Curve(label, solution.t, {name: solution[name] for name in (*INPUTS, *MOTION)}, line)


def shown(name: str, values: Array) -> Array:
    """Convert to the unit of the axis: angles to degrees."""
    return np.degrees(values) if name == "phi" else values


def draw(axes: Axes, name: str, curves: Sequence[Curve]) -> None:
    """Draw one quantity of several curves into a panel and label it."""
    for each in curves:
        axes.plot(
            each.t,
            shown(name, each.values[name]),
            label=each.label,
            **each.line.options(len(each.t)),
        )
    axes.set_ylabel(LABELS[name])
    axes.margins(x=0.01)
    _keep_rounding_flat(axes)


def _keep_rounding_flat(axes: Axes) -> None:
    """Widen the axis of a quantity that is constant but for rounding."""
    low, high = axes.dataLim.intervaly
    slightest = 1e-6 * max(1.0, abs(low), abs(high))
    if high - low < slightest:
        axes.set_ylim((low + high) / 2 - 1e4 * slightest, (low + high) / 2 + 1e4 * slightest)


def stack(names: Sequence[str], curves: Sequence[Curve], height: float = 1.75) -> Figure:
    """Return a figure with one panel a quantity, above each other; several curves get a legend."""
    with styled():
        figure, axes = panels(len(names), height=height)
        for axis, name in zip(axes, names, strict=True):
            draw(axis, name, curves)
        axes[-1].set_xlabel(TIME)
        figure.align_ylabels(axes)
        if len(curves) > 1:
            handles, labels = axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside upper center", ncols=len(curves))
    return figure


def inputs_and_motion(solution: sc.Solution) -> Figure:
    """Return inputs on the left, the motion of the crane on the right: what ``--plot`` draws."""
    drawn = [curve("", solution, PLAIN)]
    with styled():
        figure, axes = panels(3, 2, width=8.2)
        for axis, name in zip(axes, [n for pair in zip(INPUTS, MOTION, strict=True) for n in pair], strict=True):
            draw(axis, name, drawn)
        for axis in axes[-2:]:
            axis.set_xlabel(TIME)
        figure.align_ylabels(axes)
    return figure


def reference_function(reference: sc.Reference) -> Figure:
    """Return s(t) and its second derivative for a straight path: how far along its line the load is.

    Parameters
    ----------
    reference : Reference
        A path along a straight line, from its start to its end.
    """
    t = np.linspace(reference.start_time, reference.end_time, 801)
    jets = reference.jet(t, 2)
    way = jets[-1, 0] - jets[0, 0]
    s = (jets - np.where(np.arange(3) == 0, 1.0, 0.0)[None, :, None] * jets[0, 0]) @ way / (way @ way)
    with styled():
        figure, axes = panels(2)
        for axis, order, label in ((axes[0], 0, "$s(t)$ (1)"), (axes[1], 2, "$\\ddot{s}(t)$ (1/s²)")):
            axis.plot(t, s[:, order], **PLAIN.options())
            axis.set_ylabel(label)
            axis.margins(x=0.01)
        axes[-1].set_xlabel(TIME)
        figure.align_ylabels(axes)
    return figure


def inputs_compared(redundant: sc.Solution, generalised: sc.Solution, exact: Curve) -> Figure:
    """Return M_b and F of both sets of coordinates on top of each other, with the closed form."""
    curves = (
        curve("generalised coordinates (GEN)", generalised, COMPUTED),
        curve("redundant coordinates (RED)", redundant, REDUNDANT),
        exact,
    )
    return stack(("M_b", "F"), curves, height=2.4)


def closed_form_curve(scene: sc.Scene) -> Curve:
    """Return the closed form of a scene on a fine grid."""
    t = np.linspace(scene.reference.start_time, scene.reference.end_time, 1601)
    return Curve("closed form", t, scene.exact(t), EXACT)


def beside_closed_form(names: Sequence[str], solution: sc.Solution, scene: sc.Scene) -> Figure:
    """Return some quantities of a run, computed and in closed form."""
    return stack(names, (curve("computed", solution, COMPUTED), closed_form_curve(scene)))


def strayed(runs: Sequence[LoadRun], shown: Sequence[LoadRun]) -> Figure:
    """Return where the load should be and where it goes in some runs, and its distance from its path in all runs.

    Parameters
    ----------
    runs : sequence of LoadRun
        At most four, on one path.
    shown : sequence of LoadRun
        Those of them whose positions are drawn.
    """
    with styled():
        figure, (above, below) = panels(2, height=2.5)
        t = runs[0].t
        for name, values in zip("xyz", runs[0].wanted.T, strict=True):
            above.plot(t, values, color=GREY, linewidth=4.0, label="path" if name == "x" else None)
            above.annotate(f"${name}$", (t[0], values[0]), (-6, 0), textcoords="offset points", va="center", ha="right")
        for run, line in zip(runs, _RUN_LINES, strict=False):
            if run in shown:
                above.plot(run.t, run.driven, **line.options())
            below.semilogy(run.t, np.maximum(1e3 * run.error, LEAST_ERROR), label=run.label, **line.options())
        above.set_ylabel("position of the load (m)")
        below.set_ylabel("distance from the path (mm)")
        below.set_xlabel(TIME)
        below.margins(x=0.03)
        figure.align_ylabels([above, below])
        figure.legend(loc="outside upper center", ncols=2)
    return figure
