"""The rotary crane and its feedback in plain NumPy: a witness of the kernel that shares no equation with it.

The crane is that of Newton and Lagrange for trolley and load as points, q = (p_x, p_y, x, y, z); the law is written
from docs/fmu.md and decisions 30, 32 and 33, whose symbols it has. Both take p = (J_b, m_t, m, J_w, r_w, g).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import comb, exp, factorial, log, sqrt

import numpy as np
from present import present

import servocore as sc
from servocore.numerics.compiled_calls import Array

CRANE = sc.scenes.rotary_crane()
DRIVES = ("M_b", "F", "M_w")
LOAD = slice(2, 5)
Flat = tuple[Array, Array]


def accelerations(x: Array, u: Array, d: Array, p: Array) -> Array:
    """Return the accelerations (5,) of trolley and load under inputs u and a force d on the load."""
    J, m_t, m, J_w, r_w, g = p
    v, place = x[5:7], x[:2]
    s = np.sqrt(place @ place)
    out, round_ = place / s, np.array([-place[1], place[0]]) / s
    rope = x[LOAD] - np.array([*place, 0.0])
    length = np.sqrt(rope @ rope)
    e, relative = rope / length, x[7:] - np.array([*v, 0.0])
    turn, roll, pay = np.array([*round_ / s, 0, 0, 0]), np.array([*out, 0, 0, 0]), np.array([*-e[:2], *e])
    s_dot, phi_dot, l_dot = out @ v, round_ @ v / s, e @ relative
    mass = np.diag([m_t, m_t, m, m, m]) + J * np.outer(turn, turn) + J_w / r_w**2 * np.outer(pay, pay)
    winding = u[2] / r_w - J_w / r_w**2 * (relative @ relative - l_dot**2) / length
    force = (u[0] + 2 * J * s_dot * phi_dot / s) * turn + u[1] * roll + winding * pay
    return np.asarray(np.linalg.solve(mass, force + np.array([0, 0, *d]) - np.array([0, 0, 0, 0, m * g])))


def rate(x: Array, u: Array, d: Array, p: Array) -> Array:
    return np.concatenate([x[5:], accelerations(x, u, d, p)])


def advance(short: bool, x: Array, u: Array, slope: Array, d: Array, p: Array, h: float) -> Array:
    """Return the state after h by the Runge-Kutta method, in one step where it is short and else in two."""
    parts = 1 if short else 2
    h /= parts
    for k in range(parts):
        begin, middle, end = (u + slope * h * (k + part) for part in (0.0, 0.5, 1.0))
        a = rate(x, begin, d, p)
        b = rate(x + h / 2 * a, middle, d, p)
        c = rate(x + h / 2 * b, middle, d, p)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, end, d, p))
    return x


def sampled(short: bool, x: Array, u: Array, d: Array, p: Array, h: float) -> tuple[Array, Array, Array]:
    """Return A, h phi_1 B, h phi_2 B of the crane linearized by complex steps; series have two powers or five."""
    tiny = 1e-30j * np.eye(13)
    given = np.concatenate([x, u])
    lower = np.array([accelerations((given + row)[:10], (given + row)[10:], d, p).imag / 1e-30 for row in tiny]).T
    X = h * np.block([[np.zeros((5, 5)), np.eye(5)], [lower[:, :10]]])
    B = np.concatenate([np.zeros((5, 3)), lower[:, 10:]])
    phi_2 = sum(np.linalg.matrix_power(X, k) / factorial(k + 2) for k in range(2 if short else 5))
    phi_1 = np.eye(10) + X @ phi_2
    return np.eye(10) + X @ phi_1, h * phi_1 @ B, h * phi_2 @ B


def continued(jet: Array, crackle: Array, tau: float) -> Array:
    """Return the jet (5, 3) of a path's Taylor polynomial so much later."""
    rows = np.concatenate([jet, [crackle]])
    return np.array([sum(rows[j] * tau ** (j - k) / factorial(j - k) for j in range(k, 6)) for k in range(5)])


