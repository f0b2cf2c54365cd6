"""What hangs: an aircraft with a load, cranes with two pendulums, with a boom, in polar coordinates, a robot on ropes.

The answers follow the forces up the ropes: from the path of the load to the force in its rope, to where it begins.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import casadi as ca
import numpy as np
from outside.writing import Case, coordinates, cos_sin, g, lagrange, rate, square

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.scenes import jets
from servocore.scenes.jets import Jet


def length(*components: Jet) -> Jet:
    return jets.sqrt(sum((each * each for each in components[1:]), components[0] * components[0]))


def thrust(theta: ca.SX, n: int) -> ca.SX:
    """B of a thrust along a body and a torque on it; the body's coordinates (x, z, theta) are the first of n."""
    B = ca.SX(2, n)
    B[0, 0], B[0, 1], B[1, 2] = ca.sin(theta), -ca.cos(theta), -1.0
    return B


@cache
def quadrotor(unit: float, nominal: float) -> sc.MechanicalSystem:
    """A planar aircraft with a load on a rigid cable, both in Cartesian coordinates; `unit` scales its lengths."""
    M, J, m, rope = 1.2, 0.03 * unit**2, 0.4, 0.9 * unit
    q = sc.Coordinates(
        sc.Quantity("x", "m", nominal=nominal), sc.Quantity("z", "m", nominal=nominal), sc.Quantity("theta", "rad"),
        sc.Quantity("x_L", "m", nominal=nominal), sc.Quantity("z_L", "m", nominal=nominal),
    )  # fmt: skip
    x, z, theta, x_L, z_L = ca.vertsplit(q.q)
    kinetic = (M * square(q.v[:2]) + J * q.v[2] ** 2 + m * square(q.v[3:])) / 2
    system = lagrange(
        "quadrotor", q, kinetic, {"X": x_L, "Z": z_L}, {"f": z, "torque": theta},
        potential=g * unit * (M * z + m * z_L), constraints=((x - x_L) ** 2 + (z - z_L) ** 2 - rope**2) / 2,
        guess=lambda at: (at[0], at[1] + rope, 0.0, *ca.vertsplit(at)), home=(0.2 * unit, 0.1 * unit),
    )  # fmt: skip
    return replace(system, input_matrix=thrust(theta, 5))


@cache
def quadrotor_in_generalized_coordinates(zeros: bool) -> sc.MechanicalSystem:
    """The same with the angle of the cable; `zeros` writes the zeros of the input matrix."""
    q = coordinates("x z", "theta cable")
    x, z, theta, cable = ca.vertsplit(q.q)
    load = ca.vertcat(x + 0.9 * ca.sin(cable), z - 0.9 * ca.cos(cable))
    kinetic = (1.2 * square(q.v[:2]) + 0.03 * q.v[2] ** 2 + 0.4 * square(rate(load, q))) / 2
    system = lagrange(
        "quadrotor", q, kinetic, {"X": load[0], "Z": load[1]}, {"f": x, "torque": theta},
        potential=g * (1.2 * z + 0.4 * load[1]), guess=lambda at: (at[0], at[1] + 0.9, 0.0, 0.0), home=(0.2, 0.1),
    )  # fmt: skip
    B = thrust(theta, 4)
    return replace(system, input_matrix=ca.densify(B) if zeros else B)


def quadrotor_with_a_load(
    unit: float = 1.0, nominal: float = 1.0, generalized: bool = False, zeros: bool = False
) -> Case:
    M, J, m, rope, gravity = 1.2, 0.03 * unit**2, 0.4, 0.9 * unit, g * unit

    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        x, z = jets.components(reference.jet(t, 6))
        pull = m * x.d().d(), m * (z.d().d() + gravity)
        tension = length(*pull)
        body = [p + rope * f / tension for p, f in zip((x, z), pull, strict=True)]
        fx, fz = M * body[0].d().d() + pull[0], M * (body[1].d().d() + gravity) + pull[1]
        theta = jets.atan2(-fx, fz)
        found = {"f": length(fx, fz).value, "torque": J * theta.d().d().value, "theta": theta.value}
        return found | {"x": body[0].value, "z": body[1].value}

    path = sc.rest_to_rest((0.0, 0.0), (2.0 * unit, 0.7 * unit), 3.0, sc.DEGREE13)
    model = partial(quadrotor_in_generalized_coordinates, zeros) if generalized else partial(quadrotor, unit, nominal)
    return Case(sc.Scene("quadrotor", {"cable": model}, path), exact, index=7)


