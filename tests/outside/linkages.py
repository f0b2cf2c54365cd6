"""Arms and closed linkages: where places go, by trigonometry; what drives them, by virtual work."""

from __future__ import annotations

from functools import cache, partial

import casadi as ca
import numpy as np
from outside.writing import Case, constant, coordinates, cos_sin, g, implicit, lagrange, rate, square

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.scenes import jets
from servocore.scenes.jets import Jet


def e(angle: ca.SX) -> ca.SX:
    return ca.vertcat(ca.cos(angle), ca.sin(angle))


# An arm with two links on springs behind its motors.


@cache
def flexible_joints() -> sc.MechanicalSystem:
    q = coordinates("", "a b alpha beta")
    a, b, alpha, beta = ca.vertsplit(q.q)
    elbow, tip = 0.5 * e(a), 0.5 * e(a) + 0.4 * e(a + b)
    kinetic = (3 * square(rate(elbow, q)) + 2 * square(rate(tip, q)) + 0.08 * square(q.v[2:])) / 2
    return lagrange(
        "arm with flexible joints", q, kinetic, {"A": a, "B": b}, {"T_1": alpha, "T_2": beta},
        potential=g * (3 * elbow[1] + 2 * tip[1]) + 400 * (alpha - a) ** 2 / 2 + 250 * (beta - b) ** 2 / 2,
        guess=lambda at: (at[0], at[1], at[0], at[1]), home=(0.4, 0.9),
    )  # fmt: skip


def arm_with_flexible_joints() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        a, b = jets.components(reference.jet(t, 4))
        (c_1, s_1), (c_2, s_2) = cos_sin(a), cos_sin(a + b)
        places = [(0.5 * c_1, 0.5 * s_1), (0.5 * c_1 + 0.4 * c_2, 0.5 * s_1 + 0.4 * s_2)]
        forces = [(m * x.d().d(), m * (y.d().d() + g)) for m, (x, y) in zip((3.0, 2.0), places, strict=True)]
        first = sum((x * fy - y * fx for (x, y), (fx, fy) in zip(places, forces, strict=True)), 0.0 * c_1)
        second = 0.4 * (c_2 * forces[1][1] - s_2 * forces[1][0])
        alpha, beta = a + first / 400.0, b + second / 250.0
        return {
            "alpha": alpha.value, "beta": beta.value, "T_1": (0.08 * alpha.d().d() + first).value,
            "T_2": (0.08 * beta.d().d() + second).value,
        }  # fmt: skip

    path = sc.through([(0.2, 0.5), (1.0, 1.2), (0.7, 0.4), (0.2, 0.5)], duration=3.0)
    return Case(sc.Scene("flexible_joints", {"links": flexible_joints}, path), exact, index=5)


# Four bars, crank 0.2, coupler 0.5, rocker 0.4 on ground of 0.6 m, driven at the rocker.

CRANK, COUPLER, ROCKER, GROUND = 0.2, 0.5, 0.4, 0.6


@cache
def four_bars() -> sc.MechanicalSystem:
    q = coordinates("x y", "a b c")
    x, y, a, b, c = ca.vertsplit(q.q)
    pin = CRANK * e(a)
    end = ca.vertcat(GROUND, 0) + ROCKER * e(c)
    kinetic = (0.02 * q.v[2] ** 2 + 2 * square(q.v[:2]) + 0.05 * q.v[3] ** 2 + 0.06 * q.v[4] ** 2) / 2
    middle = pin + 0.5 * COUPLER * e(b) - ca.vertcat(x, y)
    closure = pin + COUPLER * e(b) - end

    def guess(at: ca.SX) -> tuple[ca.SX | float, ...]:
        diagonal = ca.vertcat(GROUND, 0) - CRANK * e(at[0])
        d = ca.norm_2(diagonal)
        b = ca.atan2(diagonal[1], diagonal[0]) + ca.acos((COUPLER**2 + d**2 - ROCKER**2) / (2 * COUPLER * d))
        end = CRANK * e(at[0]) + COUPLER * e(b)
        middle = CRANK * e(at[0]) + 0.5 * COUPLER * e(b)
        return middle[0], middle[1], at[0], b, ca.atan2(end[1], end[0] - GROUND)

    return lagrange(
        "four bars", q, kinetic, {"A": a}, {"T": c}, potential=2 * g * y,
        constraints=ca.vertcat(middle, closure), guess=guess, home=(0.9,),
    )  # fmt: skip