def flat(jet: Array, p: Array) -> Flat:
    """Return state and inputs with which the load moves as a jet says."""
    fall = p[5] + jet[2, 2]
    lean = jet[2, :2] / fall
    lean_dot = (jet[3, :2] - lean * jet[3, 2]) / fall
    place, velocity = jet[0, :2] - jet[0, 2] * lean, jet[1, :2] - jet[1, 2] * lean - jet[0, 2] * lean_dot
    found = present(CRANE.closed_form)(jet[None], dict(zip(CRANE.parameter_values(), p, strict=True)))
    return np.concatenate([place, jet[0], velocity, jet[1]]), np.array([found[name][0] for name in DRIVES])


def seen(measured: Array) -> Array:
    """Return the state that is measured."""
    phi, s, _, phi_dot, s_dot, _ = measured[:6]
    out, round_ = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
    return np.concatenate([s * out, measured[6:9], s_dot * out + s * phi_dot * round_, measured[9:]])


def measured_of(x: Array) -> Array:
    """Return what is measured of a state."""
    place, v = x[:2], x[5:7]
    s, rope, relative = np.hypot(*place), x[LOAD] - np.array([*place, 0.0]), x[7:] - np.array([*v, 0.0])
    length = np.sqrt(rope @ rope)
    turning = (place[0] * v[1] - place[1] * v[0]) / s**2
    return np.array([np.arctan2(*place[::-1]), s, length, turning, place @ v / s, rope @ relative / length,
                     *x[LOAD], *x[7:]])  # fmt: skip


# The law -------------------------------------------------------------------------------------------------------------


@dataclass
class Offset:
    """(d/dt + a)^4 delta = 0 by y_k = (d/dt + a)^k delta, k = 0 ... 3."""

    y: Array
    a: Array

    @classmethod
    def at_start(cls, jet: Array, measured: Array, p: Array, h: float) -> Offset:
        """A rope's direction tells the load's acceleration and jerk; a takes up to half of gravity's acceleration."""
        x, fall, z, reach = seen(measured), p[5] + jet[2, 2], measured[8], 0.5 * p[5]
        lean, lean_dot = x[2:4] - x[:2], x[7:9] - x[5:7]
        acceleration = fall / z * lean
        jerk = (jet[3, 2] * lean + fall * lean_dot - x[9] * acceleration) / z
        off = np.array([x[LOAD], x[7:], [*acceleration, jet[2, 2]], [*jerk, jet[3, 2]]]) - jet[:4]
        sizes = np.maximum([comb(4, k) * np.hypot(*off[k, :2]) for k in range(4)], 1e-12)
        across = min((reach * p[5] / measured[2] / size) ** (1 / (4 - k)) for k, size in enumerate(sizes))
        down = min(sqrt(reach / max(abs(off[0, 2]), 1e-12)), reach / max(abs(off[1, 2]), 1e-12))
        a = np.minimum(0.3 / h, [across, across, down])
        return cls(
            np.array([sum(comb(k, j) * a ** (k - j) * off[j] for j in range(k + 1)) for k in range(4)]), a
        ).kept()

    def later(self, tau: float) -> Offset:
        terms = [[self.y[j] * tau ** (j - k) / factorial(j - k) for j in range(k, 4)] for k in range(4)]
        return Offset(np.array([np.exp(-self.a * tau) * sum(each) for each in terms]), self.a)

    def kept(self) -> Offset:
        return self if np.abs(self.y).max() > 1e-12 else Offset(np.zeros((4, 3)), self.a)

    def jet(self, tau: float) -> Array:
        y = self.later(tau).y
        return np.array([sum(comb(k, j) * (-self.a) ** (k - j) * y[j] for j in range(min(k, 3) + 1)) for k in range(5)])


def worth(x: Array, p: Array, h: float, strain: float) -> tuple[Array, Array]:
    """Return R of inputs worth 1 m/s2, as freely as they are used, and S of errors of the load."""
    s = np.hypot(*x[:2])
    efforts = np.array([1.5 * (p[0] / s + p[1] * s), 0.7 * p[1], (p[2] + p[3] / p[4] ** 2) * p[4]])
    weights = exp(-2.0 * strain) * np.minimum(4000.0, np.array([2.0, 2.0, 0.7]) / h**2)
    squares = np.zeros((10, 10))
    squares[LOAD, LOAD] = np.diag(weights**2)
    return np.diag(1 / efforts**2), squares


