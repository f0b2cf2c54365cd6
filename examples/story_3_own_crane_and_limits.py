"""
Your own crane, and its limits
==============================

Other data and actuator limits, and the shortest duration within them.
"""

import matplotlib.pyplot as plt
import numpy as np

import servocore as sc

# %%
# Parameters are changed by name, in SI units; impossible values are refused with a message.

crane = sc.scenes.rotary_crane().with_parameters(load_mass=150.0, trolley_mass=20.0)
try:
    crane.with_parameters(load_mass=-3.0)
except sc.ServocoreError as error:
    print(error)

# %%
# Limits are given by name, too: inputs, observables, and the rate of each.

crane = crane.with_limits(F=60, swing="4 deg", **{"s.rate": 1.2})
solution = sc.solve(crane, step=0.05)
for name, margin in solution.margins.items():
    print(f"{name}: {margin.slack:.3g} {margin.unit} left, at t = {margin.time:.1f} s")

# %%
# A manoeuvre that is too fast violates one. The message names it, with its time; ``shortest_duration`` computes the
# shortest duration of the same time law.

start, end = (5.0, 0.0, -5.0), (-2.0, 2.0, -2.0)
hasty = crane.with_reference(sc.rest_to_rest(start, end, 6.0))
try:
    sc.solve(hasty)
except sc.LimitBroken as error:
    print(error)
shortest = sc.shortest_duration(hasty)
print(f"The same law keeps all limits from {shortest:g} s on.")

# %%
# Swing against duration, with the limit:

durations = np.linspace(8.0, 20.0, 25)
unlimited = sc.scenes.rotary_crane().with_parameters(load_mass=150.0, trolley_mass=20.0)
swings = [
    np.degrees(sc.solve(unlimited.with_reference(sc.rest_to_rest(start, end, T)))["swing"].max()) for T in durations
]
figure, axis = plt.subplots(figsize=(7, 3.4), constrained_layout=True)
axis.plot(durations, swings, label="largest swing")
axis.axhline(4.0, color="0.4", linestyle="--", label="limit")
axis.axvline(shortest, color="0.4", linestyle=":", label="shortest duration within all limits")
axis.set(xlabel="duration (s)", ylabel="swing (deg)")
axis.legend()
