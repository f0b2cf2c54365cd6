"""Values at the end of the test set's index-3 problems, integrated with 40 digits: what the published ones are held to.

Written from the report of the test set and apart from the library: equations of motion with their multipliers at the
level of accelerations, stepped by extrapolation of the midpoint rule (Gragg, Bulirsch, Stoer) of order 24 in mpmath.
Constraints are differentiated and never enforced: what is left of them tells how accurate the values are.

    .venv/peers/bin/python -m pip install mpmath gmpy2
    .venv/peers/bin/python -m benchmarks.ivp.references [problem ...]      (some fifteen minutes)
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import mpmath as mp

from benchmarks.ivp import REFERENCES

COLUMNS = 12  # of the extrapolation: order 24

Number: TypeAlias = Any  # an mpf; mpmath has no types
Vector = list[Number]
Equations = Callable[[Number, Vector, Vector], tuple[list[Vector], Vector, list[Vector], Vector]]
"""(t, q, v) -> M, f, G and the rest of g'', so that M a + G^T lam = f and G a = -rest."""


def m(text: str) -> Number:
    """Return a decimal number to all digits."""
    return mp.mpf(text)


def accelerations(equations: Equations, t: Number, q: Vector, v: Vector) -> tuple[Vector, Vector]:
    """Accelerations and multipliers, by elimination with pivoting."""
    M, f, G, rest = equations(t, q, v)
    n, k = len(q), len(G)
    rows = [[*M[i], *(G[j][i] for j in range(k)), f[i]] for i in range(n)]
    rows += [[*G[j], *([m("0")] * k), -rest[j]] for j in range(k)]
    size = n + k
    for c in range(size):
        sizes = [abs(rows[r][c]) for r in range(c, size)]
        best = c + sizes.index(max(sizes))
        rows[c], rows[best] = rows[best], rows[c]
        for r in range(c + 1, size):
            if rows[r][c]:
                factor = rows[r][c] / rows[c][c]
                rows[r] = [a - factor * b for a, b in zip(rows[r], rows[c], strict=True)]
    x = [m("0")] * size
    for r in reversed(range(size)):
        x[r] = (rows[r][-1] - sum(rows[r][c] * x[c] for c in range(r + 1, size))) / rows[r][r]
    return x[:n], x[n:]


def integrate(equations: Equations, q: Vector, v: Vector, end: Number, steps: int) -> tuple[Vector, Vector]:
    """Extrapolate the modified midpoint rule over equal steps."""
    n, h = len(q), end / steps
    numbers = [2 * (k + 1) for k in range(COLUMNS)]

    def slope(t: Number, y: Vector) -> Vector:
        return [*y[n:], *accelerations(equations, t, y[:n], y[n:])[0]]

    y = [*q, *v]
    for step in range(steps):
        t, first, table = step * h, slope(step * h, y), list[Vector]()
        for k, count in enumerate(numbers):
            d = h / count
            old, new = y, [a + d * b for a, b in zip(y, first, strict=True)]
            for i in range(1, count):
                rates = slope(t + i * d, new)
                old, new = new, [a + 2 * d * b for a, b in zip(old, rates, strict=True)]
            row = [new]
            for j in range(1, k + 1):
                factor = mp.mpf(count) ** 2 / mp.mpf(numbers[k - j]) ** 2 - 1
                row.append([a + (a - b) / factor for a, b in zip(row[j - 1], table[j - 1], strict=True)])
            table = row
        y = table[-1]
    return y[:n], y[n:]


def car_axis(t: Number, q: Vector, v: Vector) -> tuple[list[Vector], Vector, list[Vector], Vector]:
    """Return the equations of the car axis."""
    rest_length, bump, rate, half, gravity = m("0.5"), m("0.1"), m("10"), m("0.0005"), m("1")
    y_b, y_1, y_2 = bump * mp.sin(rate * t), bump * rate * mp.cos(rate * t), -bump * rate**2 * mp.sin(rate * t)
    x_b = mp.sqrt(1 - y_b**2)
    x_1 = -y_b * y_1 / x_b
    x_2 = -(x_1**2 + y_1**2 + y_b * y_2) / x_b
    (x_l, y_l, x_r, y_r), (u_l, w_l, u_r, w_r) = q, v
    left, right = mp.sqrt(x_l**2 + y_l**2), mp.sqrt((x_r - x_b) ** 2 + (y_r - y_b) ** 2)
    a, b = (rest_length - left) / left, (rest_length - right) / right
    f = [a * x_l, a * y_l - half * gravity, b * (x_r - x_b), b * (y_r - y_b) - half * gravity]
    dx, dy, du, dw, zero = x_l - x_r, y_l - y_r, u_l - u_r, w_l - w_r, m("0")
    G = [[x_b, y_b, zero, zero], [2 * dx, 2 * dy, -2 * dx, -2 * dy]]
    rest = [2 * (x_1 * u_l + y_1 * w_l) + x_2 * x_l + y_2 * y_l, 2 * (du**2 + dw**2)]
    return [[half if i == j else zero for j in range(4)] for i in range(4)], f, G, rest


def squeezer(_: Number, q: Vector, v: Vector) -> tuple[list[Vector], Vector, list[Vector], Vector]:
    """Return the equations of Andrews' squeezer."""
    c = {name: m(value) for name, value in SQUEEZER.items()}
    sin, cos = mp.sin, mp.cos
    be, th, ga, ph, de, om, ep = q
    bp, tp, gp, pp, dp, op, ee = v
    z, e_a, z_f = m("0"), c["e"] - c["ea"], c["zf"] - c["fa"]
    M = [[z] * 7 for _ in range(7)]
    M[0][0] = c["m1"] * c["ra"] ** 2 + c["m2"] * (c["rr"] ** 2 - 2 * c["da"] * c["rr"] * cos(th) + c["da"] ** 2)
    M[0][0] += c["i1"] + c["i2"]
    M[0][1] = M[1][0] = c["m2"] * (c["da"] ** 2 - c["da"] * c["rr"] * cos(th)) + c["i2"]
    M[1][1] = c["m2"] * c["da"] ** 2 + c["i2"]
    M[2][2] = c["m3"] * (c["sa"] ** 2 + c["sb"] ** 2) + c["i3"]
    M[3][3] = c["m4"] * e_a**2 + c["i4"]
    M[3][4] = M[4][3] = c["m4"] * (e_a**2 + c["zt"] * e_a * sin(ph)) + c["i4"]
    M[4][4] = c["m4"] * (c["zt"] ** 2 + 2 * c["zt"] * e_a * sin(ph) + e_a**2)
    M[4][4] += c["m5"] * (c["ta"] ** 2 + c["tb"] ** 2) + c["i4"] + c["i5"]
    M[5][5] = c["m6"] * z_f**2 + c["i6"]
    M[5][6] = M[6][5] = c["m6"] * (z_f**2 - c["u"] * z_f * sin(om)) + c["i6"]
    M[6][6] = c["m6"] * (z_f**2 - 2 * c["u"] * z_f * sin(om) + c["u"] ** 2)
    M[6][6] += c["m7"] * (c["ua"] ** 2 + c["ub"] ** 2) + c["i6"] + c["i7"]
    x_d = c["sd"] * cos(ga) + c["sc"] * sin(ga) + c["xb"] - c["xc"]
    y_d = c["sd"] * sin(ga) - c["sc"] * cos(ga) + c["yb"] - c["yc"]
    long = mp.sqrt(x_d**2 + y_d**2)
    force = -c["c0"] * (long - c["l0"]) / long
    f = [
        m("0.033") - c["m2"] * c["da"] * c["rr"] * tp * (tp + 2 * bp) * sin(th),
        c["m2"] * c["da"] * c["rr"] * bp**2 * sin(th),
        force * (x_d * (c["sc"] * cos(ga) - c["sd"] * sin(ga)) + y_d * (c["sd"] * cos(ga) + c["sc"] * sin(ga))),
        c["m4"] * c["zt"] * e_a * dp**2 * cos(ph),
        -c["m4"] * c["zt"] * e_a * pp * (pp + 2 * dp) * cos(ph),
        -c["m6"] * c["u"] * z_f * ee**2 * cos(om),
        c["m6"] * c["u"] * z_f * op * (op + 2 * ee) * cos(om),
    ]
    first = [-c["rr"] * sin(be) + c["d"] * sin(be + th), c["d"] * sin(be + th)]
    second = [c["rr"] * cos(be) - c["d"] * cos(be + th), -c["d"] * cos(be + th)]
    e_c, e_s, z_c, z_s = c["e"] * cos(ph + de), c["e"] * sin(ph + de), c["zf"] * cos(om + ep), c["zf"] * sin(om + ep)
    t_c, t_s, u_c, u_s = c["zt"] * cos(de), c["zt"] * sin(de), c["u"] * cos(ep), c["u"] * sin(ep)
    G = [
        [*first, -c["ss"] * cos(ga), z, z, z, z],
        [*second, -c["ss"] * sin(ga), z, z, z, z],
        [*first, z, -e_c, -e_c + t_s, z, z],
        [*second, z, -e_s, -e_s - t_c, z, z],
        [*first, z, z, z, z_s, z_s - u_c],
        [*second, z, z, z, -z_c, -z_c - u_s],
    ]
    turning, swung = (bp + tp) ** 2, (pp + dp) ** 2
    both = -c["rr"] * cos(be) * bp**2 + c["d"] * cos(be + th) * turning
    across = -c["rr"] * sin(be) * bp**2 + c["d"] * sin(be + th) * turning
    rest = [
        both + c["ss"] * sin(ga) * gp**2,
        across - c["ss"] * cos(ga) * gp**2,
        both + e_s * swung + t_c * dp**2,
        across - e_c * swung + t_s * dp**2,
        both + z_c * (op + ee) ** 2 + u_s * ee**2,
        across + z_s * (op + ee) ** 2 - u_c * ee**2,
    ]
    return M, f, G, rest


