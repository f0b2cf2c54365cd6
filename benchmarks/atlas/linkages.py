"""Two overconstrained linkages of rigid bars, assembled from hinges, with the torque that drives them.

The parallelogram is planar; three of its four hinges in space keep all bars in the plane already. The Bricard linkage
is not: six bars of one length a, the axes at the ends of each across it and at right angles (the hinges of a
kaleidocycle). By the count of Gruebler and Kutzbach, 6 (6 - 1) - 5 * 6 = 0, it cannot move; it has one degree of
freedom (R. Bricard, Lecons de cinematique II, 1927). With every second joint angle alike, theta_1 and theta_2, its loop
closes if

    cos theta_1 + cos theta_2 + cos theta_1 cos theta_2 = 0,

the closure equation of Y. Chen, Z. You and T. Tarnai, Threefold-symmetric Bricard linkages for deployable structures,
Int. J. Solids Struct. 42 (2005) 2287, at a twist of 90 degrees; `loop_gap` checks it.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np

import servocore as sc
from servocore.rotationless import GROUND, Assembly, Frame, Place, RigidBody, angle, on_line, revolute, turned

CRANK, BASE = 0.5, 1.1
"""Lengths of crank and rocker, and of coupler and base, in m: a parallelogram."""
DENSITY, GRAVITY = 5.0, 9.81
BAR = 0.4
"""Length of every bar of the Bricard linkage in m."""
ALONG, UP, HERE = (1, 0, 0), (0, 0, 1), (0, 0, 0)
_MOVING = 5  # bars of the Bricard linkage; the sixth is the ground
_ACROSS = 0.02  # moment of inertia about the bar, of that across it


def bar(name: str, length: float) -> RigidBody:
    """Return a bar with its reference point at one end and d1 along it."""
    mass, across = DENSITY * length, DENSITY * length**3 / 12
    return RigidBody(name, mass, (_ACROSS * across, across, across), (length / 2, 0, 0))


@cache
def parallelogram(closed_by: str = "on_line", extra_input: bool = False) -> sc.MechanicalSystem:
    """Return a parallelogram of thin bars in space; the last hinge is a pin (`on_line`) or a full `revolute`."""
    bars = [bar("crank", CRANK), bar("coupler", BASE), bar("rocker", CRANK)]
    linkage = Assembly((*bars, sc.Quantity("theta", "rad")), sc.Parameters(), (0, -GRAVITY, 0))
    crank, coupler, rocker = (linkage.body(name) for name in ("crank", "coupler", "rocker"))
    pivot = GROUND.at(HERE, axis=UP, normal=ALONG), crank.at(HERE, axis=UP, normal=ALONG)
    last = rocker.at((CRANK, 0, 0)), coupler.at((BASE, 0, 0))
    theta = linkage.augmented("theta")
    driven = {sc.Quantity("torque", "N.m"): theta}
    follow = {sc.Quantity("y", "rad"): theta}
    if extra_input:
        driven[sc.Quantity("pull", "N")] = follow[sc.Quantity("x", "m")] = rocker.point((CRANK, 0, 0))[0]

    def near(y: ca.SX) -> dict[str, object]:
        joint = CRANK * ca.vertcat(ca.cos(y[0]), ca.sin(y[0]), 0)
        base, directors = ca.vertcat(BASE, 0, 0), turned(UP, y[0])
        return {
            "crank": (HERE, directors), "coupler": (joint, ca.DM.eye(3)), "rocker": (base, directors), "theta": y[0]
        }  # fmt: skip

    return linkage.system(
        "parallelogram",
        constraints={
            "A": revolute(*pivot),
            "B": revolute(crank.at((CRANK, 0, 0)), coupler.at(HERE)),
            "D": revolute(GROUND.at((BASE, 0, 0)), rocker.at(HERE)),
            "C": revolute(*last) if closed_by == "revolute" else on_line(*last),
            "theta": angle(*pivot, theta),
        },
        inputs=driven,
        outputs=follow,
        guess=near,
        home=(1.0, 1.2)[: len(driven)],
    )


def parallelogram_torque(reference: np.ndarray) -> dict[str, np.ndarray]:
    """Return the exact torque: cranks turn, the coupler is carried around without turning."""
    y = reference[:, :, 0].T
    crank, coupler = DENSITY * CRANK, DENSITY * BASE
    inertia = 2 * crank * CRANK**2 / 3 + coupler * CRANK**2
    return {"torque": inertia * y[2] + (crank + coupler) * GRAVITY * CRANK * np.cos(y[0])}


def antiparallelogram_angles(y: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the angles of coupler and rocker of the crossed assembly for the crank angle y, between 0 and 2 pi.

    It is the parallelogram with its far corner mirrored at the diagonal from the end of the crank to the far end of
    the base; there the directions 0 of the coupler and y of the rocker become these.
    """
    twice = 2 * ca.atan2(-CRANK * ca.sin(y), BASE - CRANK * ca.cos(y))
    return twice, twice - y


def crossed_torque(reference: np.ndarray) -> dict[str, np.ndarray]:
    """Return the exact torque of the crossed assembly, by Lagrange's equation in the crank angle."""
    y = ca.SX.sym("y")
    coupler, rocker = antiparallelogram_angles(y)
    joint = CRANK * ca.vertcat(ca.cos(y), ca.sin(y))
    places = [
        (DENSITY * CRANK, joint / 2, y, CRANK),
        (DENSITY * BASE, joint + BASE / 2 * ca.vertcat(ca.cos(coupler), ca.sin(coupler)), coupler, BASE),
        (DENSITY * CRANK, CRANK / 2 * ca.vertcat(ca.cos(rocker), ca.sin(rocker)), rocker, CRANK),
    ]
    inertia = potential = ca.SX(0)
    for mass, centre, tilt, length in places:
        rate = ca.jacobian(tilt, y)
        inertia += mass * (ca.sumsqr(ca.jacobian(centre, y)) + length**2 / 12 * rate**2)
        potential += mass * GRAVITY * centre[1]
    return {"torque": _lagrange(y, inertia, potential, reference)}


