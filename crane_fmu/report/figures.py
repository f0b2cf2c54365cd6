"""Figures of the report: motion and inputs over time, errors over the step, the crane in space.

Fonts and line styles remain distinct in grey. No global setting is changed, and no window system is needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, NullLocator

import servocore as sc
from crane_fmu.report.study import Errors, LoadRun
from servocore.files import figure_file

BLUE, VERMILLION, GREEN, BLACK, GREY = "#0072B2", "#D55E00", "#009E73", "#000000", "#a6a6a6"
"""Colours that remain distinct with colour blindness (Okabe and Ito): exact inversion blue, the paper's vermillion."""

PURPLE = "#7b4fa3"

FAINT = "#5c5c5c"
"""Of remarks."""

WIDTH = 6.7
"""Width of a figure in inches: the text width of an A4 page."""

_REMARK = 100
"""Most characters of a line below a figure."""

_RC: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.5,
    "mathtext.fontset": "dejavusans",
    "savefig.dpi": 200,
    "svg.hashsalt": "crane-fmu",
}

LABELS = {
    "M_b": "slewing torque $M_b$ (N m)",
    "F": "trolley force $F$ (N)",
    "M_w": "winch torque $M_w$ (N m)",
}
"""Axis labels of the inputs."""

styled = mpl.rc_context(_RC)
"""Decorates functions that make or save figures in this style."""


