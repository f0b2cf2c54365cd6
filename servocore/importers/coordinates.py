"""Coordinates of an imported mechanism (joints, motors of elastic joints, point masses), and its servo outputs."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import cached_property
from itertools import dropwhile, pairwise, takewhile
from math import comb

import casadi as ca
import numpy as np

from servocore.importers.options import Options, driven_joints
from servocore.importers.recursion import Motion, Place, stages_of
from servocore.importers.tree import IDENTITY, ZERO, Body, Joint, Tendon, Tree
from servocore.model.quantity import Quantity
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.numerics.compiled_calls import Array
from servocore.numerics.components import filled

UNITS = {"hinge": ("rad", "N.m", "torque"), "slide": ("m", "N", "force"), "ball": ("1", "N.m", "torque")}
"""Unit of a coordinate, unit and name of its force."""

MOTOR = ".motor"
"""Suffix of the coordinate of a motor."""

_HALVINGS = 3
_TERMS = 11  # of the series of asin(x)/x for x below sin(pi/16): the next one is below 1e-17
_MEETS = 1e-9  # m between hinges of a rope
_LIGHT = 1e-6  # of a load: bodies of a rope, which MJCF does not let be massless


class Layout:
    """Symbols of a mechanism, and its motion as expressions of them.

    Parameters
    ----------
    tree : Tree
        The mechanism.
    options : Options
        Choices of the user.
    """

    def __init__(self, tree: Tree, options: Options) -> None:
        options.require_known(tree)
        self.tree, self.options, self.driven = tree, options, driven_joints(tree, options)
        self.ropes = {body: rope_hinges(tree, body, self.driven) for body in options.ropes}
        self.roped = {name for body, hinges in self.ropes.items() for name in _below(tree, body, hinges)}
        on_way = {name for body in options.points for name in _light(tree, tree.body[body], self.driven)} | self.roped
        self.loads = (*options.points, *options.ropes)
        self.carried = dict[str, str]()
        for body in tree.bodies:  # parents first
            if load := body.name if body.name in self.loads else "" if body.joints else self.carried.get(body.parent):
                self.carried[body.name] = load
        taut = {f"range of tendon {name}" for name in options.taut}
        self.left_out = [each for each in tree.left_out if each.partition(",")[0] not in taut]
        self.left_out += [f"inertia of {name} about its centre: it is a point mass" for name in self.loads]
        on_way = on_way.difference(self.carried)
        self.left_out += [f"mass of {name}: it is part of a rope" for name in on_way if tree.body[name].mass]
        self.locked = {*options.locked, *(joint.name for hinges in self.ropes.values() for joint in hinges)}
        self.stages, self.places = stages_of(tree, on_way.union(self.carried))
        self.joints = [stage.joint for stage in self.stages]
        self.moving = [joint for joint in self.joints if joint.name not in self.locked and not joint.mimic]
        self.coordinates = Coordinates(
            *(Quantity(name, UNITS[joint.kind][0]) for joint in self.moving for name in joint.coordinates),
            *(Quantity(f"{name}{MOTOR}", UNITS[tree.joints[name].kind][0]) for name in options.elastic),
            *(Quantity(f"{name}.{axis}", "m") for name in self.loads for axis in "xyz"),
        )
        self.q, self.v = self.coordinates.q, self.coordinates.v
        self.parameters = Parameters(*self._declared())

    def _declared(self) -> Iterator[Parameter]:
        """Yield the parameters: of elastic joints, and payloads."""
        for name, elastic in self.options.elastic.items():
            joint = self.tree.joints[name]
            per, force, _ = UNITS[joint.kind]
            inertia = "kg.m2" if joint.kind == "hinge" else "kg"
            motor = joint.armature if elastic.motor_inertia is None else elastic.motor_inertia
            yield Parameter(f"{name}.stiffness", elastic.stiffness, f"{force}/{per}", 1e-12, 1e15)
            yield Parameter(f"{name}.motor_inertia", motor, inertia, 0.0, 1e9)
            if elastic.damping:  # without any, other equations hold: the index is higher
                yield Parameter(f"{name}.spring_damping", elastic.damping, f"{force}.s/{per}", 0.0, 1e9)
        for name, mass in self.options.payload.items():
            yield Parameter(f"{name}.payload", mass, "kg", 0.0, 1e9, f"point mass at {name}")

    @cached_property
    def start(self) -> dict[str, float]:
        """Posture of all joints: as given, or zero, or the middle of limits that exclude zero.

        Loops are closed in the file where all joints are at zero.
        """
        start, given = dict[str, float](), self.options.posture
        for joint in self.joints:
            if joint.kind == "ball":
                turn = np.array([given.get(name, float(k == 0)) for k, name in enumerate(joint.coordinates)])
                if not turn.any():
                    raise self.tree.fault(f"posture: the quaternion of {joint.name} is zero")
                start |= zip(joint.coordinates, (turn / np.linalg.norm(turn)).tolist(), strict=True)
            else:
                at_zero = self.tree.closures or joint.lower <= joint.zero <= joint.upper
                usual = joint.zero if at_zero else (joint.lower + joint.upper) / 2
                start[joint.name] = float(given.get(joint.name, usual))
        return start

    @cached_property
    def _values(self) -> dict[str, ca.SX]:
        """Coordinates of all stages, affine in those that move."""
        values = {name: self.coordinates[name] for joint in self.moving for name in joint.coordinates}
        held = [name for joint in self.joints if joint.name in self.locked for name in joint.coordinates]
        values |= {name: ca.SX(self.start[name]) for name in held}
        for joint in self.joints:
            if joint.mimic:
                self._follow(joint, values, [])
        return {name: values[name] for joint in self.joints for name in joint.coordinates}

    def _follow(self, joint: Joint, values: dict[str, ca.SX], followers: list[str]) -> None:
        """Add the value of a joint that mimics another one, after that of the other one."""
        if joint.name in values:
            return
        if not joint.mimic:
            raise self.tree.fault(f"the joint {joint.name} is mimicked by others and has no coordinate of its own")
        master, factor, offset = joint.mimic
        if master in (*followers, joint.name) or master not in self.tree.joints:
            why = "itself" if master in self.tree.joints else "no joint of the file"
            raise self.tree.fault(f"the joint {joint.name} mimics {master}, which is {why}")
        self._follow(self.tree.joints[master], values, [*followers, joint.name])
        values[joint.name] = factor * values[master] + offset

    @cached_property
    def reduction(self) -> ca.SX:
        """d(coordinates of the stages)/dq, constant, shape (of the stages, n)."""
        return ca.jacobian(ca.vertcat(ca.SX(0, 1), *self._values.values()), self.q)

    @cached_property
    def motion(self) -> Motion:
        """Kinematics and dynamics of the stages."""
        rates = dict(zip(self._values, ca.vertsplit(ca.mtimes(self.reduction, self.v)), strict=True))
        beside = [name for name in self.options.payload if name not in self.carried]
        loads = [(self.place(name), self.parameters[f"{name}.payload"]) for name in beside]
        return Motion(self.stages, self._values, rates, loads)

    def place(self, name: str) -> Place:
        """Return the place of a frame; raises `InvalidModel` if there is none, or a rope has replaced its joints."""
        self.tree.above(name)
        if name in self.roped:
            load = self.carried.get(name)
            what = f"the body {load} hangs on a rope as a point mass" if load else f"the body {name} is part of a rope"
            raise self.tree.fault(f"{what}: it has no orientation")
        return self.places[name]

    def load_mass(self, load: str) -> ca.SX:
        """Return the mass of a point mass, kg: of the body, all that is fixed to it, and payloads."""
        fixed = [name for name, carrier in self.carried.items() if carrier == load]
        payloads = (self.parameters[f"{name}.payload"] for name in fixed if name in self.options.payload)
        return sum(payloads, ca.SX(sum(self.tree.body[name].mass for name in fixed)))

    def point(self, body: str) -> ca.SX:
        """Return the coordinates x, y, z of a body that is a point mass, shape (3,)."""
        first = self.coordinates.index(f"{body}.x")
        return self.coordinates.q[first : first + 3]

    def position(self, name: str) -> ca.SX:
        """Return the position of a frame, shape (3,), m; a point mass is at one place."""
        load = self.carried.get(name)
        return self.point(load) if load else self.motion.pose(self.place(name))[1]

    def length(self, tendon: Tendon) -> ca.SX:
        """Return the length of a tendon; raises `InvalidModel` where it cannot be computed."""
        if tendon.refusal:
            raise self.tree.fault(f"the tendon {tendon.name} {tendon.refusal}")
        length = sum((factor * self.motion.q[name] for name, factor in tendon.terms.items()), ca.SX(0))
        for divisor, frames in tendon.branches:
            points = [self.position(name) for name in frames]
            length += sum((ca.norm_2(b - a) for a, b in pairwise(points)), ca.SX(0)) / divisor
        return length

    def output_rows(self, names: Sequence[str], posture: Array) -> dict[Quantity, ca.SX]:
        """Return the servo outputs with their expressions.

        Parameters
        ----------
        names : sequence of str
            Joints; frames for their three coordinates; a frame with ``.x``, ``.y``, ``.z``, ``.rx``, ``.ry``, ``.rz``.
        posture : ndarray, shape (n,)
            Configuration from which rotations count.

        Raises
        ------
        InvalidModel
            If there is no joint or frame of a name.
        """
        rows = dict[Quantity, ca.SX]()
        for name in names:
            if name in self.motion.q:
                joint = next(joint for joint in self.joints if name in joint.coordinates)
                rows[Quantity(name, UNITS[joint.kind][0])] = self.motion.q[name]
                continue
            frame, _, part = name.rpartition(".")
            if part in ("rx", "ry", "rz") and name not in self.tree.body:
                vector = self._rotation_vector(frame, posture)
                rows[Quantity(name, "rad", f"rotation of {frame} from its posture")] = vector["xyz".index(part[1])]
            elif part in ("x", "y", "z") and frame and name not in self.tree.body:
                rows[Quantity(name, "m", f"position of {frame}")] = self.position(frame)["xyz".index(part)]
            else:
                for axis, place in zip("xyz", ca.vertsplit(self.position(name)), strict=True):
                    rows[Quantity(f"{name}.{axis}", "m", f"position of {name}")] = place
        return rows

    def _rotation_vector(self, frame: str, posture: Array) -> ca.SX:
        """Return the rotation vector from the orientation at the posture, base axes, shape (3,), rad.

        It is analytic at zero: the unit quaternion is halved three times, and what remains is the series of asin(x)/x.
        Rotations reach up to half a turn.
        """
        R, _ = self.motion.pose(self.place(frame))
        start = filled(ca.Function("start", [self.coordinates.q], [R])(posture))
        D = ca.mtimes(R, ca.DM(start).T)
        w = ca.sqrt(1 + ca.trace(D)) / 2
        e = ca.inv_skew(D) / (2 * w)
        for _ in range(_HALVINGS):
            w = ca.sqrt((1 + w) / 2)
            e = e / (2 * w)
        terms = [comb(2 * k, k) / 4**k / (2 * k + 1) for k in reversed(range(_TERMS))]
        series = ca.polyval(ca.DM(terms), ca.sumsqr(e))
        return e * series * 2.0 ** (_HALVINGS + 1)

    def anchor(self, body: str) -> int:
        """Return the stage at whose origin the rope of a point mass begins; raises `InvalidModel` if there is none."""
        stages = [self.joints.index(joint) for joint in self.ropes[body]]
        for stage in stages:
            apart = self.motion.seen_from(Place(stage, ZERO, IDENTITY), stages[-1])
            if not (apart.is_constant() and np.abs(np.asarray(ca.DM(apart))).max() < _MEETS):
                raise self.tree.fault(
                    f"ropes: the hinges above {body} do not meet in one point, where a rope could begin"
                )
        return stages[-1]

    def centre(self, body: str) -> Place:
        """Return the centre of mass of a body."""
        return self.places[body].moved(self.tree.body[body].centre)


def rope_hinges(tree: Tree, load: str, driven: Collection[str]) -> list[Joint]:
    """Return hinges and balls without a drive on which a load hangs, the lowest first; slides may lie below them."""
    above = [joint for body in tree.above(load) for joint in reversed(body.joints)]
    free = dropwhile(lambda joint: joint.kind == "slide", above)
    return list(takewhile(lambda joint: joint.kind != "slide" and joint.name not in driven, free))


def _below(tree: Tree, load: str, hinges: list[Joint]) -> list[str]:
    """Return the bodies that the hinges of a rope move; raises `InvalidModel` without any, or if another one moves."""
    if not hinges:
        raise tree.fault(f"ropes: {load} cannot hang on a rope: no hinge without a drive lies above it")
    found = list[str]()
    for body in tree.bodies:
        if hinges[-1] in body.joints or body.parent in found:
            found.append(body.name)
            if other := [joint.name for joint in body.joints if joint not in hinges and joint.kind != "slide"]:
                raise tree.fault(f"ropes: {body.name} cannot be part of a rope: the joint {other[0]} moves beside it")
    return found


def _light(tree: Tree, load: Body, driven: Collection[str]) -> list[str]:
    """Return the bodies above a point mass, up to the next driven hinge, whose mass is nothing beside its own."""
    way = tree.above(load.name)
    turns = [any(joint.name in driven and joint.kind != "slide" for joint in body.joints) for body in way]
    above = way[1 : turns.index(True) + 1] if True in turns else way[1:]
    return [body.name for body in above if body.mass < _LIGHT * load.mass]
