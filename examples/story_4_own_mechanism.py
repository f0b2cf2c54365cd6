"""
Your own mechanism
==================

A hoist lifts a load on an elastic rope: two coordinates, one input, and a load that has to follow a path.
"""

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import servocore as sc

# %%
# Names, units and bounds first. ``MechanicalSystem`` then takes mass matrix, potential, inputs and output. The sign
# of the input matrix: the inputs exert the force :math:`-B^T u`.

parameters = sc.Parameters(
    sc.Parameter("hoist_mass", 20.0, "kg", 1e-3, 1e9, "m_1"),
    sc.Parameter("load_mass", 100.0, "kg", 1e-3, 1e9, "m_2"),
    sc.Parameter("stiffness", 2e4, "N/m", 1e-3, 1e12, "k, of the rope"),
    sc.Parameter("slack_length", 3.0, "m", 0.0, 1e3, "d, of the rope without load"),
)
hoist, load = sc.Quantity("w", "m", "height of the hoist"), sc.Quantity("y", "m", "height of the load")
force = sc.Quantity("F", "N", "force on the hoist, positive upwards", nominal=1e3)


def elastic_hoist() -> sc.MechanicalSystem:
    """Two heights, one force, a spring between them."""
    coordinates = sc.Coordinates(hoist, load)
    w, y = ca.vertsplit(coordinates.q)
    p = parameters
    gamma = ca.SX.sym("gamma", 1, sc.MAX_REFERENCE_ORDER + 1)
    weight = 9.81 * (p["hoist_mass"] * w + p["load_mass"] * y)
    return sc.MechanicalSystem(
        name="elastic hoist",
        coordinates=coordinates,
        parameters=p,
        inputs=(force,),
        outputs=(load,),
        mass=ca.diag(ca.vertcat(p["hoist_mass"], p["load_mass"])),
        potential=weight + p["stiffness"] * (w - y - p["slack_length"]) ** 2 / 2,
        input_matrix=ca.SX([[-1, 0]]),
        output=y,
        gamma=gamma,
        guess=ca.vertcat(gamma[0, 0] + p["slack_length"], gamma[0, 0]),
    )


scene = sc.Scene("elastic_hoist", {"points": elastic_hoist}, sc.rest_to_rest((0.0,), (5.0,), 4.0))

# %%
# The analysis determines index and internal dynamics, and recommends a route.

print(sc.analyse(scene))

# %%
# The inputs, and an independent check: the same system, simulated under these inputs, must carry the load along the
# path.

inputs = sc.ExactInversion(scene)
simulated = sc.simulate(scene, inputs, t=np.linspace(0.0, 4.0, 201))
path = scene.reference.jet(simulated.t, 0)[:, 0, 0]
print(f"The simulated load leaves its path by {np.abs(simulated['y'] - path).max():.1e} m.")

figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(7, 4.5), constrained_layout=True)
top.plot(simulated.t, simulated["w"] - 3.0, label="hoist less slack length")
top.plot(simulated.t, simulated["y"], "--", label="load")
top.set_ylabel("height (m)")
top.legend()
bottom.plot(simulated.t, inputs(simulated.t))
bottom.set(xlabel="time (s)", ylabel="F (N)")
