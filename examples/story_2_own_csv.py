"""
Your own path, from a file
==========================

The load follows waypoints from a table with the columns ``time,x,y,z``: pick up, lift over an obstacle, slew, lower.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import servocore as sc

# %%
# The file has seven waypoints. Between them the load moves on a spline that is smooth enough for the crane, whose
# inputs depend on the fourth derivative of the path; it rests at both ends.

folder = Path.cwd()
path = sc.waypoints_from_csv(folder / "working_cycle_waypoints.csv")
crane = sc.scenes.rotary_crane().with_reference(path)
solution = sc.solve(crane, step=0.1)

figure, (above, over_time) = plt.subplots(1, 2, figsize=(9, 3.8), constrained_layout=True)
above.plot(solution["x"], solution["y"], label="load")
above.plot(solution["s"] * np.cos(solution["phi"]), solution["s"] * np.sin(solution["phi"]), "--", label="trolley")
above.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="from above")
above.legend()
over_time.plot(solution.t, solution["M_b"])
over_time.set(xlabel="time (s)", ylabel="M_b (N m)", title="slewing torque")

# %%
# ``from_csv`` reads a file with many samples of a smooth path. Rounded positions need a tolerance, the largest
# distance of the spline from them.

sampled = sc.from_csv(folder / "working_cycle_sampled.csv")
again = sc.solve(crane.with_reference(sampled), step=0.1)
difference = np.abs(again["M_b"] - solution["M_b"]).max() / np.abs(solution["M_b"]).max()
print(f"Inputs from samples and from waypoints differ by {difference:.1e} of the peak.")

# %%
# The inputs, with their times, for the drives:

solution.to_csv("inputs.csv", ["M_b", "F", "M_w"])
print(Path("inputs.csv").read_text().splitlines()[:2])
Path("inputs.csv").unlink()
