r"""The quadrotor with a load on a rope, in a vertical plane, after Sreenath, Lee and Kumar (2013).

            ^ f     thrust along the body's own axis
            |  /
      ===[ m_Q ]===      pitch theta (M), from the vertical to the thrust; rotors a off the centre
             \
              \  rope l, of fixed length, tied to the centre of mass
               o load (x, z)

Data of the scene: m_Q, J, l, m, g of four degrees of freedom, two inputs; model ``points``. The distance a only
shares thrust and moment among the rotors. ``generalized`` has the quadrotor's position, the swing and the pitch as
coordinates. Left out: drag, the rotors' own dynamics, a rope that stretches, what happens across the plane.

The load's path prescribes everything, six derivatives of it, so that the index is 7: the rope lies along the load's
acceleration less gravity, the quadrotor is a rope's length up from the load, its acceleration needs a thrust, and the
moment is what turns the body along with that thrust,

    T n = m (r'' + g e_z),    p = r + l n,    f d = m_Q (p'' + g e_z) + T n,    M = J theta'',    d = (sin, cos)(theta).

K. Sreenath, T. Lee, V. Kumar: Geometric control and differential flatness of a quadrotor UAV with a cable-suspended
load. 52nd IEEE Conference on Decision and Control (2013) 2269-2274.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from servocore.model.drawing import Part
from servocore.model.generalize import generalize
from servocore.model.limits import Limit
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MechanicalSystem, reference_symbols
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import diagonal, time_derivative
from servocore.references.profiles import DEGREE13
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes import hanging_load, jets
from servocore.scenes.hanging_load import TENSION

PARAMETERS = Parameters(
    Parameter("quadrotor_mass", 1.5, "kg", 1e-3, 1e6, "m_Q"),
    Parameter("quadrotor_inertia", 0.03, "kg.m2", 1e-6, 1e6, "J, about the level axis of pitch"),
    Parameter("arm_length", 0.25, "m", 1e-3, 1e3, "a, from the centre to the rotors in front and behind"),
    Parameter("rope_length", 1.0, "m", 1e-3, 1e3, "l, from the quadrotor's centre of mass to the load"),
    Parameter("load_mass", 0.5, "kg", 1e-3, 1e6, "m"),
    Parameter("gravity", 9.81, "m/s2", 1e-3, 1e3, "g", fixed=True),
)
INPUTS = (
    Quantity("f", "N", "thrust of all rotors, along the body's axis"),
    Quantity("M", "N.m", "moment of the rotors, positive as the pitch"),
)
OUTPUTS = (Quantity("x", "m", "load position"), Quantity("z", "m", "load position, upwards"))
PLACE = (Quantity("p_x", "m", "quadrotor position"), Quantity("p_z", "m", "quadrotor position, upwards"))
SWING = Quantity("swing", "rad", "angle of the rope from the vertical, positive where the load is ahead")
PITCH = Quantity("pitch", "rad", "angle of the thrust from the vertical, positive where it pulls ahead", wraps=True)
FRONT = Quantity("front", "N", "thrust of the rotors in front, f/2 - M/(2 a)")
REAR = Quantity("rear", "N", "thrust of the rotors behind, f/2 + M/(2 a)")

SMALLEST_THRUST = 1e-3
"""The thrust must stay larger than this, in N: without any the pitch is undefined."""


def points() -> MechanicalSystem:
    """Six coordinates q = (p, d, r), two constraints: M constant, g quadratic, the thrust along d by q-dependent B.

    Quadrotor p (mass m_Q), direction d of its thrust (mass J), load r; constraints |d|^2 = 1 and |r - p|^2 = l^2.
    """
    coordinates, p = Coordinates(*PLACE, Quantity("d_x"), Quantity("d_z"), *OUTPUTS), PARAMETERS
    place, direction, load = ca.vertsplit(coordinates.q, 2)
    rope, lam, u, gamma = load - place, ca.SX.sym("lam", 2), ca.SX.sym("u", 2), reference_symbols(2)
    above, thrust = flown(gamma, p)
    none = ca.SX(1, 2)
    turning = ca.horzcat(direction[1], -direction[0])  # the pitch changes by d_z delta d_x - d_x delta d_z
    shared, twist = u[0] / 2, u[1] / (2 * p["arm_length"])
    return MechanicalSystem(
        name="quadrotor with load, points",
        coordinates=coordinates,
        parameters=p,
        inputs=INPUTS,
        outputs=OUTPUTS,
        mass=diagonal((*[p["quadrotor_mass"]] * 2, *[p["quadrotor_inertia"]] * 2, *[p["load_mass"]] * 2)),
        potential=p["gravity"] * (p["quadrotor_mass"] * place[1] + p["load_mass"] * load[1]),
        constraints=ca.vertcat(ca.sumsqr(direction) - 1, ca.sumsqr(rope) - p["rope_length"] ** 2),
        input_matrix=-ca.vertcat(ca.horzcat(direction.T, none, none), ca.horzcat(none, turning, none)),
        output=load,
        multipliers=lam,
        u=u,
        gamma=gamma,
        guess=ca.vertcat(above, thrust / ca.norm_2(thrust), gamma[:, 0]),
        home=(1.0, 1.0),
        observables={
            PITCH: ca.atan2(direction[0], direction[1]),
            SWING: hanging_load.swing_angle(rope),
            TENSION: 2 * lam[1] * p["rope_length"],
            FRONT: shared - twist,
            REAR: shared + twist,
        },
    )


def generalized() -> MechanicalSystem:
    """Four generalized coordinates, derived from `points`: quadrotor position, swing and pitch."""
    base = points()
    coordinates, p, gamma = Coordinates(*PLACE, SWING, PITCH), base.parameters, base.gamma
    place, swing, pitch = ca.vertsplit(coordinates.q, [0, 2, 3, 4])
    load = place + p["rope_length"] * ca.vertcat(ca.sin(swing), -ca.cos(swing))
    above, thrust = flown(gamma, p)
    # Without multipliers the tension follows from the load's prescribed acceleration.
    kept = {quantity: base.observables[quantity] for quantity in (FRONT, REAR)}
    return generalize(
        base,
        coordinates,
        ca.vertcat(place, ca.sin(pitch), ca.cos(pitch), load),
        guess=ca.vertcat(above, hanging_load.swing_angle(gamma[:, 0] - above), ca.atan2(thrust[0], thrust[1])),
        observables={TENSION: hanging_load.tension(gamma, p), **kept},
        name="quadrotor with load, generalized",
    )


def flown(gamma: ca.SX, p: Parameters) -> tuple[ca.SX, ca.SX]:
    """Return where the quadrotor is, and its thrust as a vector, when the load follows the path."""
    weight = ca.vertcat(0, p["gravity"])
    pull = gamma[:, 2] + weight
    place = gamma[:, 0] + p["rope_length"] * pull / ca.norm_2(pull)
    acceleration = time_derivative(time_derivative(place, gamma), gamma)
    return place, p["quadrotor_mass"] * (acceleration + weight) + p["load_mass"] * pull


def closed_form(reference: Array, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Exact inputs and motion for reference jets of order six or higher: flat in the load position.

    Parameters
    ----------
    reference : ndarray, shape (N, orders, 2)
        Load position and its derivatives.
    parameters : mapping of str to float
        All six parameters.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        f, M, front, rear, pitch, swing, tension, p_x, p_z, x, z.
    """
    m_Q, J, a, length, m, g = (parameters[name] for name in PARAMETERS.names)
    x, z = jets.components(reference)
    pull_x, pull_z = x.d().d(), z.d().d() + g
    size = jets.sqrt(pull_x**2 + pull_z**2)
    p_x, p_z = x + length * (pull_x / size), z + length * (pull_z / size)
    thrust_x, thrust_z = m_Q * p_x.d().d() + m * pull_x, m_Q * (p_z.d().d() + g) + m * pull_z
    thrust, pitch = jets.sqrt(thrust_x**2 + thrust_z**2).value, jets.atan2(thrust_x, thrust_z)
    moment = J * pitch.derivatives()[2]
    return {
        "f": thrust,
        "M": moment,
        FRONT.name: (thrust - moment / a) / 2,
        REAR.name: (thrust + moment / a) / 2,
        PITCH.name: np.unwrap(pitch.value),
        SWING.name: np.arctan2(-pull_x.value, pull_z.value),
        TENSION.name: m * size.value,
        "p_x": p_x.value,
        "p_z": p_z.value,
        "x": x.value,
        "z": z.value,
    }


