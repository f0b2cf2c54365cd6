"""The wheelset of the test set of Bari: a railway wheelset on straight rails that hunts, stiff, of index 2.

Written from the set's report (Simeon, Fuehrer and Rentrop 1991; initial values by de Swart; release 2.4): places x, y,
z, yaw theta and roll phi, the excess beta' of the wheels' angular velocity, contact coordinates psi and xi of both
wheels as algebraic unknowns, and the multipliers of the two contacts, scaled by 10^4. Creep forces depend on the normal
forces, and these on the multipliers: outside equation (1), where multipliers enter linearly. So it is a `Dae`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from servocore.dae import Dae, Equation, Unknown

MASS, GRAVITY, SPEED, RADIUS, INERTIA, ACROSS = 16.08, 9.81, 30.0, 0.1, 0.0605, 0.366
FRICTION, SPRING_ARM, SPRING_X, SPRING_Z = 0.12, 0.19, 6400.0, 6400.0
CONE, GAUGE, RAIL = 0.0262, 0.1506, 0.06
ELLIPSE_E, ELLIPSE_G, POISSON, SHEAR = 1.3537956, 0.7115218, 0.28, 7.92e10
KALKER = (4.72772197, 4.27526987, 1.97203505)
PI = 3.1415926  # as the set's program has it: of the size of the contacts, and so of all creep forces
SCALE, DURATION = 1e4, 10.0
NAMES = (
    "x", "y", "z", "theta", "phi", "x'", "y'", "z'", "theta'", "phi'", "beta'",
    "psi_l", "xi_l", "psi_r", "xi_r", "lam_1", "lam_2",
)  # fmt: skip
START = np.array([
    0.14941e-2, 0.40089e-6, 0.11241e-5, -0.28573e-3, 0.26459e-3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    -7.4122380357667139e-6, -0.1521364296121248, 7.5634406395172940e-6, 0.1490635714733819, -0.83593e-2, -0.74144e-2,
])  # fmt: skip
END = np.array([
    0.86355386965811e-2, 0.13038281022727e-4, -0.93635784016818e-4, -0.13642299804033e-1, 0.15292895005422e-2,
    -0.76985374142666e-1, -0.25151106429207e-3, 0.20541188079539e-2, -0.23904837703692, -0.13633468454173e-1,
    -0.24421377661131, -0.33666751972196e-3, -0.15949425684022, 0.37839614386969e-3, 0.14173214964613,
    -0.10124044903201e-1, -0.56285630573753e-2,
])  # fmt: skip
"""The 17 values at t = 10 s that the set publishes, by DASSL at 1e-9, the multipliers without error control."""


@dataclass(frozen=True, eq=False)
class _Contact:
    """A wheel on its rail; `side` is -1 on the left and 1 on the right.

    `radius` and `slope` are those of the conical wheel at the contact, `rail` and `bend` the first two derivatives of
    the rail's profile there, `row` the derivative of the contact constraint by (x, y, z, theta, phi).
    """

    side: int
    radius: ca.SX
    slope: ca.SX
    rail: ca.SX
    bend: ca.SX
    row: ca.SX
    angle: ca.SX
    conditions: ca.SX


def _contact(side: int, q: ca.SX, psi: ca.SX, xi: ca.SX) -> _Contact:
    x, theta, phi = q[0], q[3], q[4]
    s_t, c_t, s_f, c_f, s_p, c_p = (function(each) for each in (theta, phi, psi) for function in (ca.sin, ca.cos))
    across = side * xi  # positive on either side
    radius, slope = RADIUS + np.tan(CONE) * (GAUGE - across), ca.SX(-side * np.tan(CONE))
    place = x + xi * c_t * c_f + radius * (c_t * s_f * c_p - s_t * s_p)
    offset = side * place - GAUGE - np.sin(CONE) * RAIL
    height = ca.sqrt(RAIL**2 - offset**2)
    rail, bend = -side * offset / height, -(RAIL**2) / height**3
    row = ca.vertcat(
        rail, -1, 0,
        rail * (radius * (-c_t * s_p - c_p * s_f * s_t) - c_f * s_t * xi),
        -c_p * radius * s_f - c_f * xi + rail * (c_f * c_p * c_t * radius - c_t * s_f * xi),
    )  # fmt: skip
    level, steep = (slope * c_f - s_f * c_p) * c_t + s_p * s_t, slope * s_f + c_p * c_f
    conditions = ca.vertcat(
        rail * (slope * s_f + c_f * c_p) + slope * c_t * c_f - c_t * s_f * c_p + s_t * s_p,
        slope * s_t * c_f - s_t * s_f * c_p - c_t * s_p,
    )
    return _Contact(side, radius, slope, rail, bend, row, ca.atan(side * level / steep), conditions)


def _creep(contact: _Contact, normal: ca.SX, q: ca.SX, v: ca.SX, spin: ca.SX, psi: ca.SX, xi: ca.SX) -> ca.SX:
    """Return the creep force at a contact along x, y and z, by Kalker's linear theory with saturation."""
    theta, phi, radius, side = q[3], q[4], contact.radius, contact.side
    s_f, c_f, s_p, c_p = (function(each) for each in (phi, psi) for function in (ca.sin, ca.cos))
    s_d, c_d = -side * ca.sin(contact.angle), ca.cos(contact.angle)  # of the plane of contact
    s_t, c_t = ca.sin(theta / c_d), ca.cos(theta / c_d)
    rolling = ca.vertcat(
        -spin * radius * (s_t * c_p + c_t * s_f * s_p), spin * radius * c_f * s_p,
        -spin * radius * (c_t * c_p - s_t * s_f * s_p),
    )  # fmt: skip
    turning, tilting = v[3], v[4]
    lever = xi * s_f - radius * c_f * c_p
    carried = ca.vertcat(
        -turning * (radius * (s_t * s_f * c_p + c_t * s_p) + xi * s_t * c_f) - tilting * c_t * lever,
        tilting * (xi * c_f + radius * s_f * c_p),
        -turning * (xi * c_t * c_f + radius * (c_t * s_f * c_p - s_t * s_p)) + tilting * s_t * lever,
    )
    moving = ca.vertcat(v[0], v[1], v[2] + SPEED)
    slip = rolling + carried + moving
    pace = ca.norm_2(rolling + carried - moving) / 2
    along = (s_t * slip[0] + c_t * slip[2]) / pace
    sideways = (c_t * c_d * slip[0] + s_d * slip[1] - s_t * c_d * slip[2]) / pace
    turn = (-s_d * spin + c_d * turning) / pace
    curve = 0.5 / (radius * ca.sqrt(1 + contact.slope**2)) - 0.5 * contact.bend / (1 + contact.rail**2) ** 1.5
    size = (3 * ca.fabs(normal) * (1 - POISSON) * ELLIPSE_E / (2 * PI * curve * SHEAR * np.sqrt(ELLIPSE_G))) ** (1 / 3)
    most = FRICTION * normal
    t_x = -most * ca.tanh(SHEAR * size**2 * KALKER[0] * along / most)
    t_y = -most * ca.tanh((SHEAR * size**2 * KALKER[1] * sideways + SHEAR * size**3 * KALKER[2] * turn) / most)
    total = ca.sqrt(t_x**2 + t_y**2)
    share = ca.if_else(total > ca.fabs(most), ca.fabs(most) / total, 1)
    t_x, t_y = share * t_x, share * t_y
    force: ca.SX = ca.vertcat(s_t * t_x + c_t * c_d * t_y, s_d * t_y, c_t * t_x - s_t * c_d * t_y)
    return force


