"""Common part of all cranes: a load on a rope below a trolley; its last coordinate points up, the trolley is at zero.

`swinging` gives a crane whose trolley runs along straight rails, in one direction or in two, swing angles; `follow` is
the flat algebra of the closed forms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import add
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from servocore.model.drawing import Part
from servocore.model.generalize import generalize
from servocore.model.limits import Limit
from servocore.model.quantity import Quantity
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.scenes import jets

PARAMETERS = (
    Parameter("trolley_mass", 10.0, "kg", 1e-3, 1e9, "m_t, of trolley and winch"),
    Parameter("load_mass", 100.0, "kg", 1e-3, 1e9, "m"),
    Parameter("winch_inertia", 0.1, "kg.m2", 1e-6, 1e9, "J_w, about the winch's own axis"),
    Parameter("winch_radius", 0.1, "m", 1e-3, 1e3, "r_w", fixed=True),
    Parameter("gravity", 9.81, "m/s2", 1e-3, 1e3, "g", fixed=True),
)
WINCH = Quantity("M_w", "N.m", "winch torque, positive where it pays out rope")
ROPE = Quantity("l", "m", "rope length", positive=True)
TENSION = Quantity("tension", "N", "rope tension", nonnegative=True)
SWING = Quantity("swing", "rad", "angle of the rope from the vertical", nonnegative=True)


def swing_angle(rope: ca.SX) -> ca.SX:
    """Angle of a rope vector, from trolley to load, from the vertical that points down; signed in a plane."""
    return ca.atan2(rope[0] if rope.numel() == 2 else ca.norm_2(rope[:2]), -rope[-1])


def tension(gamma: ca.SX, p: Parameters) -> ca.SX:
    """Rope tension that gives the load its prescribed acceleration: m |gamma'' + g e_z|, without multipliers."""
    return p["load_mass"] * ca.norm_2(pull(gamma, p))


def suspension(gamma: ca.SX, p: Parameters) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the trolley's level position, the rope's length, and its direction from trolley to load.

    The rope lies along the load's acceleration less gravity. One guessed vertical is too far off for Newton's method
    where the load swings by tens of degrees.
    """
    direction = -upwards(gamma, p)
    length = gamma[-1, 0] / direction[-1]
    return gamma[:-1, 0] - length * direction[:-1], length, direction


def rope_beside(along: ca.SX, inside: ca.SX, outside: ca.SX) -> ca.SX:
    """Return a rope's direction from its swing angles in the plane of a level direction, outwards, and out of it."""
    across = ca.vertcat(-along[1], along[0])
    level = ca.sin(inside) * ca.cos(outside) * along + ca.sin(outside) * across
    return ca.vertcat(level, -ca.cos(inside) * ca.cos(outside))


def swings_beside(along: ca.SX, rope: ca.SX) -> ca.SX:
    """Return these angles of a rope's direction; at 90 degrees the second makes the first undefined."""
    outwards, sideways = ca.dot(along, rope[:2]), along[0] * rope[1] - along[1] * rope[0]
    return ca.vertcat(ca.atan2(outwards, -rope[2]), ca.asin(sideways))


def pull(gamma: ca.SX, p: Parameters) -> ca.SX:
    """Rope force on the load by its mass: acceleration less gravity."""
    return gamma[:, 2] + ca.vertcat(ca.SX.zeros(gamma.size1() - 1), p["gravity"])


def upwards(gamma: ca.SX, p: Parameters) -> ca.SX:
    """Direction of the rope, from the load on."""
    force = pull(gamma, p)
    return force / ca.norm_2(force)


def drawn(trolley: tuple[Any, ...], load: tuple[Any, ...], *frame: Part) -> list[Part]:
    """Return what the trolley runs on, rope, trolley and load."""
    rope = Part("rope", (trolley, load), colour=TENSION.name)
    return [*frame, rope, Part("box", (trolley,), "trolley"), Part("body", (load,), "load")]