def drawing(v: Mapping[str, Any]) -> list[Part]:
    """Return the body between its rotors, rope and load."""
    middle, load = (v["p_x"], 0, v["p_z"]), (v["x"], 0, v["z"])
    ahead, down = v["arm_length"] * ca.cos(v["pitch"]), v["arm_length"] * ca.sin(v["pitch"])
    front, rear = (v["p_x"] + ahead, 0, v["p_z"] - down), (v["p_x"] - ahead, 0, v["p_z"] + down)
    return [
        Part("rope", (middle, load), colour=TENSION.name),
        Part("bar", (rear, front)),
        Part("pin", (rear,)),
        Part("pin", (front,)),
        Part("body", (load,), "load"),
    ]


LIMITS = (
    hanging_load.TAUT,
    Limit(
        "the thrust",
        "N",
        SMALLEST_THRUST,
        "without thrust the pitch is undefined",
        lambda gamma, p: ca.norm_2(flown(gamma, p)[1]),
    ),
)


def quadrotor_with_load() -> Scene:
    """Return the quadrotor with its default manoeuvre, the load from (0, 1) m to (5, 2) m in 4 s.

    Returns
    -------
    Scene
        With its models and its path, a polynomial of degree 13: the moment takes six derivatives of it.
    """
    return Scene(
        name="quadrotor_with_load",
        models={"points": points, "generalized": generalized},
        reference=rest_to_rest((0.0, 1.0), (5.0, 2.0), 4.0, DEGREE13),
        closed_form=closed_form,
        closed_form_order=6,
        limits=LIMITS,
        tracked="load",
        drawing=drawing,
    )
