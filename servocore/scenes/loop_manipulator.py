r"""A manipulator with a kinematic loop and a passive joint: two carts drive a lambda of links.

                         x tracked point (x, y), at y_2 on the third link
                        /
               gamma   / spring c, damper d
                     (J)
                    /                  seen from above, a horizontal plane
      link 2, L    /
                 (P)
                /   \   link 1, l_1, to the point P at l_2 on link 2
          beta /     \ alpha
    ==[cart 2]========[cart 1]==       one rail, forces F_2 and F_1
         s_2              s_1

Data of the scene: masses of carts and links (homogeneous rods), lengths, c, d and y_2; model ``angles``, in the carts'
positions and three angles with the two constraints of the loop. Left out: gravity, friction, flexible links.

The tracked point fixes all but one degree of freedom. With the direction theta = beta + gamma of link 3,
e = (cos theta, sin theta) and n normal to it, J = (x, y) - y_2 e gives beta by L sin(beta) = J_y, and the carts; link 3
turns about J,

    (I_3 + m_3 s_3^2 - m_3 s_3 y_2) theta'' = -m_3 s_3 n.(x, y)'' - c gamma - d gamma',    s_3 = l_3/2.

As the arm with a passive joint it is of minimum phase where y_2 is less than the centre of percussion, two thirds of
l_3, and of non-minimum phase at the tip: index 3, two internal states. Forces follow from the balances of links and
carts. There is no closed form, for theta depends on the history of the path: `exact` integrates the line above by
SciPy, at the tip as a boundary value problem.

After the example of Berger, Druecker, Lanza, Reis and Seifried, Tracking control for underactuated non-minimum phase
multibody systems, Nonlinear Dynamics 104 (2021) 3671: a manipulator with a loop and a passive joint in a combination of
feedforward by servo constraints and funnel feedback. Of its text only the introduction could be read here: structure in
detail, dimensions, masses and the path are declared assumptions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from servocore.model.drawing import Part
from servocore.model.limits import Limit
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MechanicalSystem, reference_symbols
from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes.internal_ode import bounded

PARAMETERS = Parameters(
    Parameter("cart_1_mass", 5.0, "kg", 1e-3, 1e9, "m_c1"),
    Parameter("cart_2_mass", 5.0, "kg", 1e-3, 1e9, "m_c2"),
    Parameter("link_1_mass", 4.0, "kg", 1e-3, 1e9, "m_1, from cart 1 to link 2"),
    Parameter("link_2_mass", 8.0, "kg", 1e-3, 1e9, "m_2, from cart 2 to the passive joint"),
    Parameter("link_3_mass", 2.0, "kg", 1e-3, 1e9, "m_3, beyond the passive joint"),
    Parameter("link_1_length", 1.5, "m", 1e-3, 1e3, "l_1"),
    Parameter("loop_length", 1.2, "m", 1e-3, 1e3, "l_2, from cart 2 to the point where link 1 holds link 2"),
    Parameter("link_2_length", 2.5, "m", 1e-3, 1e3, "L"),
    Parameter("link_3_length", 0.9, "m", 1e-3, 1e3, "l_3"),
    Parameter("joint_stiffness", 30.0, "N.m/rad", 0.0, 1e9, "c"),
    Parameter("joint_damping", 1.5, "N.m.s/rad", 0.0, 1e9, "d"),
    Parameter("tracked_distance", 0.5, "m", 0.0, 1e3, "y_2, from the passive joint to the tracked point"),
)
TIP = 0.9
"""Distance y_2 in m of the tip of link 3."""
INPUTS = tuple(Quantity(f"F_{k}", "N", f"force on cart {k}, positive as s_{k}") for k in (1, 2))
OUTPUTS = (Quantity("x", "m", "tracked point along the rail"), Quantity("y", "m", "tracked point across the rail"))


def angles() -> MechanicalSystem:
    """Carts and absolute angles q = (s_1, s_2, alpha, beta, theta), two constraints: link 1 holds link 2."""
    names = {"alpha": "link 1", "beta": "link 2", "theta": "link 3"}
    coordinates = Coordinates(
        *(Quantity(f"s_{k}", "m", f"position of cart {k}") for k in (1, 2)),
        *(Quantity(name, "rad", f"angle of {link} from the rail") for name, link in names.items()),
    )
    q, v, p, gamma = coordinates.q, coordinates.v, PARAMETERS, reference_symbols(2)
    carts = [ca.vertcat(place, 0) for place in (q[0], q[1])]
    e = [ca.vertcat(ca.cos(angle), ca.sin(angle)) for angle in ca.vertsplit(q[2:])]
    joint = carts[1] + p["link_2_length"] * e[1]
    point = joint + p["tracked_distance"] * e[2]
    energy = sum(p[f"cart_{k}_mass"] * v[k - 1] ** 2 / 2 for k in (1, 2))
    for k, (start, along) in enumerate(zip((carts[0], carts[1], joint), e, strict=True), 1):
        mass, length = p[f"link_{k}_mass"], p[f"link_{k}_length"]
        centre = ca.jtimes(start + length / 2 * along, q, v)
        energy += mass * (ca.sumsqr(centre) + length**2 / 12 * v[k + 1] ** 2) / 2
    bend, bend_rate = q[4] - q[3], v[4] - v[3]
    straight = ca.asin(gamma[1, 0] / (p["link_2_length"] + p["tracked_distance"]))
    return MechanicalSystem(
        name="loop manipulator, angles",
        coordinates=coordinates,
        parameters=p,
        inputs=INPUTS,
        outputs=OUTPUTS,
        mass=ca.hessian(energy, v)[0],
        potential=p["joint_stiffness"] * bend**2 / 2,
        force=-p["joint_damping"] * bend_rate * ca.jacobian(bend, q).T,
        constraints=carts[0] + p["link_1_length"] * e[0] - carts[1] - p["loop_length"] * e[1],
        input_matrix=-ca.jacobian(q[:2], q),
        output=point,
        gamma=gamma,
        guess=_configuration(gamma[0, 0], gamma[1, 0], straight, p),
        home=(3.0, 1.6),
        observables={Quantity("bend", "rad", "angle of the passive joint"): bend},
    )


def _configuration(x: ca.SX, y: ca.SX, theta: ca.SX, p: Parameters) -> ca.SX:
    """Return (s_1, s_2, alpha, beta, theta) of the loop with its carts apart, from the tracked point and link 3."""
    l_1, l_2, length, y_2 = (p[name] for name in ("link_1_length", "loop_length", "link_2_length", "tracked_distance"))
    beta = ca.asin((y - y_2 * ca.sin(theta)) / length)
    alpha = ca.pi - ca.asin(l_2 * ca.sin(beta) / l_1)
    s_2 = x - y_2 * ca.cos(theta) - length * ca.cos(beta)
    s_1 = s_2 + l_2 * ca.cos(beta) - l_1 * ca.cos(alpha)
    return ca.vertcat(s_1, s_2, alpha, beta, theta)


def independent_solution(t: Array, reference: Reference, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Return forces and motion by the balances of links and carts: the solution that stays bounded for all times.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in s, increasing; outside the motion of the path as well.
    reference : Reference
        Path of the tracked point, with two derivatives.
    parameters : mapping of str to float
        All parameters.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        F_1, F_2, the coordinates, x, y.
    """
    p = parameters
    m, s, y_2 = p["link_3_mass"], p["link_3_length"] / 2, p["tracked_distance"]
    length, c, d = p["link_2_length"], p["joint_stiffness"], p["joint_damping"]
    inertia, soft = m * s**2 * 4 / 3 - m * s * y_2, 1 + y_2 / length
    reach = length + y_2  # theta is counted from the angle of a straight manipulator

    def turning(y: Array, theta: Array, rate: Array) -> tuple[Array, Array, Array]:
        """Return theta'', beta and beta' from the jet of the point, shape (3, 2, ...)."""
        sin, cos = np.sin(theta), np.cos(theta)
        beta = np.arcsin((y[0, 1] - y_2 * sin) / length)
        beta_rate = (y[1, 1] - y_2 * cos * rate) / (length * np.cos(beta))
        push = m * s * (cos * y[2, 1] - sin * y[2, 0])
        return -(push + c * (theta - beta) + d * (rate - beta_rate)) / inertia, beta, beta_rate

    def rate(time: Array | float, state: Array) -> Array:
        y = np.moveaxis(reference.jet(time, 2), (-2, -1), (0, 1))
        rest = _arc_sine(y[:, 1] / reach)
        return np.array([state[1], turning(y, rest[0] + state[0], rest[1] + state[1])[0] - rest[2]])

    states = bounded(rate, t, reference, (inertia, d * soft, c * soft))
    y = np.moveaxis(reference.jet(t, 2), 0, -1)
    rest = _arc_sine(y[:, 1] / reach)
    theta = np.array([rest[0] + states[0], rest[1] + states[1], np.zeros(len(t))])
    theta[2], *_ = turning(y, theta[0], theta[1])
    return _forces(y, theta, p)


