"""Masses, springs, pendulums, a satellite: what is left to integrate has a differential equation of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from outside.writing import Case, constant, coordinates, g, implicit, lagrange, rate, square
from present import present
from scipy.integrate import solve_bvp, solve_ivp

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.scenes import jets
from servocore.scenes.jets import Jet


def _rate(
    slope: Callable[..., Array], reference: sc.Reference, order: int, last: float, time: float, state: Array
) -> Array:
    """Rate of the states, with the path as it is up to `last`."""
    return slope(state, reference.jet(min(time, last), order))


def followed(
    slope: Callable[..., np.ndarray], start: list[float], t: np.ndarray, reference: sc.Reference, order: int
) -> np.ndarray:
    """States (states, N) of slope(state, path (orders, m)) by SciPy to near round-off, piece of the path by piece."""
    found, state = np.empty((len(start), len(t))), np.array(start, dtype=float)
    knots = reference.stretches
    for a, b in pairwise(knots):
        inside = (t >= a) & (t <= b)
        last = np.nextafter(b, a)  # at the knot itself the next piece would answer
        run = solve_ivp(
            partial(_rate, slope, reference, order, last),
            (a, b), state, "DOP853", rtol=1e-13, atol=1e-14, dense_output=True,
        )  # fmt: skip
        found[:, inside], state = present(run.sol)(t[inside]), run.y[:, -1]
    return found


# Chains of cars.


@cache
def chain(masses: tuple[float, ...], cubic: float, damper: float, nominal: float = 1.0) -> sc.MechanicalSystem:
    """Cars in a row, springs of 1 N/m with a cubic part and dampers between; the first is driven, the last follows."""
    n = len(masses)
    q = sc.Coordinates(*(sc.Quantity(f"x_{k}", "m", nominal=nominal) for k in range(1, n + 1)))
    stretches = [q.q[k] - q.q[k + 1] for k in range(n - 1)]
    return lagrange(
        "chain of cars", q, sum((m * v**2 for m, v in zip(masses, ca.vertsplit(q.v), strict=True)), ca.SX(0)) / 2,
        {"X": q.q[n - 1]}, {"F": q.q[0]}, potential=sum(d**2 / 2 + cubic * d**4 / 4 for d in stretches),
        damping=sum(damper * rate(d, q) ** 2 / 2 for d in stretches),
        guess=lambda at: [at[0]] * n, home=(0.3 * nominal,),
    )  # fmt: skip


def stretched(force: Jet, cubic: float) -> Jet:
    start = force.value / (1.0 + (cubic * force.value**2) ** (1 / 3))
    (d,) = implicit(lambda d: (d + cubic * d * d * d - force,), (start,), force)
    return d


def chain_of_cars(masses: tuple[float, ...], cubic: float = 3.0, unit: float = 1.0, nominal: float = 1.0) -> Case:
    """From the last car to the first: the force on it, the stretch that gives it, the car before."""

    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        (x,) = jets.components(reference.jet(t, 2 * len(masses)))
        force, found = constant(0.0, x), {}
        for k in range(len(masses), 0, -1):
            found[f"x_{k}"] = x.value
            force = force + masses[k - 1] * x.d().d()
            if k > 1:
                x = x + stretched(force, cubic / unit**2)
        return found | {"F": force.value}

    path = sc.rest_to_rest((0.0,), (2.0 * unit,), 4.0, sc.DEGREE13)
    scene = sc.Scene("chain", {"cars": partial(chain, masses, cubic / unit**2, 0.0, nominal)}, path)
    return Case(scene, exact, index=2 * len(masses) + 1, steps=400)


def two_cars_with_a_cubic_spring() -> Case:
    return chain_of_cars((1.0, 1.0))


def three_cars_with_cubic_springs() -> Case:
    """Where the force on the last car changes sign, the first is pushed 57 times as hard as at any instant."""
    case = chain_of_cars((1.0, 0.4, 2.0), cubic=0.5)
    return replace(case, warned=r"passes close to a pole: at t = 1.9995\d* s F is 4\.(39|4)\d*e\+05 N")


def two_cars_with_a_damper() -> Case:
    """The stretch d obeys c d' + d = m x'': one state, which decays."""
    m_1, m_2, c = 1.0, 2.0, 0.7

    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        x = reference.jet(t, 3)[:, :, 0].T
        (d,) = followed(lambda d, path: (m_2 * path[2] - d) / c, [0.0], t, reference, 3)
        d_1 = (m_2 * x[2] - d) / c
        d_2 = (m_2 * x[3] - d_1) / c
        return {"x_1": x[0] + d, "F": m_1 * (x[2] + d_2) + m_2 * x[2]}

    scene = sc.Scene("damped", {"cars": partial(chain, (m_1, m_2), 0.0, c)}, sc.rest_to_rest((0.0,), (2.0,), 4.0))
    return Case(scene, exact, index=4, internal=1, steps=400, tolerance=1e-9)


