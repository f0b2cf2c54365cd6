"""Style of the figures: fonts, line styles that remain distinct in grey, and files as bytes.

Figures are plain `matplotlib.figure.Figure` objects: nothing global is changed, no window system is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from textwrap import fill
from typing import Any, Protocol

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

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
    "phi": "bridge angle $\\varphi$ (°)",
    "s": "trolley position $s$ (m)",
    "l": "rope length $l$ (m)",
}
"""Axis labels with the unit that is drawn; angles in degrees."""


class Trajectories(Protocol):
    """Arrays over time by name: a `Solution`, or a closed form."""

    def __getitem__(self, name: str, /) -> Array:
        """Return one trajectory."""


styled = mpl.rc_context(_RC)
"""Decorates functions that make or save figures in this style."""


def panels(labels: Sequence[str], height: float = 1.75) -> tuple[Figure, list[Axes]]:
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
    stream = BytesIO()
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix)
    figure.savefig(stream, format=suffix[1:], metadata=metadata)
    return stream.getvalue()