def four_bars_driven_at_the_rocker() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        """All places as functions of the crank's angle; the torque by the power at a unit rate of it."""
        path = reference.jet(t, 2)[:, :, 0]
        a = Jet.from_derivatives([path[:, 0], np.ones_like(t), np.zeros_like(t)])
        ca_, sa_ = cos_sin(a)
        dx, dy = GROUND - CRANK * ca_, -CRANK * sa_
        d = jets.sqrt(dx * dx + dy * dy)
        cosine = (COUPLER**2 - ROCKER**2 + d * d) / (2 * COUPLER * d)
        b = jets.atan2(dy, dx) + jets.atan2(jets.sqrt(1.0 - cosine * cosine), cosine)
        cb, sb = cos_sin(b)
        c = jets.atan2(CRANK * sa_ + COUPLER * sb, CRANK * ca_ + COUPLER * cb - GROUND)
        x, y = CRANK * ca_ + 0.5 * COUPLER * cb, CRANK * sa_ + 0.5 * COUPLER * sb
        work = 2.0 * g * y.derivatives()[1]
        for inertia, each in ((0.02, a), (2.0, x), (2.0, y), (0.05, b), (0.06, c)):
            _, first, second = each.derivatives()
            work = work + inertia * first * (first * path[:, 2] + second * path[:, 1] ** 2)
        return {"T": work / c.derivatives()[1], "b": b.value, "x": x.value, "y": y.value}

    path = sc.rest_to_rest((0.9,), (2.4,), 2.0)
    return Case(sc.Scene("four_bars", {"absolute": four_bars}, path), exact, index=3)


# Five bars with two cranks, pinned twice at every joint: half of the constraints say nothing new.


@cache
def five_bars() -> sc.MechanicalSystem:
    names = [f"{letter}_{k}" for k in range(1, 5) for letter in "xy"]
    q = coordinates(" ".join(names), "a b c d")
    places, angles = [q.q[2 * k : 2 * k + 2] for k in range(4)], ca.vertsplit(q.q[8:])
    left, right = ca.DM([-0.2, 0.0]), ca.DM([0.2, 0.0])
    halves = [0.15, 0.25, 0.15, 0.25]
    begin = [p - h * e(a) for p, h, a in zip(places, halves, angles, strict=True)]
    end = [p + h * e(a) for p, h, a in zip(places, halves, angles, strict=True)]
    pins = ca.vertcat(begin[0] - left, begin[1] - end[0], begin[2] - right, begin[3] - end[2], end[3] - end[1])
    kinetic = sum((m * square(q.v[2 * k : 2 * k + 2]) for k, m in enumerate((1.0, 0.6, 1.0, 0.6))), ca.SX(0)) / 2
    kinetic += 0.02 * square(q.v[8:]) / 2

    def guess(at: ca.SX) -> tuple[ca.SX | float, ...]:
        """Cranks outside."""
        found = []
        for base, side in ((left, 1.0), (right, -1.0)):
            reach = at - base
            d = ca.norm_2(reach)
            crank = ca.atan2(reach[1], reach[0]) + side * ca.acos((0.3**2 + d**2 - 0.5**2) / (0.6 * d))
            elbow = base + 0.3 * e(crank)
            bar = ca.atan2(at[1] - elbow[1], at[0] - elbow[0])
            found += [(base + 0.15 * e(crank), crank), ((elbow + at) / 2, bar)]
        return (*(p for p, _ in found), *(a for _, a in found))

    return lagrange(
        "five bars", q, kinetic, {"X": end[1][0], "Y": end[1][1]}, {"T_1": angles[0], "T_2": angles[2]},
        potential=g * (q["y_1"] + 0.6 * q["y_2"] + q["y_3"] + 0.6 * q["y_4"]),
        constraints=ca.vertcat(pins, ca.SX([[1, 1], [2, -1]]) @ pins[:2], 2.0 * pins[2:]),
        guess=guess, home=(0.03, 0.55),
    )  # fmt: skip