@cache
def maxwell() -> sc.MechanicalSystem:
    """A driven car, a spring, a node without mass, a damper, the car that follows."""
    q = coordinates("x node y")
    x, node, y = ca.vertsplit(q.q)
    return lagrange(
        "spring and damper in series", q, (3 * q.v[0] ** 2 + 2 * q.v[2] ** 2) / 2, {"Y": y}, {"F": x},
        potential=50 * (x - node) ** 2 / 2, damping=4 * rate(node - y, q) ** 2 / 2,
        guess=lambda at: [at[0]] * 3, home=(0.3,),
    )  # fmt: skip


def spring_and_damper_in_series() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        (y,) = jets.components(reference.jet(t, 4))
        node = y + 2.0 / 4.0 * y.d() - constant(2.0 / 4.0 * reference.jet(0.0, 1)[1, 0], y)
        x = node + 2.0 / 50.0 * y.d().d()
        return {"node": node.value, "x": x.value, "F": (3.0 * x.d().d() + 2.0 * y.d().d()).value}

    scene = sc.Scene("maxwell", {"cars": maxwell}, sc.rest_to_rest((0.0,), (2.0,), 4.0))
    return Case(scene, exact, index=5, internal=1, steps=400, tolerance=1e-9)


# Pendulums.


@cache
def cart(upright: bool) -> sc.MechanicalSystem:
    """A cart of 2 kg, a point of 0.5 kg on a rod of 0.7 m; its angle is zero where it hangs, or where it stands."""
    q = coordinates("x", "theta")
    x, theta = ca.vertsplit(q.q)
    side = 1.0 if upright else -1.0
    place = ca.vertcat(x + 0.7 * ca.sin(theta), side * 0.7 * ca.cos(theta))
    return lagrange(
        "cart", q, (2 * q.v[0] ** 2 + 0.5 * square(rate(place, q))) / 2, {"X": x}, {"F": x},
        potential=0.5 * g * place[1], guess=lambda at: (at[0], 0.0), home=(0.2,),
    )  # fmt: skip


def force_on_the_cart(x: np.ndarray, theta: np.ndarray, omega: np.ndarray, side: float) -> dict[str, np.ndarray]:
    alpha = (side * g * np.sin(theta) - x[2] * np.cos(theta)) / 0.7
    push = 2.5 * x[2] + 0.35 * (alpha * np.cos(theta) - omega**2 * np.sin(theta))
    return {"theta": theta, "F": push}


def cart_with_a_pendulum() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        theta, omega = followed(
            lambda s, path: np.array([s[1], -(g * np.sin(s[0]) + path[2, 0] * np.cos(s[0])) / 0.7]),
            [0.0, 0.0], t, reference, 2,
        )  # fmt: skip
        return force_on_the_cart(reference.jet(t, 2)[:, :, 0].T, theta, omega, -1.0)

    scene = sc.Scene("cart", {"hanging": partial(cart, False)}, sc.rest_to_rest((0.0,), (1.5,), 2.0))
    return Case(scene, exact, index=3, internal=2, steps=400, tolerance=1e-9)


def cart_pole() -> Case:
    """Upright: the bounded motion begins before the path and ends after it."""

    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        e = np.sqrt(g / 0.7)
        mesh = np.linspace(-5.0, 7.0, 1201)

        def slope(time: Array, s: Array) -> Array:
            x = reference.jet(time, 2)[:, 2, 0]
            return np.stack([s[1], (g * np.sin(s[0]) - x * np.cos(s[0])) / 0.7])

        found = solve_bvp(
            slope, lambda a, b: np.array([a[1] - e * a[0], b[1] + e * b[0]]), mesh, np.zeros((2, len(mesh))),
            tol=1e-9, max_nodes=200_000,
        )  # fmt: skip
        assert found.success
        theta, omega = found.sol(t)
        return force_on_the_cart(reference.jet(t, 2)[:, :, 0].T, theta, omega, 1.0)

    scene = sc.Scene("cart_pole", {"upright": partial(cart, True)}, sc.rest_to_rest((0.0,), (1.0,), 2.0))
    return Case(scene, exact, index=3, internal=2, steps=400, tolerance=1e-8)


@cache
def container() -> sc.MechanicalSystem:
    """A trolley, a winch and a container that turns with its ropes; its centre follows a path, its sway is free."""
    q = coordinates("s l", "theta")
    s, paid, theta = ca.vertsplit(q.q)
    centre = ca.vertcat(s + paid * ca.sin(theta), -paid * ca.cos(theta))
    kinetic = (20 * q.v[0] ** 2 + 5 * q.v[1] ** 2 + 30 * square(rate(centre, q)) + 12 * q.v[2] ** 2) / 2
    return lagrange(
        "container crane", q, kinetic, {"X": centre[0], "Z": centre[1]}, {"F": s, "W": -paid},
        potential=30 * g * centre[1], guess=lambda at: (at[0], -at[1], 0.0), home=(0.4, -5.0),
    )  # fmt: skip


