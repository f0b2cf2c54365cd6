"""Draw docs/pictures/certificate.png: proved, refuted and undecided cases of certificates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import servocore as sc
from servocore.references.rest_to_rest import RestToRest

TARGET = Path(__file__).parent / "pictures" / "certificate.png"
STYLE: Any = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.25,
    "savefig.dpi": 160,
}  # fmt: skip
LIMITED, UNKNOWN, INPUT = "#c1440e", "#7f8c9b", "#1f4e79"
MASSES, LIMIT = (50.0, 150.0), 160.0  # kg, N m


def draw_proved(axes: Axes) -> None:
    """Draw the enclosure of the slewing torque for all loads of an interval, within its limit."""
    crane = sc.scenes.rotary_crane()
    certificate = sc.certify(crane, limits={"M_b": LIMIT}, parameters={"load_mass": MASSES})
    t = np.linspace(0.0, 20.0, 401)
    low, high = certificate.tube(t)["M_b"].T
    axes.fill_between(t, low, high, color=INPUT, alpha=0.5, lw=0)
    for side in (-LIMIT, LIMIT):
        axes.axhline(side, color=LIMITED, lw=1, ls="--")
    axes.set(xlabel="t (s)", ylabel="$M_b$ (N m)", ylim=(-230, 190))
    axes.text(0.5, -222, f"every load from {MASSES[0]:g} to {MASSES[1]:g} kg\nkeeps the limit", fontsize=8)
    axes.set_title(certificate.verdict, loc="left", fontsize=9, pad=3)


def draw_refuted(axes: Axes) -> None:
    """Draw a moment that is many times as large between two instants of a run as at the instants."""
    drone = sc.scenes.quadrotor_with_load()
    path = drone.reference
    assert isinstance(path, RestToRest)
    moved = drone.with_reference(sc.rest_to_rest(path.start, (5.91, 2.15), 1.71, profile=path.profile))
    certificate = sc.certify(moved)
    t = np.linspace(0.26, 0.32, 2001)
    instants = np.linspace(0.0, 1.71, 201)
    instants = instants[(instants > t[0]) & (instants < t[-1])]
    for times, style in ((t, {"lw": 1.5}), (instants, {"marker": "o", "ls": ""})):
        low, high = certificate.tube(times)["M"].T
        axes.plot(times, (low + high) / 2e3, color=INPUT, **style)
    axes.set(xlabel="t (s)", ylabel="$M$ (kN m)")
    axes.text(0.2985, 0.75, "dots: instants of\na run of 201 rows", fontsize=8)
    axes.set_title(f"{certificate.verdict}: a value between instants", loc="left", fontsize=9, pad=3)


def draw_undecided(axes: Axes) -> None:
    """Draw a load that is lowered faster than it falls: its motion is proved up to the slack rope."""
    scene = sc.scenes.overhead_crane().with_reference(sc.rest_to_rest((0, -1), (1, -4), 0.9))
    certificate = sc.certify(scene)
    first = next(each.time for each in certificate.statements if each.time is not None)
    t = np.linspace(0.0, first, 1001)[:-1]
    low, high = certificate.tube(t)["l"].T
    axes.plot(t, (low + high) / 2.0, color=INPUT, lw=1.5)
    axes.axvspan(first, 0.2, color=UNKNOWN, alpha=0.3, lw=0)
    text = f"not proved beyond\n{first:.4f} s: the rope\ngoes slack"
    axes.text(first + 0.004, 9.0, text, fontsize=8)
    axes.set(xlabel="t (s)", ylabel="rope length $l$ (m)", ylim=(0, 12), xlim=(0, 0.2))
    axes.set_title("undecided near a singular point", loc="left", fontsize=9, pad=3)


def main() -> None:
    """Draw the three side by side."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 3, figsize=(10.0, 3.0), layout="constrained")
        for draw, ax in zip((draw_proved, draw_refuted, draw_undecided), axes, strict=True):
            draw(ax)
        figure.savefig(TARGET, metadata={"Software": None})
        plt.close(figure)
    print(f"wrote {TARGET}")


if __name__ == "__main__":
    main()
