"""The feedback on the measured motion of the crane as CasADi functions: memory in, memory and inputs out.

Everything is designed for sampled data. Between communication points the plant's inputs run linearly; how, is known
from the instant that the inputs of a step belong to. With *start* (a Jacobi master) the inputs computed in a step take
effect after it, and go on as from the step before; with *end* (Gauss-Seidel) they are reached at the end of the same
step. The state is that of trolley and load as points: there the error of the load is a coordinate, and the motion is
nearly linear also close to the axis, where the bridge turns far. Deviations e of the state and w of the inputs follow

    e+ = A e + B w+ + B' w + delta              delta: what the path's own inputs miss, run linearly between instants

    w+ = w_d - K (A (e - e_d) + B' (w - w_d))   e_d, w_d: where the load is on its path in spite of delta

over a step, from the motion that has the load on its path under the force d that disturbs it: a rope that holds a load
against a force leans as one that accelerates it. delta is computed in advance: the nonlinear crane is sent over the
step from its place on the path. With *start* e is measured, and simulated over the step in which nothing can be changed
any more. K minimizes the sum of |W e_load|^2 + |w/f|^2. The cost-to-go M of A e + B' w is part of the memory: some
Riccati steps in each step let it follow the crane along its path. d is corrected by the velocity of the load that the
prediction missed; it is made with the inputs that the limits of the drives have left, so nothing winds up.

A load that is off its path when the feedback begins is not pulled at: position, velocity, acceleration and jerk of the
load tell the whole motion, so the path gets an offset that begins with the measured ones and ends smoothly.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import casadi as ca

import servocore as sc
from crane_fmu.build.flatness import continued, flat_motion, forgotten, measured_state, offset, offset_at_start
from crane_fmu.build.sampling import SHORT_TURN, advance, function, resting, sampled
from crane_fmu.slave.interface import DIMENSION, FEEDBACK_FORMAT, ORDERS

LAW_MODEL = "points"
"""The model of the rotary crane that the law is made from."""

WEIGHT, WEIGHT_TIMES_SQUARE, HEIGHT_TIMES_SQUARE = 4000.0, 2.0, 0.7
"""Of an error of the load in m against an input worth 1 m/s2: at most, times the squared step, and the same for z."""

EFFORT = (1.5, 0.7, 1.0)
"""How freely bridge, trolley and winch are used."""

LEARNING_RATE, LEARNING_SHARE, LARGEST_FORCE = 50.0, 0.28, 0.5
"""How fast the force on the load is learnt, in 1/s, and at most in a step; its components stay within so many weights
of the load."""

RICCATI_STEPS, FIRST_RICCATI_STEPS = 3, 400
"""By which the cost-to-go is brought up to date in a step, and before the first."""

EASE, RECOVERY = 2.0, 0.5
"""Drives at their limits ease the weights: by which power of the share they give, and how fast that ends, in 1/s."""

SLACK_SHARE = 0.5
"""Of the rope's tension: more the feedback does not take away."""

SIZES = {"cost": 100, "force": 3, "predicted": 10, "before": 3, "strain": 1, "snap": 3, "step": 1, "known": 1}
SIZES |= {"offset": 12, "return": 3}
"""What the memory holds: M, d, predicted state, inputs of the step before, how long drives have been at their limits
(logarithm of a share), snap told then, its length (0: none), whether the prediction knew how its inputs run, the
offset y_0 ... y_3 and the rates a at which it ends."""

_N, _M, _HALF = 10, 3, 5
_LOAD = 2  # where the load's place begins in the coordinates
_JET = DIMENSION * len(ORDERS)


def feedback_text(functions: Mapping[str, ca.Function]) -> str:
    """Return functions as a text that an FMU carries; what they share is in it once."""
    packer = ca.StringSerializer()
    packer.pack(list(functions.values()))
    return json.dumps({"format": FEEDBACK_FORMAT, "names": list(functions), "functions": packer.encode()})


