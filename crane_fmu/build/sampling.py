"""The crane in its feedback: its motion from that of the load; a step, nonlinear and linearized; Riccati steps.

A load that is off its path when the feedback starts returns along an offset: delta and its derivatives have the
measured values at first, and (d/dt + a)^4 delta = 0 then. With y_k = (d/dt + a)^k delta: y_k' = y_(k+1) - a y_k.

A step is short if the fastest pendulum turns little in it: one Runge-Kutta step in place of two, and fewer terms of a
series, are enough. Functions branch, so that only one variant is computed.

Riccati steps compute the cost-to-go of a linear model over sampled steps, one by one or 2^k at a time. The model says
how deviations z and the chosen inputs w+ act over a step; see `crane_fmu.build.feedback_law`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeVar

import casadi as ca

import servocore as sc
from crane_fmu.catalogue import DIMENSION, ORDERS

STATES, DRIVES, POINTS, LOAD = 10, 3, 5, slice(2, 5)
"""Numbers of states, inputs and coordinates (trolley and load as points), and the load's coordinates."""

RETURN_SHARE, RETURN_TURN, NO_OFFSET = 0.5, 0.3, 1e-12
"""Return of a load that starts off its path: largest acceleration in g, largest a h, and offsets treated as zero."""

SHORT_TURN = 0.1
"""Largest turn of the fastest pendulum in a short step, in rad."""

_TERMS = {False: 4, True: 1}
"""Terms of the series of the matrix exponential, by whether the step is short: error 1e-3, in the gains only, where a
pendulum turns 0.1 rad in a short step or 1 rad in another one."""

_SQUARE, _TALL, _SMALL = (STATES, STATES), (STATES, DRIVES), (DRIVES, DRIVES)

Matrix = TypeVar("Matrix", ca.SX, ca.MX)


def dense(name: str, given: Sequence[ca.SX], results: Sequence[ca.SX]) -> ca.Function:
    """Return a function of dense results, with common terms computed once."""
    return ca.Function(name, [*given], [ca.densify(each) for each in results], {"cse": True})


# The load -------------------------------------------------------------------------------------------------------------


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
    return ca.vertcat(*_taylor(rows, tau)[:-1])


def _taylor(rows: list[ca.SX], tau: Any) -> list[ca.SX]:
    """Return values and derivatives of a polynomial tau later, by Horner's scheme: powers are slow."""
    moved = []
    for k in range(len(rows)):
        value = rows[-1]
        for j in reversed(range(k, len(rows) - 1)):
            value = rows[j] + tau / (j - k + 1) * value
        moved.append(value)
    return moved


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
    fading = ca.exp(-a * tau)
    later = [fading * row for row in _taylor(ca.vertsplit(y, DIMENSION), tau)]
    powers = [ca.SX.ones(DIMENSION)]
    for _ in ORDERS[1:]:
        powers.append(powers[-1] * -a)
    jet = [sum(math.comb(k, j) * powers[k - j] * later[j] for j in range(min(k, 3) + 1)) for k in range(len(ORDERS))]
    return ca.Function("offset", [y, a, tau], [ca.vertcat(*later), ca.vertcat(*jet)], {"cse": True})


# A step ---------------------------------------------------------------------------------------------------------------


def advance(system: sc.MechanicalSystem) -> ca.Function:
    """Return (whether the step is short, state, u, u_dot, d, p, h) -> state after h under inputs u + u_dot t."""
    slope, d = (ca.SX.sym(name, DRIVES) for name in ("u_dot", "d"))
    right = system.C.T @ d - system.bias - system.input_matrix.T @ system.u
    v_dot = ca.ldl_solve(right, *ca.ldl(system.mass))
    moving, fixed = ca.vertcat(system.q, system.v, system.u), ca.vertcat(slope, d, system.p)
    rate = ca.Function("rate", [moving, fixed], [ca.vertcat(system.v, v_dot, slope)], {"cse": True})
    step = ca.simpleRK(rate, 1).expand("runge_kutta", {"cse": True})
    sizes = {"x": STATES, "u": DRIVES, "u_dot": DRIVES, "d": DRIVES, "p": system.p.numel(), "h": 1}
    *_, h = given = [ca.MX.sym(name, size) for name, size in sizes.items()]
    begin, constant = ca.vertcat(*given[:2]), ca.vertcat(*given[2:-1])
    ends = {"short": step(begin, constant, h), "other": step(step(begin, constant, h / 2), constant, h / 2)}
    short, other = (ca.Function(f"advance_{name}", given, [end[:STATES]]) for name, end in ends.items())
    return ca.Function.if_else("advance", short, other)


