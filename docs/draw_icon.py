"""Draw the icons that tools show for the FMUs: ``python docs/draw_icon.py``."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("agg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

ROOT = Path(__file__).parents[1]
CRANE = ROOT / "crane_fmu" / "build" / "resources" / "model.png"
ANY_SCENE = ROOT / "servocore" / "export" / "c" / "icon.png"
DARK, BLUE, ORANGE = "#263238", "#1565c0", "#ef6c00"


def main() -> None:
    """Write the pictures into the packages."""
    crane()
    any_scene()


def crane() -> None:
    """Draw a slewing crane with its load."""
    figure, axes = canvas()
    axes.add_patch(Rectangle((1.2, 0.4), 0.7, 8.6, color=DARK))
    axes.add_patch(Rectangle((0.5, 0.2), 2.1, 0.5, color=DARK))
    axes.add_patch(Rectangle((0.4, 7.9), 9.1, 0.6, color=DARK))
    axes.add_patch(Rectangle((5.6, 7.3), 1.6, 0.6, color=BLUE))
    axes.plot([6.4, 7.4], [7.3, 3.4], color=DARK, linewidth=2.5)
    axes.add_patch(Circle((7.55, 2.7), 0.8, color=ORANGE))
    axes.annotate("", (9.3, 6.6), (7.3, 7.6), arrowprops={"arrowstyle": "-|>", "color": BLUE, "linewidth": 0})
    figure.savefig(CRANE, transparent=True, metadata={"Software": None})


def any_scene() -> None:
    """Draw a body that is pushed along a path."""
    figure, axes = canvas()
    x = np.linspace(0.8, 9.2, 100)
    axes.plot(x, 3.0 + 4.0 / (1.0 + np.exp(5.0 - x)), color=BLUE, linewidth=2.5, linestyle="--")
    axes.add_patch(Circle((4.6, 4.6), 1.1, color=ORANGE))
    axes.annotate("", (3.7, 4.0), (1.2, 1.6), arrowprops={"arrowstyle": "-|>", "color": DARK, "linewidth": 4})
    figure.savefig(ANY_SCENE, transparent=True, metadata={"Software": None})


def canvas() -> tuple[Figure, Axes]:
    """Return an empty square without axes."""
    figure = plt.figure(figsize=(2, 2), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 10), ylim=(0, 10), aspect="equal")
    axes.axis("off")
    return figure, axes


if __name__ == "__main__":
    main()
