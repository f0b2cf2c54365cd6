r"""The boom crane: a column that slews, a boom that luffs, a winch, a load on a rope from the boom's tip.

                        _o tip
                     _-- |
              L   _--    |  rope l, paid out by the winch (M_w)
               _--       |
       e    _--  theta   o load (x, y, z)
     ----(O)- - - - -       luffing torque M_l about the boom's foot, z = 0
     |
     | axis, slewing angle phi (M_s)

Data of the scene: J_s, m_B, s_B, I_B, L, e, m, J_w, r_w, g of five degrees of freedom, three inputs; model
``points``. ``generalized`` has the angles phi and theta, the rope's length and two swing angles as coordinates. Left
out: the hoist rope's pull along the boom (its winch sits at the boom's foot, so that luffing pays out no rope), the
boom's inertia about its own axis, the effects of the other cranes; a luffing cylinder or rope, whose force by
its lever is M_l.

The crane is flat in the position r of the load. The rope lies along n, the load's acceleration less gravity, and the
tip is where that line meets the torus of all places that the tip can reach,

    P = r + l n,    (|P_xy| - e)^2 + P_z^2 = L^2,

a quartic for l. Of its solutions two are real where the line passes the circle of the boom's feet at less than L: with
the boom up, above what is perpendicular to the rope, and with the boom down. The crane works with the boom up. Where
both meet, the boom of a load at rest is level, and cannot pull the load inwards or outwards: there the reach ends.
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
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes import hanging_load, jets
from servocore.scenes.hanging_load import ROPE, SWING, TENSION

PARAMETERS = Parameters(
    Parameter("slewing_inertia", 200.0, "kg.m2", 1e-3, 1e9, "J_s, of all that slews but the boom"),
    Parameter("boom_mass", 120.0, "kg", 1e-3, 1e9, "m_B"),
    Parameter("boom_centre", 4.0, "m", 0.0, 1e3, "s_B, from the boom's foot to its mass centre"),
    Parameter("boom_inertia", 640.0, "kg.m2", 1e-6, 1e9, "I_B, across the boom about its mass centre"),
    Parameter("boom_length", 8.0, "m", 1e-3, 1e3, "L, from the boom's foot to its tip"),
    Parameter("foot_offset", 0.5, "m", 0.0, 1e3, "e, from the slewing axis to the boom's foot"),
    *hanging_load.PARAMETERS[1:],
)
INPUTS = (
    Quantity("M_s", "N.m", "slewing torque, positive as phi"),
    Quantity("M_l", "N.m", "luffing torque on the boom about its foot, positive as theta"),
    hanging_load.WINCH,
)
OUTPUTS = (
    Quantity("x", "m", "load position"),
    Quantity("y", "m", "load position"),
    Quantity("z", "m", "load position, upwards from the boom's foot"),
)
PHI = Quantity("phi", "rad", "slewing angle", wraps=True)
LUFFING = Quantity("theta", "rad", "luffing angle, from level to the boom")
SWINGS = (
    Quantity("swing_in", "rad", "swing in the boom's plane, outwards"),
    Quantity("swing_out", "rad", "swing out of the boom's plane, towards larger phi"),
)
SMALLEST_MARGIN = 1e-3
"""How far in m the rope must stay from where the boom can no longer hold it up, or stands upright."""

_TINY = 1e-300  # m², beside which every square of a length that is not zero is as it was
_ITERATIONS = 3  # to round-off, unless the rope's line passes close to the axis
_ITERATIONS_OF_JETS = 12


def points() -> MechanicalSystem:
    """Nine coordinates, four constraints: M constant, g quadratic, torques acting on directions by q-dependent B.

    q = (a, b, l, r): direction a of the column (mass J_s), of the boom b (mass I_B; the boom's mass at e a + s_B b),
    rope length l (mass J_w/r_w^2), load r; constraints |a|^2 = 1, |b|^2 = 1, a x b = 0 and
    |r - e a - L b|^2 = l^2.
    """
    directions = (Quantity(name) for name in ("a_x", "a_y", "b_x", "b_y", "b_z"))
    coordinates, p = Coordinates(*directions, ROPE, *OUTPUTS), PARAMETERS
    column, boom, length, load = ca.vertsplit(coordinates.q, [0, 2, 5, 6, 9])
    outwards, upwards = ca.dot(column, boom[:2]), boom[2]
    centre, tip = (ca.vertcat(p["foot_offset"] * column, 0) + p[name] * boom for name in ("boom_centre", "boom_length"))
    rope, lam, gamma = load - tip, ca.SX.sym("lam", 4), reference_symbols(3)
    moving = ca.jacobian(centre, coordinates.q)
    own = ca.vertcat(
        *[p["slewing_inertia"]] * 2, *[p["boom_inertia"]] * 3, p["winch_inertia"] / p["winch_radius"] ** 2,
        *[p["load_mass"]] * 3,
    )  # fmt: skip
    # How far slewing and luffing turn where q changes, without terms that vanish where the constraints hold.
    slewing = ca.horzcat(-column[1], column[0], ca.SX(1, 7))
    luffing = ca.horzcat(ca.SX(1, 2), -upwards * column.T, outwards, ca.SX(1, 4))
    winding = ca.jacobian(length / p["winch_radius"], coordinates.q)
    return MechanicalSystem(
        name="boom crane, points",
        coordinates=coordinates,
        parameters=p,
        inputs=INPUTS,
        outputs=OUTPUTS,
        mass=ca.sparsify(ca.diag(own) + p["boom_mass"] * ca.mtimes(moving.T, moving)),
        potential=p["gravity"] * (p["boom_mass"] * centre[2] + p["load_mass"] * load[2]),
        constraints=ca.vertcat(
            ca.sumsqr(column) - 1,
            ca.sumsqr(boom) - 1,
            column[0] * boom[1] - column[1] * boom[0],
            ca.sumsqr(rope) - length**2,
        ),
        input_matrix=-ca.vertcat(slewing, luffing, winding),
        output=load,
        multipliers=lam,
        gamma=gamma,
        guess=_hanging(gamma, p),
        home=(5.0, 0.0, -1.0),
        observables={
            PHI: ca.atan2(column[1], column[0]),
            LUFFING: ca.atan2(upwards, outwards),
            # The force on the load is -lam d|rope|^2/dr = -2 lam rope, towards the tip when lam > 0.
            TENSION: 2 * lam[3] * length,
            SWING: hanging_load.swing_angle(rope),
        },
    )


def generalized() -> MechanicalSystem:
    """Five generalized coordinates phi, theta, l and two swing angles, derived from `points` by q = F(mu).

    The swing angles turn with the column. Singular where the swing out of the boom's plane is 90 degrees.
    """
    base = points()
    coordinates, p, gamma = Coordinates(PHI, LUFFING, ROPE, *SWINGS), base.parameters, base.gamma
    phi, theta, length, inside, outside = ca.vertsplit(coordinates.q)
    along = ca.vertcat(ca.cos(phi), ca.sin(phi))
    boom = ca.vertcat(ca.cos(theta) * along, ca.sin(theta))
    rope = length * hanging_load.rope_beside(along, inside, outside)
    tip = ca.vertcat(p["foot_offset"] * along, 0) + p["boom_length"] * boom
    column, raised, hanging, _ = ca.vertsplit(_hanging(gamma, p), [0, 2, 5, 6, 9])
    return generalize(
        base,
        coordinates,
        ca.vertcat(along, boom, length, tip + rope),
        guess=ca.vertcat(
            ca.atan2(column[1], column[0]),
            ca.atan2(raised[2], ca.dot(column, raised[:2])),
            hanging,
            hanging_load.swings_beside(column, -hanging_load.upwards(gamma, p)),
        ),
        # Without multipliers the tension follows from the load's prescribed acceleration.
        observables={TENSION: hanging_load.tension(gamma, p), SWING: hanging_load.swing_angle(rope)},
        name="boom crane, generalized",
    )


def _from_axis(place: ca.SX) -> ca.SX:
    """Return how far a place is from the slewing axis; on the axis its derivatives are zero, not undefined."""
    return ca.sqrt(ca.sumsqr(place[:2]) + _TINY)


def _distance(gamma: ca.SX, p: Parameters) -> ca.SX:
    """How near the rope's line comes to the circle of the boom's feet, by Newton's method from the height of these.

    With R, how far a place is from the axis, half of the derivative of the squared distance is r n + l - e R'.
    """
    towards, load, offset = hanging_load.upwards(gamma, p), gamma[:, 0], p["foot_offset"]
    projected, nearest, level = ca.dot(load, towards), -load[2] / towards[2], ca.sumsqr(towards[:2])
    for _ in range(_ITERATIONS):
        place = load + nearest * towards
        R, squared, radial = _from_axis(place), ca.sumsqr(place[:2]) + _TINY, ca.dot(place[:2], towards[:2])
        slope, curvature = (projected + nearest) * R - offset * radial, level - radial**2 / squared
        nearest -= slope / (R - offset * curvature)  # both times R
    place = load + nearest * towards
    return ca.sqrt((_from_axis(place) - offset) ** 2 + place[2] ** 2)


def _tip(gamma: ca.SX, p: Parameters) -> tuple[ca.SX, ca.SX]:
    """Return the boom's tip when the load follows the path, with the boom up, and the rope's length.

    The torus is |P|^2 - 2 e R = L^2 - e^2, with R how far P is from the axis. Along the rope's line R is almost linear,
    and a tangent in its place, the first where the line leaves the sphere of radius L + e, leaves a quadratic equation
    for l. Unlike Newton's method for the quartic that does not slow down where both solutions meet.
    """
    towards, load, offset, boom = hanging_load.upwards(gamma, p), gamma[:, 0], p["foot_offset"], p["boom_length"]
    projected, outside = ca.dot(load, towards), ca.sumsqr(load) + (offset - boom) * (offset + boom)
    length = ca.sqrt(projected**2 - ca.sumsqr(load) + (boom + offset) ** 2) - projected
    for _ in range(_ITERATIONS):
        place = load + length * towards
        R, squared = _from_axis(place), ca.sumsqr(place[:2]) + _TINY
        # Not divided by R, so that the division need not wait for the root.
        slope = offset * ca.dot(place[:2], towards[:2]) / squared * R
        middle = slope - projected
        apart = middle**2 - outside + 2 * (offset * R - slope * length)
        length = middle + ca.sqrt(ca.if_else(apart > 0, apart, 0))
    return load + length * towards, length


def _hanging(gamma: ca.SX, p: Parameters) -> ca.SX:
    """Return the configuration of `points` when the load follows the path."""
    tip, length = _tip(gamma, p)
    column = tip[:2] / ca.norm_2(tip[:2])
    boom = (tip - ca.vertcat(p["foot_offset"] * column, 0)) / p["boom_length"]
    return ca.vertcat(column, boom, length, gamma[:, 0])


def closed_form(reference: Array, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Exact inputs and motion for reference jets of order four or higher: the crane is flat in the load position.

    Torques are those of the angles alone (Lagrange), the tip is found on jets by Newton's method.

    Parameters
    ----------
    reference : ndarray, shape (N, orders, 3)
        Load position and its derivatives.
    parameters : mapping of str to float
        All ten parameters.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        M_s, M_l, M_w, phi, theta, l, tension, swing, x, y, z.
    """
    J_s, m_B, s_B, I_B, L, e, m, J_w, r_w, g = (parameters[name] for name in PARAMETERS.names)
    x, y, z = jets.components(reference)
    pull = (x.d().d(), y.d().d(), z.d().d() + g)
    size = jets.sqrt(pull[0] ** 2 + pull[1] ** 2 + pull[2] ** 2)
    n_x, n_y, n_z = (component / size for component in pull)
    along = x * n_x + y * n_y + z * n_z
    rope = jets.sqrt(along**2 + (L + e) ** 2 - (x**2 + y**2 + z**2)) - along
    for _ in range(_ITERATIONS_OF_JETS):  # derivatives converge after the value, twice as many with each
        P_x, P_y, P_z = x + rope * n_x, y + rope * n_y, z + rope * n_z
        R = jets.sqrt(P_x**2 + P_y**2)
        missed = (R - e) ** 2 + P_z**2 - L**2
        rope = rope - missed / (2 * ((R - e) / R * (P_x * n_x + P_y * n_y) + P_z * n_z))
    P_x, P_y, P_z = x + rope * n_x, y + rope * n_y, z + rope * n_z
    R = jets.sqrt(P_x**2 + P_y**2)
    phi, theta = jets.atan2(P_y, P_x), jets.atan2(P_z, R - e)
    tension = m * size.value
    (_, phi1, phi2), (theta0, theta1, theta2) = phi.derivatives()[:3], theta.derivatives()[:3]
    cos, sin = np.cos(theta0), np.sin(theta0)
    # Rope force on the tip, down the rope: along the level direction of the boom, across it, and upwards.
    outwards = -tension * (n_x.value * P_x.value + n_y.value * P_y.value) / R.value
    across = -tension * (n_y.value * P_x.value - n_x.value * P_y.value) / R.value
    upwards = -tension * n_z.value
    inertia = J_s + m_B * (e + s_B * cos) ** 2 + I_B * cos**2
    slope = -2 * sin * (m_B * s_B * (e + s_B * cos) + I_B * cos)  # of that inertia by theta
    return {
        "M_s": inertia * phi2 + slope * theta1 * phi1 - R.value * across,
        "M_l": (I_B + m_B * s_B**2) * theta2
        - slope * phi1**2 / 2
        + m_B * g * s_B * cos
        - L * (upwards * cos - outwards * sin),
        "M_w": J_w * rope.derivatives()[2] / r_w - r_w * tension,
        "phi": np.unwrap(phi.value),
        "theta": theta0,
        "l": rope.value,
        "tension": tension,
        "swing": np.arctan2(np.hypot(n_x.value, n_y.value), n_z.value),
        "x": x.value,
        "y": y.value,
        "z": z.value,
    }


def drawing(v: Mapping[str, Any]) -> list[Part]:
    """Return column, boom, rope and load."""
    cos, sin, out = ca.cos(v["phi"]), ca.sin(v["phi"]), v["foot_offset"]
    reach, height = out + v["boom_length"] * ca.cos(v["theta"]), v["boom_length"] * ca.sin(v["theta"])
    foot, tip = (out * cos, out * sin, 0), (reach * cos, reach * sin, height)
    load = (v["x"], v["y"], v["z"])
    return [
        Part("post", ((0, 0, 0),)),
        Part("bar", ((0, 0, 0), foot)),
        Part("bar", (foot, tip)),
        Part("rope", (tip, load), colour=TENSION.name),
        Part("pin", (tip,)),
        Part("body", (load,), "load"),
    ]


LIMITS = (
    hanging_load.TAUT,
    Limit(
        "the boom's length less the rope's distance from its foot",
        "m",
        SMALLEST_MARGIN,
        "the load is out of the boom's reach",
        lambda gamma, p: p["boom_length"] - _distance(gamma, p),
    ),
    Limit(
        "the boom's level reach",
        "m",
        SMALLEST_MARGIN,
        "the boom stands upright, and the load is too near to the column",
        lambda gamma, p: ca.norm_2(_tip(gamma, p)[0][:2]) - p["foot_offset"],
    ),
    Limit("the rope's length", "m", 0.0, "the load reaches the boom's tip", lambda gamma, p: _tip(gamma, p)[1]),
)


def boom_crane() -> Scene:
    """Return the boom crane with its default manoeuvre, (6, 0, -1) m to (-2, 4, 2) m in 15 s.

    Returns
    -------
    Scene
        With its models and its path.
    """
    return Scene(
        name="boom_crane",
        models={"points": points, "generalized": generalized},
        reference=rest_to_rest((6.0, 0.0, -1.0), (-2.0, 4.0, 2.0), 15.0),
        closed_form=closed_form,
        limits=LIMITS,
        tracked="load",
        drawing=drawing,
    )