def five_bars_pinned_twice() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        path = jets.components(reference.jet(t, 2))
        torques: list[Array] = []
        found: dict[str, Array] = {}
        forces = []
        rows = []
        for base, side in ((-0.2, 1.0), (0.2, -1.0)):
            dx, dy = path[0] - base, path[1]
            d = jets.sqrt(dx * dx + dy * dy)
            cosine = (d * d + 0.3**2 - 0.5**2) / (0.6 * d)
            crank = jets.atan2(dy, dx) + side * jets.atan2(jets.sqrt(1.0 - cosine * cosine), cosine)
            c, s = cos_sin(crank)
            ex, ey = base + 0.3 * c, 0.3 * s
            bar = jets.atan2(path[1] - ey, path[0] - ex)
            rows.append((crank, bar, ex, ey))
        # Free bodies: bar k carries a force at the tip (unknown, equal and opposite) and one at its elbow.
        N = len(t)
        A, rhs = np.zeros((N, 2, 2)), np.zeros((N, 2))
        for k, (_, bar, ex, ey) in enumerate(rows):
            (cb, sb), sign = cos_sin(bar), 1.0 - 2.0 * k
            mx, my = (ex + path[0]) * 0.5, (ey + path[1]) * 0.5
            fx, fy = 0.6 * mx.derivatives()[2], 0.6 * (my.derivatives()[2] + g)
            moment = 0.02 * bar.derivatives()[2] + 0.25 * (cb.value * fy - sb.value * fx)
            A[:, k, 0], A[:, k, 1] = -sign * 0.5 * sb.value, sign * 0.5 * cb.value  # tip force about the elbow
            rhs[:, k] = moment
            forces.append((fx, fy))
        tip = np.linalg.solve(A, rhs[..., None])[..., 0]
        for k, (crank, bar, _, _) in enumerate(rows):
            sign, (c, s) = 1.0 - 2.0 * k, cos_sin(crank)
            px, py = forces[k][0] - sign * tip[:, 0], forces[k][1] - sign * tip[:, 1]  # of the crank on the bar
            own = 0.15**2 * 1.0 * crank.derivatives()[2] + 0.02 * crank.derivatives()[2] + 0.15 * c.value * g
            torques.append(own + 0.3 * (c.value * py - s.value * px))
            found |= {("a", "c")[k]: crank.value, ("b", "d")[k]: bar.value}
        return found | {"T_1": torques[0], "T_2": torques[1]}

    path = sc.periodic((0.0, 0.5), [[0.1, 0.0]], [[0.0, 0.08]], 2.0)
    return Case(sc.Scene("five_bars", {"absolute": five_bars}, path), exact, index=3)


# A platform with three coordinates on three legs, each a driven crank and a rod without mass.

BASES = [0.8 * np.array([np.cos(x), np.sin(x)]) for x in (-2.6, -0.5, 1.6)]
CORNERS = [0.25 * np.array([np.cos(x), np.sin(x)]) for x in (-2.4, -0.4, 1.7)]