def container_crane() -> Case:
    def slope(s: Any, path: Any) -> Array:
        (x_2, z_2), paid = path[2], -path[0, 1] / np.cos(s[0])
        return np.array([s[1], -30.0 * paid * (x_2 * np.cos(s[0]) + (z_2 + g) * np.sin(s[0])) / 12.0])

    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        x, z = np.moveaxis(reference.jet(t, 2), (2, 1), (0, 1))
        a, w = followed(slope, [0.0, 0.0], t, reference, 2)
        tan, sec = np.tan(a), 1.0 / np.cos(a)
        alpha = -30.0 * (-z[0] * sec) * (x[2] * np.cos(a) + (z[2] + g) * np.sin(a)) / 12.0
        across = z[2] * tan + 2 * z[1] * sec**2 * w + z[0] * sec**2 * (alpha + 2 * tan * w**2)  # of z tan a
        slant = z[2] * sec + 2 * z[1] * sec * tan * w + z[0] * sec * (tan * alpha + (tan**2 + sec**2) * w**2)
        push = 20.0 * (x[2] + across) + 30.0 * x[2]
        pull = 5.0 * slant - 30.0 * (x[2] * np.sin(a) - (z[2] + g) * np.cos(a))
        return {"theta": a, "s": x[0] + z[0] * tan, "F": push, "W": pull}

    path = sc.rest_to_rest((0.0, -6.0), (3.0, -4.0), 4.0)
    return Case(sc.Scene("container", {"crane": container}, path), exact, 3, 2, steps=800, tolerance=1e-8)


# A block that slides down a wedge, which is pushed; the block's way along the wedge is prescribed.

SLOPE = 0.5


@cache
def wedge() -> sc.MechanicalSystem:
    q = coordinates("X s")
    X, s = ca.vertsplit(q.q)
    block = ca.vertcat(X + s * np.cos(SLOPE), s * np.sin(SLOPE))
    return lagrange(
        "wedge", q, (4 * q.v[0] ** 2 + 1.5 * square(rate(block, q))) / 2, {"S": s}, {"F": X},
        potential=1.5 * g * block[1], guess=lambda at: (0.0, at[0]), home=(0.2,),
    )  # fmt: skip


def block_on_a_wedge() -> Case:
    """Along the wedge nothing acts but gravity: X'' cos + s'' + g sin = 0, twice integrated."""

    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        s = reference.jet(t, 2)[:, :, 0].T
        X = -(g * np.sin(SLOPE) * t**2 / 2 + s[0] - s[0][0]) / np.cos(SLOPE)
        X_2 = -(g * np.sin(SLOPE) + s[2]) / np.cos(SLOPE)
        return {"X": X, "F": 4.0 * X_2 + 1.5 * (X_2 + s[2] * np.cos(SLOPE))}

    scene = sc.Scene("wedge", {"block": wedge}, sc.rest_to_rest((0.0,), (1.0,), 2.0))
    return Case(scene, exact, index=3, internal=2, steps=400, tolerance=1e-9)


# A satellite with quaternions.

INERTIA = (3.0, 2.0, 1.2)


@cache
def quaternion() -> sc.MechanicalSystem:
    q = coordinates("e_0 e_1 e_2 e_3")
    e_0, e_1, e_2, e_3 = ca.vertsplit(q.q)
    E = ca.vertcat(ca.horzcat(-e_1, e_0, e_3, -e_2), ca.horzcat(-e_2, -e_3, e_0, e_1), ca.horzcat(-e_3, e_2, -e_1, e_0))
    omega = 2 * E @ q.v
    system = lagrange(
        "satellite", q, sum((J * w**2 for J, w in zip(INERTIA, ca.vertsplit(omega), strict=True)), ca.SX(0)) / 2,
        {"P": e_1, "Q": e_2, "R": e_3}, {"T_1": e_1, "T_2": e_2, "T_3": e_3},
        constraints=(square(q.q) - 1) / 2, guess=lambda at: (ca.sqrt(1 - square(at)), *ca.vertsplit(at)),
        home=(0.1, -0.2, 0.3),
    )  # fmt: skip
    return replace(system, input_matrix=-2 * E)


def satellite() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        e_1, e_2, e_3 = jets.components(reference.jet(t, 2))
        e_0 = jets.sqrt(1.0 - (e_1 * e_1 + e_2 * e_2 + e_3 * e_3))
        d_0, d_1, d_2, d_3 = (each.d() for each in (e_0, e_1, e_2, e_3))
        w = [
            2.0 * (e_0 * d_1 - e_1 * d_0 + e_3 * d_2 - e_2 * d_3),
            2.0 * (e_0 * d_2 - e_2 * d_0 + e_1 * d_3 - e_3 * d_1),
            2.0 * (e_0 * d_3 - e_3 * d_0 + e_2 * d_1 - e_1 * d_2),
        ]
        A, B, C = INERTIA
        return {
            "e_0": e_0.value,
            "T_1": A * w[0].d().value + (C - B) * w[1].value * w[2].value,
            "T_2": B * w[1].d().value + (A - C) * w[2].value * w[0].value,
            "T_3": C * w[2].d().value + (B - A) * w[0].value * w[1].value,
        }

    path = sc.through([(0.0, 0.0, 0.0), (0.4, -0.3, 0.2), (-0.2, 0.5, 0.4), (0.0, 0.0, 0.0)], duration=5.0)
    return Case(sc.Scene("satellite", {"quaternion": quaternion}, path), exact, index=3)