@cache
def double_pendulum() -> sc.MechanicalSystem:
    """Trolley and winch, a heavy hook, and the load on a rope of its own below the hook."""
    q = coordinates("s l", "a b")
    s, paid, a, b = ca.vertsplit(q.q)
    hook = ca.vertcat(s + paid * ca.sin(a), -paid * ca.cos(a))
    load = hook + 0.6 * ca.vertcat(ca.sin(b), -ca.cos(b))
    kinetic = (30 * q.v[0] ** 2 + 8 * q.v[1] ** 2 + 5 * square(rate(hook, q)) + 12 * square(rate(load, q))) / 2
    return lagrange(
        "double pendulum crane", q, kinetic, {"X": load[0], "Z": load[1]}, {"F": s, "W": -paid},
        potential=g * (5 * hook[1] + 12 * load[1]),
        guess=lambda at: (at[0], -at[1] - 0.6, 0.0, 0.0), home=(0.5, -3.0),
    )  # fmt: skip


def double_pendulum_crane() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        x, z = jets.components(reference.jet(t, 6))
        lower = 12.0 * x.d().d(), 12.0 * (z.d().d() + g)
        tension = length(*lower)
        hook = x + 0.6 * lower[0] / tension, z + 0.6 * lower[1] / tension
        upper = 5.0 * hook[0].d().d() + lower[0], 5.0 * (hook[1].d().d() + g) + lower[1]
        s = hook[0] - hook[1] * upper[0] / upper[1]
        paid = length(s - hook[0], hook[1])
        return {
            "s": s.value, "l": paid.value, "F": (30.0 * s.d().d() + upper[0]).value,
            "W": (length(*upper) - 8.0 * paid.d().d()).value,
        }  # fmt: skip

    path = sc.rest_to_rest((0.0, -4.0), (3.0, -2.5), 4.0, sc.DEGREE13)
    return Case(sc.Scene("double_pendulum", {"ropes": double_pendulum}, path), exact, index=7)


@cache
def boom() -> sc.MechanicalSystem:
    """A boom that luffs, of 6 m and 700 kg m^2, with a winch on it; the load in Cartesian coordinates."""
    q = coordinates("l x z", "luff")
    paid, x, z, luff = ca.vertsplit(q.q)
    tip = 6.0 * ca.vertcat(ca.cos(luff), ca.sin(luff))
    return lagrange(
        "boom crane", q, (3 * q.v[0] ** 2 + 20 * square(q.v[1:3]) + 700 * q.v[3] ** 2) / 2,
        {"X": x, "Z": z}, {"W": -paid, "T": luff},
        potential=g * (20 * z + 50 * 3 * ca.sin(luff)),
        constraints=(square(tip - ca.vertcat(x, z)) - paid**2) / 2,
        guess=lambda at: (ca.sqrt(36 - at[0] ** 2) - at[1], at[0], at[1], ca.acos(at[0] / 6)), home=(4.0, 1.0),
    )  # fmt: skip


def boom_crane() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        """The tip lies on the line of the force in the rope, 6 m from the foot of the boom."""
        x, z = jets.components(reference.jet(t, 4))
        fx, fz = 20.0 * x.d().d(), 20.0 * (z.d().d() + g)
        size = length(fx, fz)
        ex, ez = fx / size, fz / size
        along = x * ex + z * ez
        paid = jets.sqrt(36.0 - (x * x + z * z) + along * along) - along
        tip = x + paid * ex, z + paid * ez
        luff = jets.atan2(tip[1], tip[0])
        torque = 700.0 * luff.d().d() + 150.0 * g / 6.0 * tip[0] + tip[0] * fz - tip[1] * fx
        return {"luff": luff.value, "l": paid.value, "W": (size - 3.0 * paid.d().d()).value, "T": torque.value}

    path = sc.rest_to_rest((5.0, 0.5), (2.5, 2.0), 4.0)
    return Case(sc.Scene("boom_crane", {"boom": boom}, path), exact, index=5)