def feedback_functions(system: sc.MechanicalSystem) -> dict[str, ca.Function]:
    """Return the feedback of a crane.

    Parameters
    ----------
    system : MechanicalSystem
        The crane in its nine coordinates ``points``.

    Returns
    -------
    dict of str to casadi.Function
        For each input time T ``begin_T``, (jet, measured, p, h) -> memory, and ``feedback_T``, (memory, jet, jet
        before, measured, acting, feedforward, p, h, share, limits) -> (memory, inputs).
    """
    parts = _parts(hanging(system))
    functions = (each(parts, time) for time in ("start", "end") for each in (_begin, _feedback))
    return {each.name(): each for each in functions}


def hanging(system: sc.MechanicalSystem) -> sc.MechanicalSystem:
    """Return the crane in coordinates in which the load's place is linear, near the axis too: trolley and load."""
    coordinates = sc.Coordinates(*(sc.Quantity(name, "m") for name in ("p_x", "p_y", "x", "y", "z")))
    place, load = coordinates.q[:2], coordinates.q[2:]
    s = ca.norm_2(place)
    rope = ca.norm_2(load - ca.vertcat(place, 0))
    return sc.generalise(system, coordinates, ca.vertcat(place / s, place, s, rope, load), observables={})


@dataclass(frozen=True)
class _Parts:
    """Pieces of the law.

    flat: (jet, p) -> state, inputs. measured: what is measured -> state. advance: (whether the step is short, state, u,
    u_dot, d, p, h) -> state. sampled: (whether it is, state, u, d, p, h) -> A, h phi_1 B, h phi_2 B. riccati: (M, A, B,
    B', f, W) -> M, K.
    resisting: (state, p) -> the mass by which the load resists forces. resting: (A, B, push) -> state and inputs with
    which the load stays. offset: as of `crane_fmu.build.flatness.offset`.
    """

    flat: ca.Function
    measured: ca.Function
    advance: ca.Function
    sampled: ca.Function
    riccati: ca.Function
    resisting: ca.Function
    resting: ca.Function
    offset: ca.Function


def _parts(system: sc.MechanicalSystem) -> _Parts:
    return _Parts(
        flat=flat_motion(),
        measured=measured_state(),
        advance=advance(system, _M),
        sampled=sampled(system, _M),
        riccati=_riccati_step(),
        resisting=_resisting(system),
        resting=resting(_HALF, _LOAD, _M),
        offset=offset(),
    )


def _resisting(system: sc.MechanicalSystem) -> ca.Function:
    """Return the inverse of the accelerations that forces give to the load."""
    given = ca.densify(ca.ldl_solve(ca.densify(system.C.T), *ca.ldl(system.mass)))
    state = ca.vertcat(system.q, system.v)
    return function("resisting", [state, system.p], [ca.densify(ca.inv(system.C @ given))])


def _riccati_step() -> ca.Function:
    """Return (cost M of A e + B' w before w+ is chosen, A, B, B', f, W) -> (M a step earlier, K)."""
    cost, A = ca.SX.sym("M", _N, _N), ca.SX.sym("A", _N, _N)
    new, old = ca.SX.sym("B", _N, _M), ca.SX.sym("B'", _N, _M)
    efforts, weights = ca.SX.sym("f", _M), ca.SX.sym("W", _M)
    half = cost @ A
    quadratic = ca.SX(_N, _N)
    for k in range(_N):  # symmetric: half of it is enough
        quadratic[: k + 1, k] = A[:, : k + 1].T @ half[:, k]
    for k in range(_M):
        quadratic[_LOAD + k, _LOAD + k] += weights[k] ** 2
    quadratic = ca.triu2symm(quadratic)
    mixed = cost @ old
    crossed = A.T @ mixed
    N = quadratic @ new + crossed
    S = ca.diag(1 / efforts**2) + new.T @ (N + crossed) + old.T @ mixed
    scale = ca.diag(1 / ca.sqrt(ca.diag(S)))
    gain = scale @ ca.ldl_solve(scale @ N.T, *ca.ldl(scale @ S @ scale))
    earlier = ca.SX(_N, _N)
    for k in range(_N):
        earlier[: k + 1, k] = quadratic[: k + 1, k] - N[: k + 1, :] @ gain[:, k]
    results = [ca.triu2symm(earlier), gain]
    return ca.Function("riccati", [cost, A, new, old, efforts, weights], results, {"cse": True})


