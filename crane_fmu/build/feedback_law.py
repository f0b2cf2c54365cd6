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

How long coming steps are is not known, and with *start* inputs that go on for longer than was thought go too far. So
the law counts on steps of length H, the longest of late: M is that of steps of length H, and with *start* w+ lies
between w and what a step from w would end at after H. Where steps are even, H = h.

A load that is off its path when the feedback begins is not pulled at: position, velocity, acceleration and jerk of the
load tell the whole motion, so the path gets an offset that begins with the measured ones and ends smoothly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import accumulate
from typing import Any

import casadi as ca

import servocore as sc
from crane_fmu.build.flatness import (
    DRIVES,
    LOAD,
    POINTS,
    STATES,
    continued,
    fastest_pendulum,
    flat_motion,
    forgotten,
    measured_state,
    offset,
    offset_at_start,
)
from crane_fmu.build.riccati import riccati_functions, riccati_steps
from crane_fmu.build.sampling import SHORT_TURN, advance, resting, sampled
from crane_fmu.catalogue import DIMENSION, ORDERS

LAW_MODEL = "points"
"""The model of the rotary crane that the law is made from."""

WEIGHT, WEIGHT_TIMES_SQUARE, HEIGHT_TIMES_SQUARE = 4000.0, 2.0, 0.7
"""Of an error of the load in m against an input worth 1 m/s2: at most, times the squared step, and the same for z."""

EFFORT = (1.5, 0.7, 1.0)
"""How freely bridge, trolley and winch are used."""

LEARNING_RATE, LEARNING_SHARE, LARGEST_FORCE = 50.0, 0.28, 0.5
"""How fast the force on the load is learnt, in 1/s, and at most in a step; its components stay within so many weights
of the load."""

RICCATI_STEPS, FIRST_DOUBLINGS = 3, 18
"""Riccati steps by which the cost-to-go is brought up to date in a step, and how often one is doubled before the first:
short steps or not, the cost-to-go settles at 4.6 1/s or faster, to 1e-5 in the 2.6 s that these are at 0.01 ms."""

EASE, RECOVERY = 2.0, 0.5
"""Drives at their limits ease the weights: by which power of the share they give, and how fast that ends, in 1/s."""

FORGETTING = 0.02
"""By how much H falls in a step, in lengths of it: the longest step is forgotten in fifty times its length."""

SLACK_SHARE = 0.5
"""Of the rope's tension: more the feedback does not take away."""

SIZES = {"cost": 100, "force": 3, "predicted": 10, "before": 3, "strain": 1, "snap": 3, "step": 1}
SIZES |= {"longest": 1, "known": 1, "offset": 12, "return": 3}
"""What the memory holds: M, d, predicted state, inputs of the step before, how long drives have been at their limits
(logarithm of a share), snap told then, its length (0: none), H, whether the prediction knew how its inputs run, the
offset y_0 ... y_3 and the rates a at which it ends."""

_JET = DIMENSION * len(ORDERS)


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
    parts = _Parts(hanging(system))
    functions = (each(parts, time) for time in ("start", "end") for each in (_begin, _feedback))
    return {each.name(): each for each in functions}


def hanging(system: sc.MechanicalSystem) -> sc.MechanicalSystem:
    """Return the crane in coordinates in which the load's place is linear, near the axis too: trolley and load."""
    coordinates = sc.Coordinates(*(sc.Quantity(name, "m") for name in ("p_x", "p_y", "x", "y", "z")))
    place, load = coordinates.q[:2], coordinates.q[2:]
    s = ca.norm_2(place)
    rope = ca.norm_2(load - ca.vertcat(place, 0))
    return sc.generalize(system, coordinates, ca.vertcat(place / s, place, s, rope, load), observables={})


class _Parts:
    """Functions that the law is made of, for both input times; where they come from says what they compute."""

    def __init__(self, system: sc.MechanicalSystem) -> None:
        self.flat, self.measured, self.offset = flat_motion(), measured_state(), offset()
        self.advance, self.sampled, self.resting = advance(system), sampled(system), resting()
        self.shared, self.riccati, self.gain = riccati_functions()
        self.resisting = _resisting(system)


def _resisting(system: sc.MechanicalSystem) -> ca.Function:
    """Return the inverse of the accelerations that forces give to the load."""
    given = ca.densify(ca.ldl_solve(ca.densify(system.C.T), *ca.ldl(system.mass)))
    state = ca.vertcat(system.q, system.v)
    return ca.Function("resisting", [state, system.p], [ca.densify(ca.inv(system.C @ given))], {"cse": True})