def _forces(y: Array, theta: Array, p: Mapping[str, float]) -> dict[str, Array]:
    """Return the answer from the jets of the tracked point (3, 2, N) and of theta (3, N)."""
    l_1, l_2, length, y_2 = (p[name] for name in ("link_1_length", "loop_length", "link_2_length", "tracked_distance"))
    joint = y - y_2 * _direction(theta)
    beta = _arc_sine(joint[:, 1] / length)
    alpha = -_arc_sine(l_2 / length * joint[:, 1] / l_1)
    alpha[0] += np.pi
    s_2 = joint - length * _direction(beta)
    s_1 = s_2 + l_2 * _direction(beta) - l_1 * _direction(alpha)
    m_1, m_2, m_3 = (p[f"link_{k}_mass"] for k in (1, 2, 3))
    on_3 = m_3 * (joint + p["link_3_length"] / 2 * _direction(theta))[2]  # force of link 2 on link 3
    torque = p["joint_stiffness"] * (theta[0] - beta[0]) + p["joint_damping"] * (theta[1] - beta[1])
    e_1, e_2 = _direction(alpha)[0], _direction(beta)[0]
    # Moments about the carts: link 2 is held by link 1 with the force f, link 1 by its opposite.
    turn_1 = m_1 * l_1 * (l_1 / 3 * alpha[2] - e_1[1] * s_1[2, 0] / 2)
    turn_2 = m_2 * length * (length / 3 * beta[2] - e_2[1] * s_2[2, 0] / 2)
    moments = -turn_1 / l_1, (turn_2 + length * _cross(e_2, on_3) - torque) / l_2
    f = (moments[1] * e_1 - moments[0] * e_2) / _cross(e_2, e_1)
    cart_2 = m_2 * (s_2 + length / 2 * _direction(beta))[2] - f + on_3
    cart_1 = m_1 * (s_1 + l_1 / 2 * _direction(alpha))[2] + f
    forces = {"F_1": p["cart_1_mass"] * s_1[2, 0] + cart_1[0], "F_2": p["cart_2_mass"] * s_2[2, 0] + cart_2[0]}
    places = {"s_1": s_1[0, 0], "s_2": s_2[0, 0], "alpha": alpha[0], "beta": beta[0], "theta": theta[0]}
    return {**forces, **places, "bend": theta[0] - beta[0], "x": y[0, 0], "y": y[0, 1]}


