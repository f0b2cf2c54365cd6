"""
Closed loop: feedback against a model error
===========================================

The inverse model computes the inputs for a load of 100 kg, but the load weighs 105 kg. A winch that exerts a torque
for 100 kg does not hold it: the load sinks. Feedback of the measured load keeps it on its path. Path, inverse model
and crane are three FMUs, connected in one system.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from crane_fmu.build import SystemOptions, build_ssp
from crane_fmu.run import run_ssp

# %%
# ``build_ssp`` writes ``Crane.ssp``, a system that any co-simulation tool for SSP can run. FMPy runs it here, a
# second longer than the manoeuvre takes.

folder = Path(tempfile.mkdtemp())
build_ssp(folder, options=SystemOptions(targets="host"))

runs = {}
for name, feedback in (("feedforward alone", 0.0), ("with feedback", 1.0)):
    runs[name] = run_ssp(folder / "Crane.ssp", 21.0, 0.05, {"plant.load_mass": 105.0, "crane.feedback": feedback})

# %%
# The tracking error of the load:


def distance(run: dict[str, np.ndarray]) -> np.ndarray:
    """Return the distance in m of the load from its path, at the ends of all steps."""
    off = [run[f"plant.load.position[{k}]"] - run[f"trajectory.load.position[{k}]"] for k in (1, 2, 3)]
    away: np.ndarray = np.linalg.norm(off, axis=0)
    return away


figure, axis = plt.subplots(figsize=(7, 3.6), constrained_layout=True)
for name, run in runs.items():
    axis.semilogy(run["time"], 1e3 * np.maximum(distance(run), 1e-6), label=name)
    print(f"{name}: the load is at most {1e3 * distance(run).max():.1f} mm off its path")
axis.set(xlabel="time (s)", ylabel="distance from the path (mm)")
axis.legend()
