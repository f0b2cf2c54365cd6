"""Dynamics of a tree of rigid bodies by recursion: composite bodies for M, Newton-Euler for the inertia forces.

A `Stage` is a frame behind a hinge, a slide or a ball, with everything fixed to it as one inertia. With
q its coordinates, the frame has the pose R = R0 Rj(q), p = p0 + R0 pj(q) in its parent's axes, and in its own axes

    w = R^T w_p + W q_dot,    v = R^T (v_p + w_p x p) + V q_dot;

W q_dot has no derivative but W q_ddot, for all kinds: W = e for a hinge, and for a ball with a unit quaternion too.

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


@dataclass(eq=False)
class Stage:
    """A frame behind a joint, with its inertia.

    Attributes
    ----------
    parent : int
        Its parent stage; -1 for the ground.
    base : Place
        Pose of the joint's frame in the parent's axes.
    joint : Joint
        The joint.
    mass, moment, inertia : float, ndarray of shapes (3,) and (3, 3)
        Mass, first moment and inertia about the origin, in its axes.
    """

    parent: int
    base: Place
    joint: Joint
    mass: float = 0.0
    moment: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def require_physical(self, tree: Tree) -> None:
        """Raise `InvalidModel` if no distribution of mass has this inertia.

        Bodies that are fixed to each other are judged as one: files share inertias among them carelessly.
        """
        centre = self.moment / self.mass if self.mass > 0.0 else ZERO
        small, middle, large = np.linalg.eigvalsh(self.inertia - self.mass * _about(centre))
        if small + middle < (1.0 - _UNPHYSICAL) * large - _NEGLIGIBLE:
            body = next(body.name for body in tree.bodies if self.joint in body.joints)
            raise tree.fault(
                f"the body {body}, with all that is fixed to it, has the principal inertias {small:.4g}, {middle:.4g}"
                f" and {large:.4g} kg m2, which no distribution of mass has: the largest exceeds the sum of the others"
            )


def _about(point: Array) -> Array:
    """Return the inertia of a unit mass at a point about the origin."""
    return np.asarray(point @ point * IDENTITY - np.outer(point, point))


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
            stages.append(Stage(here.stage, here.moved(joint.anchor), joint))
            here = Place(len(stages) - 1, -joint.anchor, IDENTITY)
        places[body.name] = here
        if here.stage >= 0 and body.name not in without:
            carrier, centre = stages[here.stage], here.moved(body.centre).position
            carrier.mass += body.mass
            carrier.moment += body.mass * centre
            carrier.inertia += here.rotation @ body.inertia @ here.rotation.T + body.mass * _about(centre)
    for stage in stages:
        stage.require_physical(tree)
    return stages, places


def _cross(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return the columns a x b of a vector and a matrix."""
    return ca.mtimes(ca.sparsify(ca.skew(a)), b)


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
    def _inertias(self) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
        """Mass, first moment and inertia about the origin of every stage."""
        found = []
        for k, stage in enumerate(self.stages):
            m = ca.SX(stage.mass)
            c, J = (sparse(each, _TINY * np.abs(each).max()) for each in (stage.moment, stage.inertia))
            for place, mass in self.loads:
                if place.stage == k:
                    point = place.position
                    m, c, J = m + mass, c + mass * sparse(point), J + mass * sparse(_about(point))
            found.append((m, c, J))
        return found

    @cached_property
    def columns(self) -> Mapping[str, int]:
        """Number of every coordinate of the stages."""
        return {name: k for k, name in enumerate(self.q)}

    @cached_property
    def _local(self) -> list[tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]]:
        """R, p in the parent's axes, W, V, rates of every stage."""
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
                cross, one = ca.sparsify(ca.skew(e)), ca.SX.eye(3)
                turn = 2 * ca.horzcat(-e, w * one - cross)
                rotation = ca.mtimes(rotation, (w * w - ca.sumsqr(e)) * one + 2 * ca.mtimes(e, e.T) + 2 * w * cross)
            local.append((rotation, position, turn, slide, v))
        return local

    @cached_property
    def world(self) -> dict[int, tuple[ca.SX, ca.SX]]:
        """Rotation and position of every stage in the axes of the ground, which is stage -1."""
        found = {-1: (ca.SX.eye(3), ca.SX(3, 1))}
        for k, (stage, (R, p, *_)) in enumerate(zip(self.stages, self._local, strict=True)):
            turned, origin = found[stage.parent]
            found[k] = (ca.mtimes(turned, R), origin + ca.mtimes(turned, p))
        return found

    @cached_property
    def rates(self) -> dict[int, tuple[ca.SX, ca.SX]]:
        """Angular velocity and velocity of the origin of every stage, in its own axes; the ground is stage -1."""
        found = {-1: (ca.SX(3, 1), ca.SX(3, 1))}
        for k, (stage, (R, p, W, V, v)) in enumerate(zip(self.stages, self._local, strict=True)):
            w, u = found[stage.parent]
            found[k] = (ca.mtimes(R.T, w) + ca.mtimes(W, v), ca.mtimes(R.T, u + _cross(w, p)) + ca.mtimes(V, v))
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
            position, at = p + ca.mtimes(R, position), self.stages[at].parent
        return position

    def power(self, place: Place, force: Array, torque: Array) -> ca.SX:
        """Return the power of a unit wrench that acts at a place, both in its axes."""
        w, u = self.rates[place.stage]
        along, about = sparse(place.rotation @ force), sparse(place.rotation @ torque)
        return ca.dot(along, u + _cross(w, sparse(place.position))) + ca.dot(about, w)

    def mass(self) -> ca.SX:
        """Return M, shape (coordinates, coordinates), by composite bodies."""
        mass, rows = ca.SX(len(self.columns), len(self.columns)), self._rows
        composite = list(self._inertias)
        for i in reversed(range(len(self.stages))):
            m, c, J = composite[i]
            _, _, W, V, _ = self._local[i]
            # Momentum of the composite body for unit rates: m v + w x c and J w + c x v.
            f, n, j = m * V - _cross(c, W), ca.mtimes(J, W) + _cross(c, V), i
            while j >= 0:
                R, p, W, V, _ = self._local[j]
                block = ca.mtimes(W.T, n) + ca.mtimes(V.T, f)
                mass[rows[j], rows[i]] = block
                mass[rows[i], rows[j]] = block.T
                f, j = ca.mtimes(R, f), self.stages[j].parent
                n = ca.mtimes(R, n) + _cross(p, f)
            if (parent := self.stages[i].parent) >= 0:
                R, p, *_ = self._local[i]
                c, P, above = ca.mtimes(R, c), ca.sparsify(ca.skew(p)), composite[parent]
                C = ca.sparsify(ca.skew(c))
                J = ca.mtimes(ca.mtimes(R, J), R.T) - ca.mtimes(P, C) - ca.mtimes(C, P) - m * ca.mtimes(P, P)
                composite[parent] = above[0] + m, above[1] + c + m * p, above[2] + J
        return ca.sparsify(mass)

    def spread(self, values: Mapping[str, float]) -> ca.SX:
        """Return W^T W or V^T V times a value of every joint, shape (coordinates, coordinates).

        So armature and damping act on the rates of joints, on the angular velocity of a ball.
        """
        matrix = ca.SX(len(self.columns), len(self.columns))
        for stage, rows, (_, _, W, V, _) in zip(self.stages, self._rows, self._local, strict=True):
            if stage.joint.name in values:
                matrix[rows, rows] = values[stage.joint.name] * (ca.mtimes(W.T, W) + ca.mtimes(V.T, V))
        return ca.sparsify(matrix)

    @cached_property
    def _rows(self) -> list[list[int]]:
        """Numbers of the coordinates of every stage."""
        return [[self.columns[name] for name in stage.joint.coordinates] for stage in self.stages]

    def inertia_forces(self) -> ca.SX:
        """Return the forces quadratic in the rates, shape (coordinates,), by Newton-Euler without accelerations."""
        accelerations, wrenches = {-1: (ca.SX(3, 1), ca.SX(3, 1))}, {-1: (ca.SX(3, 1), ca.SX(3, 1))}
        for k, (stage, (R, p, W, V, v)) in enumerate(zip(self.stages, self._local, strict=True)):
            (w, _), (w_p, _), (alpha_p, a_p) = self.rates[k], self.rates[stage.parent], accelerations[stage.parent]
            carried = ca.mtimes(R.T, w_p)
            alpha = ca.mtimes(R.T, alpha_p) + _cross(carried, ca.mtimes(W, v))
            a = ca.mtimes(R.T, a_p + _cross(alpha_p, p) + _cross(w_p, _cross(w_p, p)))
            a = a + 2 * _cross(carried, ca.mtimes(V, v))
            accelerations[k] = alpha, a
            m, c, J = self._inertias[k]
            force = m * a + _cross(alpha, c) + _cross(w, _cross(w, c))
            wrenches[k] = force, ca.mtimes(J, alpha) + _cross(w, ca.mtimes(J, w)) + _cross(c, a)
        forces = ca.SX(len(self.columns), 1)
        for i in reversed(range(len(self.stages))):
            (f, n), (R, p, W, V, _), parent = wrenches[i], self._local[i], self.stages[i].parent
            forces[self._rows[i]] = ca.mtimes(W.T, n) + ca.mtimes(V.T, f)
            f, n = ca.mtimes(R, f), ca.mtimes(R, n)
            wrenches[parent] = wrenches[parent][0] + f, wrenches[parent][1] + n + _cross(p, f)
        return forces

    def weight(self, gravity: ca.SX) -> ca.SX:
        """Return the potential of gravity, J, for its acceleration in the axes of the ground, shape (3,)."""
        terms = [
            m * ca.dot(gravity, self.world[k][1]) + ca.dot(gravity, ca.mtimes(self.world[k][0], c))
            for k, (m, c, _) in enumerate(self._inertias)
        ]
        return -sum(terms, ca.SX(0))
