"""Figures: a plan within its limits beside a polynomial time law; effects of parameters."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure

from servocore.checks.motion_limits import limited_values
from servocore.model.scene import Scene
from servocore.numerics.compiled_calls import Array
from servocore.planning.report import PlanReport
from servocore.planning.sensitivities import Sensitivities
from servocore.planning.time_laws import polynomial_path
from servocore.presentation import Curve, figure_of
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.timed_path import TimedPath
from servocore.solvers.exact_inversion import prepared_motion

_INSTANTS = 1001
_PLAN = {"color": "#0072b2", "label": "near time-optimal"}
_OTHER = {"color": "#999999", "linewidth": 1.2, "linestyle": "--"}
_ACTIVE = {"color": "#d55e00", "linewidth": 3.5, "label": "active constraint"}
_BOUND = {"color": "#000000", "linewidth": 0.8, "linestyle": ":"}


def plan_figure(scene: Scene, path: Reference, report: PlanReport) -> Figure:
    """Return a figure of the limited quantities of a plan and of the polynomial time law, active limits coloured.

    The scene has the limits; path and report are the results of `fastest`.
    """
    problem = Problem.of(scene.with_reference(path))
    limits, laws = problem.motion_limits, [(problem, dict[str, object](_PLAN))]
    if isinstance(path, TimedPath) and np.isfinite(report.degree9):
        slower = polynomial_path(path.curve, report.degree9, (report.degree - 1) // 2)
        laws.insert(0, (replace(problem, reference=slower), {"label": f"degree {report.degree}"} | _OTHER))
    t = np.linspace(path.start_time, max(law.reference.end_time for law, _ in laws), _INSTANTS)
    curves = [
        Curve(each.quantity, each.unit, "", row, look)
        for law, look in laws
        for each, row in zip(limits, _limited(law, t), strict=True)
    ]
    values = {curve.name: curve.values for curve in curves}  # of the plan, which comes last
    for each in limits:
        bounds = [np.full(len(t), bound) for bound in (each.bound, each.upper) if np.isfinite(bound)]
        curves += [Curve(each.quantity, each.unit, "", bound, _BOUND) for bound in bounds]
        for active in (active for active in report.active if active.quantity == each.quantity):
            held = np.where((t >= active.begin) & (t <= active.end), values[each.quantity], np.nan)
            curves.append(Curve(each.quantity, each.unit, "", held, _ACTIVE))
    return figure_of(t, curves, f"{scene.name}: limited quantities of the near time-optimal motion")


def _limited(problem: Problem, t: Array) -> Array:
    """Return the limited quantities at instants, NaN after the end of the path, shape (limits, N)."""
    within = t <= problem.reference.end_time
    values = np.full((len(problem.motion_limits), len(t)), np.nan)
    values[:, within] = limited_values(prepared_motion(problem), t[within])
    return values


def sensitivities_figure(result: Sensitivities) -> Figure:
    """Return a figure of the effects of one per cent more of each parameter, one panel a quantity."""
    looks = zip(result.parameters, result.sizes, cycle(("-", "--", "-.", ":")), strict=False)
    curves = [
        Curve(each.name, each.unit, "", result[each.name, name] * size / 100.0, {"linestyle": style, "label": name})
        for name, size, style in looks
        for each in result.quantities
    ]
    return figure_of(result.t, curves, "effect of one per cent more of each parameter")
