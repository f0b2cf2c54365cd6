"""Index-3 problems of the test set for initial value problem solvers (Mazzia and Magherini, Bari, release 2.4, 2008).

Car axis and Andrews' squeezer, written from their report, with the published values at the end; the third, a flexible
slider crank, is in `outside.slider_crank`. Nothing is prescribed here: an input that stays zero stands in for the servo
constraint, and `simulate` runs the motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from outside.paths import Steady

import servocore as sc


@dataclass(frozen=True)
class InitialValueProblem:
    """A scene, the force of its only input in N or N m, its start, its end in s, and the published values there."""

    scene: sc.Scene
    force: float
    start: dict[str, float]
    end: float
    published: dict[str, float]

    def simulated(self, tolerance: float, count: int = 2) -> sc.Solution:
        t = np.linspace(0.0, self.end, count)
        force = np.array([self.force])
        return sc.simulate(self.scene, lambda _: force, t=t, start=self.start, rtol=tolerance, atol=1e-3 * tolerance)


def digits(found: sc.Solution, published: dict[str, float]) -> dict[str, float]:
    """Significant correct digits at the end, by name."""
    return {name: -np.log10(max(abs(found[name][-1] / value - 1.0), 1e-17)) for name, value in published.items()}


def free(name: str, coordinates: sc.Coordinates, driven: int, constraints: ca.SX, **fields: Any) -> sc.MechanicalSystem:
    """A system with a force on coordinate number `driven` as its only input; it reports rates and multipliers too."""
    n, m_h = len(coordinates), constraints.numel()
    lam, pushed = ca.SX.sym("lam", m_h), ca.SX(1, n)
    pushed[driven] = -1.0
    reported = {sc.Quantity(f"{each}_dot", "1/s"): coordinates.v[k] for k, each in enumerate(coordinates.names)}
    reported |= {sc.Quantity(f"lam_{k + 1}", "N"): lam[k] for k in range(m_h)}
    return sc.MechanicalSystem(
        name=name,
        coordinates=coordinates,
        parameters=sc.Parameters(),
        inputs=(sc.Quantity("T", "N"),),
        outputs=(sc.Quantity("output", "m"),),
        output=coordinates.q[driven],
        input_matrix=pushed,
        constraints=constraints,
        multipliers=lam,
        observables=reported,
        **fields,
    )


# The axle of a car on a bumpy road: a bar on two springs, its left end held to a road arm that moves with time.


@cache
def axle() -> sc.MechanicalSystem:
    length, rest, bump, rate, mass, gravity = 1.0, 0.5, 0.1, 10.0, 10.0 * 1e-4 / 2.0, 1.0
    q, t = sc.Coordinates(*(sc.Quantity(name, "m") for name in ("x_l", "y_l", "x_r", "y_r"))), ca.SX.sym("t")
    x_l, y_l, x_r, y_r = ca.vertsplit(q.q)
    y_b = bump * ca.sin(rate * t)
    x_b = ca.sqrt(length**2 - y_b**2)
    left, right = ca.sqrt(x_l**2 + y_l**2), ca.sqrt((x_r - x_b) ** 2 + (y_r - y_b) ** 2)
    start = list(CAR_AXIS_START.values())
    return free(
        "car axis", q, 0, mass=mass * ca.SX.eye(4), time=t, guess=ca.SX(start[:4]), home=(0.0,),
        potential=(left - rest) ** 2 / 2 + (right - rest) ** 2 / 2 + mass * gravity * (y_l + y_r),
        constraints=ca.vertcat(x_l * x_b + y_l * y_b, (x_l - x_r) ** 2 + (y_l - y_r) ** 2 - length**2),
    )  # fmt: skip


CAR_AXIS_START = {
    "x_l": 0.0, "y_l": 0.5, "x_r": 1.0, "y_r": 0.5, "x_l_dot": -0.5, "y_l_dot": 0.0, "x_r_dot": -0.5, "y_r_dot": 0.0,
}  # fmt: skip


def car_axis() -> InitialValueProblem:
    published = {
        "x_l": 0.4934557842755629e-1, "y_l": 0.4969894602303324, "x_r": 0.1041742524885400e1,
        "y_r": 0.3739110272652214, "x_l_dot": -0.7705836840321485e-1, "y_l_dot": 0.7446866596327776e-2,
        "x_r_dot": 0.1755681574942899e-1, "y_r_dot": 0.7703410437794031,
        "lam_1": 0.4736886750784630e-2, "lam_2": 0.1104680411345730e-2,  # signs as in M v_dot + G^T lam
    }  # fmt: skip
    scene = sc.Scene("car_axis", {"points": axle}, Steady.of((0.0,), (0.0,), 3.0))
    return InitialValueProblem(scene, 0.0, CAR_AXIS_START, 3.0, published)


# Andrews' squeezer: seven bodies in a plane, driven by a motor of 0.033 N m, a spring of 4530 N/m.

BETA_TO_EPSILON = ("beta", "theta", "gamma", "phi", "delta", "omega", "epsilon")
SQUEEZER_START = (
    -0.0617138900142764496358948458001, 0.0, 0.455279819163070380255912382449, 0.222668390165885884674473185609,
    0.487364979543842550225598953530, -0.222668390165885884674473185609, 1.23054744454982119249735015568,
)  # fmt: skip


@cache
def squeezer() -> sc.MechanicalSystem:
    m = (0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498)
    J = (2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5)
    d, da, e, ea, rr, ra, ss, sa, sb, s_c, sd = (
        0.028, 0.0115, 0.02, 0.01421, 0.007, 0.00092, 0.035, 0.01874, 0.01043, 0.018, 0.02,
    )  # fmt: skip
    ta, tb, u, ua, ub, zf, zt, fa = 0.02308, 0.00916, 0.04, 0.01228, 0.00449, 0.02, 0.04, 0.01421
    A, B, C = ca.DM([-0.06934, -0.00227]), ca.DM([-0.03635, 0.03273]), ca.DM([0.014, 0.072])
    q = sc.Coordinates(*(sc.Quantity(name, "rad") for name in BETA_TO_EPSILON))
    beta, theta, gamma, phi, delta, omega, epsilon = ca.vertsplit(q.q)
    M = ca.SX(7, 7)
    M[0, 0] = m[0] * ra**2 + m[1] * (rr**2 - 2 * da * rr * ca.cos(theta) + da**2) + J[0] + J[1]
    M[0, 1] = M[1, 0] = m[1] * (da**2 - da * rr * ca.cos(theta)) + J[1]
    M[1, 1] = m[1] * da**2 + J[1]
    M[2, 2] = m[2] * (sa**2 + sb**2) + J[2]
    M[3, 3] = m[3] * (e - ea) ** 2 + J[3]
    M[3, 4] = M[4, 3] = m[3] * ((e - ea) ** 2 + zt * (e - ea) * ca.sin(phi)) + J[3]
    M[4, 4] = m[3] * (zt**2 + 2 * zt * (e - ea) * ca.sin(phi) + (e - ea) ** 2) + m[4] * (ta**2 + tb**2) + J[3] + J[4]
    M[5, 5] = m[5] * (zf - fa) ** 2 + J[5]
    M[5, 6] = M[6, 5] = m[5] * ((zf - fa) ** 2 - u * (zf - fa) * ca.sin(omega)) + J[5]
    M[6, 6] = m[5] * ((zf - fa) ** 2 - 2 * u * (zf - fa) * ca.sin(omega) + u**2) + m[6] * (ua**2 + ub**2) + J[5] + J[6]
    crank = ca.vertcat(rr * ca.cos(beta) - d * ca.cos(beta + theta), rr * ca.sin(beta) - d * ca.sin(beta + theta))
    ends = [
        B + ss * ca.vertcat(ca.sin(gamma), -ca.cos(gamma)),
        A + e * ca.vertcat(ca.sin(phi + delta), -ca.cos(phi + delta)) + zt * ca.vertcat(ca.cos(delta), ca.sin(delta)),
        A + zf * ca.vertcat(ca.cos(omega + epsilon), ca.sin(omega + epsilon))
        + u * ca.vertcat(ca.sin(epsilon), -ca.cos(epsilon)),
    ]  # fmt: skip
    hook = B + ca.vertcat(sd * ca.cos(gamma) + s_c * ca.sin(gamma), sd * ca.sin(gamma) - s_c * ca.cos(gamma))
    return free(
        "squeezer", q, 0, mass=M, potential=4530.0 * (ca.norm_2(hook - C) - 0.07785) ** 2 / 2,
        constraints=ca.vertcat(*(crank - end for end in ends)), guess=ca.SX(list(SQUEEZER_START)),
        home=(SQUEEZER_START[0],),
    )  # fmt: skip


def andrews_squeezer() -> InitialValueProblem:
    published = dict(zip((*BETA_TO_EPSILON, *(f"{each}_dot" for each in BETA_TO_EPSILON)), (
        0.1581077119629904e2, -0.1575637105984298e2, 0.4082224013073101e-1, -0.5347301163226948, 0.5244099658805304,
        0.5347301163226948, 0.1048080741042263e1, 0.1139920302151208e4, -0.1424379294994111e4, 0.1103291221937134e2,
        0.1929337464421385e2, 0.5735699284790808, -0.1929337464421385e2, 0.3231791658026955,
    ), strict=True)) | {
        f"lam_{k + 1}": value for k, value in enumerate((
            0.1991753333731910e3, -0.2975531228015052e2, 0.2306654119098399e2, 0.3145271365475927e2,
            0.2264249232082739e2, 0.1161740700019673e2,
        ))
    }  # fmt: skip
    start = dict(zip(BETA_TO_EPSILON, SQUEEZER_START, strict=True)) | {f"{each}_dot": 0.0 for each in BETA_TO_EPSILON}
    scene = sc.Scene("squeezer", {"angles": squeezer}, Steady.of((SQUEEZER_START[0],), (0.0,), 0.03))
    return InitialValueProblem(scene, 0.033, start, 0.03, published)
