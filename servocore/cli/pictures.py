"""Pictures: a plan between its limits, beside the polynomial law that takes longer; effects of parameters."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from servocore.checks.motion_limits import limited_values, motion_limits
from servocore.model.limits import Limit
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array
from servocore.planning.report import PlanReport
from servocore.planning.sensitivities import Sensitivities
from servocore.planning.time_laws import polynomial_path
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.timed_path import TimedPath
from servocore.solvers.branch_continuation import exact_states, prepared_table

_INSTANTS = 1001
_PLAN, _OTHER, _ACTIVE, _BOUND = "#0072b2", "#999999", "#d55e00", "#000000"


def plan_figure(scene: Scene, path: Reference, report: PlanReport) -> Figure:
    """Return a picture of the limited quantities of a plan, active limits coloured, beside the polynomial law.

    Parameters
    ----------
    scene : Scene
        With the limits.
    path, report
        What `fastest` returned.
    """
    problem = Problem.of(scene.with_reference(path))
    limits, t, values = _limited(problem)
    other, name = None, f"degree {report.degree}"
    if isinstance(path, TimedPath) and np.isfinite(report.degree9):
        slower = polynomial_path(path.curve, report.degree9, (report.degree - 1) // 2)
        other = _limited(replace(problem, reference=slower))
    columns = 1 if len(limits) <= 3 else 2
    rows = -(-len(limits) // columns)
    figure = Figure(figsize=(8.0 if columns == 1 else 11.0, 0.8 + 1.9 * rows), layout="constrained", dpi=120)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for k, (axes, limit) in enumerate(zip(panels, limits, strict=False)):
        factor, unit = (180.0 / np.pi, limit.unit.replace("rad", "deg")) if "rad" in limit.unit else (1.0, limit.unit)
        if other is not None:
            axes.plot(other[1], factor * other[2][k], color=_OTHER, linewidth=1.2, linestyle="--", label=name)
        axes.plot(t, factor * values[k], color=_PLAN, linewidth=1.6, label="near time-optimal")
        _mark(axes, limit, report, t, factor * values[k], factor)
        axes.set_title(f"{limit.quantity} ({unit})", fontsize="medium", loc="left")
        axes.margins(x=0.01)
    for axes in panels[len(limits) :]:
        axes.set_visible(False)
    for axes in panels[max(len(limits) - columns, 0) : len(limits)]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("time (s)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _limited(problem: Problem) -> tuple[tuple[Limit, ...], Array, Array]:
    """Return limits, instants, and the quantities there (limits, N)."""
    limits, path = motion_limits(problem), problem.reference
    t = np.linspace(path.start_time, path.end_time, _INSTANTS)
    return limits, t, limited_values(problem, exact_states(problem, prepared_table(problem)), t)


def _mark(axes: Axes, limit: Limit, report: PlanReport, t: Array, values: Array, factor: float) -> None:
    """Draw bounds, and where the plan touches them."""
    for bound in (limit.bound, limit.upper):
        if np.isfinite(bound):
            axes.axhline(factor * bound, color=_BOUND, linewidth=0.8, linestyle=":", label="_limit")
    label = "active constraint"
    for active_limit in report.active:
        if active_limit.quantity == limit.quantity:
            during = (t >= active_limit.begin) & (t <= active_limit.end)
            axes.plot(t[during], values[during], color=_ACTIVE, linewidth=3.5, label=label, solid_capstyle="round")
            label = "_more"


def sensitivities_figure(result: Sensitivities) -> Figure:
    """Return a picture of the effects of one per cent more of each parameter, one panel a quantity."""
    rows = -(-len(result.quantities) // 2)
    figure = Figure(figsize=(11.0, 0.8 + 1.9 * rows), layout="constrained", dpi=120)
    panels = figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()
    for axes, quantity in zip(panels, result.quantities, strict=False):
        for k, (name, size) in enumerate(zip(result.parameters, result.sizes, strict=True)):
            look = ("-", "--", "-.", ":")[k % 4]
            axes.plot(
                result.t,
                result[quantity.name, name] * size / 100.0,
                linewidth=1.5,
                linestyle=look,
                label=name,
            )
        axes.set_title(f"{quantity.name} ({quantity.unit})", fontsize="medium", loc="left")
        axes.margins(x=0.01)
    for axes in panels[len(result.quantities) :]:
        axes.set_visible(False)
    for axes in panels[max(len(result.quantities) - 2, 0) : len(result.quantities)]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("time (s)")
    handles, labels = panels[0].get_legend_handles_labels()
    title = "effect of one per cent more of"
    figure.legend(handles, labels, loc="outside upper center", ncols=6, frameon=False, title=title)
    return figure


def saved_figure(figure: Figure, file: Path) -> bytes:
    """Return a figure as the content of a PNG, SVG or PDF file, alike from run to run."""
    stream, kind = io.BytesIO(), file.suffix[1:].lower()
    metadata = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[kind]
    figure.savefig(stream, format=kind, metadata=metadata)
    return stream.getvalue()
