"""The job of `flat_ocp` by hand: formulas of the crane, a spline, CasADi and IPOPT, and nothing of servocore.

The load's path is a B-spline of degree 5 over the share tau of the duration T, so that r'''' and with it the inputs are
continuous; r(tau) has all derivatives that the inputs take, d^k r/dt^k = r^(k)(tau) / T^k. Both ends are at rest.
Unknowns are the coefficients and T, which is made small within the limits at some instants of every piece.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_lsq_spline

Array = npt.NDArray[np.float64]

BRIDGE, TROLLEY, LOAD, GRAVITY = 480.0, 10.0, 100.0, 9.81
DEGREE, ORDER = 5, 4
PIECES, PER_PIECE = 80, 4
NEAREST, LEAST_PULL = 0.1, 1.0
"""Of the trolley to the axis, in m, and of the load's acceleration less gravity, in m/s^2: beyond lies no motion."""

LONGEST = 600.0
"""Seconds of the processor that IPOPT may take."""


@dataclass(frozen=True)
class Plan:
    """What IPOPT returned.

    Attributes
    ----------
    duration : float
        In s.
    spline : BSpline
        Of the load over the share of the duration.
    status : str
        IPOPT's own word.
    """

    duration: float
    spline: BSpline
    status: str

    def jets(self, count: int) -> Array:
        """Return the load's place and derivatives at even instants, shape (count, 5, 3)."""
        tau = np.linspace(0.0, 1.0, count)
        return np.stack([self.spline(tau, nu=k) / self.duration**k for k in range(ORDER + 1)], axis=1)


def needed() -> ca.Function:
    """Return the formulas: r, r', ..., r'''' -> M_b, F, distance of the trolley from the axis, a_z + g."""
    jets = [ca.SX.sym(f"r{k}", 3) for k in range(ORDER + 1)]
    r, v, a, j, s = jets
    trolley = r[:2] - r[2] / (a[2] + GRAVITY) * a[:2]  # the rope lies along the load's acceleration less gravity
    speed = ca.jtimes(trolley, ca.vertcat(r, a), ca.vertcat(v, j))
    change = ca.jtimes(speed, ca.vertcat(r, v, a, j), ca.vertcat(v, a, j, s))
    force = TROLLEY * change + LOAD * a[:2]
    radius = ca.norm_2(trolley)
    turning = _cross(trolley, speed) / radius**2
    angular = (_cross(trolley, change) - 2 * turning * ca.dot(trolley, speed)) / radius**2
    torque = BRIDGE * angular + _cross(trolley, force)
    rows = ca.vertcat(torque, ca.dot(trolley, force) / radius, radius, a[2] + GRAVITY)
    return ca.Function("needed", jets, [rows], {"cse": True})


def _cross(one: ca.SX, other: ca.SX) -> ca.SX:
    return one[0] * other[1] - one[1] * other[0]


def by_hand(
    start: Sequence[float], end: Sequence[float], limits: Mapping[str, float], guess: float, *, straight: bool
) -> Plan:
    """Plan the fastest motion between two places, on the line between them or on a way of its own.

    Parameters
    ----------
    start, end : sequence of float
        Of the load, m.
    limits : mapping of str to float
        Of the magnitudes of M_b and F.
    guess : float
        A duration to start from, s, with the law of degree 9.
    straight : bool
        Whether on the line.
    """
    way = np.subtract(end, start)
    directions = way[:, None] if straight else np.eye(3)  # path = start + directions @ spline
    goal = np.ones(1) if straight else way
    knots = np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, PIECES + 1), np.ones(DEGREE)])
    count, rest = len(knots) - DEGREE - 1, ORDER + 1
    tau = np.linspace(0.0, 1.0, PER_PIECE * PIECES + 1)[1:-1]
    inner, T = ca.MX.sym("inner", len(goal), count - 2 * rest), ca.MX.sym("T")
    ends = [ca.repmat(ca.DM(each), 1, rest) for each in (0 * goal, goal)]
    moved = ca.mtimes(ca.DM(directions), ca.horzcat(ends[0], inner, ends[1]))
    basis = [ca.sparsify(ca.DM(BSpline(knots, np.eye(count), DEGREE)(tau, nu=k).T)) for k in range(ORDER + 1)]
    jets = [ca.mtimes(moved, each) / T**k for k, each in enumerate(basis)]
    jets[0] += ca.repmat(ca.DM(start), 1, len(tau))
    sizes = ca.DM([limits["M_b"], limits["F"], 1.0, 1.0])
    rows = needed().map(len(tau))(*jets) / ca.repmat(sizes, 1, len(tau))
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_cpu_time": LONGEST}
    problem = {"x": ca.vertcat(ca.vec(inner), T), "f": T, "g": ca.vec(rows)}
    solver = ca.nlpsol("by_hand", "ipopt", problem, options)
    law = _degree_9(knots)[rest:-rest]
    found = solver(
        x0=np.append(np.outer(law, goal).ravel(), guess),
        lbg=np.tile([-1.0, -1.0, NEAREST, LEAST_PULL], len(tau)),
        ubg=np.tile([1.0, 1.0, np.inf, np.inf], len(tau)),
    )
    unknowns = np.asarray(found["x"]).ravel()
    inside = unknowns[:-1].reshape(-1, len(goal))
    table = np.vstack([np.zeros((rest, len(goal))), inside, np.tile(goal, (rest, 1))])
    spline = BSpline(knots, np.array(start) + table @ directions.T, DEGREE)
    return Plan(float(unknowns[-1]), spline, str(solver.stats()["return_status"]))


def _degree_9(knots: Array) -> Array:
    """Return coefficients of the law of degree 9 from 0 to 1."""
    tau = np.linspace(0.0, 1.0, 2001)
    law = tau**5 * np.polynomial.Polynomial([126.0, -420.0, 540.0, -315.0, 70.0])(tau)
    return np.asarray(make_lsq_spline(tau, law, knots, DEGREE).c)