@cache
def tower() -> sc.MechanicalSystem:
    """A tower crane in polar coordinates, the load in Cartesian ones; its outputs are radius, angle and height."""
    q = coordinates("r l x y z", "slew")
    r, paid, x, y, z, slew = ca.vertsplit(q.q)
    trolley = r * ca.vertcat(ca.cos(slew), ca.sin(slew))
    rope = ca.vertcat(trolley - ca.vertcat(x, y), -z)
    kinetic = (900 * q.v[5] ** 2 + 25 * square(rate(trolley, q)) + 6 * q.v[1] ** 2 + 40 * square(q.v[2:5])) / 2
    return lagrange(
        "tower crane", q, kinetic, {"R": ca.sqrt(x**2 + y**2), "A": ca.atan2(y, x), "Z": z},
        {"M": slew, "F": r, "W": -paid},
        potential=40 * g * z, constraints=(square(rope) - paid**2) / 2,
        guess=lambda at: (at[0], -at[2], at[0] * ca.cos(at[1]), at[0] * ca.sin(at[1]), at[2], at[1]),
        home=(5.0, 0.4, -6.0),
    )  # fmt: skip


def tower_crane() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        radius, angle, z = jets.components(reference.jet(t, 4))
        c, s = cos_sin(angle)
        x, y = radius * c, radius * s
        fx, fy, fz = 40.0 * x.d().d(), 40.0 * y.d().d(), 40.0 * (z.d().d() + g)
        tx, ty = x - z * fx / fz, y - z * fy / fz
        r, slew = length(tx, ty), jets.atan2(ty, tx)
        px, py = 25.0 * tx.d().d() + fx, 25.0 * ty.d().d() + fy
        paid = length(tx - x, ty - y, z)
        return {
            "r": r.value, "slew": slew.value, "l": paid.value, "F": ((px * tx + py * ty) / r).value,
            "M": (900.0 * slew.d().d() + tx * py - ty * px).value, "W": (length(fx, fy, fz) - 6.0 * paid.d().d()).value,
        }  # fmt: skip

    path = sc.rest_to_rest((4.0, 0.2, -7.0), (8.0, 1.7, -4.0), 6.0)
    return Case(sc.Scene("tower_crane", {"polar": tower}, path), exact, index=5)


ANCHORS = ((-2.0, -1.5, 4.0), (2.2, -1.0, 4.2), (0.1, 2.0, 3.9))
"""Where the three ropes begin, in m."""


@cache
def ropes() -> sc.MechanicalSystem:
    """A point of 7 kg on three ropes, each from a winch of its own."""
    q = coordinates("x y z l_1 l_2 l_3")
    place = q.q[:3]
    reach = [ca.norm_2(place - ca.DM(each)) for each in ANCHORS]
    return lagrange(
        "rope robot", q, (7 * square(q.v[:3]) + 2 * square(q.v[3:])) / 2, {"X": q["x"], "Y": q["y"], "Z": q["z"]},
        {f"W_{k}": -q[f"l_{k}"] for k in (1, 2, 3)},
        potential=7 * g * q["z"], constraints=ca.vertcat(*reach) - q.q[3:],
        guess=lambda at: (*ca.vertsplit(at), *(ca.norm_2(at - ca.DM(each)) for each in ANCHORS)), home=(0.1, 0.2, 1.0),
    )  # fmt: skip


def rope_robot() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        place = jets.components(reference.jet(t, 2))
        lines = [[c - p for p, c in zip(place, anchor, strict=True)] for anchor in ANCHORS]
        lengths = [length(*line) for line in lines]
        directions = np.array([[(c / paid).value for c in line] for line, paid in zip(lines, lengths, strict=True)])
        force = 7.0 * np.stack([p.derivatives()[2] for p in place], axis=-1) + np.array([0.0, 0.0, 7.0 * g])
        tensions = np.linalg.solve(np.moveaxis(directions, (0, 1), (-1, -2)), force[..., None])[..., 0]
        found = {f"l_{k + 1}": paid.value for k, paid in enumerate(lengths)}
        return found | {f"W_{k + 1}": tensions[:, k] - 2.0 * paid.derivatives()[2] for k, paid in enumerate(lengths)}

    path = sc.through([(0.0, 0.0, 1.0), (0.5, 0.3, 1.8), (-0.4, 0.5, 1.2), (0.0, 0.0, 1.0)], duration=4.0)
    return Case(sc.Scene("rope_robot", {"point": ropes}, path), exact, index=3)
