"""Flat systems whose momentum equations have to be combined first, in many coordinates, each with its closed form.

The idea behind all answers is Huygens': a rigid body in a plane moves like two point masses, one where the force enters
and the other at the centre of oscillation that belongs to that point. What joins them lies in the line of both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial

import casadi as ca
import numpy as np
from outside.systems import Outsider
from outside.writing import coordinates, lagrange, named

import servocore as sc
from servocore.model.generalize import generalize
from servocore.model.system import reference_symbols
from servocore.scenes import jets

GRAVITY = 9.81
UP = ca.DM([0, 1])


@dataclass(frozen=True)
class Mechanism:
    """Point masses and turning inertias as functions of coordinates, as many forces as outputs."""

    coordinates: sc.Coordinates
    masses: Sequence[tuple[float, ca.SX]]
    inertias: Sequence[tuple[float, ca.SX]]
    forces: Sequence[tuple[ca.SX, ca.SX]]
    """Where (a point or an angle) and in which direction."""
    output: ca.SX
    guess: tuple[ca.SX | ca.DM | float, ...]
    home: tuple[float, ...]
    gamma: ca.SX
    potential: ca.SX | None = None
    constraints: ca.SX = field(default_factory=lambda: ca.SX(0, 1))

    def system(self, name: str) -> sc.MechanicalSystem:
        q = self.coordinates.q
        everything = [*self.masses, *self.inertias]
        jacobians = [ca.jacobian(place, q) for _, place in everything]
        pushes = [ca.mtimes(ca.jacobian(place, q).T, direction).T for place, direction in self.forces]
        height = sum((m * place[place.numel() - 1] for m, place in self.masses), ca.SX(0))
        return sc.MechanicalSystem(
            name=name,
            coordinates=self.coordinates,
            parameters=sc.Parameters(),
            inputs=named(" ".join(f"u_{k + 1}" for k in range(len(pushes))), "N"),
            outputs=named(" ".join(f"y_{k + 1}" for k in range(len(pushes)))),
            mass=sum((m * ca.mtimes(J.T, J) for (m, _), J in zip(everything, jacobians, strict=True)), ca.SX(0)),
            output=self.output,
            input_matrix=-ca.vertcat(*pushes),
            potential=GRAVITY * height if self.potential is None else self.potential,
            constraints=self.constraints,
            gamma=self.gamma,
            guess=ca.vertcat(*self.guess),
            home=self.home,
        )


CHARTS = ("centre", "tracked", "turned", "polar", "directors", "mixed")
"""Coordinates of the aircraft; with "mixed" the outputs are x + z and x - 2 z."""

TURN = ca.DM([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
MIX = ca.DM([[1, 1], [1, -2]])


@cache
def flyer(mass: float, inertia: float, side: float, chart: str) -> sc.MechanicalSystem:
    """A planar aircraft whose torque pushes sideways by `side` N a N.m, tracked at its Huygens point.

    That point lies side inertia/mass above the centre of mass. The charts are coordinates of one aircraft.
    """
    offset = side * inertia / mass
    gamma = reference_symbols(2)
    x, z = ca.vertsplit(gamma[:, 0])
    constraints = ca.SX(0, 1)
    if chart == "directors":
        coordinates = sc.Coordinates(*named("x z d_x d_z"))
        centre, up = coordinates.q[:2], coordinates.q[2:]
        turning, constraints = up, ca.dot(up, up) - 1.0
        guess: tuple[ca.SX | ca.DM | float, ...] = (x, z, 0.0, 1.0)
    else:
        coordinates = sc.Coordinates(*named("x z"), sc.Quantity("theta", "rad"))
        place, turning = coordinates.q[:2], coordinates.q[2]
        up = ca.vertcat(-ca.sin(turning), ca.cos(turning))
        far = (place[0] + 30.0) * ca.vertcat(ca.cos(place[1]), ca.sin(place[1])) - ca.DM([30, 0])
        centres = {"tracked": place - offset * up, "turned": ca.mtimes(TURN, place), "polar": far}
        starts = {"turned": ca.mtimes(TURN.T, gamma[:, 0]), "polar": ca.vertcat(x, z / 30.0)}
        centre, guess = centres.get(chart, place), (starts.get(chart, gamma[:, 0]), 0.0)
    across = ca.vertcat(up[1], -up[0])
    tracked = centre + offset * up
    torque = ca.vertcat(side * across, -across if chart == "directors" else 1.0)
    return Mechanism(
        coordinates, [(mass, centre)], [(inertia, turning)], [(centre, up), (ca.vertcat(centre, turning), torque)],
        ca.mtimes(MIX, tracked) if chart == "mixed" else tracked, guess, (0.3, 0.2), gamma, constraints=constraints,
    ).system(f"flyer, {chart}")  # fmt: skip


def huygens_flyer(
    chart: str, mass: float = 1.5, inertia: float = 0.02, side: float = 2.0, path: sc.Reference | None = None
) -> Outsider:
    """The aircraft on a path, with its exact inputs."""

    def answer(reference: np.ndarray) -> Mapping[str, np.ndarray]:
        first, second = jets.components(reference)
        x, z = ((2 * first + second) / 3, (first - second) / 3) if chart == "mixed" else (first, second)
        lift, aside = z.d().d() + GRAVITY, -1.0 * x.d().d()
        tilt = jets.atan2(aside, lift).derivatives()
        thrust = mass * np.hypot(lift.value, aside.value) + side * inertia * tilt[1] ** 2
        return {"u_1": thrust, "u_2": inertia * tilt[2]}

    reference = path or sc.through(((0.3, 0.2), (1.5, 1.0), (3.0, 0.0), (4.0, 1.5)), duration=4.0)
    return Outsider(sc.Scene("flyer", {"body": partial(flyer, mass, inertia, side, chart)}, reference), answer)


@dataclass(frozen=True)
class Rod:
    """A rigid rod: mass, inertia about its centre, distance of that from its upper joint."""

    mass: float
    inertia: float
    centre: float

    @property
    def oscillation(self) -> float:
        """Distance of the centre of oscillation from the upper joint, where the next rod hangs."""
        return self.centre + self.inertia / (self.mass * self.centre)

    @property
    def lower(self) -> float:
        """The one of the two equivalent point masses that sits in the centre of oscillation."""
        return self.mass * self.centre / self.oscillation


RODS = (Rod(1.2, 0.05, 0.4), Rod(0.7, 0.03, 0.3), Rod(0.5, 0.01, 0.25))
CART = 3.0


def _directions(chart: str, count: int, dimension: int) -> tuple[list[sc.Quantity], ca.SX, list[ca.SX], ca.SX]:
    """Return quantities, their symbols' place holders, unit vectors along the rods and constraints."""
    axes = "xyz" if dimension == 3 else "xz"
    if "directors" in chart:
        quantities = named(" ".join(f"d_{k}{axis}" for k in range(count) for axis in axes))
    else:
        swings = "ab" if dimension == 3 else "a"
        quantities = named(" ".join(f"{swing}_{k}" for k in range(count) for swing in swings), "rad")
    symbol = ca.SX.sym("s", len(quantities))
    each = ca.vertsplit(symbol, len(quantities) // count)
    if "directors" in chart:
        return list(quantities), symbol, each, ca.vertcat(*[ca.dot(d, d) - 1.0 for d in each])
    if dimension == 2:
        return list(quantities), symbol, [ca.vertcat(ca.sin(a), -ca.cos(a)) for a in each], ca.SX(0, 1)
    cos, sin = ca.cos, ca.sin
    return list(quantities), symbol, [
        ca.vertcat(sin(s[0]) * cos(s[1]), sin(s[1]), -cos(s[0]) * cos(s[1])) for s in each
    ], ca.SX(0, 1)  # fmt: skip


@cache
def rods(count: int, chart: str, dimension: int = 2) -> sc.MechanicalSystem:
    """Rods that hang from one another at their centres of oscillation, from a cart that is driven along all axes.

    Coordinates are the place of the cart ("pivot"), of the first rod's centre, of its centre of oscillation ("tip"), or
    of the tracked point ("directors"), besides what turns; "joints" has the centres of all rods, and constraints.
    """
    gamma, chain = reference_symbols(dimension), RODS[:count]
    turning, symbol, directions, constraints = _directions(chart, count, dimension)
    axes = "xyz" if dimension == 3 else "xz"
    bodies = [f"c_{k}{axis}" for k in range(count) for axis in axes] if chart == "joints" else []
    coordinates = sc.Coordinates(*named(" ".join([*axes, *bodies])), *turning)
    place = coordinates.q[:dimension]
    own = coordinates.q[dimension : dimension * (1 + len(bodies) // dimension)]
    axis = coordinates.q[-len(turning) :]
    directions = ca.horzsplit(ca.substitute(ca.horzcat(*directions), symbol, axis))
    constraints = ca.substitute(constraints, symbol, axis)
    whole = sum((rod.oscillation * e for rod, e in zip(chain, directions, strict=True)), ca.SX.zeros(dimension))
    hanging = {"centre": chain[0].centre * directions[0], "tip": chain[0].oscillation * directions[0]}
    pivot = place - {**hanging, "directors": whole}.get(chart, ca.SX.zeros(dimension))
    joint, centres = pivot, []
    for k, (rod, direction) in enumerate(zip(chain, directions, strict=True)):
        centre = own[dimension * k : dimension * (k + 1)] if bodies else joint + rod.centre * direction
        constraints = ca.vertcat(constraints, centre - rod.centre * direction - joint) if bodies else constraints
        joint = centre + (rod.oscillation - rod.centre) * direction
        centres.append(centre)
    down = [0.0] * (dimension - 1) + [-1.0]
    still = ca.DM(down * count if "directors" in chart else [0.0] * len(turning))
    tip = gamma[:, 0]
    above = ca.Function("above", [coordinates.q], [joint - place])
    rest = ca.SX.zeros(len(coordinates.names) - len(turning) - len(bodies))
    offset = above(ca.vertcat(rest, ca.SX.zeros(len(bodies)), still)) if not bodies else None
    guess: list[ca.SX | ca.DM] = [tip - offset, still] if offset is not None else _hanging(tip, chain, still)
    return Mechanism(
        coordinates, [(CART, pivot), *((rod.mass, c) for rod, c in zip(chain, centres, strict=True))],
        [(rod.inertia, e) for rod, e in zip(chain, directions, strict=True)],
        [(pivot, axis) for axis in ca.horzsplit(ca.SX.eye(dimension))], joint, tuple(guess),
        (0.3, 0.2, -1.0)[-dimension:], gamma, constraints=constraints,
    ).system(f"{count} rods on a cart, {chart}")  # fmt: skip


def _hanging(tip: ca.SX, chain: Sequence[Rod], still: ca.DM) -> list[ca.SX | ca.DM]:
    """Return places of the cart and of the rods' centres where all hang straight down."""
    length = sum(rod.oscillation for rod in chain)
    up = ca.DM([0.0] * (tip.numel() - 1) + [1.0])
    places, above = [tip + length * up], length
    for rod in chain:
        places.append(tip + (above - rod.centre) * up)
        above -= rod.oscillation
    return [*places, still]


def hanging_rods(count: int, chart: str, dimension: int = 2) -> Outsider:
    """The rods on a path of their end, with the forces on the cart."""

    def answer(reference: np.ndarray) -> Mapping[str, np.ndarray]:
        """From below: what holds the lower point mass of a rod pulls along it, which gives the one above."""
        place = list(jets.components(reference))
        pull = [0.0 * each for each in place]
        for rod in reversed(RODS[:count]):
            pull = [a + rod.lower * b.d().d() for a, b in zip(pull, place, strict=True)]
            pull[-1] = pull[-1] + rod.lower * GRAVITY
            size = jets.sqrt(sum((a * a for a in pull[1:]), pull[0] * pull[0]))
            place = [a + rod.oscillation * b / size for a, b in zip(place, pull, strict=True)]
            upper = rod.mass - rod.lower
            pull = [a + upper * b.d().d() for a, b in zip(pull, place, strict=True)]
            pull[-1] = pull[-1] + upper * GRAVITY
        force = [a + CART * b.d().d() for a, b in zip(pull, place, strict=True)]
        force[-1] = force[-1] + CART * GRAVITY
        return {f"u_{k + 1}": each.value for k, each in enumerate(force)}

    middle, amplitude = ((0.3, -1.0), (0.4, 0.1)) if dimension == 2 else ((0.3, 0.2, -1.0), (0.4, -0.3, 0.1))
    reference = sc.periodic(middle, [list(amplitude)], [[0.2, *amplitude[1:]]], 4.0, 1)
    scene = sc.Scene("rods", {"rods": partial(rods, count, chart, dimension)}, reference)
    return Outsider(scene, answer, order=2 * count + 2)


@cache
def small_swing(chart: str) -> sc.MechanicalSystem:
    """A rod on a cart with one drive, at small angles: the output is its centre of oscillation."""
    rod = RODS[0]
    coordinates = sc.Coordinates(sc.Quantity("x", "m"), sc.Quantity("a", "rad"))
    x, a = ca.vertsplit(coordinates.q)
    pivot = x - {"pivot": 0.0, "centre": rod.centre, "tip": rod.oscillation}[chart] * a
    gamma = reference_symbols(1)
    return Mechanism(
        coordinates, [(CART, pivot), (rod.mass, pivot + rod.centre * a)], [(rod.inertia, a)], [(pivot, ca.SX(1))],
        pivot + rod.oscillation * a, (gamma[0, 0], 0.0), (0.3,), gamma,
        potential=rod.mass * GRAVITY * rod.centre * a**2 / 2,
    ).system(f"rod on a cart, {chart}")  # fmt: skip


def swinging_rod(chart: str) -> Outsider:
    """The rod on its cart, from rest to rest."""
    rod = RODS[0]

    def answer(reference: np.ndarray) -> Mapping[str, np.ndarray]:
        (y,) = jets.components(reference)
        a = y.d().d() / -GRAVITY
        pivot = y - rod.oscillation * a
        return {"u_1": ((CART + rod.mass) * pivot.d().d() + rod.mass * rod.centre * a.d().d()).value}

    reference = sc.rest_to_rest((0.3,), (1.5,), 4.0, sc.DEGREE13)
    return Outsider(sc.Scene("swinging rod", {"rod": partial(small_swing, chart)}, reference), answer)


@cache
def adjustable_flyer() -> sc.MechanicalSystem:
    """The aircraft with the height of the tracked point as a parameter, which is that of the Huygens point at first."""
    mass, inertia, side = 1.5, 0.02, 2.0
    parameters = sc.Parameters(sc.Parameter("height", side * inertia / mass, "m"))
    coordinates = sc.Coordinates(*named("x z"), sc.Quantity("theta", "rad"))
    centre, angle = coordinates.q[:2], coordinates.q[2]
    up, gamma = ca.vertcat(-ca.sin(angle), ca.cos(angle)), reference_symbols(2)
    across = ca.vertcat(up[1], -up[0])
    return sc.MechanicalSystem(
        name="adjustable flyer", coordinates=coordinates, parameters=parameters, gamma=gamma, home=(0.3, 0.2),
        inputs=(sc.Quantity("f", "N"), sc.Quantity("torque", "N.m")), outputs=named("X Z"),
        mass=ca.diag(ca.SX([mass, mass, inertia])), output=centre + parameters.p[0] * up,
        input_matrix=-ca.horzcat(ca.vertcat(up, 0), ca.vertcat(side * across, 1)).T,
        potential=mass * GRAVITY * centre[1], guess=ca.vertcat(gamma[:, 0], 0.0),
    )  # fmt: skip


def in_the_first(at: ca.SX) -> tuple[ca.SX | float, ...]:
    """Guess that the first of two coordinates is the output."""
    return at[0], 0.0


@cache
def ball_and_beam() -> sc.MechanicalSystem:
    """A ball that rolls on a beam with a drive, after Hauser, Sastry and Kokotovic (1992): r'' = r a'^2 - g sin a."""
    q = coordinates("r", "a")
    (r, a), (along, turn) = ca.vertsplit(q.q), ca.vertsplit(q.v)
    return lagrange(
        "ball and beam", q, (0.1 * along**2 + (0.02 + 0.1 * r**2) * turn**2) / 2, {"y": r}, {"u": a},
        potential=0.981 * r * ca.sin(a), guess=in_the_first, home=(0.3,),
    )  # fmt: skip


@cache
def rod_on_one_drive() -> sc.MechanicalSystem:
    """A rod on a cart that moves on a line, with the horizontal place of its centre of oscillation as output."""
    rod, q = RODS[0], coordinates("x", "a")
    (x, a), (along, turn) = ca.vertsplit(q.q), ca.vertsplit(q.v)
    coupling = rod.mass * rod.centre * ca.cos(a)
    kinetic = (CART + rod.mass) * along**2 / 2 + (rod.inertia + rod.mass * rod.centre**2) * turn**2 / 2
    return lagrange(
        "rod on one drive", q, kinetic + coupling * along * turn, {"y": x + rod.oscillation * ca.sin(a)}, {"u": x},
        potential=-GRAVITY * coupling, guess=in_the_first, home=(0.3,),
    )  # fmt: skip


@cache
def mixed_rods() -> sc.MechanicalSystem:
    """Two rods on a cart, in coordinates that are sums of all: one cancellation holds where another equation does."""
    plain, n = rods(2, "pivot"), 4
    mixing = np.eye(n) + 0.3 * np.sin(1.0 + np.arange(n * n)).reshape(n, n)
    coordinates = sc.Coordinates(*named("w_1 w_2 w_3 w_4"))
    return generalize(
        plain, coordinates, ca.mtimes(mixing, coordinates.q), guess=ca.mtimes(np.linalg.inv(mixing), plain.guess)
    )
