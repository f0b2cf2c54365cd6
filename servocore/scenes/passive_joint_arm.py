r"""The arm with a passive joint (Seifried & Blajer 2013): two links in a horizontal plane, a torque on the first.

                          x  tracked point, at y_2 on link 2
                         /
                        /  b, spring c, damper d
              l_1      /
      ____------------O
    (O)  a                        torque u on link 1 at its pivot, (O)

Data of the scene: l_1, J_1, m_2, s_2, I_2, c, d and y_2 of two degrees of freedom, one input; model
``generalized``, in the joint angles a and b. ``points`` has directors and the mass centre of link 2 as well: M is
constant there. Left out: gravity (the plane is horizontal), friction in the driven joint.

The output is linear, y = a + y_2/(l_1 + y_2) b: for small b the angle at which the tracked point is seen from the
pivot (the observable point_angle is that angle itself). With w = y_2/(l_1 + y_2) and J_2 = I_2 + m_2 s_2^2 joint 2 has

    (J_2 - w M_12) b'' + m_2 l_1 s_2 sin(b) (y' - w b')^2 + d b' + c b = -M_12 y'',    M_12 = J_2 + m_2 l_1 s_2 cos(b).

Near b = 0 the coefficient of b'' is l_1 (J_2 - m_2 s_2 y_2)/(l_1 + y_2). It changes sign where y_2 reaches the centre
of percussion J_2/(m_2 s_2), of a homogeneous rod two thirds of its length:

    y_2 shorter    index 3, two internal states, minimum phase
    y_2 longer     index 3, two internal states, non-minimum phase: no forward integration gives bounded inputs
    y_2 there      singular

In the second case the coefficient vanishes again where link 2 bends far, cos(b) = l_1 J_2/(m_2 l_1 s_2 y_2): a forward
integration, which leaves the bounded solution, ends there (at 48 degrees for the tip of the default arm).

There is no closed form: b depends on the history of the path. `exact` integrates the line above by SciPy and gives, in
the second case, the solution that stays bounded for all times; it moves before the path does.
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
from servocore.numerics.expressions import diagonal
from servocore.references.base import Reference
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes.internal_ode import bounded

TIP, INSIDE = 1.0, 0.4
"""Distance y_2 in m of the tip of link 2, and of the point tracked by default."""

PARAMETERS = Parameters(
    Parameter("first_length", 1.0, "m", 1e-3, 1e3, "l_1, from pivot to joint 2"),
    Parameter("first_inertia", 1.0, "kg.m2", 1e-6, 1e9, "J_1, of link 1 about its pivot"),
    Parameter("second_mass", 3.0, "kg", 1e-3, 1e9, "m_2"),
    Parameter("second_centre", 0.5, "m", 1e-3, 1e3, "s_2, from joint 2 to the mass centre of link 2"),
    Parameter("second_inertia", 0.25, "kg.m2", 1e-6, 1e9, "I_2, of link 2 about its mass centre"),
    Parameter("joint_stiffness", 50.0, "N.m/rad", 0.0, 1e9, "c"),
    Parameter("joint_damping", 1.5, "N.m.s/rad", 0.0, 1e9, "d"),
    Parameter("tracked_distance", INSIDE, "m", 0.0, 1e3, "y_2, from joint 2 to the tracked point"),
)
INPUT = Quantity("u", "N.m", "torque on link 1, positive as a")
OUTPUT = Quantity("y", "rad", "linearized angle of the tracked point, a + y_2/(l_1 + y_2) b")
FIRST = Quantity("a", "rad", "angle of link 1")
SECOND = Quantity("b", "rad", "angle of link 2 against link 1")
POINT_X = Quantity("point_x", "m", "tracked point")
POINT_Y = Quantity("point_y", "m", "tracked point")
POINT_ANGLE = Quantity("point_angle", "rad", "angle at which the tracked point is seen from the pivot", wraps=True)


def points() -> MechanicalSystem:
    """Eight coordinates q = (d_1, r, d_2, a, b), six constraints: M constant, the angles massless.

    Directors d_1 = (cos a, sin a) with J_1 and d_2 = (cos(a + b), sin(a + b)) with I_2; the mass centre of link 2,
    r = l_1 d_1 + s_2 d_2, with m_2.
    """
    names = ("d_1x", "d_1y", "r_x", "r_y", "d_2x", "d_2y")
    coordinates = Coordinates(*(Quantity(name, "m" if name[0] == "r" else "1") for name in names), FIRST, SECOND)
    first, centre, second = coordinates.q[0:2], coordinates.q[2:4], coordinates.q[4:6]
    a, b = coordinates["a"], coordinates["b"]
    p = PARAMETERS
    weight = p["tracked_distance"] / (p["first_length"] + p["tracked_distance"])
    gamma = reference_symbols(1)
    masses = [p[name] for name in ("first_inertia", "second_mass", "second_inertia") for _ in range(2)]
    point = p["first_length"] * first + p["tracked_distance"] * second
    start = gamma[0, 0]
    along = ca.vertcat(ca.cos(start), ca.sin(start))
    return MechanicalSystem(
        name="passive joint arm, points",
        coordinates=coordinates,
        parameters=p,
        inputs=(INPUT,),
        outputs=(OUTPUT,),
        mass=diagonal([*masses, 0, 0]),
        potential=p["joint_stiffness"] * b**2 / 2,
        force=-p["joint_damping"] * coordinates.velocity("b") * ca.jacobian(b, coordinates.q).T,
        constraints=ca.vertcat(
            first - ca.vertcat(ca.cos(a), ca.sin(a)),
            second - ca.vertcat(ca.cos(a + b), ca.sin(a + b)),
            centre - p["first_length"] * first - p["second_centre"] * second,
        ),
        input_matrix=-ca.jacobian(a, coordinates.q),
        output=a + weight * b,
        gamma=gamma,
        guess=ca.vertcat(along, (p["first_length"] + p["second_centre"]) * along, along, start, 0),
        home=(0.4,),
        observables={POINT_X: point[0], POINT_Y: point[1], POINT_ANGLE: ca.atan2(point[1], point[0])},
    )


def generalized() -> MechanicalSystem:
    """Two generalized coordinates a and b, derived from `points`: M depends on b."""
    base = points()
    coordinates = Coordinates(FIRST, SECOND)
    a, b = ca.vertsplit(coordinates.q)
    p = base.parameters
    first, second = (ca.vertcat(ca.cos(angle), ca.sin(angle)) for angle in (a, a + b))
    centre = p["first_length"] * first + p["second_centre"] * second
    return generalize(
        base,
        coordinates,
        ca.vertcat(first, centre, second, a, b),
        guess=ca.vertcat(base.gamma[0, 0], 0),
        name="passive joint arm, generalized",
    )


def drawing(v: Mapping[str, Any]) -> list[Part]:
    """Return both links, seen from above."""
    first, second = v["first_length"], 1.5 * v["second_centre"] + 0.5 * v["tracked_distance"]
    pivot, turn = (0, 0, 0), v["a"] + v["b"]
    joint = (first * ca.cos(v["a"]), 0, first * ca.sin(v["a"]))
    tip = (joint[0] + second * ca.cos(turn), 0, joint[2] + second * ca.sin(turn))
    return [
        Part("bar", (pivot, joint)),
        Part("bar", (joint, tip)),
        Part("pin", (pivot,)),
        Part("pin", (joint,)),
        Part("body", ((v["point_x"], 0, v["point_y"]),), "tracked point"),
    ]


def independent_solution(t: Array, reference: Reference, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Torque and motion by the equation of joint 2 alone: the solution that stays bounded for all times.

    Minimum phase: from rest, to about 1e-12. Non-minimum phase: a boundary value problem, to about 1e-11.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in s, increasing; outside the motion of the path as well.
    reference : Reference
        Path of y, with two derivatives.
    parameters : mapping of str to float
        All eight parameters.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        u, a, b, y.
    """
    l_1, J_1, m_2, s_2, I_2, c, d, y_2 = (parameters[name] for name in PARAMETERS.names)
    weight, J_2, coupling = y_2 / (l_1 + y_2), I_2 + m_2 * s_2**2, m_2 * l_1 * s_2

    def acceleration(y: Array, b: Array, speed: Array) -> Array:
        """Return b'' from the jet y, shape (3, ...), and from b, b'."""
        M_12 = J_2 + coupling * np.cos(b)
        load = coupling * np.sin(b) * (y[1] - weight * speed) ** 2 + d * speed + c * b
        return np.asarray(-(M_12 * y[2] + load) / (J_2 - weight * M_12))

    def rate(time: Array | float, state: Array) -> Array:
        y = np.moveaxis(reference.jet(time, 2)[..., 0], -1, 0)
        return np.array([state[1], acceleration(y, state[0], state[1])])

    inertia = J_2 - weight * (J_2 + coupling)
    b, speed = bounded(rate, t, reference, (inertia, d, c))
    y = reference.jet(t, 2)[:, :, 0].T
    b_second = acceleration(y, b, speed)
    a_first, a_second = y[1] - weight * speed, y[2] - weight * b_second
    M_11, M_12 = J_1 + m_2 * l_1**2 + J_2 + 2 * coupling * np.cos(b), J_2 + coupling * np.cos(b)
    centrifugal = coupling * np.sin(b) * speed * (2 * a_first + speed)
    return {"u": M_11 * a_second + M_12 * b_second - centrifugal, "a": y[0] - weight * b, "b": b, "y": y[0]}


