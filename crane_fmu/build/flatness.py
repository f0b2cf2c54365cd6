"""The crane's motion and inputs from those of its load, a flat output.

A load that is off its path when the feedback starts returns along an offset: delta and its derivatives have the
measured values at first, and (d/dt + a)^4 delta = 0 then. With y_k = (d/dt + a)^k delta: y_k' = y_(k+1) - a y_k.
"""

from __future__ import annotations

import math
from typing import Any, TypeVar

import casadi as ca

from crane_fmu.catalogue import DIMENSION, ORDERS

STATES, DRIVES, POINTS, LOAD = 10, 3, 5, slice(2, 5)
"""Numbers of states, inputs and coordinates (trolley and load as points), and the load's coordinates."""

RETURN_SHARE, RETURN_TURN, NO_OFFSET = 0.5, 0.3, 1e-12
"""Return of a load that starts off its path: largest acceleration in g, largest a h, and offsets treated as zero."""


Matrix = TypeVar("Matrix", ca.SX, ca.MX)


def flat_motion() -> ca.Function:
    """Return (jet of the load, p) -> (state, inputs, accelerations) of the crane."""
    jet = ca.SX.sym("jet", DIMENSION, len(ORDERS) + 1)
    flat, shifted = ca.vec(jet[:, :-1]), ca.vec(jet[:, 1:])
    bridge, trolley, load, winch, radius, gravity = ca.vertsplit(ca.SX.sym("p", 6))

    def dot(of: ca.SX) -> ca.SX:
        return ca.jtimes(of, flat, shifted)

    r, fall = jet[:, 0], gravity + jet[2, 2]
    place = r[:2] - r[2] / fall * jet[:2, 2]  # the trolley is on the line of the rope force
    velocity = dot(place)
    acceleration = dot(velocity)
    s, rope = ca.norm_2(place), ca.vertcat(r[:2] - place, r[2])
    length = ca.norm_2(rope)
    c, sn = place[0] / s, place[1] / s

    def along(w: ca.SX) -> ca.SX:
        return c * w[0] + sn * w[1]

    def across(w: ca.SX) -> ca.SX:
        return c * w[1] - sn * w[0]

    tension = load * fall * length / -r[2]
    pull = tension * rope / length
    s_dot, turning, rolling = along(velocity), across(velocity) / s, dot(length)
    turning_dot = (across(acceleration) - 2 * s_dot * turning) / s
    inputs = ca.vertcat(
        bridge * turning_dot + s * (trolley * across(acceleration) - across(pull)),
        trolley * along(acceleration) - along(pull),
        winch * dot(rolling) / radius - tension * radius,
    )
    state = ca.vertcat(place, r, velocity, jet[:, 1])
    p = ca.vertcat(bridge, trolley, load, winch, radius, gravity)
    results = state, inputs, ca.vertcat(acceleration, jet[:, 2])
    return ca.Function("flat", [flat, p], [ca.substitute(each, jet[:, -1], 0) for each in results], {"cse": True})


def fastest_pendulum(path: ca.SX, length: ca.SX, p: ca.SX) -> ca.SX:
    """Return the angular frequency of the fastest pendulum, in rad/s: a load below a trolley that is free to roll."""
    return ca.sqrt(ca.fmax(p[5] + path[8], 0) / length * (1 + p[2] / p[1]))


def measured_state() -> ca.Function:
    """Return (measured) -> state: positions of trolley and load, and their velocities."""
    given = ca.SX.sym("measured", 12)
    phi, s, _, phi_dot, s_dot, _ = ca.vertsplit(given[:6])
    along, across = ca.vertcat(ca.cos(phi), ca.sin(phi)), ca.vertcat(-ca.sin(phi), ca.cos(phi))
    state = ca.vertcat(s * along, given[6:9], s_dot * along + s * phi_dot * across, given[9:])
    return ca.Function("measured", [given], [state])


def continued(jet: ca.SX, crackle: ca.SX, tau: Any) -> ca.SX:
    """Continue a path by its Taylor polynomial with a fifth derivative."""
    rows = [*(jet[DIMENSION * k : DIMENSION * (k + 1)] for k in range(len(ORDERS))), crackle]
    moved = []
    for k in range(len(ORDERS)):
        value = rows[-1]
        for j in reversed(range(k, len(ORDERS))):
            value = rows[j] + tau / (j - k + 1) * value
        moved.append(value)
    return ca.vertcat(*moved)


def offset_at_start(jet: ca.MX, measured: ca.MX, p: ca.MX, h: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return y_0 ... y_3 and a of an offset with (d/dt + a)^4 delta = 0, y_k = (d/dt + a)^k delta.

    The measured values determine position, velocity and, by the rope's direction, acceleration and jerk of the load.
    """
    phi, s, length, turning, s_dot, _ = ca.vertsplit(measured[:6])
    r, v, gravity = measured[6:9], measured[9:], p[5]
    fall, fall_dot = gravity + jet[8], jet[11]
    out, round_ = ca.vertcat(ca.cos(phi), ca.sin(phi)), ca.vertcat(-ca.sin(phi), ca.cos(phi))
    lean, lean_dot = r[:2] - s * out, v[:2] - s_dot * out - s * turning * round_
    acceleration = fall / r[2] * lean
    jerk = (fall_dot * lean + fall * lean_dot - v[2] * acceleration) / r[2]
    off = ca.horzcat(r, v, ca.vertcat(acceleration, jet[8]), ca.vertcat(jerk, jet[11])) - ca.reshape(jet[:12], 3, 4)
    sizes = [ca.norm_2(off[:2, k]) for k in range(4)]
    reach = RETURN_SHARE * gravity
    snap = reach * gravity / length
    across = [(snap / ca.fmax(math.comb(4, k) * size, 1e-12)) ** (1 / (4 - k)) for k, size in enumerate(sizes)]
    down = [ca.sqrt(reach / ca.fmax(ca.fabs(off[2, 0]), 1e-12)), reach / ca.fmax(ca.fabs(off[2, 1]), 1e-12)]
    a = ca.fmin(RETURN_TURN / h, ca.vertcat(*(ca.mmin(ca.vertcat(*each)) for each in (across, across, down))))
    y = [sum(math.comb(k, j) * a ** (k - j) * off[:, j] for j in range(k + 1)) for k in range(4)]
    return forgotten(ca.vertcat(*y)), a


def forgotten(y: Matrix) -> Matrix:
    """Return an offset, or zeros in place of round-off, whose squares would underflow."""
    return ca.if_else(ca.norm_inf(y) > NO_OFFSET, y, type(y).zeros(y.numel()))


def offset() -> ca.Function:
    """Return (y, a, tau) -> (y_0 ... y_3, jet of the offset), tau seconds later."""
    y, a, tau = ca.SX.sym("y", 4 * DIMENSION), ca.SX.sym("a", DIMENSION), ca.SX.sym("tau")
    rows, fading = ca.vertsplit(y, DIMENSION), ca.exp(-a * tau)
    later: list[ca.SX] = []
    for k in range(4):
        value = rows[3]
        for j in reversed(range(k, 3)):  # Horner: powers are slow
            value = rows[j] + tau / (j - k + 1) * value
        later.append(fading * value)
    powers = [ca.SX.ones(DIMENSION)]
    for _ in ORDERS[1:]:
        powers.append(powers[-1] * -a)
    jet = [sum(math.comb(k, j) * powers[k - j] * later[j] for j in range(min(k, 3) + 1)) for k in range(len(ORDERS))]
    return ca.Function("offset", [y, a, tau], [ca.vertcat(*later), ca.vertcat(*jet)], {"cse": True})