def _efforts(p: ca.SX, state: ca.SX) -> ca.SX:
    """Return the inputs worth 1 m/s2 of bridge (at the trolley), trolley, winch with load, as freely as wanted."""
    s = ca.norm_2(state[: LOAD.start])
    bridge, trolley, load, winch, radius = (p[k] for k in range(5))
    worth = bridge / s + trolley * s, trolley, (load + winch / radius**2) * radius
    return ca.vertcat(*(each * factor for each, factor in zip(worth, EFFORT, strict=True)))


def _weights(h: ca.SX, strain: ca.SX | float) -> ca.SX:
    """Return what an error of the load in x, y and z weighs."""
    level, height = (ca.fmin(WEIGHT, each / h**2) for each in (WEIGHT_TIMES_SQUARE, HEIGHT_TIMES_SQUARE))
    return ca.exp(-EASE * strain) * ca.vertcat(level, level, height)


def _inlined(name: str, rule: Callable[..., Sequence[ca.SX]], *given: ca.MX) -> Any:
    """Return what a rule makes of some numbers, as one expression: loops over two or three numbers cost more."""
    symbols = [ca.SX.sym(f"i{k}", *each.shape) for k, each in enumerate(given)]
    return ca.Function(name, symbols, [ca.densify(each) for each in rule(*symbols)], {"cse": True}).call(list(given))


def _linear(parts: _Parts, time: str, short: ca.MX, *about: ca.MX) -> tuple[Any, ...]:
    """Return A, B, B' about a point of the path: state, inputs, d, p, h."""
    A, first, second = parts.sampled(short, *about)
    return (A, second, first - second) if time == "end" else (A, first + second, -second)


def _begin(parts: _Parts, time: str) -> ca.Function:
    """Return the memory before the first step, with the cost-to-go of a crane that would stay where it is."""
    jet, measured = ca.MX.sym("jet", _JET), ca.MX.sym("measured", 12)
    p, h = ca.MX.sym("p", 6), ca.MX.sym("h")
    about = *parts.flat(jet, p), ca.MX.zeros(DRIVES), p, h
    worth = _inlined("worth", lambda x, p, h: (_efforts(p, x), _weights(h, 0)), about[0], p, h)
    model = *_linear(parts, time, ca.MX(0), *about), *worth
    _, *shared = parts.shared.call(model)
    found = riccati_steps(FIRST_DOUBLINGS)(*shared)
    led = ca.vertcat(*offset_at_start(jet, measured, p, h))
    memory = ca.vertcat(ca.vec(found), ca.MX.zeros(sum(SIZES.values()) - STATES**2 - led.numel()), led)
    return ca.Function(f"begin_{time}", [jet, measured, p, h], [ca.densify(memory)])


def _feedback(parts: _Parts, time: str) -> ca.Function:
    """Return the law."""
    sizes = {"memory": sum(SIZES.values()), "jet": _JET, "jet_before": _JET, "measured": 12, "acting": DRIVES}
    sizes |= {"feedforward": DRIVES, "p": 6, "h": 1, "share": 1, "limits": DRIVES}
    given = {name: ca.MX.sym(name, size) for name, size in sizes.items()}
    memory, jet, before, measured, acting, feedforward, p, h, share, limits = given.values()
    cost, *known = ca.vertsplit(memory, [0, *accumulate(SIZES.values())])
    heard = ca.vertcat(*known), jet, before, measured, acting, p, h
    situation = _inlined("situation", partial(_situation, parts, time), *heard)
    short, longest, state, force, here, u_here, there, u_there, beyond, slope, ran, *model, offset = situation
    cost = ca.reshape(cost, STATES, STATES)
    cost, share_of, *rule = _design(parts, time, cost, (short, *model, force, p), h, longest)
    A, new, old, ahead, alone, goes_on, gain = rule
    after = parts.advance(short, state, acting, ran, force, p, h) if time == "start" else state
    e, origin = (state - here, (here, u_here)) if time == "end" else (after - there, (there, u_there))
    delta = parts.advance(short, *origin, slope, force, p, h if time == "end" else longest) - beyond
    e_d, w_d = parts.resting(A, new + old, delta)
    w = acting - u_here - w_d
    z = A @ (e - e_d) + old @ w
    chosen = -alone @ z - gain @ (goes_on @ z + ahead @ w)
    more = w_d + share_of * chosen + (1 - share_of) * w
    strain = known[list(SIZES).index("strain") - 1]
    told = u_there, more, feedforward, acting, jet, p, h, longest, share, limits, strain
    inputs, strain = _inlined("bounded", partial(_bounded, time), *told)
    if time == "end":
        after = parts.advance(short, state, acting, (inputs - acting) / h, force, p, h)
    remembered = ca.vertcat(ca.vec(cost), force, after, acting, strain, jet[-DIMENSION:], h, longest, offset)
    return ca.Function(f"feedback_{time}", list(given.values()), [ca.densify(remembered), inputs])


