"""Figures over time: reference function, motion of the crane, its inputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from crane_fmu.report.style import BLACK, BLUE, GREEN, LABELS, TIME, VERMILLION, Line, panels, styled

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    import servocore as sc
    from servocore.symbols import Array

INPUTS = ("M_b", "F", "M_w")
MOTION = ("phi", "s", "l")

EXACT = Line(BLACK, "-", 0.9)
REDUNDANT = Line(VERMILLION, "none", 0.0, "o")
GENERALISED = Line(BLUE, "--", 2.2)
PLAIN = Line(BLUE, "-", 1.5)


@dataclass(frozen=True)
class Curve:
    """Trajectories by name over time, and how they are drawn."""

    label: str
    t: Array
    values: Mapping[str, Array]
    line: Line
    phase: float = 0.0


def curve(label: str, solution: sc.Solution, line: Line, phase: float = 0.0) -> Curve:
    """Return the inputs and the motion of a solution as a curve."""
    names = [name for name in (*INPUTS, *MOTION) if name in solution]
    return Curve(label, solution.t, {name: solution[name] for name in names}, line, phase)


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
            **each.line.options(len(each.t), each.phase),
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
        curve("generalised coordinates (GEN)", generalised, GENERALISED),
        curve("redundant coordinates (RED)", redundant, REDUNDANT),
        exact,
    )
    return stack(("M_b", "F"), curves, height=2.4)


def closed_form_curve(scene: sc.Scene, label: str = "closed form") -> Curve:
    """Return the closed form of a scene on a fine grid."""
    t = np.linspace(scene.reference.start_time, scene.reference.end_time, 1601)
    return Curve(label, t, scene.exact(t), EXACT)


def motion(solution: sc.Solution, scene: sc.Scene) -> Figure:
    """Return bridge angle, trolley position and rope length, computed and in closed form."""
    return stack(MOTION, (curve("computed", solution, Line(BLUE, "--", 2.2)), closed_form_curve(scene)))


def tracking(paths: Sequence[tuple[str, sc.Solution]], reference: sc.Reference) -> Figure:
    """Return the load's distance from its path over time for several forward simulations.

    Parameters
    ----------
    paths : sequence of (str, Solution)
        Label and forward simulation.
    reference : Reference
        Where the load should be.
    """
    lines = (Line(VERMILLION, "-", 1.5), Line(BLUE, "--", 1.5), Line(GREEN, "-.", 1.5), Line(BLACK, ":", 1.5))
    with styled():
        figure, axes = panels(1, height=2.4)
        for (label, solution), line in zip(paths, lines, strict=False):
            axes[0].plot(solution.t, 1e3 * tracking_error(solution, reference), label=label, **line.options())
        axes[0].set_yscale("log")
        axes[0].set_ylabel("distance of the load from its path (mm)")
        axes[0].set_xlabel(TIME)
        axes[0].legend()
    return figure


def tracking_error(simulated: sc.Solution, reference: sc.Reference) -> Array:
    """Distance of the load from where it should be, in m, shape (N,)."""
    found = np.column_stack([simulated[name] for name in "xyz"])
    distance: Array = np.linalg.norm(found - reference.jet(simulated.t, 0)[:, 0], axis=1)
    return distance