def _lagrange(y: ca.SX, inertia: ca.SX, potential: ca.SX, reference: np.ndarray) -> np.ndarray:
    """Evaluate I y'' + I_y y'^2 / 2 + V_y along jets (N, orders, 1)."""
    parts = ca.vertcat(inertia, ca.jacobian(inertia, y) / 2, ca.jacobian(potential, y))
    at = reference[:, :, 0]
    found = np.asarray(ca.Function("parts", [y], [parts]).map(len(at))(at[:, 0][None]))
    return np.asarray(found[0] * at[:, 2] + found[1] * at[:, 1] ** 2 + found[2])


def _bricard_frames(first: ca.SX, second: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Return (origin, directors) of all six bars from their joint angles, by Denavit and Hartenberg."""
    origin, directors = ca.SX.zeros(3), ca.SX.eye(3)
    frames = []
    for k in range(_MOVING + 1):
        directors = ca.mtimes(directors, turned(UP, second if k % 2 else first))
        frames.append((origin, directors))
        origin = origin + BAR * directors[:, 0]
        directors = ca.mtimes(directors, turned(ALONG, _twist(k)))
    return [*frames, (origin, directors)]


def _twist(k: int) -> float:
    return -np.pi / 2 if k % 2 else np.pi / 2


def second_angle(y: ca.SX) -> ca.SX:
    """Return theta_2 of the Bricard linkage, between 0 and pi, for theta_1 = y: within 2 pi/3 of zero."""
    return ca.acos(-ca.cos(y) / (1 + ca.cos(y)))


@cache
def bricard() -> sc.MechanicalSystem:
    """Return the Bricard linkage with five moving bars, sixty coordinates and one more for the driven angle."""
    names = [f"bar{k + 1}" for k in range(_MOVING)]
    linkage = Assembly(
        (*(bar(name, BAR) for name in names), sc.Quantity("theta", "rad")), sc.Parameters(), (0, 0, -GRAVITY)
    )
    theta = linkage.augmented("theta")
    bars = [linkage.body(name) for name in names]
    pivot = GROUND.at(HERE, axis=UP, normal=ALONG), bars[0].at(HERE, axis=UP, normal=ALONG)
    hinges = {"1": revolute(*pivot)}
    for k in range(1, _MOVING):
        hinges[f"{k + 1}"] = revolute(_far_end(bars[k - 1], k - 1), bars[k].at(HERE, axis=UP))
    hinges["6"] = revolute(
        GROUND.at((-BAR, 0, 0), axis=(0, np.sin(_twist(5)), np.cos(_twist(5)))), _far_end(bars[-1], _MOVING - 1)
    )

    def near(y: ca.SX) -> dict[str, object]:
        rough = 2 * np.pi / 3 - 0.3 * y**2  # a parabola in place of theta_2: the guess is not assembled
        frames = _bricard_frames(y, rough)
        return {**dict(zip(names, frames, strict=False)), "theta": y}

    return linkage.system(
        "Bricard linkage",
        constraints={**{f"hinge {key}": rows for key, rows in hinges.items()}, "theta": angle(*pivot, theta)},
        inputs={sc.Quantity("torque", "N.m"): theta},
        outputs={sc.Quantity("y", "rad"): theta},
        observables={sc.Quantity("cos_theta_2", "1"): ca.dot(bars[0].directors[:, 0], bars[1].directors[:, 0])},
        guess=near,
        home=(1.0,),
    )


def _far_end(frame: Frame, k: int) -> Place:
    return frame.at((BAR, 0, 0), axis=(0, -np.sin(_twist(k)), np.cos(_twist(k))))


def bricard_torque(reference: np.ndarray) -> dict[str, np.ndarray]:
    """Return the exact torque, by Lagrange's equation in theta_1 with the closed relation for theta_2."""
    y = ca.SX.sym("y")
    inertia = potential = ca.SX(0)
    mass, across = DENSITY * BAR, DENSITY * BAR**3 / 12
    for origin, directors in _bricard_frames(y, second_angle(y))[:_MOVING]:
        centre = origin + BAR / 2 * directors[:, 0]
        turning = ca.mtimes(directors.T, ca.reshape(ca.jacobian(directors, y), 3, 3))  # skew, in the bar's triad
        rate = ca.vertcat(turning[2, 1], turning[0, 2], turning[1, 0])
        spin = ca.dot(rate**2, across * ca.vertcat(_ACROSS, 1, 1))
        inertia += mass * ca.sumsqr(ca.jacobian(centre, y)) + spin
        potential += mass * GRAVITY * centre[2]
    return {"torque": _lagrange(y, inertia, potential, reference), "cos_theta_2": _cosine(reference)}


def _cosine(reference: np.ndarray) -> np.ndarray:
    cosine = np.cos(reference[:, 0, 0])
    return np.asarray(-cosine / (1 + cosine))


def loop_gap(first: float, second: float) -> float:
    """Return by how much six bars with these joint angles fail to close, in m and as parts of directors."""
    y = ca.SX.sym("y", 2)
    origin, directors = _bricard_frames(y[0], y[1])[-1]
    gap = ca.norm_inf(ca.vertcat(origin, ca.vec(directors - ca.SX.eye(3))))
    return float(ca.Function("gap", [y], [gap])((first, second)))