def panels(labels: Sequence[str], height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure of labelled panels above each other that share their time axis.

    Parameters
    ----------
    labels : sequence of str
        Quantity of each panel, with its unit.
    height : float
        Height of a panel in inches.
    """
    figure = Figure(figsize=(WIDTH, height * len(labels) + 0.35), layout="constrained")
    axes: list[Axes] = list(figure.subplots(len(labels), sharex=True, squeeze=False)[:, 0])
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
    axes[-1].set_xlabel("time (s)")
    figure.align_ylabels()
    return figure, axes


@styled
def picture(figure: Figure, suffix: str, by: str) -> bytes:
    """Return the figure as the content of a file, the same every time.

    Parameters
    ----------
    figure : Figure
        The drawing.
    suffix : str
        .png, .svg or .pdf.
    by : str
        Form and method of the results, written at the edge: pictures are used without their captions.
    """
    edge = figure.suptitle if figure.get_layout_engine() is None else figure.supxlabel
    edge(fill(by, _REMARK), x=0.99, horizontalalignment="right", fontsize=8.0, color=FAINT)
    return figure_file(figure, suffix)


Look = Mapping[str, Any]
"""Arguments of `Axes.plot`; curves on top of each other differ in more than colour."""

REDUNDANT: Look = {
    "color": VERMILLION,
    "linestyle": "none",
    "marker": "o",
    "markersize": 5.0,
    "markerfacecolor": "none",
    "markeredgewidth": 1.1,
}
PAPER_LINE: Look = {"color": VERMILLION, "linestyle": "--", "linewidth": 1.6}
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

LEAST_ERROR = 1e-3
"""In mm; a smaller distance is a numerical residual, and is drawn as this one."""


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


@styled
def inputs_compared(redundant: sc.Solution, generalized: sc.Solution, default: sc.Solution) -> Figure:
    """Return the inputs of both sets of coordinates on top of each other, by one scheme, with those by the default."""
    curves = (
        ("default: exact inversion", default, DEFAULT_LINE),
        ("generalized coordinates (GEN)", generalized, PAPER_LINE),
        ("redundant coordinates (RED)", redundant, REDUNDANT),
    )
    figure, axes = panels(list(LABELS.values()), height=2.1)
    for axis, name in zip(axes, LABELS, strict=True):
        for label, run, look in curves:
            axis.plot(run.t, run[name], label=label, markevery=max(1, len(run.t) // 25), **look)
        axis.margins(x=0.01)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(curves))
    return figure


@styled
def strayed(runs: Sequence[LoadRun], shown: Sequence[LoadRun], looks: Sequence[Look] = SIMULATED) -> Figure:
    """Return the prescribed and the simulated position of the load in some runs, and the tracking error of all runs.

    Parameters
    ----------
    runs : sequence of LoadRun
        At most as many as there are looks, on one path.
    shown : sequence of LoadRun
        Those of them whose positions are drawn.
    looks : sequence of Look
        The look of each run.
    """
    figure, (above, below) = panels(["position of the load (m)", "distance from the path (mm)"], height=2.5)
    for gust in (run.gust for run in shown if run.gust is not None):
        above.axvspan(*gust, color=GREY, alpha=0.3, linewidth=0.0)
        below.axvspan(*gust, color=GREY, alpha=0.3, linewidth=0.0, label="gust")
    t = runs[0].t
    for name, values in zip("xyz", runs[0].prescribed.T, strict=True):
        above.plot(t, values, color=GREY, linewidth=4.0, label="path" if name == "x" else None)
        above.annotate(f"${name}$", (t[0], values[0]), (-6, 0), textcoords="offset points", va="center", ha="right")
    for run, look in zip(runs, looks, strict=False):
        if run in shown:
            above.plot(run.t, run.driven, **look)
        below.semilogy(run.t, np.maximum(1e3 * run.error, LEAST_ERROR), label=run.label, **look)
    below.margins(x=0.03)
    figure.legend(loc="outside upper center", ncols=2)
    return figure


_INPUTS: dict[str, dict[str, Any]] = {
    "M_b": {"color": BLUE},
    "F": {"color": VERMILLION, "linestyle": "--"},
    "M_w": {"color": GREEN, "linestyle": "-."},
}
_MODELS: dict[str, dict[str, Any]] = {
    "points": {"marker": "o", "markersize": 9.0, "markerfacecolor": "none"},
    "generalized": {"marker": "^", "markersize": 6.0, "markerfacecolor": "none"},
    "bodies": {"marker": "x", "markersize": 5.5, "markerfacecolor": "none"},
}


@styled
def error_against_step(errors: Mapping[tuple[str, float], Errors]) -> Figure:
    """Return the errors of the inputs over the step, both logarithmic, with a line of slope one.

    Parameters
    ----------
    errors : mapping of (model, step) to Errors
        Every model with every step.
    """
    models = dict.fromkeys(model for model, _ in errors)
    steps = np.array(sorted({step for _, step in errors}))
    figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
    axes = figure.add_subplot()
    for model in models:
        for name, look in _INPUTS.items():
            values = [errors[model, step][name] for step in steps]
            axes.loglog(steps, values, linewidth=1.1, label=f"{model}, {name}", **look, **_MODELS[model])
    low, high = axes.get_ylim()
    middle = np.sqrt(low * high) * steps / np.sqrt(steps[0] * steps[-1])  # of the picture
    axes.loglog(steps, middle, color=BLACK, linestyle=":", linewidth=1.4, label="slope 1")
    axes.set_xlabel("step (s)")
    axes.set_ylabel("largest error of an input / its largest value")
    axes.set_xticks(steps, [f"{step:g}" for step in steps])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    handles = [
        *(Line2D([], [], label=f"${name}$", **look) for name, look in _INPUTS.items()),
        *(Line2D([], [], color=BLACK, linestyle="none", label=model, **_MODELS[model]) for model in models),
        Line2D([], [], color=BLACK, linestyle=":", label="slope 1"),
    ]
    figure.legend(handles=handles, loc="outside right center")
    return figure


_TURNED = np.radians(40.0)
"""Turn of the bridge in the labelled drawing, in rad."""


@styled
def posture(run: sc.Solution, index: int) -> Figure:
    """Return the crane at one instant of a run."""
    return run.draw(float(run.t[index]))


@styled
def sketch(run: sc.Solution) -> Figure:
    """Return the crane on its manoeuvre, with phi, s and l labelled."""
    # At an instant with the bridge turned, well before the load comes near the slewing axis.
    shown = int(np.searchsorted(np.abs(run["phi"] - run["phi"][0]), _TURNED))
    index = min(shown, len(run.t) // 2)
    figure, phi, s, radius = posture(run, index), run["phi"][index], run["s"][index], 0.9 * float(run["s"].max())
    axes: Any = figure.axes[0]  # in space
    load = np.array([run[name][index] for name in "xyz"])
    along = np.array([np.cos(phi), np.sin(phi), 0.0])
    arc = np.linspace(0.0, phi, 40)
    axes.plot([0, 1.2 * radius], [0, 0], [0, 0], color=BLACK, linewidth=0.9, linestyle=":")
    axes.plot(radius * np.cos(arc), radius * np.sin(arc), 0 * arc, color=BLACK, linewidth=0.9)
    middle = 1.1 * radius * np.array([np.cos(phi / 2), np.sin(phi / 2), 0.0])
    for place, text, aside in (
        (middle, "$\\varphi$", {"ha": "left", "va": "center"}),
        (0.5 * s * along + [0, 0, 0.15], "$s$", {"ha": "center", "va": "bottom"}),
        ((s * along + load) / 2 + [0.2, 0, 0], "$l$", {"ha": "left", "va": "center"}),
    ):
        axes.text(*place, text, fontsize=12, **aside)
    return figure
