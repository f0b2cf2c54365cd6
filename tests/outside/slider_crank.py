"""A slider crank with a flexible connecting rod: problem `crank` of the test set of Mazzia and Magherini (Bari, 2008).

Simeon, B.: Modelling a flexible slider crank mechanism by a mixed system of DAEs and PDEs, Math. Modelling of Systems
2 (1996) 1-18. The rod bends in two modes and stretches at two nodes: eigenvalues of 2e4 rad/s beside a crank that
turns at 150 rad/s, deflections of 1e-5 m beside lengths of 0.3 m. Here the crank's angle is the servo output, and the
torque that turns it is the input: the multiplier of the driving constraint in the test set.
"""

from __future__ import annotations

from functools import cache, partial

import casadi as ca
import numpy as np
from outside.paths import Steady
from outside.writing import Case
from scipy.integrate import solve_ivp

import servocore as sc
from servocore.numerics.compiled_calls import Array

OMEGA, END = 150.0, 0.1
m_2, m_3, l_1, l_2, J_1, J_2 = 0.151104, 0.075552, 0.15, 0.30, 0.002727, 0.0045339259
pi, YOUNG, DENSITY, WIDTH = 3.1415927, 0.2e12, 7870.0, 0.008
NAMES = ("phi_1", "phi_2", "x_3", "q_1", "q_2", "q_3", "q_4")

SMOOTH_START = {
    "q_1": 0.0, "q_2": 0.0, "q_3": 0.103339863e-4, "q_4": 0.169327969e-4,
    "q_1_dot": 0.444896105, "q_2_dot": 0.463434311e-2, "q_3_dot": -0.178591076e-5, "q_4_dot": -0.268938672e-5,
}  # fmt: skip
"""Published initial values of the deflections, close to the motion without oscillations."""

PUBLISHED = {
    "phi_1": 15.0, "phi_2": -3.311734987910881e-01, "x_3": 1.697373326718410e-01, "q_1": 1.893192460247178e-04,
    "q_2": 2.375751865617931e-05, "q_3": -5.323907988763734e-06, "q_4": -8.363283141616840e-06,
    "phi_2_dot": 6.025346682645789e01, "x_3_dot": -8.753116989887888, "q_1_dot": -3.005536801092212e-02,
    "q_2_dot": -5.500488291932075e-03, "q_3_dot": 4.978243404809343e-04, "q_4_dot": 1.104933470696396e-03,
    "lam_1": -6.232893262533717e01, "lam_2": -1.637910131687472e02, "T": 2.529853213732781e01,
}  # fmt: skip
"""Published values at 0.1 s, from `SMOOTH_START`."""


@cache
def beam(length: float) -> dict[str, np.ndarray]:
    """Matrices of the rod in (q_1 .. q_4): two sines across, a quadratic element along."""
    mass, stiffness, volume = DENSITY * WIDTH**2 * length, YOUNG * WIDTH**2 / length, WIDTH**2 * length
    slender = pi**4 * (WIDTH / length) ** 2
    M, K, B = np.diag([0.5, 0.5, 8.0, 2.0]), np.diag([slender / 24, slender * 2 / 3, 16 / 3, 7 / 3]), np.zeros((4, 4))
    M[2, 3] = M[3, 2] = 1.0
    K[2, 3] = K[3, 2] = -8.0 / 3.0
    B[0, 2], B[0, 3], B[1, 3] = -16 / pi**3, 8 / pi**3 - 1 / pi, 0.5 / pi
    return {
        "M": mass * M,
        "K": stiffness * K,
        "B": volume * (B - B.T),
        "c_1": volume * np.array([0.0, 0.0, 2 / 3, 1 / 6]),
        "c_2": volume * np.array([2 / pi, 0.0, 0.0, 0.0]),
        "c_12": length * volume * np.array([0.0, 0.0, 1 / 3, 1 / 6]),
        "c_21": length * volume * np.array([1 / pi, -0.5 / pi, 0.0, 0.0]),
    }


