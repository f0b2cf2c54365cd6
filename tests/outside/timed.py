"""Systems whose equations hold the time: a ship that heaves, a pivot that shakes, a wind, waves that push."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
from outside.moving import cart
from outside.writing import Case, coordinates, g, lagrange, square
from scipy.integrate import solve_ivp

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.scenes import jets
from servocore.scenes.jets import Jet

HEAVE, WAVES = 0.4, 1.3
"""Of the ship, in m and rad/s."""


@cache
def crane_on_a_ship() -> sc.MechanicalSystem:
    """Trolley, winch and load, whose girder goes up and down with the ship."""
    q, t = coordinates("s l x z"), ca.SX.sym("t")
    s, paid, x, z = ca.vertsplit(q.q)
    girder = HEAVE * ca.sin(WAVES * t)
    return lagrange(
        "crane on a ship", q, (30 * q.v[0] ** 2 + 8 * q.v[1] ** 2 + 25 * square(q.v[2:])) / 2,
        {"X": x, "Z": z}, {"F": s, "W": -paid}, potential=25 * g * z, time=t,
        constraints=((x - s) ** 2 + (z - girder) ** 2 - paid**2) / 2,
        guess=lambda at: (at[0], -at[1], at[0], at[1]), home=(0.5, -3.0),
    )  # fmt: skip


def load_below_a_ship() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        x, z = jets.components(reference.jet(t, 4))
        shape = [HEAVE * WAVES**k * np.sin(WAVES * t + k * np.pi / 2) for k in range(5)]
        depth = Jet.from_derivatives(shape) - z
        fx, fz = 25.0 * x.d().d(), 25.0 * (z.d().d() + g)
        s = x + depth * fx / fz
        paid = jets.sqrt((s - x) * (s - x) + depth * depth)
        tension = jets.sqrt(fx * fx + fz * fz)
        force, winch = 30.0 * s.d().d() + fx, tension - 8.0 * paid.d().d()
        return {"s": s.value, "l": paid.value, "F": force.value, "W": winch.value}

    path = sc.rest_to_rest((0.0, -4.0), (3.0, -2.5), 4.0)
    return Case(sc.Scene("ship", {"rope": crane_on_a_ship}, path), exact, index=5)


@cache
def cart_in_the_wind() -> sc.MechanicalSystem:
    """A cart of 2 kg with a pendulum of 0.5 kg and 0.7 m, on whose bob a gusty wind pushes."""
    hanging, t = cart(upright=False), ca.SX.sym("t")
    x, theta = ca.vertsplit(hanging.coordinates.q)
    push = 1.5 * ca.sin(3.0 * t) ** 2 * (x + 0.7 * ca.sin(theta))
    return replace(hanging, name="cart in the wind", potential=hanging.potential - push, time=t)


def pendulum_in_the_wind() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        def slope(time: float, s: Array) -> tuple[float, float]:
            x_2 = reference.jet(min(max(time, 0.0), 2.0 - 1e-15), 2)[2, 0]
            return s[1], (1.5 * np.sin(3 * time) ** 2 / 0.5 - x_2) * np.cos(s[0]) / 0.7 - g * np.sin(s[0]) / 0.7

        found = solve_ivp(slope, (0.0, 2.0), [0.0, 0.0], "DOP853", t, rtol=1e-13, atol=1e-14)
        (theta, omega), x = found.y, reference.jet(t, 2)[:, :, 0].T
        wind = 1.5 * np.sin(3 * t) ** 2
        alpha = ((wind / 0.5 - x[2]) * np.cos(theta) - g * np.sin(theta)) / 0.7
        return {"theta": theta, "F": 2.5 * x[2] + 0.35 * (alpha * np.cos(theta) - omega**2 * np.sin(theta)) - wind}

    scene = sc.Scene("wind", {"cart": cart_in_the_wind}, sc.rest_to_rest((0.0,), (1.5,), 2.0))
    return Case(scene, exact, index=3, internal=2, steps=400, tolerance=1e-9)


def mass_in_waves() -> sc.Scene:
    """A mass of 2 kg that waves push with sin t, at rest F = -sin t: each instant by itself."""

    def system() -> sc.MechanicalSystem:
        q, t = coordinates("x"), ca.SX.sym("t")
        return lagrange(
            "mass in waves", q, q.v[0] ** 2, {"X": q.q[0]}, {"F": q.q[0]}, potential=-q.q[0] * ca.sin(t), time=t,
            guess=lambda at: (at[0],), home=(0.0,),
        )  # fmt: skip

    return sc.Scene("waves", {"mass": system}, sc.rest_to_rest((0.0,), (1.0,), 2.0))


@cache
def shaken() -> sc.MechanicalSystem:
    """A pendulum in Cartesian coordinates, its pivot shaken up and down; a torque in the plane as input."""
    q, t = coordinates("x z"), ca.SX.sym("t")
    x, z = ca.vertsplit(q.q)
    pivot = 0.05 * ca.cos(60.0 * t)
    return lagrange(
        "shaken pendulum", q, square(q.v) / 2, {"A": ca.atan2(x, z)}, {"F": x}, potential=g * z, time=t,
        constraints=(x**2 + (z - pivot) ** 2 - 0.25) / 2,
        guess=lambda at: (0.5 * ca.sin(at[0]), 0.05 + 0.5 * ca.cos(at[0])), home=(0.2,),
    )  # fmt: skip
