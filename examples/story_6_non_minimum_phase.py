"""
Stable inversion: an arm that moves before its path does
========================================================

An arm with a passive, elastic second joint: when its tip is to follow a path, the internal dynamics are unstable
(non-minimum phase), and every integration forward in time diverges. The bounded solution starts to move before
the path.
"""

import matplotlib.pyplot as plt
import numpy as np

import servocore as sc

# %%
# Stability depends on the tracked point. Within the centre of percussion the zero dynamics are stable:

for distance in (0.4, 1.0):
    arm = sc.scenes.passive_joint_arm().with_parameters(tracked_distance=distance)
    report = sc.analyse(arm)
    print(f"tracked point at {distance} m: {report.classification}, eigenvalues {np.round(report.eigenvalues, 2)}")

# %%
# For the tip, ``solve`` solves a boundary value problem over the whole time: bounded before and after the motion.

tip = sc.scenes.passive_joint_arm().with_parameters(tracked_distance=1.0)
solution = sc.solve(tip)
print(solution.route)

figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(7, 4.6), constrained_layout=True)
top.plot(solution.t, np.degrees(solution["b"]))
top.set_ylabel("passive joint (deg)")
bottom.plot(solution.t, solution["u"])
bottom.set(xlabel="time (s)", ylabel=f"torque ({solution.unit('u')})")
for axis in (top, bottom):
    axis.axvspan(tip.reference.start_time, tip.reference.end_time, color="0.9", label="the path moves")
top.legend()
