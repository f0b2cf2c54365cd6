"""
Time-optimal motion within actuator limits
==========================================

The limits are 1000 N m for slewing, 60 N for the trolley and 5 degrees of swing. The time-optimal trajectory along a
line is compared with a smooth standard time law within the same limits.
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
# The law of degree 9 within the same limits; shaded times: an active constraint of the time-optimal motion:

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
