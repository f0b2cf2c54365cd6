"""Mechanisms whose energy and momentum nothing changes, for the tests of the energy-momentum scheme."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from outside.writing import coordinates, lagrange
from problems import changed

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.rotationless import GROUND, Assembly, PointMass, RigidBody, distance, prismatic, revolute, spherical

GRAVITY = 9.81


@dataclass(frozen=True)
class Motion:
    """A system, a start and what stays: its angular momentum about some axes."""

    system: sc.MechanicalSystem
    start: dict[str, float]
    axes: str = ""
    scene: sc.Scene = field(init=False)

    def __post_init__(self) -> None:
        rest = (0.0,) * len(self.system.outputs)
        scene = sc.Scene(self.system.name, {"only": lambda: self.system}, sc.rest_to_rest(rest, rest, 1.0))
        object.__setattr__(self, "scene", scene)

    def run(
        self,
        step: float,
        steps: int,
        every: int = 1,
        inputs: Callable[[float], Any] | None = None,
        **how: Any,
    ) -> sc.Solution:
        t = step * np.arange(0.0, steps + 1.0, every)
        still = lambda _: np.zeros(len(self.system.inputs))  # noqa: E731
        how = how if "rtol" in how else {"method": sc.EnergyMomentum(), "step": step} | how
        return sc.simulate(self.scene, inputs or still, t=t, start=self.start, **how)

    def drift(self, found: sc.Solution) -> tuple[float, float]:
        """Largest change of energy, beside the initial kinetic one, and of the angular momentum, beside its size."""
        energy = found["energy"] - found["work"]
        momentum = np.stack([found[f"angular_momentum_{axis}"] for axis in "xyz"])
        kept = [k for k, axis in enumerate("xyz") if axis in self.axes]
        size = np.linalg.norm(momentum[:, 0])
        moved = max((np.abs(momentum[k] - momentum[k, 0]).max() for k in kept), default=0.0)
        return float(np.abs(energy - energy[0]).max() / self.kinetic()), float(moved / size) if kept else 0.0

    def kinetic(self) -> float:
        v = np.array([self.start[f"{name}_dot"] for name in self.system.coordinates.names])
        mass = ca.Function("M", [self.system.q, self.system.p], [ca.densify(self.system.mass)])
        q = np.array([self.start[name] for name in self.system.coordinates.names])
        return float(v @ np.asarray(mass(q, self.system.parameters.values())) @ v / 2)


def started(names: tuple[str, ...] | list[str], q: Sequence[Any] | Array, v: Sequence[Any] | Array) -> dict[str, float]:
    """Values and rates by name."""
    return dict(zip(names, map(float, q), strict=True)) | {
        f"{name}_dot": float(rate) for name, rate in zip(names, v, strict=True)
    }


def turning(omega: tuple[float, float, float] | Array, directors: Array | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Directors one after the other, (9,), and their rates."""
    directors = np.eye(3) if directors is None else directors
    return directors.T.ravel(), np.cross(omega, directors.T).ravel()


def made(
    assembly: Assembly, name: str, place: ca.SX, guess: Mapping[str, Any], constraints: dict[str, ca.SX] | None = None
) -> sc.MechanicalSystem:
    """A system of parts with a push along x that nobody uses."""
    return assembly.system(
        name,
        constraints=constraints or {},
        inputs={sc.Quantity("push", "N"): place},
        outputs={sc.Quantity("X", "m"): place},
        guess=lambda _: guess,
    )


def free_body() -> Motion:
    """A body without weight that turns about its middle axis, and tumbles."""
    parts = Assembly((RigidBody("body", 3.0, (0.2, 0.5, 0.6)),), sc.Parameters(), gravity=(0, 0, 0))
    system = made(parts, "free body", parts.body("body").origin[0], {"body": ((0, 0, 0), ca.SX.eye(3))})
    d, rate = turning((0.01, 6.0, 0.01))
    return Motion(system, started(system.coordinates.names, [0, 0, 0, *d], [0, 0, 0, *rate]), "xyz")


