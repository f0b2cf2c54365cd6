"""The figure of the error against the step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, NullLocator

from crane_fmu.report.study import INPUTS, ErrorRow
from crane_fmu.report.style import BLACK, BLUE, GREEN, VERMILLION, WIDTH, Array, styled

_INPUT_LINES: dict[str, tuple[str, Any]] = {"M_b": (BLUE, "-"), "F": (VERMILLION, "--"), "M_w": (GREEN, "-.")}
_MODEL_MARKS = {"points": ("o", 9.0), "generalized": ("^", 6.0), "bodies": ("x", 5.5)}


def error_against_step(rows: Sequence[ErrorRow]) -> Figure:
    """Return the errors of the inputs over the step, both logarithmic, with a line of slope one.

    Parameters
    ----------
    rows : sequence of ErrorRow
        Models and steps in any order.
    """
    models = list(dict.fromkeys(row.model for row in rows))
    with styled():
        figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
        axes = figure.add_subplot()
        for model in models:
            mine = sorted((row for row in rows if row.model == model), key=lambda row: row.step)
            steps = np.array([row.step for row in mine])
            mark, size = _MODEL_MARKS[model]
            for name in INPUTS:
                color, style = _INPUT_LINES[name]
                axes.loglog(
                    steps, [row.inputs[name] for row in mine], color=color, linestyle=style, linewidth=1.1,
                    marker=mark, markersize=size, markerfacecolor="none", label=f"{model}, {name}",
                )  # fmt: skip
        _slope_one(axes, steps)
        axes.set_xlabel("step (s)")
        axes.set_ylabel("largest error of an input / its largest value")
        axes.set_xticks(steps, [f"{step:g}" for step in steps])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_minor_formatter(NullFormatter())
        figure.legend(handles=_legend(models), loc="outside right center")
    return figure


def _slope_one(axes: Axes, steps: Array) -> None:
    """Draw a line of slope one across the middle of the picture."""
    low, high = axes.get_ylim()
    middle = np.sqrt(low * high) * steps / np.sqrt(steps[0] * steps[-1])
    axes.loglog(steps, middle, color=BLACK, linestyle=":", linewidth=1.4, label="slope 1")


def _legend(models: Sequence[str]) -> list[Line2D]:
    inputs = [
        Line2D([], [], color=color, linestyle=style, label=f"${name}$") for name, (color, style) in _INPUT_LINES.items()
    ]
    marks = [
        Line2D([], [], color=BLACK, linestyle="none", marker=_MODEL_MARKS[model][0], markerfacecolor="none",
               markersize=_MODEL_MARKS[model][1], label=model)
        for model in models
    ]  # fmt: skip
    return [*inputs, *marks, Line2D([], [], color=BLACK, linestyle=":", label="slope 1")]
