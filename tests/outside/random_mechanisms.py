"""Planar mechanisms by chance: trees of bodies on hinges and slides, with springs, dampers, a few motors, smooth paths.

The library gets them as Lagrange's equations of an energy. `balance` says what Newton and Euler say, body by body, from
the ends of the tree to its root, and shares no line with that.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from outside.writing import g, lagrange, square

import servocore as sc


def _cross(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the moment about the normal of the plane."""
    moment: np.ndarray = x[0] * y[1] - x[1] * y[0]
    return moment


@dataclass(frozen=True)
class Body:
    """A body on its parent (-1 is the ground): a hinge, or a slide along a direction of the parent, and a spring."""

    parent: int
    slides: bool
    place: np.ndarray  # of the joint on the parent, m
    direction: float  # of the slide on the parent, rad
    centre: np.ndarray  # of mass, from the joint, m
    mass: float
    inertia: float
    stiffness: float
    damping: float


@dataclass(frozen=True)
class Mechanism:
    """Bodies, their angles and ways at home, which joints have motors, and what is to follow a path."""

    bodies: tuple[Body, ...]
    home: np.ndarray
    motors: tuple[int, ...]
    by_joints: tuple[int, ...]  # outputs; empty where the last body's centre is the output
    moves: np.ndarray  # of the outputs, in m or rad
    duration: float

    @classmethod
    def by_chance(cls, seed: int) -> Mechanism:
        r = np.random.default_rng(seed)
        n = int(r.integers(1, 5))
        bodies = tuple(
            Body(
                parent=k - 1 if r.random() < 0.75 else int(r.integers(-1, k)),
                slides=bool(r.random() < 0.3), place=r.uniform(-0.6, 0.6, 2),
                direction=r.uniform(-np.pi, np.pi), centre=r.uniform(-0.5, 0.5, 2), mass=r.uniform(0.3, 4.0),
                inertia=r.uniform(0.01, 0.4), stiffness=float(r.choice([0.0, 0.0, r.uniform(5.0, 400.0)])),
                damping=float(r.choice([0.0, r.uniform(0.1, 4.0)])),
            )
            for k in range(n)
        )  # fmt: skip
        m = int(r.integers(1, n + 1))
        motors = tuple(sorted(int(k) for k in r.choice(n, m, replace=False)))
        if m == 2 and r.random() < 0.4:
            outputs: tuple[int, ...] = ()
        else:
            outputs = motors if r.random() < 0.4 else tuple(sorted(int(k) for k in r.choice(n, m, replace=False)))
        return cls(bodies, r.uniform(-0.8, 0.8, n), motors, outputs, r.uniform(-0.3, 0.3, m), r.uniform(0.8, 2.0))

    def scene(self) -> sc.Scene:
        """The mechanism as a user would write it."""
        n, bodies = len(self.bodies), self.bodies
        q = sc.Coordinates(*(sc.Quantity(f"q_{k}", "m" if body.slides else "rad") for k, body in enumerate(bodies)))
        angle, origin, kinetic, potential = {-1: ca.SX(0)}, {-1: ca.SX.zeros(2)}, ca.SX(0), ca.SX(0)
        centre = ca.SX.zeros(2)
        for k, body in enumerate(bodies):
            turn = _turn(angle[body.parent])
            place = ca.SX(ca.DM(body.place))
            if body.slides:
                place = place + q.q[k] * ca.DM([np.cos(body.direction), np.sin(body.direction)])
            origin[k] = origin[body.parent] + turn @ place
            angle[k] = angle[body.parent] + (0 if body.slides else q.q[k])
            centre = origin[k] + _turn(angle[k]) @ ca.DM(body.centre)
            velocity, spin = ca.jtimes(centre, q.q, q.v), ca.jtimes(angle[k], q.q, q.v)
            kinetic += (body.mass * square(velocity) + body.inertia * spin**2) / 2
            potential += body.mass * g * centre[1] + body.stiffness * (q.q[k] - self.home[k]) ** 2 / 2
        outputs = {f"y_{k}": q.q[k] for k in self.by_joints} or {"X": centre[0], "Z": centre[1]}
        value = ca.Function("output", [q.q], [ca.vertcat(*outputs.values())])
        at_home = np.asarray(value(self.home)).ravel()
        system = lagrange(
            "mechanism", q, kinetic, outputs, {f"u_{k}": q.q[k] for k in self.motors}, potential=potential,
            damping=sum((body.damping * q.v[k] ** 2 / 2 for k, body in enumerate(bodies)), ca.SX(0)),
            guess=lambda _: list(self.home), home=tuple(at_home + 0.3 * self.moves),
            observables={sc.Quantity(f"v_{k}", "1/s"): q.v[k] for k in range(n)},
        )  # fmt: skip
        path = sc.rest_to_rest(tuple(at_home), tuple(at_home + self.moves), self.duration, sc.DEGREE13)
        return sc.Scene("mechanism", {"tree": lambda: system}, path)

    def balance(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the motors of all joints would have to do for a motion (n, N), and the size of the forces there."""
        zero, count = np.zeros(q.shape[1]), len(self.bodies)
        ground = (zero, zero, zero, np.zeros((2, len(zero))), np.array([zero, zero + g]))
        frames = {-1: ground}  # angle, its rate and acceleration, origin, its acceleration less gravity
        loads, sizes = [], []
        for k, body in enumerate(self.bodies):
            angle, spin, spun, origin, felt = frames[body.parent]
            place = np.outer(body.place, np.ones_like(zero))
            along = _rotated(angle, np.outer([np.cos(body.direction), np.sin(body.direction)], np.ones_like(zero)))
            arm = _rotated(angle, place) + (q[k] * along if body.slides else 0.0)
            felt = felt + spun * _left(arm) - spin**2 * arm
            if body.slides:
                felt = felt + a[k] * along + 2 * spin * v[k] * _left(along)
                own = angle, spin, spun
            else:
                own = angle + q[k], spin + v[k], spun + a[k]
            frames[k] = (*own, origin + arm, felt)
            lever = _rotated(own[0], np.outer(body.centre, np.ones_like(zero)))
            force = body.mass * (felt + own[2] * _left(lever) - own[1] ** 2 * lever)
            loads.append((origin + arm + lever, force, body.inertia * own[2], along))
        efforts = np.zeros((count, len(zero)))
        for k, body in enumerate(self.bodies):
            for j, (centre, force, moment, _) in enumerate(loads):
                if not self._carries(k, j):
                    continue
                turning = _cross(centre - frames[k][3], force) + moment
                part = (force * loads[k][3]).sum(axis=0) if body.slides else turning
                efforts[k] += part
                sizes.append(np.abs(part).max())
            pull = body.stiffness * (q[k] - self.home[k])
            efforts[k] += pull + body.damping * v[k]
            sizes.append(np.abs(pull).max())
        return efforts, np.max(sizes)

    def _carries(self, k: int, j: int) -> bool:
        while j > k:
            j = self.bodies[j].parent
        return j == k


def _turn(angle: ca.SX) -> ca.SX:
    return ca.vertcat(ca.horzcat(ca.cos(angle), -ca.sin(angle)), ca.horzcat(ca.sin(angle), ca.cos(angle)))


def _rotated(angle: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.array([np.cos(angle) * x[0] - np.sin(angle) * x[1], np.sin(angle) * x[0] + np.cos(angle) * x[1]])


def _left(x: np.ndarray) -> np.ndarray:
    return np.array([-x[1], x[0]])
