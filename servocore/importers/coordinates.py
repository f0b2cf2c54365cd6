"""Coordinates of an imported mechanism: joints that move, motors of elastic joints, point masses of their own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.importers.options import Options
from servocore.importers.recursion import Motion, Place, Stage, stages_of
from servocore.importers.tree import Body, Joint, Tree
from servocore.model.quantity import Quantity
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.numerics.compiled_calls import Array

UNITS = {"hinge": ("rad", "N.m", "torque"), "slide": ("m", "N", "force"), "ball": ("1", "N.m", "torque")}
"""Unit of a coordinate, unit and name of its force."""

MOTOR = ".motor"
"""Suffix of the coordinate of a motor."""

_MEETS = 1e-9  # m between hinges of a rope
_LIGHT = 1e-6  # of a load: bodies of a rope, which MJCF does not let be massless


@dataclass(frozen=True, eq=False)
class Rope:
    """A rope in the place of hinges: from a point of a body to a point mass.

    Attributes
    ----------
    anchor : Place
        Its upper end.
    hoist : str
        The slide that changes its length; empty for none.
    length, sign : float
        Length where the hoist is at zero, and its change for each metre of the hoist, 1 or -1.
    dropped : tuple of str
        Hinges and balls that it replaces.
    without : tuple of str
        Bodies on the way, whose mass is left out.
    """

    anchor: Place
    hoist: str
    length: float
    sign: float
    dropped: tuple[str, ...]
    without: tuple[str, ...]


class Layout:
    """Symbols of a mechanism, and its motion as expressions of them.

    Parameters
    ----------
    tree : Tree
        The mechanism.
    options : Options
        Choices of the user.
    driven : sequence of str
        Joints with a drive.
    """

    def __init__(self, tree: Tree, options: Options, driven: frozenset[str]) -> None:
        self.tree, self.options = tree, options
        whole, places = stages_of(tree)
        self.ropes = {body: _rope(tree, whole, places, tree.body[body], driven) for body in options.ropes}
        dropped = [name for rope in self.ropes.values() for name in rope.dropped]
        light = {body: _light(tree, tree.body[body], driven) for body in options.points}
        without = [*options.points, *options.ropes, *(name for rope in self.ropes.values() for name in rope.without)]
        without += [name for names in light.values() for name in names]
        self.left_out = [f"inertia of {name} about its centre: it is a point mass" for name in light | self.ropes]
        self.left_out += [
            f"mass of {name}: the rope is massless" for name in dict.fromkeys(without) if name not in light | self.ropes
        ]
        self.stages, self.places = stages_of(tree, without, dropped)
        self.joints = [joint for stage in self.stages for joint in stage.joints]
        self.moving = [joint for joint in self.joints if joint.name not in options.locked and not joint.mimic]
        points = (*options.points, *options.ropes)
        self.coordinates = Coordinates(
            *(Quantity(name, UNITS[joint.kind][0]) for joint in self.moving for name in joint.coordinates),
            *(Quantity(f"{name}{MOTOR}", UNITS[tree.joints[name].kind][0]) for name in options.elastic),
            *(Quantity(f"{name}.{axis}", "m") for name in points for axis in "xyz"),
        )
        self.parameters = Parameters(*self._declared())

    def _declared(self) -> list[Parameter]:
        """Return the parameters: of elastic joints, and payloads."""
        declared = []
        for name, elastic in self.options.elastic.items():
            joint = self.tree.joints[name]
            per = "rad" if joint.kind == "hinge" else "m"
            force, inertia = ("N.m", "kg.m2") if joint.kind == "hinge" else ("N", "kg")
            motor = joint.armature if elastic.motor_inertia is None else elastic.motor_inertia
            declared += [
                Parameter(f"{name}.stiffness", elastic.stiffness, f"{force}/{per}", 1e-12, 1e15),
                Parameter(f"{name}.motor_inertia", motor, inertia, 0.0, 1e9),
                Parameter(f"{name}.spring_damping", elastic.damping, f"{force}.s/{per}", 0.0, 1e9),
            ]
        return declared + [
            Parameter(f"{name}.payload", mass, "kg", 0.0, 1e9, f"point mass at {name}")
            for name, mass in self.options.payload.items()
        ]

    def start(self, joint: Joint) -> Array:
        """Return the posture of a joint: as given, or zero, or the middle of limits that exclude zero."""
        given = self.options.posture
        if joint.kind == "ball":
            values = np.array([given.get(name, float(k == 0)) for k, name in enumerate(joint.coordinates)])
            return np.asarray(values / np.linalg.norm(values))
        usual = joint.zero if joint.lower <= joint.zero <= joint.upper else (joint.lower + joint.upper) / 2
        return np.array([given.get(joint.name, usual)])

    def _values(self, names: Mapping[str, ca.SX], scale: float) -> dict[str, ca.SX]:
        """Return all coordinates of the stages from those that move; `scale` is zero for rates of constants."""
        values = {name: names[name] for joint in self.moving for name in joint.coordinates}
        for joint in self.joints:
            if joint.name in self.options.locked:
                held = scale * self.start(joint)
                values |= {name: ca.SX(float(each)) for name, each in zip(joint.coordinates, held, strict=True)}
        for joint in self.joints:
            if joint.name not in values and joint.mimic:
                values[joint.name] = self._mimic(joint, values, scale)
        return values

    def _mimic(self, joint: Joint, values: Mapping[str, ca.SX], scale: float) -> ca.SX:
        factor, offset, seen = 1.0, 0.0, {joint.name}
        while joint.mimic:
            master, times, plus = joint.mimic
            factor, offset = factor * times, offset + factor * plus
            if master in seen or master not in self.tree.joints:
                why = "itself" if master in seen else "no joint of the file"
                raise self.tree.fault(f"the joint {joint.name} mimics {master}, which is {why}")
            seen.add(master)
            joint = self.tree.joints[master]
        if joint.name not in values:
            raise self.tree.fault(f"the joint {joint.name} is mimicked by others and has no coordinate of its own")
        return factor * values[joint.name] + scale * offset

    @cached_property
    def motion(self) -> Motion:
        """Kinematics and dynamics of the stages."""
        q, v = (
            self._values(dict(zip(self.coordinates.names, ca.vertsplit(symbols), strict=True)), scale)
            for symbols, scale in ((self.coordinates.q, 1.0), (self.coordinates.v, 0.0))
        )
        loads = [(self.place(name), self.parameters[f"{name}.payload"]) for name in self.options.payload]
        return Motion(self.stages, q, v, loads)

    @cached_property
    def reduction(self) -> ca.SX:
        """d(coordinates of the stages)/dq, constant, shape (of the stages, n)."""
        rates = ca.vertcat(ca.SX(0, 1), *[self.motion.v[name] for name in self.motion.columns])
        return ca.jacobian(rates, self.coordinates.v)

    def place(self, name: str) -> Place:
        """Return the place of a frame; raises `InvalidModel` if there is none."""
        frame = self.tree.frame(name)
        return self.places[frame.body].moved(frame.position, frame.rotation)

    def point(self, body: str) -> ca.SX:
        """Return the coordinates x, y, z of a body that is a point mass, shape (3,)."""
        first = self.coordinates.index(f"{body}.x")
        return self.coordinates.q[first : first + 3]

    def position(self, name: str) -> ca.SX:
        """Return the position of a frame, shape (3,), m; a point mass is at one place."""
        body = self.tree.frame(name).body
        if body in self.options.points or body in self.options.ropes:
            return self.point(body)
        return self.motion.pose(self.place(name))[1]

    def rotation(self, name: str) -> ca.SX:
        """Return the axes of a frame in those of the ground, shape (3, 3)."""
        body = self.tree.frame(name).body
        if body in self.options.ropes:
            raise self.tree.fault(f"the body {body} hangs on a rope as a point mass: it has no orientation")
        return self.motion.pose(self.place(name))[0]


def _rope(tree: Tree, stages: list[Stage], places: Mapping[str, Place], load: Body, driven: frozenset[str]) -> Rope:
    """Return the rope that stands for the free hinges above a load."""
    above, body = [(load, joint) for joint in reversed(load.joints)], load
    while body.parent:
        body = tree.body[body.parent]
        above += [(body, joint) for joint in reversed(body.joints)]
    slides = list(takewhile(lambda pair: pair[1].kind == "slide", above))
    hinges = list(takewhile(lambda pair: pair[1].kind != "slide" and pair[1].name not in driven, above[len(slides) :]))
    if not hinges or len(slides) > 1:
        why = f"{len(slides)} slides lie" if len(slides) > 1 else "no hinge without a drive lies"
        raise tree.fault(f"ropes: {load.name} cannot hang on a rope: {why} between it and its support")
    on_way, replaced = _below(tree, hinges[-1][0]), [joint for _, joint in (*slides, *hinges)]
    beside = [joint.name for body in on_way for joint in body.joints if joint not in replaced]
    if beside:
        raise tree.fault(f"ropes: {load.name} cannot hang on a rope of its own: the joint {beside[0]} moves beside it")
    zero = _at_zero(stages)
    anchors = [zero[k].position for k, stage in enumerate(stages) if stage.joints[0] in [joint for _, joint in hinges]]
    if max(float(np.linalg.norm(anchor - anchors[0])) for anchor in anchors) > _MEETS:
        raise tree.fault(f"ropes: the hinges above {load.name} do not meet in one point, where a rope could begin")
    top = next(k for k, stage in enumerate(stages) if stage.joints[0] is hinges[-1][1])
    place = places[load.name].moved(load.centre)
    base = zero[place.stage]
    way = base.position + base.rotation @ place.position - anchors[0]
    hoist, length, sign = "", float(np.linalg.norm(way)), 1.0
    for _, joint in slides:
        along = float(way @ (base.rotation @ joint.axis))
        if abs(abs(along) - length) > _MEETS * max(1.0, length):
            raise tree.fault(f"ropes: the slide {joint.name} does not move {load.name} along its rope")
        hoist, sign = joint.name, math.copysign(1.0, along)
        length -= sign * joint.zero
    anchor = Place(stages[top].parent, stages[top].base.position, stages[top].base.rotation)
    dropped, without = tuple(joint.name for _, joint in hinges), tuple(body.name for body in on_way)
    return Rope(anchor, hoist, length, sign, dropped, without)


def _below(tree: Tree, top: Body) -> list[Body]:
    """Return a body and all that hang on it."""
    found = [top]
    for body in tree.bodies:
        found += [body] if body.parent in [each.name for each in found] else []
    return found


def _light(tree: Tree, load: Body, driven: frozenset[str]) -> list[str]:
    """Return the bodies above a point mass, up to the next drive, whose mass is nothing beside its own."""
    found, body = list[str](), load
    while body.parent and not any(joint.name in driven and joint.kind != "slide" for joint in body.joints):
        body = tree.body[body.parent]
        found += [body.name] if body.mass < _LIGHT * load.mass else []
    return found


def rope_of(tree: Tree, body: str, driven: frozenset[str]) -> Rope | None:
    """Return the rope that can stand for the free hinges above a body; None if there is none."""
    stages, places = stages_of(tree)
    try:
        return _rope(tree, stages, places, tree.body[body], driven)
    except InvalidModel:
        return None


def _at_zero(stages: list[Stage]) -> list[Place]:
    """Return the pose of every stage in the axes of the ground, where all joints are at their zero."""
    found: list[Place] = []
    for stage in stages:
        base = stage.base
        if stage.parent >= 0:
            up = found[stage.parent]
            base = Place(-1, up.position + up.rotation @ base.position, up.rotation @ base.rotation)
        found.append(Place(-1, base.position, base.rotation))
    return found