def sampled(system: sc.MechanicalSystem) -> ca.Function:
    """Return (whether the step is short, state, u, d, p, h) -> A, h phi_1 B, h phi_2 B of the linearized crane.

    phi_k are the functions behind the matrix exponential.
    """
    linear, begin, term, driven = _linearized(system), *_series()

    def results(terms: int, K: Any, D: Any, B: Any, h: Any) -> list[Any]:
        phi = begin(K, D, h, 1 / math.factorial(terms + 1), 1 / math.factorial(terms + 2))
        for k in reversed(range(terms - 1)):
            phi = term(phi, K, D, h, 1 / math.factorial(k + 2))
        phi_1 = term(phi, K, D, h, 1)
        return [term(phi_1, K, D, h, 1), *driven(phi_1, phi, B, h)]

    # One expression for the short series: half of the numbers in the first powers are zeros and ones.
    few, many = [*linear.sx_out(), ca.SX.sym("h")], [*linear.mx_out(), ca.MX.sym("h")]
    short = ca.Function("series_short", few, results(_TERMS[True], *few), {"cse": True})
    other = ca.Function("series_other", many, results(_TERMS[False], *many))
    given = linear.mx_in()
    is_short, h = ca.MX.sym("short"), ca.MX.sym("h")
    found = ca.Function.if_else("series", short, other)
    return ca.Function("sampled", [is_short, *given, h], found.call([is_short, *linear.call(given), h]))


def _linearized(system: sc.MechanicalSystem) -> ca.Function:
    """Return (state, u, d, p) -> K, D, B of the accelerations K q + D v + B u about a state."""
    p, a, d = system.p, ca.SX.sym("a", POINTS), ca.SX.sym("d", DRIVES)
    load = system.bias + system.input_matrix.T @ system.u - system.C.T @ d
    factors = ca.ldl(system.mass)
    balance = ca.horzcat(*(ca.jacobian(system.mass @ a + load, each) for each in (system.q, system.v)))
    balance = ca.substitute(balance, a, ca.ldl_solve(-load, *factors))
    lower = -ca.ldl_solve(ca.densify(ca.horzcat(balance, system.input_matrix.T)), *factors)
    columns = ca.horzsplit(lower, [0, POINTS, STATES, STATES + DRIVES])
    given = [ca.vertcat(system.q, system.v), system.u, d, p]
    return dense("linearized", given, columns)


def _series() -> tuple[ca.Function, ca.Function, ca.Function]:
    """Return functions that sum powers of X = h [0 1; K D], and one that applies the sums to inputs.

    (K, D, h, c, c') -> c + c' X; (F, K, D, h, c) -> c + X F; (phi_1, phi_2, B, h) -> h phi_1 [0; B], h phi_2 [0; B].
    """
    F, other = (ca.SX.sym(name, STATES, STATES) for name in ("F", "F'"))
    K, D, B = (ca.SX.sym(name, POINTS, count) for name, count in (("K", POINTS), ("D", POINTS), ("B", DRIVES)))
    h, c, more = (ca.SX.sym(name) for name in ("h", "c", "c'"))
    one = ca.SX.eye(STATES)

    def times(of: ca.SX) -> ca.SX:
        top, bottom = ca.vertsplit(of, POINTS)
        return ca.vertcat(h * bottom, h * (K @ top + D @ bottom))

    begin = dense("begun", [K, D, h, c, more], [c * one + more * times(one)])
    term = dense("term", [F, K, D, h, c], [c * one + times(F)])
    return begin, term, dense("driven", [F, other, B, h], [h * each[:, POINTS:] @ B for each in (F, other)])


def resting() -> ca.Function:
    """Return (A, B, push) -> state and inputs with which the load keeps its position under a constant push.

    Unknowns are the trolley's coordinates, all rates and the inputs. Rates follow from the upper rows, whose diagonal
    is the length of the step: elimination needs no pivots there.
    """
    A, B, push = ca.SX.sym("A", STATES, STATES), ca.SX.sym("B", STATES, DRIVES), ca.SX.sym("push", STATES)
    away, free = A - ca.SX.eye(STATES), LOAD.start
    table = ca.horzcat(away[:, POINTS:], away[:, :free], B, -push)
    rows = ca.vertsplit(table)
    for k in range(POINTS):
        for j in range(k + 1, STATES):
            rows[j] = rows[j] - rows[j][k] / rows[k][k] * rows[k]
    lower = ca.vertcat(*rows[POINTS:])[:, POINTS:]
    others = ca.solve(lower[:, :-1], lower[:, -1])
    found: list[Any] = [None] * POINTS
    for k in reversed(range(POINTS)):
        row = rows[k]
        known = ca.mtimes(row[POINTS:-1], others) + sum(row[j] * found[j] for j in range(k + 1, POINTS))
        found[k] = (row[-1] - known) / row[k]
    state = ca.vertcat(others[:free], ca.SX.zeros(POINTS - free), *found)
    return ca.Function("resting", [A, B, push], [ca.densify(state), others[free:]], {"cse": True})


