r"""The mass on a car (Seifried & Blajer 2013): the mass is to follow a path, the force acts on the car.

        y ---->     [m_2]
                    //      s up the incline, from equilibrium; spring k, damper d
                   //
                  //  alpha
      u   _______//____________
    ---> |        m_1          |      y = x + s cos(alpha) is to follow the path
         |___O___________O_____|
        x ---->

Data of the scene: m_1, m_2, k, d and the inclination alpha of two degrees of freedom, one input; model
``generalized``, in x and s. ``points`` has y as a third coordinate, with a constraint: M is diagonal, C Boolean.
Left out: friction; gravity, which only shifts the equilibrium from which s is measured.

The data decide what kind of problem this is. The mass alone has

    m_2 sin(alpha)^2 s'' + d s' + k s = -m_2 cos(alpha) y'',    u = m_1 x'' + m_2 y'',

    alpha in (0, 90 deg]      index 3, two internal states (minimum phase for k, d > 0)
    alpha = 0, d > 0          index 4, one internal state
    alpha = 0, d = 0          index 5, none: s = -m_2 y''/k

There is no closed form, except in the last case: s depends on the history of the path. `exact` integrates the line
above by SciPy. A negative k (a mass that its support pushes away) makes the internal dynamics unstable: the problem is
then of non-minimum phase, and `exact` is the solution that stays bounded for all times. It moves before the path does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.model.drawing import Part
from servocore.model.generalize import generalize
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MechanicalSystem, reference_symbols
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import diagonal
from servocore.references.base import Reference
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes.internal_ode import backward, bounded, forward

PARAMETERS = Parameters(
    Parameter("car_mass", 1.0, "kg", 1e-3, 1e9, "m_1"),
    Parameter("mass", 2.0, "kg", 1e-3, 1e9, "m_2"),
    Parameter("stiffness", 5.0, "N/m", -1e9, 1e9, "k; below zero the internal dynamics are unstable"),
    Parameter("damping", 1.0, "N.s/m", 0.0, 1e9, "d"),
    Parameter("inclination", math.pi / 4, "rad", 0.0, math.pi / 2, "alpha, of the incline"),
)
INPUT = Quantity("u", "N", "force on the car, positive forwards")
OUTPUT = Quantity("y", "m", "horizontal position of the mass")
CAR = Quantity("x", "m", "position of the car")
SLIDE = Quantity("s", "m", "position of the mass on the incline, from equilibrium")


def points() -> MechanicalSystem:
    """Three coordinates q = (x, s, y), one constraint y = x + s cos(alpha): M constant and diagonal.

    The height s sin(alpha) of the mass is not a coordinate: its inertia is that of s.
    """
    coordinates = Coordinates(CAR, SLIDE, OUTPUT)
    x, s, y = ca.vertsplit(coordinates.q)
    p = PARAMETERS
    gamma = reference_symbols(1)
    masses = (p["car_mass"], p["mass"] * ca.sin(p["inclination"]) ** 2, p["mass"])
    return MechanicalSystem(
        name="mass on car, points",
        coordinates=coordinates,
        parameters=p,
        inputs=(INPUT,),
        outputs=(OUTPUT,),
        mass=diagonal(masses),
        potential=p["stiffness"] * s**2 / 2,
        force=-p["damping"] * coordinates.velocity("s") * ca.jacobian(s, coordinates.q).T,
        constraints=y - x - s * ca.cos(p["inclination"]),
        input_matrix=-ca.jacobian(x, coordinates.q),
        output=y,
        gamma=gamma,
        guess=ca.vertcat(gamma[0, 0], 0, gamma[0, 0]),
    )


def generalized() -> MechanicalSystem:
    """Two generalized coordinates x and s, derived from `points`."""
    base = points()
    coordinates = Coordinates(CAR, SLIDE)
    x, s = ca.vertsplit(coordinates.q)
    return generalize(
        base,
        coordinates,
        ca.vertcat(x, s, x + s * ca.cos(base.parameters["inclination"])),
        guess=ca.vertcat(base.gamma[0, 0], 0),
        name="mass on car, generalized",
    )


def drawing(v: Mapping[str, Any]) -> list[Part]:
    """Return the car, and the mass on its incline with the spring."""
    reach, up = 1.5, (ca.cos(v["inclination"]), ca.sin(v["inclination"]))
    foot, top = ((v["x"] + place * up[0], 0, place * up[1]) for place in (-reach, reach))
    mass = (v["x"] + v["s"] * up[0], 0, v["s"] * up[1])
    return [
        Part("rail", ((0, 0, -reach),)),
        Part("bar", (foot, top)),
        Part("spring", (foot, mass)),
        Part("box", ((v["x"], 0, -reach),), "car"),
        Part("body", (mass,), "mass"),
    ]


def independent_solution(t: Array, reference: Reference, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Force and motion by the equation of the mass alone: the solution that stays bounded for all times.

    With k >= 0 it rests until the path starts. With k < 0 it also moves before: see `internal_motion`.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in s, increasing; outside the motion of the path as well.
    reference : Reference
        Path of the mass, with two derivatives (four for alpha = 0).
    parameters : mapping of str to float
        All five parameters.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        u, x, s, y.

    Raises
    ------
    InvalidModel
        If alpha, d and k are zero: then s is not determined by the path.
    """
    m_1, m_2, _, _, alpha = (parameters[name] for name in PARAMETERS.names)
    s, s_second = internal_motion(t, reference, parameters)
    y = reference.jet(t, 2)[:, :, 0].T
    x_second = y[2] - math.cos(alpha) * s_second
    return {"u": m_1 * x_second + m_2 * y[2], "x": y[0] - math.cos(alpha) * s, "s": s, "y": y[0]}


def internal_motion(t: Array, reference: Reference, parameters: Mapping[str, float]) -> tuple[Array, Array]:
    """Return s and s'' at the times `t`, each of shape (N,).

    An unstable part of the motion is integrated backward in time from the end of the path: its only bounded solution.
    """
    _, m_2, k, d, alpha = (parameters[name] for name in PARAMETERS.names)
    inertia, push = m_2 * math.sin(alpha) ** 2, -m_2 * math.cos(alpha)

    def drive(time: float) -> float:
        return push * float(reference.jet(time, 2)[2, 0])

    def rate(time: Array | float, state: Array) -> Array:
        forced = push * reference.jet(time, 2)[..., 2, 0]
        return np.array([state[1], (forced - d * state[1] - k * state[0]) / inertia])

    if inertia:
        states = bounded(rate, t, reference, (inertia, d, k))
        return states[0], rate(t, states)[1]
    forces = push * reference.jet(t, 4)[:, 2:, 0].T
    if d:
        integrate, limit = (forward, reference.start_time) if k >= 0.0 else (backward, reference.end_time)
        (position,) = integrate(lambda time, s: np.array([(drive(time) - k * s[0]) / d]), t, limit, 1)
        speed = (forces[0] - k * position) / d
        return position, (forces[1] - k * speed) / d
    if not k:
        raise InvalidModel("mass on car: without inclination, spring and damper the path does not determine s")
    return forces[0] / k, forces[2] / k


def mass_on_car() -> Scene:
    """Return the mass on a car with its default manoeuvre: the mass moves from 0 m to 2 m in 4 s.

    Returns
    -------
    Scene
        With its models and its path.
    """
    return Scene(
        name="mass_on_car",
        models={"generalized": generalized, "points": points},
        reference=rest_to_rest((0.0,), (2.0,), 4.0),
        independent_solution=independent_solution,
        drawing=drawing,
    )