def swinging(
    base: MechanicalSystem, name: str, rails: Sequence[Quantity], swings: Sequence[Quantity]
) -> MechanicalSystem:
    """Return a crane on straight rails in generalized coordinates: rails, rope length and one swing angle a rail.

    Parameters
    ----------
    base : MechanicalSystem
        With coordinates q = (rails, l, load).
    name : str
        What the system is called in messages.
    rails, swings : sequence of Quantity
        Trolley positions; the angle of the rope along the first rail, and out of that plane. At 90 degrees the
        second makes the first undefined.
    """
    coordinates, count, gamma = Coordinates(*rails, ROPE, *swings), len(rails), base.gamma
    trolley, length, along, across = ca.vertsplit(coordinates.q, [0, count, count + 1, count + 2, 2 * count + 1])
    in_plane = ca.cos(across) if count == 2 else 1  # of the first rail and the vertical
    rope = length * ca.vertcat(ca.sin(along) * in_plane, ca.sin(across), -ca.cos(along) * in_plane)
    trolley_there, rope_length, direction = suspension(gamma, base.parameters)
    return generalize(
        base,
        coordinates,
        ca.vertcat(trolley, length, ca.vertcat(trolley, 0) + rope),
        guess=ca.vertcat(trolley_there, rope_length, ca.atan2(direction[0], -direction[-1]), ca.asin(direction[1:-1])),
        # Without multipliers the tension follows from the load's prescribed acceleration.
        observables={
            TENSION: tension(gamma, base.parameters),
            **({SWING: swing_angle(rope)} if count == 2 else {}),
        },
        name=name,
    )


Followed: TypeAlias = tuple[tuple[jets.Jet, ...], tuple[Array, ...], jets.Jet, dict[str, Array]]
"""The trolley's level position (m), the level force of the rope on it (N), the rope's length (m), and the answer: M_w,
l, tension, swing, and the load's path by the names of the outputs."""


def follow(reference: Array, parameters: Mapping[str, float], outputs: Sequence[Quantity]) -> Followed:
    """Return the quantities of any crane that follow exactly from the path of its load: it is flat in that.

    Parameters
    ----------
    reference : ndarray, shape (N, orders, len outputs)
        Load position and its derivatives, four or more for all that a crane needs.
    parameters : mapping of str to float
        Among them `PARAMETERS`.
    outputs : sequence of Quantity
        What the components are called.
    """
    _, m, J_w, r_w, g = (parameters[parameter.name] for parameter in PARAMETERS)
    *level, z = load = jets.components(reference)
    k = -z / (g + z.d().d())
    to_trolley = [k * component.d().d() for component in level]
    rope = jets.sqrt(reduce(add, (component**2 for component in (*to_trolley, z))))
    per_length = m / k.value  # rope tension divided by rope length
    force = per_length * rope.value
    lean = -to_trolley[0].value if len(level) == 1 else np.hypot(*(component.value for component in to_trolley))
    trolley = tuple(position + offset for position, offset in zip(level, to_trolley, strict=True))
    level_pull = tuple(-per_length * component.value for component in to_trolley)
    answer = {
        WINCH.name: J_w * rope.derivatives()[2] / r_w - r_w * force,
        ROPE.name: rope.value,
        TENSION.name: force,
        SWING.name: np.arctan2(lean, -z.value),
        **{quantity.name: path.value for quantity, path in zip(outputs, load, strict=True)},
    }
    return trolley, level_pull, rope, answer


TAUT = Limit("g + z''", "m/s2", 0.0, "the rope goes slack", lambda gamma, p: p["gravity"] + gamma[-1, 2])
"""The load must not fall freely: below what it hangs from, on a rope that is taut."""


def limits(above: str) -> tuple[Limit, Limit]:
    """Return the limits of a taut rope and of a load below what it hangs from, called `above`."""
    return (
        TAUT,
        Limit(
            f"the load's depth below the {above}",
            "m",
            0.0,
            f"the load is not below the {above}",
            lambda gamma, _: -gamma[-1, 0],
        ),
    )
