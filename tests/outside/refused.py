"""Systems that cannot do what they are asked, and the words that say why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from outside.hanging import thrust
from outside.writing import Case, coordinates, g, lagrange, rate, square

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.scenes import jets


@dataclass(frozen=True)
class Refusal:
    """What makes a scene, and what is said of it: when its model is made, or when it is solved."""

    make: Callable[[], sc.Scene]
    words: str


def scene(system: Callable[[], sc.MechanicalSystem], end: float = 0.5) -> sc.Scene:
    size = len(system().outputs)
    return sc.Scene("refused", {"model": system}, sc.rest_to_rest((0.1,) * size, (0.1 + end,) * size, 2.0))


def ball_on_a_beam() -> sc.MechanicalSystem:
    """A torque on the beam, the ball's place on it prescribed: only a beam that turns lets the torque reach it."""
    q = coordinates("r", "a")
    r, a = ca.vertsplit(q.q)
    place = r * ca.vertcat(ca.cos(a), ca.sin(a))
    return lagrange(
        "ball on a beam", q, (0.3 * q.v[1] ** 2 + 0.2 * square(rate(place, q)) + 0.08 * q.v[0] ** 2) / 2, {"R": r},
        {"T": a}, potential=0.2 * g * place[1], guess=lambda at: (at[0], 0.0), home=(0.1,),
    )  # fmt: skip


def aircraft_that_shall_roll() -> sc.MechanicalSystem:
    """Sideways position and roll are prescribed: upright, no thrust pushes sideways."""
    q = coordinates("x z", "theta")
    x, z, theta = ca.vertsplit(q.q)
    system = lagrange(
        "aircraft", q, (1.5 * square(q.v[:2]) + 0.02 * q.v[2] ** 2) / 2, {"X": x, "A": theta},
        {"f": z, "torque": theta}, potential=1.5 * g * z, guess=lambda at: (at[0], 0.0, at[1]), home=(0.0, 0.3),
    )  # fmt: skip
    return replace(system, input_matrix=thrust(theta, 3))


def through_a_pole() -> sc.Scene:
    """The aircraft shall roll from one side to the other while it moves sideways."""
    path = sc.rest_to_rest((0.0, -0.2), (1.0, 0.3), 2.0)
    return sc.Scene("roll", {"aircraft": aircraft_that_shall_roll}, path)


def car_that_nothing_drives() -> sc.MechanicalSystem:
    """Two cars without a spring between them: the force on one never moves the other."""
    q = coordinates("x y")
    return lagrange(
        "two cars apart", q, square(q.v) / 2, {"Y": q["y"]}, {"F": q["x"]}, guess=lambda at: (0.0, at[0]), home=(0.2,)
    )  # fmt: skip


def two_motors_on_one_joint() -> sc.MechanicalSystem:
    q = coordinates("", "a b")
    return lagrange(
        "two motors on one joint", q, square(q.v) / 2, {"A": q["a"], "B": q["b"]}, {"T_1": q["a"], "T_2": q["a"]},
        potential=ca.cos(q["a"] - q["b"]), guess=lambda at: (at[0], at[1]), home=(0.2, 0.3),
    )  # fmt: skip


def one_output_twice() -> sc.MechanicalSystem:
    q = coordinates("x y")
    return lagrange(
        "one output twice", q, square(q.v) / 2, {"X": q["x"], "2X": 2.0 * q["x"]}, {"F": q["x"], "G": q["y"]},
        guess=lambda at: (at[0], at[1]), home=(0.2, 0.4),
    )  # fmt: skip


def knife_edge() -> sc.MechanicalSystem:
    """A blade on ice does not slide sideways: a constraint of velocities."""
    q = coordinates("x y", "heading")
    x_dot, y_dot, _ = ca.vertsplit(q.v)
    sideways = ca.sin(q["heading"]) * x_dot - ca.cos(q["heading"]) * y_dot
    return lagrange(
        "knife edge", q, square(q.v) / 2, {"X": q["x"], "Y": q["y"]}, {"F": q["x"], "T": q["heading"]},
        constraints=sideways, guess=lambda at: (at[0], at[1], 0.0), home=(0.2, 0.3),
    )  # fmt: skip


def speed_as_output() -> sc.MechanicalSystem:
    q = coordinates("x")
    return lagrange(
        "car at a speed", q, q.v[0] ** 2 / 2, {"V": q.v[0]}, {"F": q["x"]}, guess=lambda at: (at[0],), home=(0.2,)
    )  # fmt: skip


REFUSED = {
    each.__name__: Refusal(lambda each=each: scene(each), words)  # type: ignore[misc]  # wrong on purpose
    for each, words in {
        ball_on_a_beam: "no relative degree|singular",
        car_that_nothing_drives: "structurally singular: no equation determines u.F",
        two_motors_on_one_joint: "the inputs T_1, T_2 drive the same",
        one_output_twice: "the outputs X, 2X follow the same coordinates",
        knife_edge: "nonholonomic constraints are not solved",
        speed_as_output: "the output V depends on velocities",
    }.items()
}


# Flat, but only by a combination of momentum equations that both have inputs.

ARM = 0.3


def huygens() -> sc.MechanicalSystem:
    """An aircraft whose torque pushes sideways too; its output is the point that this push does not move."""
    q = coordinates("x z", "theta")
    x, z, theta = ca.vertsplit(q.q)
    c, s = ca.cos(theta), ca.sin(theta)
    system = lagrange(
        "aircraft at its centre of oscillation", q, (square(q.v[:2]) + ARM * q.v[2] ** 2) / 2,
        {"X": x - ARM * s, "Z": z + ARM * c}, {"f": z, "torque": theta},
        potential=g * z, guess=lambda at: (at[0], at[1] - ARM, 0.0), home=(0.1, 0.2),
    )  # fmt: skip
    return replace(system, input_matrix=-ca.vertcat(ca.horzcat(-s, c, 0), ca.horzcat(c, s, 1)))


def aircraft_at_its_centre_of_oscillation() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        x, z = jets.components(reference.jet(t, 4))
        lift, side = z.d().d() + g, -1.0 * x.d().d()
        tilt = jets.atan2(side, lift).derivatives()
        return {"theta": tilt[0], "torque": ARM * tilt[2], "f": np.hypot(lift.value, side.value) + ARM * tilt[1] ** 2}

    path = sc.rest_to_rest((0.0, 0.0), (3.0, 1.0), 3.0)
    return Case(sc.Scene("huygens", {"body": huygens}, path), exact, index=5)