SQUEEZER = {
    "m1": ".04325", "m2": ".00365", "m3": ".02373", "m4": ".00706", "m5": ".07050", "m6": ".00706", "m7": ".05498",
    "xa": "-.06934", "ya": "-.00227", "xb": "-.03635", "yb": ".03273", "xc": ".014", "yc": ".072", "c0": "4530",
    "i1": "2.194e-6", "i2": "4.410e-7", "i3": "5.255e-6", "i4": "5.667e-7", "i5": "1.169e-5", "i6": "5.667e-7",
    "i7": "1.912e-5", "d": "28e-3", "da": "115e-4", "e": "2e-2", "ea": "1421e-5", "rr": "7e-3", "ra": "92e-5",
    "l0": "7785e-5", "ss": "35e-3", "sa": "1874e-5", "sb": "1043e-5", "sc": "18e-3", "sd": "2e-2", "ta": "2308e-5",
    "tb": "916e-5", "u": "4e-2", "ua": "1228e-5", "ub": "449e-5", "zf": "2e-2", "zt": "4e-2", "fa": "1421e-5",
}  # fmt: skip


def rod() -> dict[str, list[Vector]]:
    """Matrices of the slider crank's rod."""
    pi, width, length, density = m("3.1415927"), m("0.008"), m("0.3"), m("7870")
    mass, stiff, volume = density * width**2 * length, m("0.2e12") * width**2 / length, width**2 * length
    M, K, B = ([[m("0")] * 4 for _ in range(4)] for _ in range(3))
    for k, value in enumerate(("0.5", "0.5", "8", "2")):
        M[k][k] = mass * m(value)
    M[2][3] = M[3][2] = mass
    slender = pi**4 * (width / length) ** 2
    for k, value in enumerate((slender / 24, slender * 2 / 3, m("16") / 3, m("7") / 3)):
        K[k][k] = stiff * value
    K[2][3] = K[3][2] = -stiff * 8 / 3
    for i, j, value in ((0, 2, -16 / pi**3), (0, 3, 8 / pi**3 - 1 / pi), (1, 3, 1 / (2 * pi))):
        B[i][j], B[j][i] = volume * value, -volume * value
    z = m("0")
    vectors = [
        [z, z, volume * 2 / 3, volume / 6],
        [2 * volume / pi, z, z, z],
        [z, z, length * volume / 3, length * volume / 6],
        [length * volume / pi, -length * volume / (2 * pi), z, z],
    ]
    return {"M": M, "K": K, "B": B, "c": vectors}