def _design(
    parts: _Parts, time: str, cost: ca.MX, model: tuple[ca.MX, ...], h: ca.MX, longest: ca.MX
) -> tuple[Any, ...]:
    """Return M a step later and what the law decides by.

    With *start* it chooses v, which inputs would come to from w in a step of length H; w+ = w + (v - w) h / H. The
    input then goes on by v - w in H, whatever h is, and v is what costs effort: an input that is steep would cost
    little at its beginning. With *end* v = w+. Then z = A e + B' w, v = -F z - K (C z + D w) by `riccati_functions`.

    Parameters
    ----------
    model : tuple of casadi.MX
        Whether the step is short; state, inputs, efforts, weights of the step to be ruled; d, p.
    h, longest : casadi.MX
        This step, and H.

    Returns
    -------
    tuple
        M, h / H or 1, A, B, B', D, F, C, K.
    """
    short, state, u, efforts, weights, force, p = model
    A, new, old = _linear(parts, time, short, state, u, force, p, longest)
    alone, *shared = parts.shared(A, new, old, efforts, weights)
    for _ in range(RICCATI_STEPS - 1):
        cost, _ = parts.riccati(cost, *shared)
    share = h / longest if time == "start" else ca.MX(1)
    given = [cost, A, new, old, alone, *shared, *model, h, share]
    symbols = [ca.MX.sym(f"i{k}", each.sparsity()) for k, each in enumerate(given)]
    even = ca.Function("even", symbols, _even(parts, *symbols))
    uneven = ca.Function("uneven", symbols, _uneven(parts, time, *symbols))
    cost, *rule = ca.Function.if_else("design", even, uneven).call([h == longest, *given])
    rule.insert(3, (1 - share) * old)
    return cost, share, *rule


def _even(parts: _Parts, cost: ca.MX, *given: ca.MX) -> list[ca.MX]:
    """Return M and what `_design` does but D, where this step has the length of those to come."""
    A, new, old, alone, *shared = given[:9]
    after, gain = parts.riccati(cost, *shared)
    return [after, A, new, old, alone, shared[0], gain]


def _uneven(parts: _Parts, time: str, cost: ca.MX, *given: ca.MX) -> list[ca.MX]:
    """Return what `_even` does for any step."""
    A, new, old, _, *shared = given[:9]
    short, state, u, efforts, weights, force, p, h, share = given[9:]
    if time == "end":
        now, begun, ended = _linear(parts, time, short, state, u, force, p, h)
    else:
        now, begun, ended = A, new + (share - 1) * (new + old), old + (1 - share) * (new + old)
    alone, goes_on, _, _, acting, effort = parts.shared(A, begun, share * old, efforts, weights)
    after, _ = parts.riccati(cost, *shared)
    return [after, now, begun, ended, alone, goes_on, parts.gain(cost, acting, effort)]


def _situation(
    parts: _Parts, time: str,
    memory: ca.SX, jet: ca.SX, before: ca.SX, measured: ca.SX, acting: ca.SX, p: ca.SX, h: ca.SX,
) -> Sequence[ca.SX]:  # fmt: skip
    """Return what is known before the design, by the memory behind M, paths, what is measured and acts, p and h.

    That is: whether the step is short; H; state; force on the load; where path and inputs are now, a step later, and
    where the path is when what the law decides has acted; slopes of the inputs of the path and of those that act; state
    and inputs of the step to be ruled; efforts and weights; the memory from `known` on.
    """
    sizes = [size for name, size in SIZES.items() if name != "cost"]
    known = dict(zip(list(SIZES)[1:], ca.vertsplit(memory, [0, *accumulate(sizes)]), strict=True))
    goes_on, none = known["step"] > 0, ca.SX.zeros(DRIVES)
    last = ca.fmax(known["step"], 1e-9)
    crackle = ca.if_else(goes_on, (jet[-DIMENSION:] - known["snap"]) / last, none)
    led = known["offset"], known["return"]
    longest = ca.fmax(h, known["longest"] - FORGETTING * h)
    short = fastest_pendulum(before, measured[2], p) * longest <= SHORT_TURN
    state = parts.measured(measured)
    force = _learnt(parts, known, state, p, last)
    places = _places(parts, [before, jet, crackle], led, force, p, (h, longest), time)
    (_, u_here, _, u_there, _), middle = places[:5], places[5:]
    slope = (u_there - u_here) / h
    ran = ca.if_else(goes_on, (acting - known["before"]) / last, slope)
    worth = _efforts(p, middle[0]), _weights(longest, known["strain"])
    knew = ca.SX(1) if time == "end" else ca.if_else(goes_on, 1, 0)
    then = ca.vertcat(knew, forgotten(parts.offset(*led, h)[0]), led[1])
    return [short, longest, state, force, *places[:5], slope, ran, *middle, *worth, then]


