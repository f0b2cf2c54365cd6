"""
First feedforward
=================

Feedforward inputs of the rotary crane (slewing torque, trolley force, winch torque) for a load of 100 kg that moves
from (5, 0, -5) m to (-2, 2, -2) m in 20 s, from rest to rest.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import servocore as sc

# %%
# A scene has the crane's equations, its parameters and a path. The default scene is the manoeuvre above;
# ``analyse`` classifies the problem: the crane is flat.

crane = sc.scenes.rotary_crane()
report = sc.analyse(crane)
print(report)

# %%
# ``solve`` takes the route that the analysis recommends. Here it is exact inversion: the inputs follow from the path
# and its derivatives at every instant, without any integration.

solution = sc.solve(crane, step=0.05)
exact = crane.exact(solution.t)

figure, axes = plt.subplots(3, 1, sharex=True, figsize=(7, 6), constrained_layout=True)
for axis, name in zip(axes, ("M_b", "F", "M_w"), strict=True):
    axis.plot(solution.t, solution[name])
    axis.set_ylabel(f"{name} ({solution.unit(name)})")
axes[-1].set_xlabel("time (s)")

# %%
# The inputs agree with the crane's closed form to rounding:

for name in ("M_b", "F", "M_w"):
    largest = np.abs(exact[name]).max()
    error = np.abs(solution[name] - exact[name]).max() / largest
    print(f"{name}: largest {largest:.4g} {solution.unit(name)}, error {error:.1e} of that")

# %%
# The scheme of the paper integrates the projected equations by backward Euler. The error of its inputs is proportional
# to the step. ``solve`` warns of it; here the errors are printed instead.

warnings.simplefilter("ignore", sc.ServocoreWarning)
for step in (0.1, 0.05, 0.025):
    paper = sc.solve(crane, sc.Projected(), sc.BackwardEuler(), step=step)
    exact = crane.exact(paper.t)
    off = np.abs(paper["M_b"] - exact["M_b"]).max() / np.abs(exact["M_b"]).max()
    print(f"step {step:5.3f} s: M_b is off by {100 * off:.2g} % of its peak")
