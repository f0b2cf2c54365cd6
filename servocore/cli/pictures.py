"""Figures: a plan within its limits beside a polynomial time law; effects of parameters; the page of a sweep."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from servocore.checks.motion_limits import limited_values
from servocore.files import figure_file
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


# The page of a sweep -------------------------------------------------------------------------------------------------

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Sweep of {title}</title>
<style>body {{ font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }}
img {{ max-width: 100%; }} table {{ border-collapse: collapse; }}
td, th {{ padding: 0.2rem 1rem 0.2rem 0; text-align: left; }}
td + td, th + th {{ text-align: right; }} .wide {{ overflow-x: auto; }}</style></head>
<body><h1>Sweep of {title}</h1>
<p>{cases} cases, {failed} not solved. Varied: {varied}.</p>
<img alt="{alt}" src="data:image/png;base64,{picture}">
<div class="wide"><table><tr><th>quantity</th><th>unit</th><th>minimum</th><th>median</th><th>maximum</th></tr>
{rows}</table></div>
{failures}<p>Open the numbers with <code>{opening}</code>.</p></body></html>
"""
_SENTENCES = 10


def sweep_page(swept: Any, title: str, store: str) -> tuple[str, bytes]:
    """Return a page about the dataset of a sweep, and its figure as PNG."""
    settings = json.loads(swept.attrs["settings"])  # in the order of the options, which coordinates lose
    first = f"peak_{settings['quantities'][0]}"
    figure = Figure(figsize=(7.0, 4.4), layout="constrained", dpi=130)
    axes = figure.subplots()
    _draw(axes, swept, list(settings["varied"]), first)
    axes.set_title("")
    picture = figure_file(figure, ".png")
    return _page(swept, settings["varied"], title, first, picture, store), picture


def _draw(axes: Axes, swept: Any, varied: Sequence[str], name: str) -> None:
    """Draw a peak over one or two varied parameters; over further dimensions its maximum."""
    x, y = (*varied, name)[:2]
    if "case" in swept.sizes:
        swept.plot.scatter(x=x, y=y, ax=axes, s=5, edgecolors="none", **({} if y == name else {"hue": name}))
        return
    wide = [each for each in varied[:2] if swept.sizes[each] > 1] or varied[:1]
    shown = swept[name].max([each for each in swept[name].dims if each not in wide], keep_attrs=True)
    if shown.ndim < 2:
        shown.plot.line(ax=axes)
        return
    shown.plot.pcolormesh(x=x, y=y, ax=axes, cmap="viridis")
    if min(shown.shape) > 2 and shown.max() > shown.min():
        lines = shown.plot.contour(x=x, y=y, ax=axes, colors="white", linewidths=0.8)
        axes.clabel(lines, fontsize="small")


def _page(swept: Any, varied: Mapping[str, Any], title: str, first: str, picture: bytes, store: str) -> str:
    failures = swept.failure.to_numpy().ravel()
    reasons = list(dict.fromkeys(str(failure) for failure in failures[failures != ""]))
    rows = []
    # A store has no order.
    for name in sorted(swept, key=lambda name: (name.startswith("margin_") - name.startswith("peak_"), name)):
        if name == "failure" or "instant" in swept[name].dims:
            continue
        values = swept[name].to_numpy()
        finite = values[np.isfinite(values)]
        shown = [f"{value:.4g}" for value in np.quantile(finite, (0.0, 0.5, 1.0))] if finite.size else ["–"] * 3
        cells = "".join(f"<td>{html.escape(str(cell))}</td>" for cell in (name, swept[name].attrs["units"], *shown))
        rows.append(f"<tr>{cells}</tr>\n")
    sentences = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in reasons[:_SENTENCES])
    more = f"<p>Reasons why cases are not solved, among others:</p><ul>{sentences}</ul>\n" if reasons else ""
    ranges = [f"{name} from {min(row):g} to {max(row):g} ({len(row)})" for name, (_, row) in varied.items()]
    opening = f'{"pandas.read_parquet" if store.endswith(".parquet") else "xarray.open_zarr"}("{store}")'
    return _PAGE.format(
        title=html.escape(title), cases=failures.size, failed=int((failures != "").sum()),
        varied=html.escape(", ".join(ranges)), alt=f"{first} over the varied parameters", rows="".join(rows),
        picture=base64.b64encode(picture).decode(), failures=more, opening=html.escape(opening, quote=False),
    )  # fmt: skip