def _efforts(p: Any, s: Any) -> Any:
    """Return the inputs worth 1 m/s2 of bridge (at the trolley), trolley, winch with load, as freely as wanted."""
    bridge, trolley, load, winch, radius = (p[k] for k in range(5))
    worth = bridge / s + trolley * s, trolley, (load + winch / radius**2) * radius
    return ca.vertcat(*(each * factor for each, factor in zip(worth, EFFORT, strict=True)))


def _weights(h: ca.MX, strain: ca.MX) -> ca.MX:
    """Return what an error of the load in x, y and z weighs."""
    level, height = (ca.fmin(WEIGHT, each / h**2) for each in (WEIGHT_TIMES_SQUARE, HEIGHT_TIMES_SQUARE))
    return ca.exp(-EASE * strain) * ca.vertcat(level, level, height)


def _over_a_step(
    parts: _Parts, jet: ca.MX, force: ca.MX, p: ca.MX, h: ca.MX, strain: ca.MX, time: str, short: ca.MX
) -> tuple[Any, ...]:
    """Return A, B, B', f, W about a point of the path."""
    state, inputs = parts.flat(jet, p)
    A, first, second = parts.sampled(short, state, inputs, force, p, h)
    new, old = (second, first - second) if time == "end" else (first + second, -second)
    return A, new, old, _efforts(p, ca.norm_2(state[:_LOAD])), _weights(h, strain)


def _begin(parts: _Parts, time: str) -> ca.Function:
    """Return the memory before the first step, with the cost-to-go of a crane that would stay where it is."""
    jet, measured = ca.MX.sym("jet", _JET), ca.MX.sym("measured", 12)
    p, h = ca.MX.sym("p", 6), ca.MX.sym("h")
    A, new, old, efforts, weights = _over_a_step(parts, jet, ca.MX.zeros(_M), p, h, ca.MX(0), time, ca.MX(0))
    given = [ca.MX.sym(f"g{k}", each.sparsity()) for k, each in enumerate((A, new, old, efforts, weights))]
    cost = ca.MX.sym("M", _N, _N)
    one = ca.Function("one", [cost, *given], [parts.riccati(cost, *given)[0]])
    many = [ca.repmat(each, 1, FIRST_RICCATI_STEPS) for each in (A, new, old, efforts, weights)]
    found = one.fold(FIRST_RICCATI_STEPS)(1e-6 * ca.MX.eye(_N), *many)
    led = ca.vertcat(*offset_at_start(jet, measured, p, h))
    memory = ca.vertcat(ca.vec(found), ca.MX.zeros(sum(SIZES.values()) - _N * _N - led.numel()), led)
    return ca.Function(f"begin_{time}", [jet, measured, p, h], [ca.densify(memory)])


def _feedback(parts: _Parts, time: str) -> ca.Function:
    """Return the law."""
    sizes = {"memory": sum(SIZES.values()), "jet": _JET, "jet_before": _JET, "measured": 12, "acting": _M}
    sizes |= {"feedforward": _M, "p": 6, "h": 1, "share": 1, "limits": _M}
    given = {name: ca.MX.sym(name, size) for name, size in sizes.items()}
    memory, jet, _, measured, acting, feedforward, p, h, share, limits = given.values()
    known = dict(zip(SIZES, ca.vertsplit(memory, [0, *accumulate(SIZES.values())]), strict=True))
    goes_on, none = known["step"] > 0, ca.MX.zeros(_M)
    last = ca.fmax(known["step"], 1e-9)
    crackle = ca.if_else(goes_on, (jet[-DIMENSION:] - known["snap"]) / last, none)
    path = [given["jet_before"], jet, crackle]
    led = known["offset"], known["return"]
    pendulum = ca.fmax(p[5] + given["jet_before"][8], 0) / measured[2] * (1 + p[2] / p[1])
    short = ca.sqrt(pendulum) * h <= SHORT_TURN  # as of `fastest_pendulum`
    state = parts.measured(measured)
    force = _learnt(parts, known, state, p, h)
    (here, u_here), (there, u_there), beyond, middle = _places(parts, path, led, force, p, h, time)
    A, new, old, efforts, weights = _over_a_step(parts, middle, force, p, h, known["strain"], time, short)
    cost = ca.reshape(known["cost"], _N, _N)
    model = A, new, old, efforts, weights
    for _ in range(RICCATI_STEPS):
        cost, gain = parts.riccati(cost, *model)
    slope = (u_there - u_here) / h
    if time == "end":
        e, origin, target = state - here, (here, u_here), there
    else:
        ran = ca.if_else(goes_on, (acting - known["before"]) / last, slope)
        after = parts.advance(short, state, acting, ran, force, p, h)
        e, origin, target = after - there, (there, u_there), beyond
    delta = parts.advance(short, *origin, slope, force, p, h) - target
    e_d, w_d = parts.resting(A, new + old, delta)
    wanted = u_there + w_d - gain @ (A @ (e - e_d) + old @ (acting - u_here - w_d))
    wanted[2] = ca.fmin(wanted[2], _loosest(feedforward, acting, jet, p, time))
    inputs, strain = _within(limits, feedforward, share * (wanted - feedforward), known["strain"] - RECOVERY * h)
    if time == "end":
        after = parts.advance(short, state, acting, (inputs - acting) / h, force, p, h)
    offset_then = forgotten(parts.offset(*led, h)[0])
    knew = ca.MX(1) if time == "end" else ca.if_else(goes_on, 1, 0)
    remembered = ca.vertcat(ca.vec(cost), force, after, acting, strain, jet[-DIMENSION:], h, knew, offset_then, led[1])
    return ca.Function(f"feedback_{time}", list(given.values()), [ca.densify(remembered), inputs])


