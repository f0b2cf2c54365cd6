"""Systems that are no scenes of ours, as a user would write them, each with an answer by other means."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial

import casadi as ca
import numpy as np
from outside.hanging import thrust
from outside.writing import coordinates, lagrange, rate, square

import servocore as sc
from servocore.scenes import jets

Answer = Callable[[np.ndarray], Mapping[str, np.ndarray]]
"""Reference jets (N, orders, m) -> exact values by name."""


@dataclass(frozen=True)
class Outsider:
    """A scene of somebody else's, with its exact answer for reference jets of `order`."""

    scene: sc.Scene
    answer: Answer
    order: int = 4

    def exact(self, t: np.ndarray) -> Mapping[str, np.ndarray]:
        return self.answer(self.scene.reference.jet(t, self.order))


LOOP = ((0, 0), (4, 0), (6.5, 1.5), (7, 4), (5, 6.2), (3, 4), (3.5, 1.5), (6, 0), (10, 0))
"""Waypoints of a loop in m: an aircraft that is fast enough turns over."""


MASS, INERTIA, GRAVITY = 1.5, 0.02, 9.81
"""Of the aircraft, in kg, kg m^2 and m/s^2."""


@cache
def aircraft(guess: float) -> sc.MechanicalSystem:
    """A planar aircraft with thrust f along its body and a torque."""
    q = coordinates("x z", "theta")
    x, z, theta = ca.vertsplit(q.q)
    system = lagrange(
        "VTOL", q, (MASS * square(q.v[:2]) + INERTIA * q.v[2] ** 2) / 2, {"X": x, "Z": z}, {"f": z, "torque": theta},
        potential=MASS * GRAVITY * z, guess=lambda at: (at[0], at[1], guess), home=(0.3, 0.2),
    )  # fmt: skip
    return replace(system, input_matrix=thrust(theta, 3))


def vtol(guess: float = 0.0, path: sc.Reference | None = None) -> Outsider:
    """The aircraft, whose centre of mass follows a path."""

    def answer(reference: np.ndarray) -> Mapping[str, np.ndarray]:
        x, z = jets.components(reference)
        lift, side = z.d().d() + GRAVITY, -1.0 * x.d().d()
        tilt = jets.atan2(side, lift)
        force = MASS * np.hypot(lift.value, side.value)
        return {"f": force, "torque": INERTIA * tilt.derivatives()[2], "theta": np.unwrap(tilt.value)}

    reference = path or sc.through(LOOP, duration=5.0)
    return Outsider(sc.Scene("vtol", {"body": partial(aircraft, guess)}, reference), answer)


l_1, l_2, m_1, m_2 = 1.0, 0.8, 2.0, 1.5
"""Links of the arm in m, and point masses at their ends in kg."""


@cache
def arm(
    guess: tuple[float, float] = (0.3, 1.0),
    lengths: tuple[float, float] = (l_1, l_2),
    masses: tuple[float, float] = (m_1, m_2),
    home: tuple[float, float] = (1.0, 0.9),
) -> sc.MechanicalSystem:
    """Two links with a motor in each joint and point masses at their ends."""
    q = coordinates("", "a b")
    a, b = ca.vertsplit(q.q)
    elbow = lengths[0] * ca.vertcat(ca.cos(a), ca.sin(a))
    tip = elbow + lengths[1] * ca.vertcat(ca.cos(a + b), ca.sin(a + b))
    kinetic = (masses[0] * square(rate(elbow, q)) + masses[1] * square(rate(tip, q))) / 2
    return lagrange(
        "elbow arm", q, kinetic, {"X": tip[0], "Y": tip[1]}, {"T_1": a, "T_2": b}, guess=lambda _: guess, home=home
    )


def elbow_arm(guess: tuple[float, float] = (0.3, 1.0), cycles: int = 1) -> Outsider:
    """The arm, whose tip goes round a circle that is regular everywhere."""

    def answer(reference: np.ndarray) -> Mapping[str, np.ndarray]:
        """With the elbow on the side of b > 0; forces on the masses by Newton, torques by virtual work."""
        x, y = jets.components(reference)
        square = x * x + y * y
        cosine = (square - (l_1**2 + l_2**2)) / (2 * l_1 * l_2)
        b = jets.atan2(jets.sqrt(1.0 - cosine * cosine), cosine)
        along = l_1 + l_2 * cosine
        a = jets.atan2(y, x) - jets.atan2(l_2 * jets.sqrt(1.0 - cosine * cosine), along)
        first = a.derivatives()[:3]
        e = np.array([np.cos(first[0]), np.sin(first[0])])
        n = np.array([-e[1], e[0]])
        elbow_force = m_1 * l_1 * (first[2] * n - first[1] ** 2 * e)
        tip_force = m_2 * np.array([x.derivatives()[2], y.derivatives()[2]])
        lever = np.array([x.value, y.value]) - l_1 * e
        second = lever[0] * tip_force[1] - lever[1] * tip_force[0]
        whole = l_1 * (e[0] * elbow_force[1] - e[1] * elbow_force[0])
        whole = whole + x.value * tip_force[1] - y.value * tip_force[0]
        return {"T_1": whole, "T_2": second, "b": b.value}

    reference = sc.periodic((0.9, 0.6), [[0.3, 0.0]], [[0.0, 0.3]], 4.0, cycles)
    return Outsider(sc.Scene("elbow_arm", {"links": partial(arm, guess)}, reference), answer)