# Riccati steps --------------------------------------------------------------------------------------------------------


def riccati_functions() -> tuple[ca.Function, ca.Function, ca.Function]:
    """Return three functions: the matrices that all Riccati steps of a model share, a step, and the gain of a step.

    With w+ = v - F z, where F would be the gain without a cost-to-go, z = A e + B' w goes on as C z + G v, and a step
    costs a form Q of z and a form R of v: (A, B, B', f, W) -> F, C, C^T, Q, G, R. A step is (cost M of z before v is
    chosen, C, C^T, Q, G, R) -> (M a step earlier, K), v = -K C z, and its gain (M, G, R) -> K. Products of whole
    matrices stay loops, which compilers vectorize.
    """
    A, new, old = ca.SX.sym("A", *_SQUARE), ca.SX.sym("B", *_TALL), ca.SX.sym("B'", *_TALL)
    efforts, weights = ca.SX.sym("f", DRIVES), ca.SX.sym("W", DIMENSION)
    squares = ca.SX(*_SQUARE)
    squares[LOAD, LOAD] = ca.diag(weights**2)
    crossed, acting = squares @ new, A @ new + old
    effort = ca.diag(1 / efforts**2) + new.T @ crossed
    alone = ca.SX(DRIVES, STATES)
    alone[:, LOAD] = ca.ldl_solve(crossed[LOAD, :].T, *ca.ldl(effort))
    goes_on = A - acting @ alone
    results = alone, goes_on, goes_on.T, squares - crossed @ alone, acting, effort
    shared = dense("shared", [A, new, old, efforts, weights], results)
    cost, *given = (ca.MX.sym(f"g{k}", *each.shape) for k, each in enumerate([A, *results[1:]]))
    C, C_T, Q, G, R = given
    M, reach, along = ca.SX.sym("M", *_SQUARE), ca.SX.sym("M G", *_TALL), ca.SX.sym("G", *_TALL)
    own = ca.SX.sym("R", *_SMALL)
    best = ca.ldl_solve(reach.T, *ca.ldl(own + along.T @ reach))
    after = ca.triu2symm(ca.triu(M - reach @ best))  # with the optimal v; symmetric, to the last digit
    choice = ca.Function("choice", [M, reach, along, own], [after, best], {"cse": True})
    left, K = choice(cost, cost @ G, G, R)
    step = ca.Function("riccati", [cost, *given], [ca.mac(C_T, left @ C, Q), K])
    return shared, step, ca.Function("gain", [cost, G, R], [K])


def riccati_steps(doublings: int) -> ca.Function:
    """Return (C, C^T, Q, G, R) -> M, the cost-to-go 2^doublings steps before an end without cost.

    Any number of steps of one model, as in `riccati_functions`, is M -> Q + C^T M (1 + H M)^-1 C, at first with
    H = G R^-1 G^T, and so are two such numbers one after the other: k doublings are 2^k steps.
    """
    C, H, Q, C_T = (ca.MX.sym(name, *_SQUARE) for name in ("C", "H", "Q", "C_T"))
    G, R = ca.MX.sym("G", *_TALL), ca.MX.sym("R", *_SMALL)
    reached, spread = ca.horzsplit(ca.solve(ca.MX.eye(STATES) + H @ Q, ca.horzcat(C, H), "qr"), STATES)
    sums = H + C @ spread @ C.T, Q + C.T @ Q @ reached
    doubled = [C @ reached, *((each + each.T) / 2 for each in sums)]  # symmetric, to the last digit
    doubling = ca.Function("doubling", [C, H, Q], doubled)
    steps = [C, G @ ca.solve(R, G.T, "qr"), Q]
    for _ in range(doublings):
        steps = doubling.call(steps)
    return ca.Function(f"riccati_2_to_{doublings}", [C, C_T, Q, G, R], [steps[-1]])