def _bounded(
    time: str, flat: ca.SX, more: ca.SX, feedforward: ca.SX, acting: ca.SX, jet: ca.SX, p: ca.SX, h: ca.SX,
    longest: ca.SX, share: ca.SX, limits: ca.SX, strain: ca.SX,
) -> Sequence[ca.SX]:  # fmt: skip
    """Add to inputs of the path within what rope and drives can do; see `_feedback`. Return inputs and strain."""
    wanted = flat + more
    wanted[2] = ca.fmin(wanted[2], _loosest(feedforward, acting, jet, p, 0 if time == "end" else longest / h))
    return _within(limits, feedforward, share * (wanted - feedforward), strain - RECOVERY * h)


def _within(limits: ca.SX, feedforward: ca.SX, more: ca.SX, strain: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return inputs within limits that keep the direction of what is added to the feedforward, and the strain."""
    base = ca.fmax(-limits, ca.fmin(limits, feedforward))
    room = ca.if_else(more > 0, limits - base, limits + base) / ca.fmax(ca.fabs(more), 1e-9)
    share = ca.fmin(1, ca.mmin(room))
    return base + share * more, ca.fmin(ca.fmax(strain, 0) - ca.log(ca.fmax(share, 0.5)), 3)


def _loosest(feedforward: ca.SX, acting: ca.SX, jet: ca.SX, p: ca.SX, further: ca.SX | float) -> ca.SX:
    """Return the winch's torque that leaves the rope its share of tension, also where it goes on to."""
    load, winch, radius = p[2], p[3], p[4]
    most = feedforward[2] + SLACK_SHARE * (p[5] + jet[8]) * (load + winch / radius**2) * radius
    return (most + further * acting[2]) / (1 + further)


def _places(
    parts: _Parts, path: Sequence[ca.SX], led: tuple[ca.SX, ca.SX], force: ca.SX, p: ca.SX, steps: tuple[ca.SX, ca.SX],
    time: str,
) -> tuple[Any, ...]:  # fmt: skip
    """Return state and inputs on the path now and a step later, the state when what is decided has acted, and more.

    That is state and inputs in the step to be ruled. The rope pulls a load that is pushed as one that is accelerated
    otherwise.
    """
    (before, jet, crackle), (h, longest) = path, steps
    pulled = ca.vertcat(ca.SX.zeros(2 * DIMENSION), -force / p[2], ca.SX.zeros(2 * DIMENSION))
    now, then = (parts.offset(*led, tau)[1] + pulled for tau in (0, h))
    if time == "end":
        none = ca.SX.zeros(DIMENSION)
        before, jet = before + now, jet + then
        middle = (continued(before, none, h / 2) + continued(jet, none, -h / 2)) / 2
        ended = parts.flat(jet, p)
        return *parts.flat(before, p), *ended, ended[0], *parts.flat(middle, p)
    there, beyond, middle = (
        continued(jet, crackle, tau) + parts.offset(*led, tau)[1] + pulled for tau in (h, h + longest, h + longest / 2)
    )
    return *parts.flat(jet + now, p), *parts.flat(there, p), parts.flat(beyond, p)[0], *parts.flat(middle, p)


def _learnt(parts: _Parts, known: dict[str, ca.SX], state: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
    """Return the force on the load, corrected by what the prediction of the load's velocity over h missed."""
    missed = (state - known["predicted"])[POINTS + LOAD.start :]
    share = ca.fmin(1 - ca.exp(-LEARNING_RATE * h), LEARNING_SHARE)
    more = ca.if_else(known["known"] > 0, share / h * parts.resisting(state, p) @ missed, ca.SX.zeros(DRIVES))
    most = LARGEST_FORCE * p[2] * p[5]
    return ca.fmax(-most, ca.fmin(most, known["force"] + more))