def heavy_top() -> Motion:
    """A top on its tip that spins with 50 rad/s, leaning by 0.3 rad."""
    parts = Assembly((RigidBody("top", 1.0, (0.01, 0.01, 0.005)),), sc.Parameters(), gravity=(0, 0, -GRAVITY))
    body = parts.body("top")
    tip = {"tip": spherical(GROUND.at(), body.at((0, 0, -0.1)))}
    system = made(parts, "heavy top", body.origin[0], {"top": ((0, 0, 0.1), ca.SX.eye(3))}, tip)
    lean = np.array([[np.cos(0.3), 0, np.sin(0.3)], [0, 1, 0], [-np.sin(0.3), 0, np.cos(0.3)]])
    omega = 50.0 * lean[:, 2]
    d, rate = turning(omega, lean)
    place, speed = 0.1 * lean[:, 2], np.cross(omega, 0.1 * lean[:, 2])
    return Motion(system, started(system.coordinates.names, [*place, *d], [*speed, *rate]), "z")


def crane() -> Motion:
    """The nine-coordinate crane: bridge and trolley free, the winch on a spring, a quartic buffer for the trolley."""
    base = sc.scenes.rotary_crane(invariant=True).model()
    s, rope = base.coordinates["s"], base.coordinates["l"]
    potential = sc.Potential(base.potential + 2000.0 / 2 * (rope - 4.0) ** 2, [(lambda x: 5.0 * (x / 25.0) ** 2, s**2)])
    system = changed(base, name="crane", potential=potential)
    swing = np.array([0.5, 0.0, -np.sqrt(25.0 - 0.25)])
    q = [1, 0, 5, 0, 5, 5, *(np.array([5.0, 0, 0]) + swing)]
    omega, slide, across = 0.1, 0.2, np.array([0.0, 1.0, 0.0])
    v = [0, omega, slide, 5 * omega, slide, 0.0, *(np.array([slide, 5 * omega, 0]) + across)]
    return Motion(system, started(system.coordinates.names, q, v), "z")


def braked_crane() -> Motion:
    """The crane in bodies, 40 coordinates: the winch is braked, no angles are defined, the buffer as in `crane`."""
    parts = Assembly(
        (
            RigidBody("bridge", 60.0, (20.0, 400.0, 400.0)),
            RigidBody("trolley", 7.0, (1.0, 1.0, 1.0)),
            RigidBody("winch", 3.0, (0.5, 0.1, 0.5)),
            PointMass("load", 100.0),
            sc.Quantity("s", "m"),
        ),
        sc.Parameters(),
        gravity=(0, 0, -GRAVITY),
    )
    bridge, trolley, winch = (parts.body(each) for each in ("bridge", "trolley", "winch"))
    load, s, x, y, z = parts.point("load"), parts.augmented("s"), (1, 0, 0), (0, 1, 0), (0, 0, 1)
    rail = bridge.at(axis=x), trolley.at(axis=x)
    constraints = {
        "mast": revolute(GROUND.at(axis=z), bridge.at(axis=z)),
        "rail": prismatic(*rail),
        "shaft": revolute(trolley.at(axis=y), winch.at(axis=y)),
        "brake": ca.dot(trolley.directors[:, 0], winch.directors[:, 2]),
        "rope": distance(winch.at(), load, 5.0),
        "s": ca.dot(trolley.origin - bridge.origin, bridge.directors[:, 0]) - s,
    }
    far = (5.0, 0.0, 0.0)
    frame = ca.SX.eye(3)
    guess = {"bridge": ((0, 0, 0), frame), "trolley": (far, frame), "winch": (far, frame), "load": (5, 0, -5), "s": 5}
    system = made(parts, "braked crane", load.position[0], guess, constraints)
    buffer = sc.Potential(system.potential, [(lambda x: 5.0 * (x / 25.0) ** 2, s**2)])
    system = replace(system, potential=buffer)
    d, rate = turning((0, 0, 0.1))
    swing = np.array([0.5, 0.0, -np.sqrt(25.0 - 0.25)])
    moved, across = np.array([0.2, 0.5, 0.0]), np.array([0.0, 1.0, 0.0])  # of the trolley; of the load besides
    q = [0, 0, 0, *d, *far, *d, *far, *d, *(swing + far), 5]
    v = [0, 0, 0, *rate, *moved, *rate, *moved, *rate, *(moved + across), 0.2]
    return Motion(system, started(system.coordinates.names, q, v), "z")


