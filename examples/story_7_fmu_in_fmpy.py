"""
The inverse model as an FMU
===========================

A scene without unstable internal dynamics becomes a co-simulation FMU without Python: its inputs are the path and its
derivatives, its outputs the inputs of the drives. Here FMPy runs it.
"""

import tempfile
from pathlib import Path

import fmpy
import matplotlib.pyplot as plt
import numpy as np

import servocore as sc
from crane_fmu.run import input_rows

# %%
# ``export_fmu`` writes C source and compiles it for this machine, or for six platforms at once (``targets="all"``).

crane = sc.scenes.rotary_crane()
file = sc.export_fmu(crane, Path(tempfile.mkdtemp()) / "crane.fmu", fmi=2, targets="host")
print(f"{file.name}: {file.stat().st_size / 1000:.0f} kB")

# %%
# Path and derivatives go in as a table, at the communication points. The FMU extrapolates the path by its derivatives
# from the start of a step to its end, so that its error decreases with the step.

step = 0.01
rows = input_rows(crane.reference, step)
result = fmpy.simulate_fmu(str(file), stop_time=20.0, output_interval=step, input=rows)

# %%
# The outputs are those of the library:

solution = sc.solve(crane, step=step)
figure, axis = plt.subplots(figsize=(7, 3.6), constrained_layout=True)
axis.plot(solution.t, solution["M_b"], label="servocore")
axis.plot(result["time"], result["M_b"], "--", label="FMU in FMPy")
axis.set(xlabel="time (s)", ylabel="M_b (N m)")
axis.legend()
for name in ("M_b", "F", "M_w"):
    print(f"{name} differs by {np.abs(result[name] - solution[name]).max():.1e} {solution.unit(name)}")