@cache
def platform() -> sc.MechanicalSystem:
    q = coordinates("x y", "phi a_1 a_2 a_3")
    x, y, phi = ca.vertsplit(q.q[:3])
    turn = ca.vertcat(ca.horzcat(ca.cos(phi), -ca.sin(phi)), ca.horzcat(ca.sin(phi), ca.cos(phi)))

    def corner(k: int, x: ca.SX, y: ca.SX, turn: ca.SX) -> ca.SX:
        return ca.vertcat(x, y) + turn @ ca.DM(CORNERS[k])

    rods = [corner(k, x, y, turn) - ca.DM(BASES[k]) - 0.45 * e(q.q[3 + k]) for k in range(3)]

    def guess(at: ca.SX) -> tuple[ca.SX | float, ...]:
        turn = ca.vertcat(ca.horzcat(ca.cos(at[2]), -ca.sin(at[2])), ca.horzcat(ca.sin(at[2]), ca.cos(at[2])))
        cranks = []
        for k in range(3):
            reach = corner(k, at[0], at[1], turn) - ca.DM(BASES[k])
            d = ca.norm_2(reach)
            cranks.append(ca.atan2(reach[1], reach[0]) + ca.acos((0.45**2 + d**2 - 0.5**2) / (0.9 * d)))
        return at[0], at[1], at[2], *cranks

    return lagrange(
        "platform", q, (4 * square(q.v[:2]) + 0.09 * q.v[2] ** 2 + 0.05 * square(q.v[3:])) / 2,
        {"X": x, "Y": y, "P": phi}, {f"T_{k}": q[f"a_{k}"] for k in (1, 2, 3)},
        constraints=(ca.vertcat(*map(square, rods)) - 0.25) / 2, guess=guess, home=(0.05, 0.02, 0.1),
    )  # fmt: skip


def platform_on_three_legs() -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        x, y, phi = jets.components(reference.jet(t, 2))
        c, s = cos_sin(phi)
        A, cranks = np.zeros((len(t), 3, 3)), []
        for k, ((bx, by), (px, py)) in enumerate(zip(BASES, CORNERS, strict=True)):
            rx, ry = c * px - s * py, s * px + c * py
            dx, dy = x + rx - bx, y + ry - by
            d = jets.sqrt(dx * dx + dy * dy)
            cosine = (d * d + 0.45**2 - 0.5**2) / (0.9 * d)
            crank = jets.atan2(dy, dx) + jets.atan2(jets.sqrt(1.0 - cosine * cosine), cosine)
            cc, sc_ = cos_sin(crank)
            ux, uy = (dx - 0.45 * cc).value / 0.5, (dy - 0.45 * sc_).value / 0.5
            A[:, :, k] = np.stack([ux, uy, rx.value * uy - ry.value * ux], axis=-1)
            cranks.append((crank, 0.45 * (cc.value * uy - sc_.value * ux)))
        wrench = np.stack([4 * x.derivatives()[2], 4 * y.derivatives()[2], 0.09 * phi.derivatives()[2]], axis=-1)
        push = np.linalg.solve(A, wrench[..., None])[..., 0]
        found: dict[str, Array] = {}
        for k, (crank, lever) in enumerate(cranks):
            found |= {f"a_{k + 1}": crank.value, f"T_{k + 1}": 0.05 * crank.derivatives()[2] + lever * push[:, k]}
        return found

    path = sc.through([(0.0, 0.0, 0.0), (0.1, 0.06, 0.2), (-0.08, 0.1, -0.1), (0.0, 0.0, 0.0)], duration=3.0)
    return Case(sc.Scene("platform", {"legs": platform}, path), exact, index=3)


# A slider crank whose rod is a stiff spring: the slider follows a path, the crank drives.