@cache
def crank(length: float = l_2, nominal: float = 1.0) -> sc.MechanicalSystem:
    """The mechanism with a rod of this length, and this nominal value of its deflections in m."""
    coordinates = sc.Coordinates(
        sc.Quantity("phi_1", "rad"), sc.Quantity("phi_2", "rad"), sc.Quantity("x_3", "m"),
        *(sc.Quantity(f"q_{k}", "m", nominal=nominal) for k in range(1, 5)),
    )  # fmt: skip
    phi_1, phi_2, x_3 = ca.vertsplit(coordinates.q[:3])
    q, rod = coordinates.q[3:], {name: ca.DM(matrix) for name, matrix in beam(length).items()}
    across, along = ca.dot(rod["c_2"], q), ca.dot(rod["c_1"], q)
    sin, cos = ca.sin(phi_1 - phi_2), ca.cos(phi_1 - phi_2)
    M = ca.SX.zeros(7, 7)
    M[0, 0], M[2, 2], M[3:, 3:] = J_1 + m_2 * l_1**2, m_3, rod["M"]
    M[0, 1] = 0.5 * l_1 * length * m_2 * cos + DENSITY * l_1 * (sin * across + cos * along)
    M[1, 1] = J_2 + ca.bilin(rod["M"], q, q) + 2.0 * DENSITY * ca.dot(rod["c_12"], q)
    M[0, 3:] = (DENSITY * l_1 * (cos * rod["c_2"] - sin * rod["c_1"])).T
    M[1, 3:] = (DENSITY * (rod["c_21"] + ca.mtimes(rod["B"].T, q))).T
    M[1, 0], M[3:, 0], M[3:, 1] = M[0, 1], M[0, 3:].T, M[1, 3:].T
    gamma, lam = ca.SX.sym("gamma", 1, sc.MAX_REFERENCE_ORDER + 1), ca.SX.sym("lam", 2)
    reach = length + q[3]
    angle = -ca.asin(l_1 * ca.sin(gamma[0, 0]) / length)
    return sc.MechanicalSystem(
        name="slider crank",
        coordinates=coordinates,
        parameters=sc.Parameters(),
        inputs=(sc.Quantity("T", "N.m", "multiplier of the drive: minus the torque on the crank"),),
        outputs=(sc.Quantity("crank", "rad"),),
        mass=M,
        output=phi_1,
        input_matrix=ca.SX([[1, 0, 0, 0, 0, 0, 0]]),
        potential=ca.bilin(rod["K"], q, q) / 2,
        constraints=ca.vertcat(
            l_1 * ca.sin(phi_1) + reach * ca.sin(phi_2), x_3 - l_1 * ca.cos(phi_1) - reach * ca.cos(phi_2)
        ),
        multipliers=lam,
        gamma=gamma,
        guess=ca.vertcat(gamma[0, 0], angle, l_1 * ca.cos(gamma[0, 0]) + length * ca.cos(angle), ca.SX.zeros(4)),
        home=(0.7,),
        observables={sc.Quantity(f"lam_{k + 1}", "N"): lam[k] for k in range(2)},
    )


def slider_crank(length: float = l_2, nominal: float = 1.0, duration: float = END) -> sc.Scene:
    return sc.Scene("slider_crank", {"modes": partial(crank, length, nominal)}, Steady.of((0.0,), (OMEGA,), duration))


def slider_crank_from_rest(nominal: float = 1.0) -> Case:
    """A few hundredths of a turn; the deflections begin at zero, without rate, and oscillate."""

    def exact(t: Array, _: object) -> dict[str, Array]:
        found = integrated(t, np.zeros(8))
        return {name: found[name] for name in ("phi_2", "x_3", "q_1", "q_2", "q_3", "q_4", "lam_1", "lam_2", "T")}

    scene = slider_crank(nominal=nominal, duration=0.002)
    return Case(scene, exact, index=3, internal=8, steps=500, tolerance=1e-6)


def integrated(t: np.ndarray, start: np.ndarray, length: float = l_2) -> dict[str, np.ndarray]:
    """The published equations in the deflections and their rates (8,), by SciPy at 1e-12; values at the times `t`."""
    found = solve_ivp(
        lambda time, state: np.append(state[4:], accelerations(time, state, length)[3:7]),
        (t[0], t[-1]), start, "DOP853", t, rtol=1e-12, atol=1e-16,
    )  # fmt: skip
    rows = []
    for time, state in zip(t, found.y.T, strict=True):
        q, v, solution = *configuration(time, state, length)[:2], accelerations(time, state, length)
        rows.append([*q, *v, *solution[7:]])
    names = (*NAMES, *(f"{name}_dot" for name in NAMES), "lam_1", "lam_2", "T")
    return dict(zip(names, np.array(rows).T, strict=True))