def settled(A: Array, new: Array, old: Array, R: Array, S: Array) -> Array:
    """Return the cost-to-go 2^18 steps before an end that costs nothing, by doubling."""
    effort = R + new.T @ S @ new
    F = np.linalg.solve(effort, new.T @ S)
    C, G, Q = A @ (np.eye(10) - new @ F) - old @ F, A @ new + old, S - S @ new @ F
    H = G @ np.linalg.solve(effort, G.T)
    for _ in range(18):
        reached, spread = np.hsplit(np.linalg.solve(np.eye(10) + H @ Q, np.hstack([C, H])), 2)
        C, H, Q = C @ reached, H + C @ spread @ C.T, Q + C.T @ Q @ reached
        H, Q = (H + H.T) / 2, (Q + Q.T) / 2
    return Q


def riccati(M: Array, A: Array, new: Array, old: Array, R: Array, S: Array) -> Array:
    """Return the cost of z before v is chosen: |z + B v|_S^2 + |v|_R^2, and M of A (z + B v) + B' v."""
    reach = A @ new + old
    G = new.T @ S + reach.T @ M @ A
    before = S + A.T @ M @ A - G.T @ np.linalg.solve(R + new.T @ S @ new + reach.T @ M @ reach, G)
    return (before + before.T) / 2  # what is not symmetric would grow


