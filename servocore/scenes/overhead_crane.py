r"""The overhead crane: a trolley on a straight girder, a winch on it, a load on a rope, in a vertical plane.

        |---- s (F) ---->
    ====[trolley]==============      z = 0
            \
             \  rope l, paid out by the winch (M_w)
              o load (x, z), z < 0

What the scene needs: m_t, m, J_w, r_w, g of three degrees of freedom, two inputs; model ``points``.
``generalized`` has the swing angle in place of the load's position.
Left out: friction, rope mass and elasticity, the third dimension (see the gantry crane).
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from servocore.scenes import jets
from servocore.references import rest_to_rest
from servocore.model.scene import Scene
from servocore.scenes import hanging_load
from servocore.model.symbols import Array, Coordinates, Parameter, Parameters, Quantity
from servocore.model.system import MAX_REFERENCE_ORDER, MechanicalSystem, generalise

PARAMETERS = Parameters(
    Parameter("trolley_mass", 10.0, "kg", 1e-3, 1e9, "m_t, of trolley and winch"),
    Parameter("load_mass", 100.0, "kg", 1e-3, 1e9, "m"),
    Parameter("winch_inertia", 0.1, "kg.m2", 1e-6, 1e9, "J_w, about the winch's own axis"),
    Parameter("winch_radius", 0.1, "m", 1e-3, 1e3, "r_w"),
    Parameter("gravity", 9.81, "m/s2", 1e-3, 1e3, "g"),
)
INPUTS = (
    Quantity("F", "N", "force on the trolley, positive as s"),
    Quantity("M_w", "N.m", "winch torque, positive where it pays out rope"),
)
OUTPUTS = (Quantity("x", "m", "load position"), Quantity("z", "m", "load position, negative below the girder"))
TROLLEY = Quantity("s", "m", "trolley position")
ROPE = Quantity("l", "m", "rope length", positive=True)
TENSION = Quantity("tension", "N", "rope tension")
SWING = Quantity("swing", "rad", "angle of the rope from the vertical, positive where the load is ahead")


def points() -> MechanicalSystem:
    """Four coordinates q = (s, l, x, z), one constraint (x - s)^2 + z^2 = l^2."""
    coordinates = Coordinates(TROLLEY, ROPE, *OUTPUTS)
    s, rope, x, z = ca.vertsplit(coordinates.q)
    p, lam = PARAMETERS, ca.SX.sym("lam")
    gamma = ca.SX.sym("gamma", 2, MAX_REFERENCE_ORDER + 1)
    above, hanging, _ = hanging_load.suspension(gamma, PARAMETERS)
    masses = (p["trolley_mass"], p["winch_inertia"] / p["winch_radius"] ** 2, p["load_mass"], p["load_mass"])
    input_matrix = ca.SX(2, 4)
    input_matrix[0, 0], input_matrix[1, 1] = -1, -1 / p["winch_radius"]
    return MechanicalSystem(
        name="overhead crane, points",
        coordinates=coordinates,
        parameters=PARAMETERS,
        inputs=INPUTS,
        outputs=OUTPUTS,
        mass=ca.sparsify(ca.diag(ca.vertcat(*masses))),
        potential=p["load_mass"] * p["gravity"] * z,
        constraints=(x - s) ** 2 + z**2 - rope**2,
        input_matrix=input_matrix,
        output=ca.vertcat(x, z),
        multipliers=lam,
        gamma=gamma,
        guess=ca.vertcat(above, hanging, gamma[:, 0]),
        home=(1.0, -4.0),
        observables={TENSION: 2 * lam * rope, SWING: ca.atan2(x - s, -z)},
    )


def generalized() -> MechanicalSystem:
    """Three generalised coordinates s, l and the swing angle."""
    base = points()
    coordinates = Coordinates(TROLLEY, ROPE, SWING)
    s, rope, swing = ca.vertsplit(coordinates.q)
    start = base.gamma
    load = ca.vertcat(s + rope * ca.sin(swing), -rope * ca.cos(swing))
    above, hanging, towards = hanging_load.suspension(start, base.parameters)
    return generalise(
        base,
        coordinates,
        ca.vertcat(s, rope, load),
        guess=ca.vertcat(above, hanging, ca.atan2(towards[0], -towards[1])),
        observables={TENSION: hanging_load.tension(start, base.parameters)},
        name="overhead crane, generalized",
    )


def closed_form(reference: Array, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Exact inputs and motion for reference jets (N, orders, 2) of order four or higher."""
    m_t, m, J_w, r_w, g = (parameters[name] for name in PARAMETERS.names)
    x, z = jets.components(reference)
    k = -z / (g + z.d().d())
    to_trolley = k * x.d().d()
    s, rope = x + to_trolley, jets.sqrt(to_trolley**2 + z**2)
    per_length = m / k.value  # rope tension divided by rope length
    tension = per_length * rope.value
    return {
        "F": m_t * s.derivatives()[2] + per_length * to_trolley.value,
        "M_w": J_w * rope.derivatives()[2] / r_w - r_w * tension,
        "s": s.value,
        "l": rope.value,
        "tension": tension,
        "swing": np.arctan2(-to_trolley.value, -z.value),
        "x": x.value,
        "z": z.value,
    }


LIMITS = hanging_load.limits("girder")


def overhead_crane() -> Scene:
    """Return the overhead crane with its default manoeuvre, (0, -4) m to (5, -1) m in 3 s."""
    return Scene(
        name="overhead_crane",
        models={"points": points, "generalized": generalized},
        reference=rest_to_rest((0.0, -4.0), (5.0, -1.0), 3.0),
        closed_form=closed_form,
        limits=LIMITS,
    )
