"""The figure of the error against the step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, NullLocator

from crane_fmu.report.study import Errors
from crane_fmu.report.style import BLACK, BLUE, GREEN, VERMILLION, WIDTH, Array, styled

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
    _slope_one(axes, steps)
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


def _slope_one(axes: Axes, steps: Array) -> None:
    """Draw a line of slope one across the middle of the picture."""
    low, high = axes.get_ylim()
    middle = np.sqrt(low * high) * steps / np.sqrt(steps[0] * steps[-1])
    axes.loglog(steps, middle, color=BLACK, linestyle=":", linewidth=1.4, label="slope 1")
