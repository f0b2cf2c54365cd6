"""The crane over a step, nonlinear and linearized, with less work in short steps.

A step is short if the fastest pendulum turns little in it: one Runge-Kutta step in place of two, and fewer terms of a
series, are enough. Functions branch, so that only one variant is computed.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

import servocore as sc
from crane_fmu.build.flatness import DRIVES, LOAD, POINTS, STATES

SHORT_TURN = 0.1
"""Largest turn of the fastest pendulum in a short step, in rad."""

_TERMS = {False: 4, True: 1}
"""Terms of the series of the matrix exponential, by whether the step is short: error 1e-3, in the gains only, where a
pendulum turns 0.1 rad in a short step or 1 rad in another one."""


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
    return ca.Function("linearized", given, [ca.densify(each) for each in columns], {"cse": True})


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

    results: dict[str, tuple[list[ca.SX], list[ca.SX]]] = {
        "begun": ([K, D, h, c, more], [c * one + more * times(one)]),
        "term": ([F, K, D, h, c], [c * one + times(F)]),
        "driven": ([F, other, B, h], [h * each[:, POINTS:] @ B for each in (F, other)]),
    }
    begin, term, driven = (
        ca.Function(name, given, [ca.densify(each) for each in found], {"cse": True})
        for name, (given, found) in results.items()
    )
    return begin, term, driven


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