@dataclass
class Law:
    """The feedback for one input time, and its memory."""

    at: str
    M: Array
    offset: Offset
    force: Array = field(default_factory=lambda: np.zeros(3))
    predicted: Array = field(default_factory=lambda: np.zeros(10))
    given: Array = field(default_factory=lambda: np.zeros(3))
    snap: Array = field(default_factory=lambda: np.zeros(3))
    strain: float = 0.0
    step: float = 0.0
    longest: float = 0.0
    knew: bool = False

    @classmethod
    def begun(cls, at: str, jet: Array, measured: Array, p: Array, h: float) -> Law:
        x, u = flat(jet, p)
        A, new, old = linear(at, sampled(False, x, u, np.zeros(3), p, h))
        return cls(at, settled(A, new, old, *worth(x, p, h, 0.0)), Offset.at_start(jet, measured, p, h))

    def follow(
        self, jet: Array, before: Array, measured: Array, acting: Array, feedforward: Array, p: Array, h: float,
        share: float, limits: Array,
    ) -> Array:  # fmt: skip
        """Return the inputs of a step from those that act at its start."""
        end, goes_on, last = self.at == "end", self.step > 0.0, max(self.step, 1e-9)
        H = self.longest = max(h, self.longest - 0.02 * h)
        turn = sqrt(max(p[5] + before[2, 2], 0.0) / measured[2] * (1 + p[2] / p[1])) * H
        short, x = turn <= 0.1, seen(measured)
        self.learn(x, p, last)
        here, there, beyond, middle = self.places(jet, before, (jet[4] - self.snap) / last * goes_on, p, h)
        slope = (there[1] - here[1]) / h
        ran = (acting - self.given) / last if goes_on else slope
        after = x if end else advance(short, x, acting, ran, self.force, p, h)
        e, origin = (x - here[0], here) if end else (after - there[0], there)
        delta = advance(short, *origin, slope, self.force, p, h if end else H) - beyond
        more = self.chosen(short, middle, e, acting - here[1], delta, p, h)
        wanted = there[1] + more
        further = 0.0 if end else H / h
        slack = feedforward[2] + 0.5 * (p[5] + jet[2, 2]) * (p[2] + p[3] / p[4] ** 2) * p[4]
        wanted[2] = min(wanted[2], (slack + further * acting[2]) / (1 + further))
        found = self.within(limits, feedforward, share * (wanted - feedforward), h)
        self.predicted = advance(short, x, acting, (found - acting) / h, self.force, p, h) if end else after
        self.given, self.snap, self.step, self.knew = acting, jet[4], h, end or goes_on
        self.offset = self.offset.later(h).kept()
        return found

    def learn(self, x: Array, p: Array, last: float) -> None:
        """Correct the force on the load by what the prediction of its velocity missed."""
        still = accelerations(x, np.zeros(3), np.zeros(3), p)
        moved = np.array([accelerations(x, np.zeros(3), each, p) - still for each in np.eye(3)]).T[LOAD]
        missed = np.linalg.solve(moved, (x - self.predicted)[7:]) * self.knew
        share, most = min(1 - exp(-50.0 * last), 0.28), 0.5 * p[2] * p[5]
        self.force = np.clip(self.force + share / last * missed, -most, most)

    def places(self, jet: Array, before: Array, crackle: Array, p: Array, h: float) -> tuple[Flat, Flat, Array, Flat]:
        """Return state and inputs on the path now, a step later and in the step that is ruled, and where it ends."""
        leaning, none, H = np.zeros((5, 3)), np.zeros(3), self.longest
        leaning[2] = -self.force / p[2]
        if self.at == "end":
            first, then = before + self.offset.jet(0.0) + leaning, jet + self.offset.jet(h) + leaning
            there = flat(then, p)
            half = (continued(first, none, h / 2) + continued(then, none, -h / 2)) / 2
            return flat(first, p), there, there[0], flat(half, p)
        later = [continued(jet, crackle, tau) + self.offset.jet(tau) + leaning for tau in (0.0, h, h + H, h + H / 2)]
        here, there, beyond, middle = (flat(each, p) for each in (jet + self.offset.jet(0.0) + leaning, *later[1:]))
        return here, there, beyond[0], middle

    def chosen(self, short: bool, about: Flat, e: Array, w: Array, delta: Array, p: Array, h: float) -> Array:
        """Return the deviation of the inputs, and bring the cost-to-go up to date."""
        R, S = worth(about[0], p, self.longest, self.strain)
        A, new, old = model = linear(self.at, sampled(short, *about, self.force, p, self.longest))
        for _ in range(2):
            self.M = riccati(self.M, *model, R, S)
        share = h / self.longest if self.at == "start" else 1.0
        if self.at == "start":
            now, begun, ended = A, new + (share - 1) * (new + old), old + (1 - share) * (new + old)
        else:
            now, begun, ended = linear(self.at, sampled(short, *about, self.force, p, h))
        # where a constant push leaves the load: trolley and rates give way, and inputs
        table = np.hstack([(now - np.eye(10))[:, [0, 1, 5, 6, 7, 8, 9]], begun + ended])
        rest = np.linalg.solve(table, -delta)
        e_d, w_d = np.concatenate([rest[:2], np.zeros(3), rest[2:7]]), rest[7:]
        w = w - w_d
        z, reach = now @ (e - e_d) + ended @ w, A @ begun + share * old
        pull = begun.T @ S @ z + reach.T @ self.M @ (A @ z + (1 - share) * old @ w)
        v = -np.linalg.solve(R + begun.T @ S @ begun + reach.T @ self.M @ reach, pull)
        self.M = riccati(self.M, *model, R, S)
        return w_d + share * v + (1 - share) * w

    def within(self, limits: Array, feedforward: Array, more: Array, h: float) -> Array:
        """Return inputs within limits, which keep the direction of what is added."""
        base = np.clip(feedforward, -limits, limits)
        room = np.where(more > 0, limits - base, limits + base) / np.maximum(np.abs(more), 1e-9)
        share = min(1.0, room.min())
        self.strain = min(max(self.strain - 0.5 * h, 0.0) - log(max(share, 0.5)), 3.0)
        return np.asarray(base + share * more)


def linear(at: str, of: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """Return A, B, B' where inputs are reached at the end of a step, or go on from its start."""
    A, first, second = of
    return (A, second, first - second) if at == "end" else (A, first + second, -second)
