"""Stray of a load on a heavy rope under the inputs of the rope itself, and under those of massless ropes; the figure.

.venv/bin/python -m benchmarks.heavy_rope        (two minutes)
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.interpolate import CubicSpline

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.references.profiles import polynomial
from servocore.scenes.heavy_rope import HeavyRope, heavy_rope
from servocore.scenes.rope_marching import RopeMotion, march_rope

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "pictures" / "heavy-rope.png"
VALUES = heavy_rope().parameter_values()
PATH = sc.rest_to_rest((0.0, -8.0), (5.0, -7.0), 6.0, polynomial(17))


def simulated(elements: int, motion: RopeMotion, step: float) -> sc.Solution:
    """Return the motion of a plant of so many elements under the inputs of a march."""
    t: Array = np.linspace(-0.4, 7.0, round(7.4 / step) + 1)
    start = HeavyRope(elements, 2).at_rest(VALUES, (0.0, -8.0))
    plant = heavy_rope(elements).with_reference(PATH)
    inputs = CubicSpline(motion.t, motion.inputs)

    def held(time: float) -> Array:
        return np.asarray(inputs(np.clip(time, motion.t[0], motion.t[-1])))

    return sc.simulate(plant, held, t=t, start=start, method=sc.EnergyMomentum(), step=step)


def main() -> None:
    """Print the strays, and draw the figure."""
    exact = march_rope(PATH, VALUES, 0.01)
    for elements in (8, 16, 32, 64):
        largest = simulated(elements, exact, 0.0025)["tracking_error"].max()
        print(f"{elements} elements: largest stray {1e3 * largest:.4f} mm")
    half = VALUES["rope_mass"] * VALUES["rope_length"] / 2
    shared = {"rope_mass": 0.0, "load_mass": VALUES["load_mass"] + half, "trolley_mass": VALUES["trolley_mass"] + half}
    weight = 2 * half * VALUES["gravity"] * np.array([0.0, 1.0])
    light = march_rope(PATH, VALUES | {"rope_mass": 0.0}, 0.01)
    supported = RopeMotion(light.t, light.X, light.position, light.force, light.inputs + weight, 0.0)
    runs = {
        "the rope itself, marched": exact,
        "massless rope, half of its mass at either end": march_rope(PATH, VALUES | shared, 0.01),
        "massless rope, its weight held": supported,
    }
    figure, axis = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
    for name, motion in runs.items():
        found = simulated(64, motion, 0.0025)
        print(f"{name}: largest stray on 64 elements {1e3 * found['tracking_error'].max():.3g} mm")
        axis.semilogy(found.t, np.maximum(1e3 * found["tracking_error"], 1e-5), label=name, lw=1.2)
    axis.set(xlabel="time in s", ylabel="distance of the load from its path in mm", ylim=(1e-4, 1e3))
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=2, fontsize=8, frameon=False)
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