def _from_percussion(_: ca.SX, p: Parameters) -> ca.SX:
    inertia = p["second_inertia"] + p["second_mass"] * p["second_centre"] ** 2
    return ca.fabs(p["tracked_distance"] - inertia / (p["second_mass"] * p["second_centre"]))


LIMITS = (
    Limit("the distance of the tracked point from the centre of percussion", "m", 1e-3,
          "joint 2 does not feel the acceleration of the tracked point", _from_percussion),
)  # fmt: skip


def passive_joint_arm(tip: bool = False) -> Scene:
    """Return the arm with its default manoeuvre: y turns from 0 to 90 degrees in 2 s.

    Both links are homogeneous rods of 1 m and 3 kg.

    Parameters
    ----------
    tip : bool
        Track the tip of link 2, y_2 = 1 m: of non-minimum phase. Otherwise y_2 = 0.4 m: minimum phase.

    Returns
    -------
    Scene
        With its models and its path.
    """
    return Scene(
        name="passive_joint_arm",
        models={"generalized": generalized, "points": points},
        reference=rest_to_rest((0.0,), (np.pi / 2,), 2.0),
        independent_solution=independent_solution,
        limits=LIMITS,
        drawing=drawing,
        parameters={"tracked_distance": TIP} if tip else {},
    )
