"""Joints: constraints between two places, at most quadratic in the coordinates.

Every function takes a place `a` on one body and a place `b` on another (or on the ground) and returns a
column that vanishes where the joint holds. With the multipliers lam of these rows the joint exerts -G^T lam.

| joint | rows | leaves |
|---|---|---|
| `fixed` | 6 | nothing |
| `revolute` | 5 | the angle about the common axis |
| `prismatic` | 5 | the displacement along the common axis |
| `cylindrical` | 4 | both |
| `spherical` | 3 | all rotations |
| `on_line` | 2 | a point slides along an axis, free to turn |
| `on_plane` | 1 | a point slides across an axis, free to turn |
| `distance` | 1 | all but the distance: a rigid link, or a rope if the length is a coordinate |
| `rope` | 1 | all but the distance; it cannot push |
| `angle`, `displacement` | 1 | define an augmented coordinate |

Closed loops of parallel hinges: a planar four-bar linkage of three moving bodies and four revolutes has 20
joint rows, 3 too many, since three revolutes keep all bodies in their plane already. `analyse` names such rows
and `solve` leaves them out, as it does in overconstrained spatial loops (Bricard). Or let the hinge that closes
the loop be `on_line`, a point of one body on the hinge axis of the other (2 rows): then all constraints are
independent, and all joint forces determined.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca

from servocore.errors import InvalidModel, described
from servocore.numerics.expressions import as_expression

if TYPE_CHECKING:
    from servocore.model.rotationless.parts import Place, Scalar


def spherical(a: Place, b: Place) -> ca.SX:
    """Return the rows of a ball joint: one common point, shape (3,), m."""
    for place in (a, b):
        if not hasattr(place, "position"):
            hint = "; frame.at(...) is one" if hasattr(place, "at") else ""
            raise InvalidModel(f"a joint is between two places, not {described(place)}{hint}")
    return b.position - a.position


def revolute(a: Place, b: Place) -> ca.SX:
    """Return the rows of a hinge: one common point and one common axis, shape (5,)."""
    return ca.vertcat(spherical(a, b), _parallel(a, b))


def cylindrical(a: Place, b: Place) -> ca.SX:
    """Return the rows of a shaft that slides and turns: one common axis, shape (4,)."""
    return ca.vertcat(on_line(a, b), _parallel(a, b))


def prismatic(a: Place, b: Place) -> ca.SX:
    """Return the rows of a slider: a common axis, and no rotation about it, shape (5,)."""
    return ca.vertcat(cylindrical(a, b), ca.dot(a.binormal, b.normal))


def fixed(a: Place, b: Place) -> ca.SX:
    """Return the rows of a weld: a common point and a common triad, shape (6,)."""
    return ca.vertcat(revolute(a, b), ca.dot(a.binormal, b.normal))


def on_line(a: Place, b: Place) -> ca.SX:
    """Return the rows that keep the point `b` on the axis of `a`, shape (2,), m."""
    gap = spherical(a, b)
    return ca.vertcat(ca.dot(gap, a.normal), ca.dot(gap, a.binormal))


def on_plane(a: Place, b: Place) -> ca.SX:
    """Return the row that keeps the point `b` in the plane through `a` across its axis, shape (1,), m."""
    return ca.dot(spherical(a, b), a.axis)


class Distance(ca.SX):
    """The row of a distance, with its length and whether it can push.

    Attributes
    ----------
    length : casadi.SX
        In m.
    pushes : bool or None
        Whether it can push; None: unless its length is a coordinate.
    """

    def __init__(self, row: ca.SX, length: Scalar, pushes: bool | None) -> None:
        super().__init__(row)
        self.length, self.pushes = ca.SX(length), pushes

    def is_rope(self, q: ca.SX) -> bool:
        """Whether it can only pull, in a mechanism with the coordinates `q`."""
        return ca.depends_on(self.length, q) if self.pushes is None else not self.pushes

    def tension(self, multiplier: ca.SX) -> ca.SX:
        """Return the force with which it pulls, N."""
        return 2 * self.length * multiplier


def distance(a: Place, b: Place, length: Scalar, *, pushes: bool | None = None) -> Distance:
    """Return |b - a|^2 - length^2, shape (1,), m^2: a rigid link, or a rope if `length` is a coordinate.

    With its multiplier lam the tension (positive when it pulls) is 2 length lam. A rope cannot push: an assembly
    reports its tension, and a motion in which it is not positive is refused.

    Parameters
    ----------
    a, b : Place
        Its ends.
    length : number or casadi.SX
        In m.
    pushes : bool, optional
        True for a link whose length is a coordinate, such as a cylinder; False for a rope of constant length.
    """
    length = as_expression(length, "the length of a distance")
    return Distance(ca.sumsqr(spherical(a, b)) - length**2, length, pushes)


def rope(a: Place, b: Place, length: Scalar) -> Distance:
    """Return the row of a `distance` that cannot push, whether its length is a coordinate or constant."""
    return distance(a, b, length, pushes=False)


def angle(a: Place, b: Place, coordinate: ca.SX) -> ca.SX:
    """Return the row that makes `coordinate` (rad) the angle from the normal of `a` to that of `b`.

    It counts right-handed about the axis of `a`, across which the normal of `b` must lie. This is the only
    row, shape (1,), that is not quadratic: it holds sine and cosine of an augmented coordinate, which may
    exceed a full turn. It also vanishes at the angle plus 180 degrees: the guess decides between the two.
    """
    coordinate = as_expression(coordinate, "the coordinate of an angle")
    across = ca.cos(coordinate) * a.binormal - ca.sin(coordinate) * a.normal
    return ca.dot(across, b.normal)


def displacement(a: Place, b: Place, coordinate: ca.SX) -> ca.SX:
    """Return the row that makes `coordinate` (m) the position of `b` along the axis of `a`, shape (1,)."""
    return on_plane(a, b) - as_expression(coordinate, "the coordinate of a displacement")


def _parallel(a: Place, b: Place) -> ca.SX:
    return ca.vertcat(ca.dot(a.normal, b.axis), ca.dot(a.binormal, b.axis))
