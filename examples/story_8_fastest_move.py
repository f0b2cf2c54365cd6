"""
As fast as the drives allow
===========================

The crane has a slewing drive of 1000 N m, a trolley drive of 60 N and no more than 5 degrees of swing. What is the
shortest duration, and what does a smooth standard law take within the same limits?
"""

import matplotlib.pyplot as plt
import numpy as np

import servocore as sc

crane = sc.scenes.rotary_crane()
limits: dict[str, float | str] = {"M_b": 1000, "F": 60, "swing": "5 deg"}
start, end = (5.0, 0.0, -5.0), (-2.0, 2.0, -2.0)

# %%
# ``fastest`` returns a path, usable everywhere, and a report with its certificate.

path, report = sc.fastest(crane, [start, end], limits)
print(report)

# %%
# The law of degree 9 within the same limits; where a limit holds the fastest law back the ground is shaded:

limited = crane.with_limits(**limits)
shortest = sc.shortest_duration(limited.with_reference(sc.rest_to_rest(start, end, 20.0)))
standard = limited.with_reference(sc.rest_to_rest(start, end, shortest))

figure, axes = plt.subplots(3, 1, sharex=True, figsize=(7, 6), constrained_layout=True)
for scene, label in ((limited.with_reference(path), "fastest"), (standard, "degree 9")):
    solution = sc.solve(scene)
    for axis, name in zip(axes, ("M_b", "F", "swing"), strict=True):
        values = np.degrees(solution[name]) if name == "swing" else solution[name]
        axis.plot(solution.t, values, label=f"{label}: {solution.t[-1]:.2f} s")
for axis, (name, bound) in zip(axes, (("M_b (N m)", 1000), ("F (N)", 60), ("swing (deg)", 5)), strict=True):
    axis.set_ylabel(name)
    axis.axhline(bound, color="0.5", linestyle=":")
    if "swing" not in name:
        axis.axhline(-bound, color="0.5", linestyle=":")
for active in report.active:
    axes[("M_b", "F", "swing").index(active.quantity)].axvspan(active.begin, active.end, color="C3", alpha=0.2, lw=0)
axes[0].legend()
axes[-1].set_xlabel("time (s)")
