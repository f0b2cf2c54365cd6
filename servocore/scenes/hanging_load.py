"""What all cranes share: a load on a rope below a trolley; its last coordinate points up, the trolley is at zero."""

from __future__ import annotations

import casadi as ca

from servocore.model.scene import Limit
from servocore.model.symbols import Parameters


def swing_angle(rope: ca.SX) -> ca.SX:
    """Angle of a rope vector in space, from trolley to load, from the vertical that points down."""
    return ca.atan2(ca.norm_2(rope[:2]), -rope[2])


def tension(gamma: ca.SX, p: Parameters) -> ca.SX:
    """Rope tension that gives the load its prescribed acceleration: m |gamma'' + g e_z|, without multipliers."""
    up = ca.SX.zeros(gamma.size1())
    up[-1] = p["gravity"]
    return p["load_mass"] * ca.norm_2(gamma[:, 2] + up)


def suspension(gamma: ca.SX, p: Parameters) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return where the trolley is, how long the rope, and its direction from trolley to load.

    The rope lies along the load's acceleration less gravity. One guessed vertical is too far off for Newton's method
    where the load swings by tens of degrees.
    """
    pull = gamma[:, 2] + ca.vertcat(ca.SX.zeros(gamma.size1() - 1), p["gravity"])
    direction = -pull / ca.norm_2(pull)
    length = gamma[-1, 0] / direction[-1]
    return gamma[:-1, 0] - length * direction[:-1], length, direction


def limits(above: str) -> tuple[Limit, Limit]:
    """Return the limits of a taut rope and of a load below what it hangs from, called `above`."""
    return (
        Limit("g + z''", "m/s2", 0.0, "the rope goes slack", lambda gamma, p: p["gravity"] + gamma[-1, 2]),
        Limit(
            f"the load's depth below the {above}",
            "m",
            0.0,
            f"the load is not below the {above}",
            lambda gamma, _: -gamma[-1, 0],
        ),
    )
