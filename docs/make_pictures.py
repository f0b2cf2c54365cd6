"""Draw docs/pictures/rotary_crane.png: the crane's default manoeuvre, seen from above and over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import servocore as sc

TARGET = Path(__file__).parent / "pictures" / "rotary_crane.png"
STYLE: Any = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.25,
    "savefig.dpi": 160, "svg.hashsalt": "servocore",
}  # fmt: skip
LOAD, BRIDGE, INPUT = "#c1440e", "#7f8c9b", "#1f4e79"
POSTURES = (0.0, 8.0, 10.0, 12.0, 20.0)
"""Times in s at which the bridge is drawn, far enough from one another to be told apart."""


def draw_from_above(axes: Axes, solution: sc.Solution) -> None:
    """Path of the load with the bridge and the trolley at a few times."""
    x, y, phi, s = (solution[name] for name in ("x", "y", "phi", "s"))
    tip = 1.08 * s.max()
    for k in np.searchsorted(solution.t, POSTURES):
        axes.plot([0, tip * np.cos(phi[k])], [0, tip * np.sin(phi[k])], color=BRIDGE, lw=3, alpha=0.35, zorder=1)
        axes.plot(s[k] * np.cos(phi[k]), s[k] * np.sin(phi[k]), "s", color=BRIDGE, ms=7, zorder=2)
        axes.annotate(
            f"{solution.t[k]:.0f} s", (tip * np.cos(phi[k]), tip * np.sin(phi[k])),
            textcoords="offset points", xytext=(4, 3), color=BRIDGE,
        )  # fmt: skip
    axes.plot(x, y, color=LOAD, lw=2, zorder=3, label="load")
    axes.plot(0, 0, "o", color="black", ms=5, zorder=3)
    axes.annotate("slewing axis", (0, 0), textcoords="offset points", xytext=(5, -12))
    for k, offset in ((0, (-20, -16)), (-1, (-52, -4))):
        text = f"z = {solution['z'][k]:.0f} m".replace("-", "\N{MINUS SIGN}")
        axes.annotate(text, (x[k], y[k]), textcoords="offset points", xytext=offset, color=LOAD)
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", ylim=(-1.2, 6))
    axes.set_title("path of the load, bridge and trolley from above", loc="left", fontsize=9, pad=3)
    axes.grid(visible=False)


def draw_inputs(axes: list[Axes], solution: sc.Solution) -> None:
    """Draw the inputs over time."""
    titles = {"M_b": "slewing torque", "F": "trolley force", "M_w": "winch torque"}
    for ax, (name, title) in zip(axes, titles.items(), strict=True):
        ax.plot(solution.t, solution[name], color=INPUT, lw=1.6)
        unit = solution.unit(name).replace("N.m", "N m")
        symbol = name[0] + (f"_{{{name[2:]}}}" if "_" in name else "")
        ax.set_ylabel(f"${symbol}$ ({unit})")
        ax.set_title(title, loc="left", fontsize=9, pad=3)
        ax.set(xlim=(solution.t[0], solution.t[-1]), xticks=np.linspace(solution.t[0], solution.t[-1], 5))
    axes[-1].set_xlabel("t (s)")


def main() -> None:
    """Solve the default manoeuvre and draw it."""
    solution = sc.solve(sc.scenes.rotary_crane(), step=0.01)
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(9.2, 4.0), layout="constrained")
        grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1))
        draw_from_above(figure.add_subplot(grid[:, 0]), solution)
        first = figure.add_subplot(grid[0, 1])
        others = [figure.add_subplot(grid[k, 1], sharex=first) for k in (1, 2)]
        for ax in (first, others[0]):
            ax.tick_params(labelbottom=False)
        draw_inputs([first, *others], solution)
        figure.align_ylabels([first, *others])
        TARGET.parent.mkdir(exist_ok=True)
        figure.savefig(TARGET, metadata={"Software": None})
        plt.close(figure)
    print(f"wrote {TARGET}")


if __name__ == "__main__":
    main()