def dot(a: Sequence[Number], b: Sequence[Number]) -> Number:
    """Return the sum of products."""
    return sum((x * y for x, y in zip(a, b, strict=True)), m("0"))


def crank(_: Number, q: Vector, v: Vector) -> tuple[list[Vector], Vector, list[Vector], Vector]:
    """Return the equations of the slider crank."""
    l_1, l_2, m_2, m_3, J_1, J_2, rho = map(
        m, ("0.15", "0.3", "0.151104", "0.075552", "0.002727", "0.0045339259", "7870")
    )
    c_1, c_2, c_12, c_21 = ROD["c"]
    M_q, K, B = ROD["M"], ROD["K"], ROD["B"]
    e, e_rate, w_1, w_2, z = q[3:], v[3:], v[0], v[1], m("0")
    s, c = mp.sin(q[0] - q[1]), mp.cos(q[0] - q[1])
    along, across, along_1, across_1 = dot(c_1, e), dot(c_2, e), dot(c_1, e_rate), dot(c_2, e_rate)
    half, M_e = l_1 * l_2 * m_2 / 2, [dot(row, e) for row in M_q]
    M = [[z] * 7 for _ in range(7)]
    M[0][0], M[2][2] = J_1 + m_2 * l_1**2, m_3
    M[0][1] = M[1][0] = half * c + rho * l_1 * (s * across + c * along)
    M[1][1] = J_2 + dot(e, M_e) + 2 * rho * dot(c_12, e)
    for i in range(4):
        M[0][3 + i] = M[3 + i][0] = rho * l_1 * (c * c_2[i] - s * c_1[i])
        M[1][3 + i] = M[3 + i][1] = rho * (c_21[i] + dot(e, [B[k][i] for k in range(4)]))
        for j in range(4):
            M[3 + i][3 + j] = M_q[i][j]
    f = [z] * 7
    f[0] = w_2**2 * (rho * l_1 * (c * across - s * along) - half * s)
    f[0] -= 2 * rho * l_1 * w_2 * (c * along_1 + s * across_1)
    f[1] = w_1**2 * (half * s + rho * l_1 * (s * along - c * across))
    f[1] -= 2 * w_2 * (rho * dot(c_12, e_rate) + dot(e_rate, M_e))
    for i in range(4):
        f[3 + i] = w_2**2 * (M_e[i] + rho * c_12[i]) + 2 * rho * w_2 * dot(B[i], e_rate) - dot(K[i], e)
        f[3 + i] += rho * l_1 * w_1**2 * (c * c_1[i] + s * c_2[i])
    s_1, k_1, s_2, k_2, reach = mp.sin(q[0]), mp.cos(q[0]), mp.sin(q[1]), mp.cos(q[1]), l_2 + e[3]
    G = [
        [l_1 * k_1, reach * k_2, z, z, z, z, s_2],
        [l_1 * s_1, reach * s_2, m("1"), z, z, z, -k_2],
        [m("1"), z, z, z, z, z, z],
    ]
    rest = [
        -l_1 * s_1 * w_1**2 - reach * s_2 * w_2**2 + 2 * w_2 * k_2 * e_rate[3],
        l_1 * k_1 * w_1**2 + reach * k_2 * w_2**2 + 2 * w_2 * s_2 * e_rate[3],
        z,
    ]
    return M, f, G, rest


