"""Servo outputs of an imported mechanism: joints, places and rotations of frames."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import casadi as ca

from servocore.importers.coordinates import UNITS, Layout
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array
from servocore.numerics.components import filled

_HALVINGS = 3
_TERMS = 11  # of the series of asin(x)/x for x below sin(pi/16): the next one is below 1e-17


def rows_of_outputs(layout: Layout, names: Sequence[str], posture: Array) -> dict[Quantity, ca.SX]:
    """Return the servo outputs with their expressions.

    Parameters
    ----------
    layout : Layout
        The mechanism.
    names : sequence of str
        Joints; frames for their three coordinates; a frame with ``.x``, ``.y``, ``.z``, ``.rx``, ``.ry`` or ``.rz``.
    posture : ndarray, shape (n,)
        Configuration from which rotations count.

    Raises
    ------
    InvalidModel
        If there is no joint or frame of a name.
    """
    rows = dict[Quantity, ca.SX]()
    for name in names:
        if name in layout.motion.q:
            joint = next(joint for joint in layout.joints if name in joint.coordinates)
            rows[Quantity(name, UNITS[joint.kind][0])] = layout.motion.q[name]
            continue
        frame, _, part = name.rpartition(".")
        if part in ("rx", "ry", "rz"):
            vector = _rotation_vector(layout, frame, posture)
            rows[Quantity(name, "rad", f"rotation of {frame} from its posture")] = vector["xyz".index(part[1])]
        elif part in ("x", "y", "z") and frame:
            rows[Quantity(name, "m", f"position of {frame}")] = layout.position(frame)["xyz".index(part)]
        else:
            place = layout.position(name)
            rows |= {Quantity(f"{name}.{axis}", "m", f"position of {name}"): place[k] for k, axis in enumerate("xyz")}
    return rows


def _rotation_vector(layout: Layout, frame: str, posture: Array) -> ca.SX:
    """Return the rotation vector from the orientation at the posture, base axes, shape (3,), rad.

    It is analytic at zero: the unit quaternion is halved three times, and what remains is the series of asin(x)/x.
    Rotations reach up to half a turn.
    """
    R = layout.rotation(frame)
    start = filled(ca.Function("start", [layout.coordinates.q], [R])(posture))
    D = ca.mtimes(R, ca.DM(start).T)
    w = ca.sqrt(1 + ca.trace(D)) / 2
    e = ca.vertcat(D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]) / (4 * w)
    for _ in range(_HALVINGS):
        w = ca.sqrt((1 + w) / 2)
        e = e / (2 * w)
    terms = [comb(2 * k, k) / 4**k / (2 * k + 1) for k in reversed(range(_TERMS))]
    series = ca.polyval(ca.DM(terms), ca.sumsqr(e))
    return e * series * 2.0 ** (_HALVINGS + 1)