@cache
def wheelset() -> Dae:
    """Return the 17 equations: 11 differential unknowns, 4 contact coordinates and 2 multipliers."""
    x, z = ca.SX.sym("x", 11), ca.SX.sym("z", 6)
    q, v, spin = x[:5], x[5:10], SPEED / RADIUS + x[10]
    s_t, c_t, s_f, c_f = (function(each) for each in (q[3], q[4]) for function in (ca.sin, ca.cos))
    left, right = _contact(-1, q, z[0], z[1]), _contact(1, q, z[2], z[3])
    lam = {left: SCALE * z[5], right: SCALE * z[4]}
    reaction = left.row * lam[left] + right.row * lam[right]
    s_l, c_l, s_r, c_r = (function(each.angle) for each in (left, right) for function in (ca.sin, ca.cos))
    sides = -s_l * c_r - s_r * c_l
    normal = {
        left: (c_r * reaction[0] - s_r * reaction[1]) / sides,
        right: (-c_l * reaction[0] - s_l * reaction[1]) / sides,
    }
    force, moment = reaction[:3], ca.vertcat(reaction[3:], 0)
    for contact, psi, xi in ((left, z[0], z[1]), (right, z[2], z[3])):
        creep = _creep(contact, normal[contact], q, v, spin, psi, xi)
        force, moment = force + creep, moment + _moments(contact.radius, creep, (s_t, c_t, s_f, c_f), psi, xi)
    springs = ca.vertcat(-2 * SPRING_X * q[0], -MASS * GRAVITY, -2 * SPRING_Z * q[2])
    yaw = -2 * SPRING_ARM**2 * SPRING_Z * q[3]
    turning, tilting = v[3], v[4]
    f = ca.vertcat(
        v,
        force + springs,
        ACROSS * turning * tilting * s_f - INERTIA * spin * tilting - (INERTIA - ACROSS) * turning * s_f * tilting
        + moment[0] + c_f * yaw,
        INERTIA * spin * turning * c_f + (INERTIA - ACROSS) * turning * s_f * turning * c_f + moment[1],
        -INERTIA * turning * tilting * c_f + moment[2] + s_f * yaw,
    )  # fmt: skip
    H = ca.SX.eye(11)
    for k in (5, 6, 7):
        H[k, k] = MASS
    H[8, 8], H[9, 9], H[10, 10], H[10, 8] = ACROSS * c_f, ACROSS, INERTIA, INERTIA * s_f
    rates = ca.vertcat(ca.dot(right.row, v), ca.dot(left.row, v))
    # Magnitudes, for Newton's method would stop where positions of 1e-5 have five digits; no levels, for creep damps
    # errors of velocities at once: they do not grow as steps become shorter.
    unknowns = tuple(Unknown(f"q.{name}", 0, abs(size)) for name, size in zip(NAMES, END.tolist(), strict=True))
    return Dae(
        name="wheelset", x=x, z=z, H=H, f=f, h=ca.vertcat(left.conditions, right.conditions, rates),
        gamma=ca.SX.sym("gamma", 1, 1), p=ca.SX(0, 1),
        unknowns=unknowns,
        equations=tuple(Equation(f"row {k + 1}", 0) for k in range(17)), physical={}, index=2,
    )  # fmt: skip


def _moments(radius: ca.SX, force: ca.SX, turns: tuple[Any, ...], psi: ca.SX, xi: ca.SX) -> ca.SX:
    """Return the moments of a creep force about the axes of yaw, roll and spin."""
    s_t, c_t, s_f, c_f = turns
    s_p, c_p = ca.sin(psi), ca.cos(psi)
    a, b, c = ca.vertsplit(force)
    flat, deep = radius * s_p, radius * c_p
    moments: ca.SX = ca.vertcat(
        -(xi * s_t + flat * c_t * c_f) * a - flat * s_f * b + (-xi * c_t + flat * s_t * c_f) * c,
        (deep * c_t * c_f - xi * c_t * s_f) * a + (xi * c_f + deep * s_f) * b + (xi * s_t * s_f - deep * s_t * c_f) * c,
        -(deep * s_t + flat * c_t * s_f) * a + flat * c_f * b - (deep * c_t - flat * s_t * s_f) * c,
    )
    return moments
