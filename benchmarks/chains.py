"""A closed chain of bars, as long as one likes: bodies hinged one to the next, both ends to the ground."""

from __future__ import annotations

from itertools import accumulate

import casadi as ca
import numpy as np

import servocore as sc
from servocore.model.system import MAX_REFERENCE_ORDER

_ARC, _MOVE, _DURATION = 1.0, -0.4, 2.0  # rad, rad of all bars together, s
_GRAVITY = 9.81


def closed_chain(bodies: int) -> sc.Scene:
    """Return bars of one metre that stand in an arc over the ground, all but the last two turned by motors.

    Places and angles of the bars are the coordinates, hinges the constraints; the last two bars close the chain.
    """
    home = _ARC * np.linspace(1.0, -1.0, bodies)
    span = float(np.cos(home).sum())
    names = [f"{kind}_{k}" for k in range(bodies) for kind in ("x", "y", "a")]
    coordinates = sc.Coordinates(*(sc.Quantity(each, "rad" if each[0] == "a" else "m") for each in names))
    x, y, a = (coordinates.q[k::3] for k in range(3))
    motors = bodies - 2
    gamma = ca.SX.sym("gamma", motors, MAX_REFERENCE_ORDER + 1)
    system = sc.MechanicalSystem(
        name=f"closed chain of {bodies} bars",
        coordinates=coordinates,
        parameters=sc.Parameters(),
        inputs=tuple(sc.Quantity(f"M_{k}", "N.m") for k in range(motors)),
        outputs=tuple(sc.Quantity(f"A_{k}", "rad") for k in range(motors)),
        mass=ca.diag(ca.SX(np.tile([1.0, 1.0, 1.0 / 12.0], bodies))),
        output=a[:motors],
        input_matrix=-ca.SX(np.asarray(np.kron(np.eye(motors, bodies), [[0.0, 0.0, 1.0]]), dtype=np.float64)),
        potential=_GRAVITY * ca.sum1(y),
        constraints=_hinges(x, y, a, span),
        multipliers=ca.SX.sym("lam", 2 * (bodies + 1)),
        gamma=gamma,
        guess=_closed(gamma[:, 0], span),
        home=tuple(home[:motors].tolist()),
    )
    path = sc.rest_to_rest(tuple(home[:motors]), tuple(home[:motors] + _MOVE / bodies), _DURATION)
    return sc.Scene(system.name, {"hinges": lambda: system}, path)


def _hinges(x: ca.SX, y: ca.SX, a: ca.SX, span: float) -> ca.SX:
    """Return what vanishes where every bar begins at the end of the one before, and the last one ends at the span."""
    half = ca.horzcat(ca.cos(a), ca.sin(a)) / 2
    centres = ca.horzcat(x, y)
    ends = ca.vertcat(ca.SX.zeros(1, 2), centres + half)
    starts = ca.vertcat(centres - half, ca.horzcat(span, 0))
    return ca.vec((starts - ends).T)


def _closed(driven: ca.SX, span: float) -> ca.SX:
    """Return places and angles for the angles of the bars that are driven: the last two meet above."""
    left, up = span - ca.sum1(ca.cos(driven)), -ca.sum1(ca.sin(driven))
    line, half = ca.atan2(up, left), ca.acos(ca.sqrt(left**2 + up**2) / 2)
    a = ca.vertcat(driven, line + half, line - half)
    places = [ca.vertcat(*accumulate(ca.vertsplit(part))) - part / 2 for part in (ca.cos(a), ca.sin(a))]
    return ca.vec(ca.horzcat(*places, a).T)
