"""Dynamics of a tree of rigid bodies by recursion: composite bodies for M, Newton-Euler for the inertia forces.

A `Stage` is a frame behind a hinge, a slide or a ball, with everything fixed to it as one inertia. With
q its coordinates, the frame has the pose R = R0 Rj(q), p = p0 + R0 pj(q) in its parent's axes, and in its own axes the
angular velocity w and the velocity v of its origin are

    (w, v) = X (w_p, v_p) + S q_dot,    X = [R^T, 0; -R^T [p]x, R^T].

S q_dot has no derivative but S q_ddot, for all kinds: S is constant for hinges and slides, and a ball has a unit
quaternion. Wrenches (torque, force) go to the parent by X^T, and inertias are matrices of six rows.

R. Featherstone: Rigid Body Dynamics Algorithms. Springer 2008, chapters 5 and 6.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from servocore.importers.tree import GROUND, IDENTITY, ZERO, Joint, Tree
from servocore.model.rotationless.parts import turned
from servocore.numerics.compiled_calls import Array

_UNPHYSICAL = 1e-3  # relative: CAD exports round inertias to three or four digits
_NEGLIGIBLE = 1e-9  # kg m2
_TINY = 1e-14  # of the largest entry of an inertia: zero but for round-off
_ROUND_OFF = 1e-12  # of a direction or a place in m: files write pi with twelve digits


@dataclass(frozen=True, eq=False)
class Place:
    """A pose fixed to a stage; -1 is the ground. Shapes (3,), (3, 3)."""

    stage: int
    position: Array
    rotation: Array

    def moved(self, position: Array, rotation: Array = IDENTITY) -> Place:
        """Return the place with this pose in the axes of this one."""
        return Place(self.stage, self.position + self.rotation @ position, self.rotation @ rotation)

    def within(self, other: Place) -> tuple[Array, Array]:
        """Return position and rotation in the axes of another place on the same stage."""
        return other.rotation.T @ (self.position - other.position), other.rotation.T @ self.rotation

    def wrench(self, acting: Sequence[float] | Array) -> Array:
        """Return torque and force on the stage, at its origin in its axes, of force and torque in the axes of here."""
        force, torque = np.reshape(acting, (2, 3)) @ self.rotation.T
        return np.concatenate([torque + np.cross(self.position, force), force])


@dataclass(eq=False)
class Stage:
    """A frame behind a joint, with its inertia.

    Attributes
    ----------
    base : Place
        Pose of the joint's frame on its parent, a stage or the ground.
    joint : Joint
        The joint.
    inertia : ndarray, shape (6, 6)
        Inertia about the origin, first moment as a cross product, and mass, in its axes.
    """

    base: Place
    joint: Joint
    inertia: Array = field(default_factory=lambda: np.zeros((6, 6)))

    def require_physical(self, tree: Tree) -> None:
        """Raise `InvalidModel` if no distribution of mass has this inertia.

        Bodies that are fixed to each other are judged as one: files share inertias among them carelessly.
        """
        cross, mass = self.inertia[:3, 3:], self.inertia[5, 5]
        about_centre = self.inertia[:3, :3] + (cross @ cross / mass if mass > 0.0 else 0.0)
        small, middle, large = np.linalg.eigvalsh(about_centre)
        if small + middle < (1.0 - _UNPHYSICAL) * large - _NEGLIGIBLE:
            body = next(body.name for body in tree.bodies if self.joint in body.joints)
            raise tree.fault(
                f"the body {body}, with all that is fixed to it, has the principal inertias {small:.4g}, {middle:.4g}"
                f" and {large:.4g} kg m2, which no distribution of mass has: the largest exceeds the sum of the others"
            )


def _at(centre: Array, mass: float = 1.0, inertia: Array | float = 0.0) -> Array:
    """Return the inertia about the origin of a mass with this inertia about its centre, shape (6, 6)."""
    cross = np.cross(centre, IDENTITY).T
    return np.block([[inertia - mass * cross @ cross, mass * cross], [-mass * cross, mass * IDENTITY]])


def sparse(values: Array, least: float = _ROUND_OFF) -> ca.SX:
    """Return numbers as an expression without those that are smaller than the least one: round-off of zeros."""
    return ca.SX(ca.sparsify(ca.DM(values), least))


def stages_of(tree: Tree, without: Collection[str] = ()) -> tuple[list[Stage], dict[str, Place]]:
    """Return the stages of a tree, and the place of every body.

    Parameters
    ----------
    tree : Tree
        The mechanism.
    without : collection of str
        Bodies whose mass is left out, for it has coordinates of its own.

    Raises
    ------
    InvalidModel
        If the inertia of a body, with all that is fixed to it, is not physical.
    """
    stages: list[Stage] = []
    places = {GROUND: Place(-1, ZERO, IDENTITY)}
    for body in tree.bodies:
        here = places[body.parent].moved(body.position, body.rotation)
        for joint in body.joints:
            stages.append(Stage(here.moved(joint.anchor), joint))
            here = Place(len(stages) - 1, -joint.anchor, IDENTITY)
        places[body.name] = here
        if here.stage >= 0 and body.name not in without:
            centre, inertia = here.moved(body.centre).position, here.rotation @ body.inertia @ here.rotation.T
            stages[here.stage].inertia += _at(centre, body.mass, inertia)
    for stage in stages:
        stage.require_physical(tree)
    return stages, places


def _skew(vector: ca.SX) -> ca.SX:
    """Return the matrix of the cross product of a vector, without entries of zero."""
    return ca.sparsify(ca.skew(vector))


def _turned(rate: ca.SX, pair: ca.SX) -> ca.SX:
    """Return the cross products of an angular velocity and each of two vectors, shape (6,)."""
    return ca.mtimes(ca.diagcat(_skew(rate), _skew(rate)), pair)


def _moved(inertia: ca.SX, R: ca.SX, p: ca.SX) -> ca.SX:
    """Return an inertia in the axes of the parent; the mass stays as it is."""
    c, P, m = ca.mtimes(R, _moment(inertia)), _skew(p), inertia[5, 5]
    C, cross = _skew(c), _skew(c + m * p)
    J = ca.mtimes(ca.mtimes(R, inertia[:3, :3]), R.T) - ca.mtimes(P, C) - ca.mtimes(C, P) - m * ca.mtimes(P, P)
    return ca.blockcat([[J, cross], [cross.T, m * ca.SX.eye(3)]])


def _moment(inertia: ca.SX) -> ca.SX:
    """Return the first moment of an inertia, shape (3,)."""
    return ca.vertcat(inertia[2, 4], inertia[0, 5], inertia[1, 3])


@dataclass(frozen=True, eq=False)
class Motion:
    """Kinematics and dynamics of stages, for expressions of their coordinates.

    Parameters
    ----------
    stages : sequence of Stage
        Parents before children.
    q, v : mapping of str to casadi.SX
        Coordinates and their rates by name, in the order of the stages.
    loads : sequence of (Place, casadi.SX)
        Further point masses, kg.
    """

    stages: Sequence[Stage]
    q: Mapping[str, ca.SX]
    v: Mapping[str, ca.SX]
    loads: Sequence[tuple[Place, ca.SX]] = ()

    @cached_property
    def _inertias(self) -> list[ca.SX]:
        """Inertia about the origin of every stage, shape (6, 6)."""
        found = [sparse(stage.inertia, _TINY * np.abs(stage.inertia).max()) for stage in self.stages]
        for place, mass in self.loads:
            if place.stage >= 0:
                found[place.stage] += mass * sparse(_at(place.position))
        return found

    @cached_property
    def _local(self) -> list[tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]]:
        """R, p in the parent's axes, X, S, rates of every stage."""
        local = []
        for stage in self.stages:
            joint = stage.joint
            q, v = (ca.vertcat(*[values[name] for name in joint.coordinates]) for values in (self.q, self.v))
            rotation, position, axis = sparse(stage.base.rotation), sparse(stage.base.position), sparse(joint.axis)
            turn = slide = ca.SX(3, q.numel())
            if joint.kind == "slide":
                position, slide = position + ca.mtimes(rotation, axis * (q - joint.zero)), axis
            elif joint.kind == "hinge":
                turn = axis
                rotation = ca.mtimes(rotation, ca.sparsify(turned(ca.DM(axis).full().ravel(), q - joint.zero)))
            else:
                w, e = q[0], q[1:]  # R = (w^2 - e.e) 1 + 2 e e^T + 2 w [e]x, W = 2 (-e, w 1 - [e]x)
                cross, one = _skew(e), ca.SX.eye(3)
                turn = 2 * ca.horzcat(-e, w * one - cross)
                rotation = ca.mtimes(rotation, (w * w - ca.sumsqr(e)) * one + 2 * ca.mtimes(e, e.T) + 2 * w * cross)
            cross = ca.mtimes(rotation.T, _skew(position))
            X = ca.blockcat([[rotation.T, ca.SX(3, 3)], [-cross, rotation.T]])
            local.append((rotation, position, X, ca.vertcat(turn, slide), v))
        return local

    @cached_property
    def world(self) -> dict[int, tuple[ca.SX, ca.SX]]:
        """Rotation and position of every stage in the axes of the ground, which is stage -1."""
        found = {-1: (ca.SX.eye(3), ca.SX(3, 1))}
        for k, (stage, (R, p, *_)) in enumerate(zip(self.stages, self._local, strict=True)):
            turned, origin = found[stage.base.stage]
            found[k] = (ca.mtimes(turned, R), origin + ca.mtimes(turned, p))
        return found

    @cached_property
    def rates(self) -> dict[int, ca.SX]:
        """Angular velocity, velocity of the origin of every stage, in its axes, shape (6,); the ground is stage -1."""
        found = {-1: ca.SX(6, 1)}
        for k, (stage, (_, _, X, S, v)) in enumerate(zip(self.stages, self._local, strict=True)):
            found[k] = ca.mtimes(X, found[stage.base.stage]) + ca.mtimes(S, v)
        return found

    def pose(self, place: Place) -> tuple[ca.SX, ca.SX]:
        """Return rotation and position of a place in the axes of the ground."""
        R, p = self.world[place.stage]
        return ca.mtimes(R, sparse(place.rotation)), p + ca.mtimes(R, sparse(place.position))

    def seen_from(self, place: Place, stage: int) -> ca.SX:
        """Return the position of a place in the axes of a stage below it."""
        position, at = sparse(place.position), place.stage
        while at != stage:
            R, p, *_ = self._local[at]
            position, at = p + ca.mtimes(R, position), self.stages[at].base.stage
        return position

    def power(self, place: Place, acting: Array) -> ca.SX:
        """Return the power of force and torque that act at a place, in its axes, shape (6,)."""
        return ca.dot(sparse(place.wrench(acting)), self.rates[place.stage])

    def mass(self) -> ca.SX:
        """Return M, shape (coordinates, coordinates), by composite bodies."""
        mass, composite = ca.SX(len(self.q), len(self.q)), list(self._inertias)
        for i in reversed(range(len(self.stages))):
            R, p, _, S, _ = self._local[i]
            if (parent := self.stages[i].base.stage) >= 0:
                composite[parent] += _moved(composite[i], R, p)
            momentum, j = ca.mtimes(composite[i], S), i
            while j >= 0:
                _, _, X, S, _ = self._local[j]
                block = ca.mtimes(S.T, momentum)
                mass[self._rows[j], self._rows[i]] = block
                mass[self._rows[i], self._rows[j]] = block.T
                momentum, j = ca.mtimes(X.T, momentum), self.stages[j].base.stage
        return ca.sparsify(mass)

    def spread(self, what: str, without: Collection[str] = ()) -> ca.SX:
        """Return S^T S times the armature or the damping of every joint but some, shape (coordinates, coordinates).

        So armature and damping act on the rates of joints, on the angular velocity of a ball.
        """
        matrix = ca.SX(len(self.q), len(self.q))
        for stage, rows, (_, _, _, S, _) in zip(self.stages, self._rows, self._local, strict=True):
            if stage.joint.name not in without:
                matrix[rows, rows] = getattr(stage.joint, what) * ca.mtimes(S.T, S)
        return ca.sparsify(matrix)

    @cached_property
    def _rows(self) -> list[list[int]]:
        """Numbers of the coordinates of every stage."""
        names = list(self.q)
        return [[names.index(name) for name in stage.joint.coordinates] for stage in self.stages]

    def inertia_forces(self) -> ca.SX:
        """Return the forces quadratic in the rates, shape (coordinates,), by Newton-Euler without accelerations."""
        forces, accelerations, wrenches = ca.SX(len(self.q), 1), {-1: ca.SX(6, 1)}, {-1: ca.SX(6, 1)}
        for k, inertia in enumerate(self._inertias):
            (_, _, X, S, v), parent = self._local[k], self.stages[k].base.stage
            carried, turning = ca.mtimes(X[:, :3], self.rates[parent][:3]), self.rates[k][:3]
            own = ca.mtimes(S, v)
            beside = _turned(carried[:3], ca.vertcat(own[:3], carried[3:] + 2 * own[3:]))
            accelerations[k] = ca.mtimes(X, accelerations[parent]) + beside
            centrifugal = _turned(turning, ca.mtimes(inertia[:, :3], turning))
            wrenches[k] = ca.mtimes(inertia, accelerations[k]) + centrifugal
        for i in reversed(range(len(self.stages))):
            _, _, X, S, _ = self._local[i]
            forces[self._rows[i]] = ca.mtimes(S.T, wrenches[i])
            wrenches[self.stages[i].base.stage] += ca.mtimes(X.T, wrenches[i])
        return forces

    def weight(self, gravity: ca.SX) -> ca.SX:
        """Return the potential of gravity, J, for its acceleration in the axes of the ground, shape (3,)."""
        moment = ca.SX(3, 1)
        for k, inertia in enumerate(self._inertias):
            moment += inertia[5, 5] * self.world[k][1] + ca.mtimes(self.world[k][0], _moment(inertia))
        return -ca.dot(gravity, moment)