@cache
def elastic_rod(rod: float, stretch: float) -> sc.MechanicalSystem:
    """Crank of 0.15 m, a massless rod with deflections of the size `stretch` in m, a slider of 2 kg."""
    stiffness = 100.0 / stretch
    q = sc.Coordinates(
        sc.Quantity("a", "rad"), sc.Quantity("b", "rad"), sc.Quantity("x", "m"),
        sc.Quantity("stretch", "m", nominal=stretch),
    )  # fmt: skip
    a, b, x, d = ca.vertsplit(q.q)
    reach = rod + d
    closure = ca.vertcat(0.15 * ca.sin(a) + reach * ca.sin(b), 0.15 * ca.cos(a) + reach * ca.cos(b) - x)

    def guess(at: ca.SX) -> tuple[ca.SX | float, ...]:
        a = ca.acos((0.15**2 + at[0] ** 2 - rod**2) / (0.3 * at[0]))
        return a, ca.atan2(-0.15 * ca.sin(a), at[0] - 0.15 * ca.cos(a)), at[0], 0.0

    return lagrange(
        "elastic slider crank", q, (0.003 * q.v[0] ** 2 + 2 * q.v[2] ** 2) / 2, {"X": x}, {"T": a},
        potential=stiffness * d**2 / 2, constraints=closure, guess=guess, home=(rod + 0.02,),
    )  # fmt: skip


@cache
def elastic_rod_in_two_coordinates(
    rod: float, stretch: float, nominal: float | None = None, order: tuple[str, ...] = ("a", "stretch"), sign: int = 1
) -> sc.MechanicalSystem:
    """The same in the crank's angle and the rod's stretch: no slider where the rod is too short to reach the rail."""
    quantities = {"a": sc.Quantity("a", "rad"), "stretch": sc.Quantity("stretch", "m", nominal=nominal)}
    q = sc.Coordinates(*(quantities[name] for name in order))
    a, d = q["a"], q["stretch"]
    x = 0.15 * ca.cos(a) + ca.sqrt((rod + sign * d) ** 2 - (0.15 * ca.sin(a)) ** 2)

    def guess(at: ca.SX) -> list[ca.SX | float]:
        start = ca.acos((0.15**2 + at[0] ** 2 - rod**2) / (0.3 * at[0]))
        return [start if name == "a" else 0.0 for name in order]

    return lagrange(
        "elastic slider crank, two coordinates", q, (0.003 * q.velocity("a") ** 2 + 2 * rate(x, q) ** 2) / 2, {"X": x},
        {"T": a}, potential=100.0 / stretch * d**2 / 2, guess=guess, home=(rod + 0.02,),
    )  # fmt: skip


def elastic_slider_crank(rod: float = 0.3, stretch: float = 1e-5, generalized: bool = False) -> Case:
    def exact(t: Array, reference: sc.Reference) -> dict[str, Array]:
        (x,) = jets.components(reference.jet(t, 4))
        force = 2.0 * x.d().d()  # of the rod on the slider
        rigid = np.arccos((0.15**2 + x.value**2 - rod**2) / (0.3 * x.value))

        def residual(a: Jet, d: Jet) -> tuple[Jet, Jet]:
            c, s = cos_sin(a)
            dx, dy, reach = x - 0.15 * c, -0.15 * s, rod + d
            # The rod pulls the slider back by its tension, along itself.
            return dx * dx + dy * dy - reach * reach, (100.0 / stretch) * d * dx + force * reach

        a, d = implicit(residual, (rigid, 0.0 * t), constant(0.0, force))
        c, s = cos_sin(a)
        # Force of the rod on the crank's pin, the opposite of what it does to the slider.
        across = force * (-0.15 * s) / (x - 0.15 * c)
        torque = 0.003 * a.d().d() - (0.15 * s * force - 0.15 * c * across)
        return {"a": a.value, "stretch": d.value, "T": torque.value}

    path = sc.rest_to_rest((rod + 0.02,), (rod + 0.1,), 0.5)
    model = partial(elastic_rod_in_two_coordinates, nominal=stretch) if generalized else elastic_rod
    return Case(sc.Scene("elastic_slider_crank", {"rod": partial(model, rod, stretch)}, path), exact, index=5)
