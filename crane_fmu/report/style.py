"""How figures look: fonts, line styles that survive a grey print, and how they become bytes.

Figures are plain `matplotlib.figure.Figure` objects: nothing global is changed, no window system is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any, Protocol

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

BLUE, VERMILLION, GREEN, BLACK, GREY = "#0072B2", "#D55E00", "#009E73", "#000000", "#a6a6a6"
"""Colours that colour-blind readers tell apart (Okabe and Ito)."""

WIDTH = 6.7
"""Width of a figure in inches: the text width of an A4 page."""

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
    "phi": "bridge angle $\\varphi$ (°)",
    "s": "trolley position $s$ (m)",
    "l": "rope length $l$ (m)",
}
"""Axis labels with the unit that is drawn; angles in degrees."""

TIME = "time (s)"


class Trajectories(Protocol):
    """Arrays over time by name: a `Solution`, or a closed form."""

    def __getitem__(self, name: str, /) -> Array:
        """Return one trajectory."""


@dataclass(frozen=True)
class Line:
    """How a curve is drawn; curves on top of each other differ in more than colour."""

    color: str
    style: str = "-"
    width: float = 1.5
    marker: str = ""

    def options(self, points: int = 0) -> dict[str, Any]:
        """Return keyword arguments for `Axes.plot`; marks are spread over a curve of `points` points."""
        chosen: dict[str, Any] = {"color": self.color, "linestyle": self.style, "linewidth": self.width}
        if self.marker:
            every = max(1, points // 25)
            chosen |= {
                "marker": self.marker,
                "markevery": every,
                "markersize": 5.0,
                "markerfacecolor": "none",
                "markeredgewidth": 1.1,
            }
        return chosen


def styled() -> Any:
    """Return a context in which figures are made and saved in this style."""
    return mpl.rc_context(_RC)


def panels(rows: int, columns: int = 1, height: float = 1.75, width: float = WIDTH) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels above each other that share their time axis, row by row.

    Parameters
    ----------
    rows, columns : int
        Number of panels.
    height : float
        Height of a panel in inches.
    width : float
        Width of the figure in inches.
    """
    figure = Figure(figsize=(width, height * rows + 0.35), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
    return figure, list(axes.ravel())


def picture(figure: Figure, suffix: str) -> bytes:
    """Return the figure as the content of a file, the same every time; suffix is .png, .svg or .pdf."""
    stream = BytesIO()
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix)
    with styled():
        figure.savefig(stream, format=suffix[1:], metadata=metadata)
    return stream.getvalue()