def crank_start() -> tuple[Vector, Vector]:
    """Return the published deflections and rates; the other coordinates follow from the constraints."""
    e, e_rate = (
        tuple(map(m, ("0", "0", ".103339863e-4", ".169327969e-4"))),
        tuple(map(m, (".444896105", ".463434311e-2", "-.178591076e-5", "-.268938672e-5"))),
    )
    reach, omega, z = m("0.3") + e[3], m("150"), m("0")
    return [z, z, m("0.15") + reach, *e], [omega, -m("0.15") * omega / reach, e_rate[3], *e_rate]


def squeezer_start() -> tuple[Vector, Vector]:
    """Return the published angles, at rest."""
    texts = (
        "-0.0617138900142764496358948458001", "0", "0.455279819163070380255912382449",
        "0.222668390165885884674473185609", "0.487364979543842550225598953530", "-0.222668390165885884674473185609",
        "1.23054744454982119249735015568",
    )  # fmt: skip
    return list(map(m, texts)), [m("0")] * 7


def problems() -> dict[str, tuple[Equations, tuple[Vector, Vector], Number, int]]:
    """Equations, start, end and a number of steps that is enough for twenty digits."""
    at_rest = list(map(m, ("0", "0.5", "1", "0.5"))), list(map(m, ("-0.5", "0", "-0.5", "0")))
    return {
        "car_axis": (car_axis, at_rest, m("3"), 60),
        "squeezer": (squeezer, squeezer_start(), m("0.03"), 60),
        "slider_crank": (crank, crank_start(), m("0.1"), 700),
    }


def main(names: Sequence[str]) -> None:
    """Integrate the problems called `names`, or all, and write their values."""
    found = json.loads(REFERENCES.read_text()) if REFERENCES.exists() else {}
    for name, (equations, (q, v), end, steps) in problems().items():
        if names and name not in names:
            continue
        coarse = integrate(equations, q, v, end, steps)
        fine = integrate(equations, q, v, end, steps * 5 // 4)
        pairs = zip([*coarse[0], *coarse[1]], [*fine[0], *fine[1]], strict=True)
        change = max(abs(a - b) / abs(b) for a, b in pairs if b)
        _, lam = accelerations(equations, end, *fine)
        found[name] = {"q": [mp.nstr(x, 20) for x in fine[0]], "v": [mp.nstr(x, 20) for x in fine[1]]}
        found[name] |= {"lam": [mp.nstr(x, 20) for x in lam], "change": mp.nstr(change, 2)}
        REFERENCES.write_text(json.dumps(found, indent=1) + "\n")
        print(name, found[name])


mp.mp.dps = 40
ROD = rod()

if __name__ == "__main__":
    main(sys.argv[1:])