def _within(limits: ca.MX, feedforward: ca.MX, more: ca.MX, strain: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return inputs within limits that keep the direction of what is added to the feedforward, and the strain."""
    base = ca.fmax(-limits, ca.fmin(limits, feedforward))
    room = ca.if_else(more > 0, limits - base, limits + base) / ca.fmax(ca.fabs(more), 1e-9)
    share = ca.fmin(1, ca.mmin(room))
    return base + share * more, ca.fmin(ca.fmax(strain, 0) - ca.log(ca.fmax(share, 0.5)), 3)


def _loosest(feedforward: ca.MX, acting: ca.MX, jet: ca.MX, p: ca.MX, time: str) -> ca.MX:
    """Return the winch's torque that leaves the rope its share of tension, also where the plant goes on to."""
    load, winch, radius = p[2], p[3], p[4]
    most = feedforward[2] + SLACK_SHARE * (p[5] + jet[8]) * (load + winch / radius**2) * radius
    return most if time == "end" else (most + acting[2]) / 2


def _places(
    parts: _Parts, path: Sequence[ca.MX], led: tuple[ca.MX, ca.MX], force: ca.MX, p: ca.MX, h: ca.MX, time: str
) -> tuple[Any, ...]:
    """Return state and inputs on the path now and a step later, the state after two, a jet of the step to be ruled.

    The rope pulls a load that is pushed as one that is accelerated otherwise.
    """
    before, jet, crackle = path
    pulled = ca.vertcat(ca.MX.zeros(2 * DIMENSION), -force / p[2], ca.MX.zeros(2 * DIMENSION))
    now, then = (parts.offset(*led, steps * h)[1] + pulled for steps in (0, 1))
    if time == "end":
        none = ca.MX.zeros(DIMENSION)
        before, jet = before + now, jet + then
        middle = (continued(before, none, h / 2) + continued(jet, none, -h / 2)) / 2
        return parts.flat(before, p), parts.flat(jet, p), None, middle
    there, beyond, middle = (
        continued(jet, crackle, k * h) + parts.offset(*led, k * h)[1] + pulled for k in (1, 2, 1.5)
    )
    return parts.flat(jet + now, p), parts.flat(there, p), parts.flat(beyond, p)[0], middle


def _learnt(parts: _Parts, known: dict[str, ca.MX], state: ca.MX, p: ca.MX, h: ca.MX) -> ca.MX:
    """Return the force on the load, corrected by what the prediction of the load's velocity missed."""
    missed = (state - known["predicted"])[_HALF + _LOAD :]
    share = ca.fmin(1 - ca.exp(-LEARNING_RATE * h), LEARNING_SHARE)
    more = ca.if_else(known["known"] > 0, share / h * parts.resisting(state, p) @ missed, ca.MX.zeros(_M))
    most = LARGEST_FORCE * p[2] * p[5]
    return ca.fmax(-most, ca.fmin(most, known["force"] + more))
