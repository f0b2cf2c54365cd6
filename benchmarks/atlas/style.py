"""How the figures look: small, readable in print and in grey, each line with a dash and a mark of its own."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from benchmarks.atlas.record import Findings, Row
from benchmarks.route_styles import EXACT, FAILING

STYLE: Any = {
    "font.size": 8, "axes.titlesize": 8, "axes.titlelocation": "left", "axes.labelsize": 8, "legend.fontsize": 7,
    "legend.frameon": True, "legend.framealpha": 0.85, "legend.edgecolor": "none",
    "legend.borderpad": 0.2, "lines.linewidth": 1.4, "lines.markersize": 4.0, "axes.spines.top": False,
    "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.25, "grid.linewidth": 0.5,
    "savefig.dpi": 170, "svg.hashsalt": "servocore", "axes.formatter.use_mathtext": True,
}  # fmt: skip
BAD, GOOD, OTHER, FOURTH = FAILING, EXACT, "#009e73", "#7b4fa3"
"""Failing, surviving, in between: different in grey as well."""

_SHADES = (
    ("#000000", "-", "o"), ("#56a0d0", "--", "s"), ("#b08a00", "-.", "^"), ("#7b4fa3", ":", "D"),
    ("#777777", (0, (5, 1, 1, 1, 1, 1)), "v"),
)  # fmt: skip


def looks() -> Any:
    """Endless supply of (colour, dash, mark) for what is no route, different from one another in grey."""
    return cycle({"color": colour, "ls": dash, "marker": mark} for colour, dash, mark in _SHADES)


def drawn(row: Row, found: Findings) -> Figure:
    """Draw the figure of a row."""
    with plt.rc_context(STYLE):
        return row.draw(found)


def panels(columns: int, rows: int = 1, width: float = 6.6, height: float = 2.5, **more: Any) -> tuple[Figure, Any]:
    """Make a figure with panels side by side; returns it and an array of axes."""
    figure, axes = plt.subplots(rows, columns, figsize=(width, height * rows), layout="constrained", **more)
    return figure, axes


def label(axes: Axes, x: str, y: str, title: str, legend: str | None = None, **more: Any) -> None:
    """Label a panel; `legend` is its place, None for none."""
    axes.set(xlabel=x, ylabel=y)
    axes.set_title(title, fontsize=8)
    if legend:
        options: dict[str, Any] = {"loc": legend, "handlelength": 2.4, **more}
        axes.legend(**options)


def legend_below(figure: Figure, *panels_: Axes, columns: int = 3, **more: Any) -> None:
    """Put one legend for all panels below them, where it takes no room from a scale."""
    entries = {text: line for axes in panels_ for line, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=columns, handlelength=3.0, **more)


def steps_in_ms(axes: Axes, h: Any) -> None:
    """Mark a logarithmic axis of less than a decade by its own values, given in s."""
    axes.set_xticks(h, [f"{1e3 * each:.3g}" for each in h])
    axes.xaxis.set_minor_formatter(NullFormatter())


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write a figure as PNG and SVG, the same bytes for the same picture."""
    with plt.rc_context(STYLE):
        figure.savefig(folder / f"{name}.png", metadata={"Software": None})
        figure.savefig(folder / f"{name}.svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
