"""Draw the icon that tools show for the FMUs: ``python docs/draw_icon.py``."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("agg")

from matplotlib import pyplot as plt
from matplotlib.patches import Circle, Rectangle

TARGET = Path(__file__).parents[1] / "crane_fmu" / "build" / "resources" / "model.png"


def main() -> None:
    """Write the picture into the package."""
    figure = plt.figure(figsize=(2, 2), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 10), ylim=(0, 10), aspect="equal")
    axes.axis("off")
    dark, blue, orange = "#263238", "#1565c0", "#ef6c00"
    axes.add_patch(Rectangle((1.2, 0.4), 0.7, 8.6, color=dark))
    axes.add_patch(Rectangle((0.5, 0.2), 2.1, 0.5, color=dark))
    axes.add_patch(Rectangle((0.4, 7.9), 9.1, 0.6, color=dark))
    axes.add_patch(Rectangle((5.6, 7.3), 1.6, 0.6, color=blue))
    axes.plot([6.4, 7.4], [7.3, 3.4], color=dark, linewidth=2.5)
    axes.add_patch(Circle((7.55, 2.7), 0.8, color=orange))
    axes.annotate("", (9.3, 6.6), (7.3, 7.6), arrowprops={"arrowstyle": "-|>", "color": blue, "linewidth": 0})
    figure.savefig(TARGET, transparent=True, metadata={"Software": None})


if __name__ == "__main__":
    main()