def configuration(time: float, state: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates, velocities and constraint Jacobian (3, 7) that belong to deflections and their rates."""
    phi_1, reach, reach_rate = OMEGA * time, length + state[3], state[7]
    phi_2 = -np.arcsin(l_1 * np.sin(phi_1) / reach)
    s_1, c_1, s_2, c_2 = np.sin(phi_1), np.cos(phi_1), np.sin(phi_2), np.cos(phi_2)
    rate = -(l_1 * c_1 * OMEGA + s_2 * reach_rate) / (reach * c_2)
    x_rate = -l_1 * s_1 * OMEGA - reach * s_2 * rate + c_2 * reach_rate
    G = np.zeros((3, 7))
    G[0, :2], G[0, 6] = (l_1 * c_1, reach * c_2), s_2
    G[1, :3], G[1, 6] = (l_1 * s_1, reach * s_2, 1.0), -c_2
    G[2, 0] = 1.0
    q = np.array([phi_1, phi_2, l_1 * c_1 + reach * c_2, *state[:4]])
    return q, np.array([OMEGA, rate, x_rate, *state[4:]]), G


def accelerations(time: float, state: np.ndarray, length: float) -> np.ndarray:
    """Accelerations and multipliers (10,) by the published forces, written out."""
    rod, (q, v, G) = beam(length), configuration(time, state, length)
    e, e_rate, (w_1, w_2) = q[3:], v[3:], v[:2]
    s, c = np.sin(q[0] - q[1]), np.cos(q[0] - q[1])
    along, across, along_rate, across_rate = rod["c_1"] @ e, rod["c_2"] @ e, rod["c_1"] @ e_rate, rod["c_2"] @ e_rate
    half = 0.5 * l_1 * length * m_2
    M = np.zeros((7, 7))
    M[0, 0], M[2, 2], M[3:, 3:] = J_1 + m_2 * l_1**2, m_3, rod["M"]
    M[0, 1] = M[1, 0] = half * c + DENSITY * l_1 * (s * across + c * along)
    M[1, 1] = J_2 + e @ rod["M"] @ e + 2 * DENSITY * rod["c_12"] @ e
    M[0, 3:] = M[3:, 0] = DENSITY * l_1 * (c * rod["c_2"] - s * rod["c_1"])
    M[1, 3:] = M[3:, 1] = DENSITY * (rod["c_21"] + e @ rod["B"])
    f = np.zeros(7)
    f[0] = w_2**2 * (DENSITY * l_1 * (c * across - s * along) - half * s)
    f[0] -= 2 * DENSITY * l_1 * w_2 * (c * along_rate + s * across_rate)
    f[1] = w_1**2 * (half * s + DENSITY * l_1 * (s * along - c * across))
    f[1] -= 2 * w_2 * (DENSITY * rod["c_12"] @ e_rate + e_rate @ rod["M"] @ e)
    f[3:] = w_2**2 * (rod["M"] @ e + DENSITY * rod["c_12"]) + 2 * DENSITY * w_2 * rod["B"] @ e_rate - rod["K"] @ e
    f[3:] += DENSITY * l_1 * w_1**2 * (c * rod["c_1"] + s * rod["c_2"])
    s_1, c_1, s_2, c_2, reach = np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1]), length + e[3]
    quadratic = np.array([
        -l_1 * s_1 * w_1**2 - reach * s_2 * w_2**2 + 2 * w_2 * c_2 * e_rate[3],
        l_1 * c_1 * w_1**2 + reach * c_2 * w_2**2 + 2 * w_2 * s_2 * e_rate[3],
        0.0,
    ])  # fmt: skip
    return np.linalg.solve(np.block([[M, G.T], [G, np.zeros((3, 3))]]), np.append(f, -quadratic))
