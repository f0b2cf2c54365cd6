r"""The gantry crane: a bridge on two rails, a trolley across it, a winch on the trolley, a load on a rope, in space.

          ---- s_x (F_x) ---->
    ======[     bridge     ]==========      rails along x, z = 0
          [   trolley      ]                s_y (F_y) across the rails, on the bridge
                \
                 \  rope l, paid out by the winch (M_w)
                  o load (x, y, z), z < 0

What the scene needs: m_b, m_t, m, J_w, r_w, g of five degrees of freedom, three inputs; model ``points``.
``generalized`` has two swing angles in place of the load's position.
Left out: friction, rope mass and elasticity, wind, bending and skewing of the bridge.

With a path in the plane y = constant this is the overhead crane, whose trolley then carries the bridge along.
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
    Parameter("bridge_mass", 40.0, "kg", 0.0, 1e9, "m_b, moves along x only"),
    Parameter("trolley_mass", 10.0, "kg", 1e-3, 1e9, "m_t, of trolley and winch"),
    Parameter("load_mass", 100.0, "kg", 1e-3, 1e9, "m"),
    Parameter("winch_inertia", 0.1, "kg.m2", 1e-6, 1e9, "J_w, about the winch's own axis"),
    Parameter("winch_radius", 0.1, "m", 1e-3, 1e3, "r_w"),
    Parameter("gravity", 9.81, "m/s2", 1e-3, 1e3, "g"),
)
INPUTS = (
    Quantity("F_x", "N", "force on the bridge, positive as s_x"),
    Quantity("F_y", "N", "force on the trolley along the bridge, positive as s_y"),
    Quantity("M_w", "N.m", "winch torque, positive where it pays out rope"),
)
OUTPUTS = (
    Quantity("x", "m", "load position along the rails"),
    Quantity("y", "m", "load position across the rails"),
    Quantity("z", "m", "load position, negative below the trolley"),
)
BRIDGE = Quantity("s_x", "m", "bridge position along the rails")
TROLLEY = Quantity("s_y", "m", "trolley position on the bridge")
ROPE = Quantity("l", "m", "rope length", positive=True)
TENSION = Quantity("tension", "N", "rope tension")
SWING = Quantity("swing", "rad", "angle of the rope from the vertical")


def points() -> MechanicalSystem:
    """Six coordinates q = (s_x, s_y, l, x, y, z), one constraint: the rope reaches from trolley to load."""
    coordinates = Coordinates(BRIDGE, TROLLEY, ROPE, *OUTPUTS)
    rope_length, load = coordinates.q[2], coordinates.q[3:]
    p, lam = PARAMETERS, ca.SX.sym("lam")
    gamma = ca.SX.sym("gamma", 3, MAX_REFERENCE_ORDER + 1)
    rope = load - ca.vertcat(coordinates.q[:2], 0)
    above, hanging, _ = hanging_load.suspension(gamma, PARAMETERS)
    masses = (
        p["bridge_mass"] + p["trolley_mass"],
        p["trolley_mass"],
        p["winch_inertia"] / p["winch_radius"] ** 2,
        *[p["load_mass"]] * 3,
    )
    input_matrix = ca.SX(3, 6)
    input_matrix[0, 0], input_matrix[1, 1], input_matrix[2, 2] = -1, -1, -1 / p["winch_radius"]
    return MechanicalSystem(
        name="gantry crane, points",
        coordinates=coordinates,
        parameters=PARAMETERS,
        inputs=INPUTS,
        outputs=OUTPUTS,
        mass=ca.sparsify(ca.diag(ca.vertcat(*masses))),
        potential=p["load_mass"] * p["gravity"] * coordinates["z"],
        constraints=ca.sumsqr(rope) - rope_length**2,
        input_matrix=input_matrix,
        output=load,
        multipliers=lam,
        gamma=gamma,
        guess=ca.vertcat(above, hanging, gamma[:, 0]),
        home=(1.0, 1.0, -4.0),
        observables={TENSION: 2 * lam * rope_length, SWING: hanging_load.swing_angle(rope)},
    )


def generalized() -> MechanicalSystem:
    """Five generalised coordinates s_x, s_y, l and two swing angles; singular where swing_y = 90 degrees."""
    base = points()
    coordinates = Coordinates(
        BRIDGE, TROLLEY, ROPE,
        Quantity("swing_x", "rad", "swing along the rails, positive where the load is ahead"),
        Quantity("swing_y", "rad", "swing across the rails, positive where the load is ahead"),
    )  # fmt: skip
    s_x, s_y, rope_length, along, across = ca.vertsplit(coordinates.q)
    direction = ca.vertcat(ca.sin(along) * ca.cos(across), ca.sin(across), -ca.cos(along) * ca.cos(across))
    rope = rope_length * direction
    start = base.gamma
    above, hanging, towards = hanging_load.suspension(start, base.parameters)
    return generalise(
        base,
        coordinates,
        ca.vertcat(s_x, s_y, rope_length, ca.vertcat(s_x, s_y, 0) + rope),
        guess=ca.vertcat(above, hanging, ca.atan2(towards[0], -towards[2]), ca.asin(towards[1])),
        # Without multipliers the tension follows from the load's prescribed acceleration.
        observables={
            TENSION: hanging_load.tension(start, base.parameters),
            SWING: hanging_load.swing_angle(rope),
        },
        name="gantry crane, generalized",
    )


def closed_form(reference: Array, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Exact inputs and motion for reference jets of order four or higher: the crane is flat in the load position.

    Parameters
    ----------
    reference : ndarray, shape (N, orders, 3)
        Load position and its derivatives.
    parameters : mapping of str to float
        All six parameters.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        F_x, F_y, M_w, s_x, s_y, l, tension, swing, x, y, z.
    """
    m_b, m_t, m, J_w, r_w, g = (parameters[name] for name in PARAMETERS.names)
    x, y, z = jets.components(reference)
    k = -z / (g + z.d().d())
    to_trolley = k * x.d().d(), k * y.d().d()
    s_x, s_y = x + to_trolley[0], y + to_trolley[1]
    rope = jets.sqrt(to_trolley[0] ** 2 + to_trolley[1] ** 2 + z**2)
    per_length = m / k.value  # rope tension divided by rope length
    tension = per_length * rope.value
    return {
        "F_x": (m_b + m_t) * s_x.derivatives()[2] + per_length * to_trolley[0].value,
        "F_y": m_t * s_y.derivatives()[2] + per_length * to_trolley[1].value,
        "M_w": J_w * rope.derivatives()[2] / r_w - r_w * tension,
        "s_x": s_x.value,
        "s_y": s_y.value,
        "l": rope.value,
        "tension": tension,
        "swing": np.arctan2(np.hypot(to_trolley[0].value, to_trolley[1].value), -z.value),
        "x": x.value,
        "y": y.value,
        "z": z.value,
    }


LIMITS = hanging_load.limits("trolley")


def gantry_crane() -> Scene:
    """Return the gantry crane with its default manoeuvre, (0, 0, -5) m to (6, 3, -2) m in 6 s."""
    return Scene(
        name="gantry_crane",
        models={"points": points, "generalized": generalized},
        reference=rest_to_rest((0.0, 0.0, -5.0), (6.0, 3.0, -2.0), 6.0),
        closed_form=closed_form,
        limits=LIMITS,
    )