def _direction(angle: Array) -> Array:
    """Return unit vector, its rate and acceleration, shape (3, 2, N), of the jet of an angle (3, N)."""
    e = np.array([np.cos(angle[0]), np.sin(angle[0])])
    n = np.array([-e[1], e[0]])
    return np.array([e, angle[1] * n, angle[2] * n - angle[1] ** 2 * e])


def _arc_sine(side: Array) -> Array:
    """Return angle, rate and acceleration from the jet of its sine."""
    cos = np.sqrt(1 - side[0] ** 2)
    rate = side[1] / cos
    return np.array([np.arcsin(side[0]), rate, (side[2] + side[0] * rate**2) / cos])


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[1] - a[1] * b[0])


def drawing(v: Mapping[str, Any]) -> list[Part]:
    """Return rail, carts and links, seen from above."""
    carts = [(v["s_1"], 0, 0), (v["s_2"], 0, 0)]

    def along(start: tuple[Any, Any, Any], length: Any, angle: Any) -> tuple[Any, Any, Any]:
        return (start[0] + length * ca.cos(angle), 0, start[2] + length * ca.sin(angle))

    held, joint = (along(carts[1], v[name], v["beta"]) for name in ("loop_length", "link_2_length"))
    links = ((carts[0], held), (carts[1], joint), (joint, along(joint, v["link_3_length"], v["theta"])))
    return [
        Part("rail", ((0, 0, 0),)),
        *(Part("bar", pair) for pair in links),
        *(Part("pin", (each,)) for each in (held, joint)),
        *(Part("box", (each,), f"cart {k}") for k, each in enumerate(carts, 1)),
        Part("body", ((v["x"], 0, v["y"]),), "tracked point"),
    ]


LIMITS = (
    Limit("the reach across the rail", "m", 1e-3, "the links stand across the rail",
          lambda gamma, p: p["link_2_length"] + p["tracked_distance"] - ca.fabs(gamma[1, 0])),
    Limit("the distance of the tracked point from the centre of percussion", "m", 1e-3,
          "link 3 does not feel the acceleration of the tracked point",
          lambda _, p: ca.fabs(p["tracked_distance"] - p["link_3_length"] * 2 / 3)),
)  # fmt: skip


def loop_manipulator(tip: bool = False) -> Scene:
    """Return the manipulator with its default manoeuvre: the tracked point moves 1 m along and 0.6 m across in 2 s.

    Parameters
    ----------
    tip : bool
        Track the tip of link 3: of non-minimum phase. Otherwise y_2 = 0.5 m: minimum phase.

    Returns
    -------
    Scene
        With its model and its path.
    """
    return Scene(
        name="loop_manipulator",
        models={"angles": angles},
        reference=rest_to_rest((3.0, 1.4), (4.0, 2.0), 2.0),
        independent_solution=independent_solution,
        limits=LIMITS,
        drawing=drawing,
        parameters={"tracked_distance": TIP} if tip else {},
    )