def points_with(
    name: str,
    count: int,
    masses: tuple[float, float] | Array,
    constraints: Callable[..., Any],
    potential: Callable[..., Any],
    start: tuple[Array, Array],
) -> Motion:
    """Point masses in space, or in the plane if the start has no third column."""
    q, v = start
    axes = "xyz"[: np.shape(q)[1]]
    names = [f"P{k}.{axis}" for k in range(count) for axis in axes]
    of, home = coordinates(" ".join(names)), np.ravel(q).tolist()
    places = [of.q[len(axes) * k : len(axes) * (k + 1)] for k in range(count)]
    system = lagrange(
        name,
        of,
        ca.dot(np.repeat(masses, len(axes)), of.v**2) / 2,
        {"X": of.q[0]},
        {"push": of.q[0]},
        constraints=ca.vertcat(*constraints(places)),
        potential=potential(places),
        guess=lambda _: home,
        home=(float(home[0]),),
    )
    return Motion(system, started(names, home, np.ravel(v)), "xyz" if len(axes) == 3 else "")


def four_bar() -> Motion:
    """A four-bar linkage in the plane under gravity: two points, three rods of 1, 2 and 1.5 m, ground 2 m."""
    first = np.array([np.cos(1.0), np.sin(1.0)])
    ground = np.array([2.0, 0.0])
    gap = ground - first
    reach = np.linalg.norm(gap)
    along = (2.0**2 - 1.5**2 + reach**2) / (2 * reach)
    normal = np.array([-gap[1], gap[0]]) / reach
    second = first + along * gap / reach + np.sqrt(4.0 - along**2) * normal
    speed = 3.0 * np.array([-first[1], first[0]])
    rows = np.array([second - first, second - ground])
    other = np.linalg.solve(rows, [rows[0] @ speed, 0.0])
    return points_with(
        "four-bar", 2, (1.0, 1.0),
        lambda r: [ca.sumsqr(r[0]) - 1, ca.sumsqr(r[1] - r[0]) - 4, ca.sumsqr(r[1] - ca.DM(ground)) - 1.5**2],
        lambda r: GRAVITY * (r[0][1] + r[1][1]),
        (np.array([first, second]), np.array([speed, other])),
    )  # fmt: skip


def floating_loop() -> Motion:
    """Four points in space in a loop of rods of 1 m, and a stiff spring of 0.9 m across it."""
    q = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    v = np.cross([0.4, 0.3, 1.0], q - 0.5)
    v[:, 2] += [0.3, -0.3, 0.3, -0.3]
    masses = np.array([1.0, 2.0, 1.0, 0.5])
    v -= masses @ v / masses.sum()  # a hundred metres away round-off of the moment would hide what is conserved
    pairs = [(0, 1), (1, 2), (2, 3), (3, 0)]
    return points_with(
        "floating loop", 4, masses,
        lambda r: [ca.sumsqr(r[j] - r[k]) - 1 for j, k in pairs],
        lambda r: sc.Potential(0, [(lambda x: 2000.0 / 2 * (ca.sqrt(x) - 1.4) ** 2, ca.sumsqr(r[2] - r[0]))]),
        (q, v),
    )  # fmt: skip
