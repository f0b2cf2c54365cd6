"""`Tree`: a mechanism of rigid bodies and joints, in the form that all readers produce.

Every body has a pose in its parent's axes (where all joints are at their zero), inertia, and the joints, in order, that
let it move against its parent; a body without joints is fixed to it. Joints of several degrees of freedom are made of
hinges, slides and balls: a free body has three slides and a ball.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from servocore.errors import InvalidModel
from servocore.numerics.compiled_calls import Array

GROUND = ""
"""Name of the parent of bodies that stand on the ground."""

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
"""Acceleration of gravity of files that do not state one, m/s2."""

LARGEST = 1e15
"""Numbers of files are smaller, in SI units: no body is made of larger ones."""

FREE = (-math.inf, math.inf)
"""Limits of what is not limited."""

_LONGEST = 300.0  # m between two joints: cranes are smaller, robots in millimetres are larger
_SLENDER = 30.0  # radius of gyration in lengths of the mechanism: inertias in kg mm2 are a thousand

ZERO = np.zeros(3)
ZERO.flags.writeable = False
IDENTITY = np.eye(3)
IDENTITY.flags.writeable = False


@dataclass(frozen=True, eq=False)
class Joint:
    """One elementary joint of a body.

    Parameters
    ----------
    name : str
        Name of its coordinate; a ball has four, ``name.e0`` ... ``name.e3``, a unit quaternion.
    kind : str
        ``hinge``, ``slide`` or ``ball``.
    axis, anchor : ndarray, shape (3,)
        Direction and point of the axis in the axes of the body, at zero; unit length, m.
    lower, upper, velocity, effort : float
        Limits in rad or m, rad/s or m/s, N m or N; infinite where there is none.
    stiffness, rest, damping : float
        Spring between body and parent, coordinate at which it is relaxed, viscous damping.
    armature : float
        Inertia of the motor behind its gear, kg m2 or kg.
    zero : float
        Coordinate at which the body has its pose.
    mimic : (str, float, float), optional
        Joint that this one follows, with factor and offset.
    """

    name: str
    kind: str = "hinge"
    axis: Array = field(default_factory=lambda: IDENTITY[2])
    anchor: Array = field(default_factory=lambda: ZERO)
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    armature: float = 0.0
    zero: float = 0.0
    mimic: tuple[str, float, float] | None = None

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of its coordinates."""
        return tuple(f"{self.name}.e{k}" for k in range(4)) if self.kind == "ball" else (self.name,)

    @classmethod
    def free(cls, name: str, rotation: Array, position: Sequence[float] | Array, **same: Any) -> list[Joint]:
        """Return the joints of a free body with this pose in its parent's axes: slides along those, and a ball."""
        along = zip("xyz", rotation, position, strict=True)
        slides = [cls(f"{name}.{axis}", "slide", turned, zero=float(zero), **same) for axis, turned, zero in along]
        return [*slides, cls(name, "ball", **same)]


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body, or a frame: a tool or a site is a body without mass that is fixed to another one.

    Parameters
    ----------
    name, parent : str
        Names; `GROUND` is no body.
    position : ndarray, shape (3,)
        Of its origin in the parent's axes, m, where all joints are at their zero.
    rotation : ndarray, shape (3, 3)
        Columns are its axes in those of the parent.
    mass : float
        In kg.
    centre : ndarray, shape (3,)
        Centre of mass in its axes, m.
    inertia : ndarray, shape (3, 3)
        About the centre of mass in its axes, kg m2.
    joints : sequence of Joint
        Between parent and body, in the order in which they act.
    """

    name: str
    parent: str = GROUND
    position: Array = field(default_factory=lambda: ZERO)
    rotation: Array = field(default_factory=lambda: IDENTITY)
    mass: float = 0.0
    centre: Array = field(default_factory=lambda: ZERO)
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))
    joints: Sequence[Joint] = ()


@dataclass(frozen=True, eq=False)
class Actuator:
    """A drive on a joint, a tendon or a frame; its input is the force behind the gear.

    Parameters
    ----------
    name : str
        In the file.
    kind, on : str
        ``joint``, ``tendon`` or ``frame``, and the name of that.
    gear : tuple of float
        Force per unit of the drive: one number, or force and torque in the axes of the frame.
    gain, bias : float, tuple of float
        Drive = gain ctrl + bias[0] + bias[1] length + bias[2] rate of the length.
    limits, control, behind : tuple of float
        Limits of the drive, of ctrl, and of the force behind the gear.
    """

    name: str
    kind: str
    on: str
    gear: tuple[float, ...] = (1.0,)
    gain: float = 1.0
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    limits: tuple[float, float] = FREE
    control: tuple[float, float] = FREE
    behind: tuple[float, float] = FREE


@dataclass(frozen=True, eq=False)
class Tendon:
    """A length: a combination of coordinates, or a path through frames with pulleys between.

    Parameters
    ----------
    name : str
        In the file.
    terms : mapping of str to float
        Coefficients of joints.
    branches : sequence of (float, sequence of str)
        Divisors and frames of the branches of a path through space.
    stiffness, rest, damping : float
        Of its spring.
    longest : float
        Upper limit of its length, at which a rope is taut, m.
    refusal : str
        Why its length cannot be computed; empty if it can.
    """

    name: str
    terms: Mapping[str, float] = field(default_factory=dict)
    branches: Sequence[tuple[float, Sequence[str]]] = ()
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    longest: float = math.inf
    refusal: str = ""


@dataclass(frozen=True, eq=False)
class Closure:
    """A constraint beside the tree.

    Parameters
    ----------
    name, kind : str
        ``connect`` (one common point), ``weld`` (one common frame), ``hinge`` (common point and axis z), ``joint`` or
        ``tendon`` (first - rest = polynomial of second - rest).
    first, second : str
        Names of frames, joints or tendons; the second joint or tendon may be empty.
    polynomial : tuple of float
        Coefficients in rising order.
    rest : (float, float)
        Values of both at which the polynomial has its origin.
    """

    name: str
    kind: str
    first: str
    second: str
    polynomial: tuple[float, ...] = ()
    rest: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Tree:
    """A mechanism: bodies and frames, drives, constraints, and a list of all that the model leaves out.

    Parameters
    ----------
    name, source : str
        Name of the mechanism, and of its file in messages.
    bodies : sequence of Body
        And frames, in any order; `Tree` sorts parents before children.
    actuators : sequence of Actuator
        Drives.
    tendons : mapping of str to Tendon
        By name.
    closures : sequence of Closure
        Constraints beside the tree.
    gravity : sequence of float
        Acceleration in the axes of the ground, m/s2.
    left_out : sequence of str
        Elements of the file that have no part in the model, with the reason.

    Raises
    ------
    InvalidModel
        If a name stands twice, a parent is missing, bodies form a cycle, or mass or inertia are not physical.
    """

    name: str
    source: str
    bodies: Sequence[Body]
    actuators: Sequence[Actuator] = ()
    tendons: Mapping[str, Tendon] = field(default_factory=dict)
    closures: Sequence[Closure] = ()
    gravity: Sequence[float] = STANDARD_GRAVITY
    left_out: Sequence[str] = ()

    def __post_init__(self) -> None:
        for kind, names in (
            ("bodies", [body.name for body in self.bodies]),
            ("joints", [joint.name for body in self.bodies for joint in body.joints]),
        ):
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise self.fault(f"two {kind} are called {twice}")
        ordered = sorted(self.bodies, key=lambda body: len(self.above(body.name)))
        object.__setattr__(self, "bodies", tuple(ordered))
        self._require_physical()

    def fault(self, sentence: str) -> InvalidModel:
        """Return the error of a sentence about the file."""
        return InvalidModel(f"{self.source}: {sentence}")

    def above(self, name: str) -> list[Body]:
        """Return a body and those that carry it, up to the ground; raises `InvalidModel` if they do not end there."""
        if name not in self.body:
            raise self.fault(f"there is no frame {name}; there are {', '.join(self.body)}")
        way = [self.body[name]]
        while way[-1].parent != GROUND:
            parent = way[-1].parent
            if parent not in self.body:
                raise self.fault(f"the body {way[-1].name} hangs on {parent}, which does not exist")
            way.append(self.body[parent])
            if way[-1] in way[:-1]:
                cycle = [body.name for body in way[way.index(way[-1]) :]]
                raise self.fault(f"the bodies form a cycle: {' on '.join(cycle)}")
        return way

    def _require_physical(self) -> None:
        """Refuse masses that no body has, and sizes out of proportion: files in millimetres.

        Inertias are checked with all that is fixed to a body, in `stages_of`.
        """
        for body in self.bodies:
            values = (body.mass, *body.centre, *body.inertia.ravel(), *body.position, *body.rotation.ravel())
            if not (np.abs(values) < LARGEST).all():
                raise self.fault(f"the body {body.name} holds a number that is not finite, or above {LARGEST:g}")
            if body.mass < 0.0:
                raise self.fault(f"the body {body.name} has the negative mass {body.mass:g} kg")
        far = max(self.bodies, key=lambda body: float(np.abs(body.position).max()), default=None)
        if far is not None and np.abs(far.position).max() > _LONGEST:
            raise self.fault(
                f"the body {far.name} is {np.linalg.norm(far.position):.4g} m from its parent: lengths are in metres"
                " here, and these are probably millimetres"
            )
        size = sum(float(np.linalg.norm(body.position) + np.linalg.norm(body.centre)) for body in self.bodies)
        for body in self.bodies:
            gyration = math.sqrt(max(0.0, float(np.trace(body.inertia)) / 2.0) / body.mass) if body.mass > 0.0 else 0.0
            if gyration > _SLENDER * max(size, 1.0):
                raise self.fault(
                    f"the body {body.name} has a radius of gyration of {gyration:.4g} m in a mechanism of {size:.4g} m:"
                    " inertias are in kg m2 here, and these are probably kg mm2"
                )

    @cached_property
    def joints(self) -> Mapping[str, Joint]:
        """All joints by name."""
        return {joint.name: joint for body in self.bodies for joint in body.joints}

    @cached_property
    def body(self) -> Mapping[str, Body]:
        """All bodies by name."""
        return {body.name: body for body in self.bodies}
