"""Figures in space: the crane in a posture, with the path of its load."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

import servocore as sc
from crane_fmu.report.style import BLACK, BLUE, GREEN, GREY, VERMILLION, WIDTH, Array, Trajectories, styled

Axes3D = Any
"""Axes in space: matplotlib has no type for them that a checker could read."""

_OVERHANG = 1.15
"""The girder is drawn this much longer than the trolley travels: its length is no datum of the crane."""


_TURNED = np.radians(40.0)
"""How far the bridge has turned where the crane is explained."""


@styled
def posture(run: Trajectories, index: int, labelled: bool = False) -> Figure:
    """Return the crane at one instant of a run.

    Parameters
    ----------
    run : Trajectories
        With phi, s, x, y, z.
    index : int
        Which instant; negative ones count from the end.
    labelled : bool
        Whether phi, s and l are written beside what they measure.
    """
    figure = Figure(figsize=(WIDTH, 4.5))
    axes = figure.add_axes((0.02, 0.09, 0.92, 1.0), projection="3d")
    path = np.column_stack([run[name] for name in "xyz"])
    reach = _OVERHANG * float(run["s"].max())
    ground = float(np.floor(path[:, 2].min() - 0.5))
    _draw_path(axes, path, ground)
    _draw_crane(axes, path[index], run["phi"][index], run["s"][index], reach, ground)
    if labelled:
        _write_names(axes, path[index], run["phi"][index], run["s"][index], reach)
    tips = reach * np.column_stack([np.cos(run["phi"]), np.sin(run["phi"]), 0.0 * run["phi"]])
    _frame(axes, np.vstack([path, tips, [[-0.5, -0.5, ground], [0.5, 0.5, 0.9]]]))
    figure.legend(*axes.get_legend_handles_labels(), loc="lower center", ncols=4)
    return figure


def sketch(scene: sc.Scene) -> Figure:
    """Return the crane on its manoeuvre, with phi, s and l written beside what they measure."""
    path = scene.reference
    t = np.linspace(path.start_time, path.end_time, 101)
    run = scene.exact(t)
    # Far enough on that the bridge has turned, and long before the load comes near the slewing axis.
    shown = int(np.searchsorted(np.abs(run["phi"] - run["phi"][0]), _TURNED))
    return posture(run, min(shown, len(t) // 2), labelled=True)


def _draw_path(axes: Axes3D, path: Array, ground: float) -> None:
    x, y, z = path.T
    axes.plot(x, y, z, color=VERMILLION, linestyle="--", linewidth=1.4, label="path of the load")
    axes.plot(x, y, np.full_like(z, ground), color=GREY, linestyle=":", linewidth=1.0)
    for k, name in ((0, "start"), (-1, "end")):
        axes.plot(x[[k]], y[[k]], z[[k]], marker="+", markersize=8, color=VERMILLION, linestyle="none")
        axes.text(x[k], y[k], z[k] - 0.35, name, color=BLACK, ha="center", va="top", fontsize=8.5)


def _draw_crane(axes: Axes3D, load: Array, phi: float, s: float, reach: float, ground: float) -> None:
    along = np.array([np.cos(phi), np.sin(phi), 0.0])
    tip, trolley = reach * along, s * along
    axes.plot([0, 0], [0, 0], [ground, 0.6], color=GREY, linewidth=2.0, linestyle="-.", label="slewing axis")
    axes.plot(*zip(0 * tip, tip, strict=True), color=BLACK, linewidth=4.0, solid_capstyle="butt", label="bridge")
    axes.plot(*zip(trolley, load, strict=True), color=BLACK, linewidth=1.0, label="rope")
    part = {"linestyle": "none", "markeredgecolor": BLACK}
    axes.plot(*trolley[:, None], marker="s", markersize=9, color=GREEN, label="trolley and winch", zorder=10, **part)
    axes.plot(*load[:, None], marker="o", markersize=10, color=BLUE, label="load", zorder=11, **part)
    axes.plot([load[0]] * 2, [load[1]] * 2, [load[2], ground], color=GREY, linewidth=0.8, linestyle=":")


def _write_names(axes: Axes3D, load: Array, phi: float, s: float, reach: float) -> None:
    along = np.array([np.cos(phi), np.sin(phi), 0.0])
    arc = np.linspace(0.0, phi, 40)
    radius = 0.8 * reach
    axes.plot([0, reach], [0, 0], [0, 0], color=BLACK, linewidth=0.9, linestyle=":")
    axes.plot(radius * np.cos(arc), radius * np.sin(arc), 0 * arc, color=BLACK, linewidth=0.9)
    middle = 1.1 * radius * np.array([np.cos(phi / 2), np.sin(phi / 2), 0.0])
    for place, text, aside in (
        (middle, "$\\varphi$", {"ha": "left", "va": "center"}),
        (0.5 * s * along + [0, 0, 0.15], "$s$", {"ha": "center", "va": "bottom"}),
        ((s * along + load) / 2 + [0.2, 0, 0], "$l$", {"ha": "left", "va": "center"}),
    ):
        axes.text(*place, text, fontsize=12, **aside)


def _frame(axes: Axes3D, everything: Array) -> None:
    """Equal scales on all axes, and limits that hold girder and path."""
    limits = np.column_stack([np.floor(everything.min(axis=0)), np.ceil(everything.max(axis=0))])
    for name, (low, high) in zip("xyz", limits, strict=True):
        axes.set(**{f"{name}lim": (low, high), f"{name}label": f"${name}$ (m)"})
        getattr(axes, f"{name}axis").set_major_locator(MultipleLocator(2.0))
    axes.set_box_aspect(np.diff(limits).ravel(), zoom=1.04)
    axes.view_init(elev=24, azim=-62)
