"""The feedback on the measured motion of the crane, as CasADi functions with a memory.

The design is for sampled data. Between communication points the plant's inputs are linear in time; their course
depends on the instant that the inputs of a step belong to. With *start* (a Jacobi master) the inputs computed in a step
take effect after it, extrapolated with the slope of the last step; with *end* (Gauss-Seidel) they are reached at the
end of the same step. The state is that of trolley and load as points: the error of the load is a coordinate then, and
the motion is nearly linear also close to the axis, where the bridge turns far. Deviations e of the state and w of the
inputs follow

    e+ = A e + B w+ + B' w + delta              delta: error of the path's own inputs, linear between instants

    w+ = w_d - K (A (e - e_d) + B' (w - w_d))   e_d, w_d: the load is on its path in spite of delta

over a step, from the motion with the load on its path under a disturbance force d: a rope that holds a load against a
force leans like one that accelerates it. delta is computed by a simulation of the nonlinear crane over the step, from
its place on the path. With *start* e is measured, and simulated over the step whose inputs are already fixed. K
minimizes the sum of |W e_load|^2 + |w/f|^2. The cost-to-go M of A e + B' w is part of the memory; some Riccati steps in
each step adapt it along the path. d is corrected by the prediction error of the load's velocity; the prediction uses
the inputs within the limits of the drives, so there is no windup.

The next step sizes are unknown, and with *start* inputs that are extrapolated for longer than assumed go too far. The
law therefore assumes steps of length H, the longest recent step: M is that of steps of length H, and with *start* w+
lies between w and the end of a step of length H from w. With constant steps H = h.

For a load that is off its path when the feedback starts, the path gets an offset that begins with the measured
position, velocity, acceleration and jerk of the load and ends smoothly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import accumulate
from typing import Any

import casadi as ca

import servocore as sc
from crane_fmu.build.sampling import (
    DRIVES,
    LOAD,
    POINTS,
    SHORT_TURN,
    STATES,
    advance,
    continued,
    dense,
    fastest_pendulum,
    flat_motion,
    forgotten,
    measured_state,
    offset,
    offset_at_start,
    resting,
    riccati_functions,
    riccati_steps,
    sampled,
)
from crane_fmu.catalogue import DIMENSION, ORDERS

LAW_MODEL = "points"
"""The model of the rotary crane in the law."""

WEIGHT, WEIGHT_TIMES_SQUARE, HEIGHT_TIMES_SQUARE = 4000.0, 2.0, 0.7
"""Weights of an error of the load in m, relative to an input of 1 m/s2: largest, times squared step, that for z."""

EFFORT = (1.5, 0.7, 1.0)
"""Relative use of bridge, trolley and winch."""

LEARNING_RATE, LEARNING_SHARE, LARGEST_FORCE = 50.0, 0.28, 0.5
"""Rate of the disturbance estimate in 1/s, its largest share in a step, and the largest force in load weights."""

RICCATI_STEPS, FIRST_DOUBLINGS = 3, 18
"""Riccati steps of the cost-to-go in each step, and doublings of one before the first step: the cost-to-go converges
at 4.6 1/s or faster for all step sizes, to 1e-5 within 2.6 s, the time of these doublings with steps of 0.01 ms."""

EASE, RECOVERY = 2.0, 0.5
"""Reduction of the weights by drives at their limits: power of the available share, and rate of its end in 1/s."""

FORGETTING = 0.02
"""Decrease of H in a step, in lengths of it: the longest step is forgotten in fifty times its length."""

SLACK_SHARE = 0.5
"""Largest share of the rope's tension that the feedback removes."""

SIZES = {"cost": 100, "force": 3, "predicted": 10, "before": 3, "strain": 1, "snap": 3, "step": 1}
SIZES |= {"longest": 1, "known": 1, "offset": 12, "return": 3}
"""Layout of the memory: M, d, predicted state, inputs of the previous step, saturation of the drives (logarithm of a
share), snap and length of the previous step (0: none), H, whether the prediction used the actual inputs, the offset
y_0 ... y_3 and its decay rates a."""

CRANE_NUMBERS = 6
"""Parameters of the crane, the first ones; those of drives follow."""

_JET = DIMENSION * len(ORDERS)


def feedback_functions(system: sc.MechanicalSystem) -> dict[str, ca.Function]:
    """Return the feedback of a crane.

    Parameters
    ----------
    system : MechanicalSystem
        The crane in its nine coordinates ``points``, with or without drives.

    Returns
    -------
    dict of str to casadi.Function
        For each input time T ``begin_T``, (jet, measured, p, h) -> memory, and ``feedback_T``, (memory, jet, jet
        before, measured, acting, feedforward, p, h, share, limits) -> (memory, inputs).
    """
    crane = hanging(system)
    # A prediction over a step knows no dry friction, which is steep at standstill.
    parts = _Parts(replace(crane, force=ca.SX(POINTS, 1)))
    functions = [each(parts, time) for time in ("start", "end") for each in (_begin, _feedback)]
    if system.p.numel() > CRANE_NUMBERS:
        functions[1::2] = [_beside_friction(law, _flat(crane), parts.flat) for law in functions[1::2]]
    return {each.name(): each for each in functions}


def hanging(system: sc.MechanicalSystem) -> sc.MechanicalSystem:
    """Return the crane in coordinates in which the load's place is linear, near the axis too: trolley and load."""
    coordinates = sc.Coordinates(*(sc.Quantity(name, "m") for name in ("p_x", "p_y", "x", "y", "z")))
    place, load = coordinates.q[:2], coordinates.q[2:]
    s = ca.norm_2(place)
    rope = ca.norm_2(load - ca.vertcat(place, 0))
    return sc.generalize(system, coordinates, ca.vertcat(place / s, place, s, rope, load), observables={})


def _flat(system: sc.MechanicalSystem) -> ca.Function:
    """Return (jet of the load, p) -> (state, inputs) of a crane, which may have drives: from its equations then."""
    jet, p = ca.SX.sym("jet", _JET), system.p
    state, inputs, acceleration = flat_motion()(jet, p[:CRANE_NUMBERS])
    if p.numel() > CRANE_NUMBERS:
        B, a = system.input_matrix, ca.SX.sym("a", POINTS)
        needed = -ca.mtimes(ca.inv(ca.mtimes(B, B.T)), ca.mtimes(B, system.mass @ a + system.bias))
        inputs = ca.substitute(needed, ca.vertcat(system.q, system.v, a), ca.vertcat(state, acceleration))
    return ca.Function("flat", [jet, p], [state, inputs], {"cse": True})


def _beside_friction(law: ca.Function, flat: ca.Function, smooth: ca.Function) -> ca.Function:
    """Return the law for inputs that overcome friction of drives too, from those along the path with it and without.

    The law gets inputs without friction, and limits smaller by it; it is added to the inputs that the law returns.
    """
    given = law.mx_in()
    memory, jet, before, measured, acting, feedforward, p, h, share, limits = given
    ahead = ca.MX(0) if law.name().endswith("end") else h
    (reached,) = _inlined("reached", lambda jet, tau: [continued(jet, ca.SX.zeros(DIMENSION), tau)], jet, ahead)
    now, then = (flat(path, p)[1] - smooth(path, p)[1] for path in (before, reached))
    inputs, room = (acting - now, feedforward - then), ca.fmax(limits - ca.fabs(then), 0)
    after, found = law(memory, jet, before, measured, *inputs, p, h, share, room)
    return ca.Function(law.name(), given, [after, found + then])


class _Parts:
    """Functions of the law, for both input times; see the functions that make them."""

    def __init__(self, system: sc.MechanicalSystem) -> None:
        self.flat, self.measured, self.offset = _flat(system), measured_state(), offset()
        self.advance, self.sampled, self.resting = advance(system), sampled(system), resting()
        self.shared, self.riccati, self.gain = riccati_functions()
        yielding = system.C @ ca.densify(ca.ldl_solve(ca.densify(system.C.T), *ca.ldl(system.mass)))
        state = ca.vertcat(system.q, system.v)
        self.resisting = dense("resisting", [state, system.p], [ca.inv(yielding)])  # apparent mass of the load (kg)


def _efforts(p: ca.SX, state: ca.SX) -> ca.SX:
    """Return the inputs for 1 m/s2 of bridge (at the trolley), trolley and winch with load, times `EFFORT`."""
    s = ca.norm_2(state[: LOAD.start])
    bridge, trolley, load, winch, radius = (p[k] for k in range(5))
    worth = bridge / s + trolley * s, trolley, (load + winch / radius**2) * radius
    return ca.vertcat(*(each * factor for each, factor in zip(worth, EFFORT, strict=True)))


def _weights(h: ca.SX, strain: ca.SX | float) -> ca.SX:
    """Return the weights of an error of the load in x, y and z."""
    level, height = (ca.fmin(WEIGHT, each / h**2) for each in (WEIGHT_TIMES_SQUARE, HEIGHT_TIMES_SQUARE))
    return ca.exp(-EASE * strain) * ca.vertcat(level, level, height)


def _inlined(name: str, rule: Callable[..., Sequence[ca.SX]], *given: ca.MX) -> Any:
    """Return the results of a function as one scalar expression, faster here than loops over two or three numbers."""
    symbols = [ca.SX.sym(f"i{k}", *each.shape) for k, each in enumerate(given)]
    return dense(name, symbols, rule(*symbols)).call(list(given))


def _linear(parts: _Parts, time: str, short: ca.MX, *about: ca.MX) -> tuple[Any, ...]:
    """Return A, B, B' about a point of the path: state, inputs, d, p, h."""
    A, first, second = parts.sampled(short, *about)
    return (A, second, first - second) if time == "end" else (A, first + second, -second)


def _begin(parts: _Parts, time: str) -> ca.Function:
    """Return the memory before the first step, with the cost-to-go of a crane at rest at its present place."""
    jet, measured = ca.MX.sym("jet", _JET), ca.MX.sym("measured", 12)
    p, h = ca.MX.sym("p", parts.flat.numel_in(1)), ca.MX.sym("h")
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
    sizes |= {"feedforward": DRIVES, "p": parts.flat.numel_in(1), "h": 1, "share": 1, "limits": DRIVES}
    given = {name: ca.MX.sym(name, size) for name, size in sizes.items()}
    memory, jet, before, measured, acting, feedforward, p, h, share, limits = given.values()
    cost, *known = ca.vertsplit(memory, [0, *accumulate(SIZES.values())])
    given_now = ca.vertcat(*known), jet, before, measured, acting, p, h
    situation = _inlined("situation", partial(_situation, parts, time), *given_now)
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
    bounded = u_there, more, feedforward, acting, jet, p, h, longest, share, limits, strain
    inputs, strain = _inlined("bounded", partial(_bounded, time), *bounded)
    if time == "end":
        after = parts.advance(short, state, acting, (inputs - acting) / h, force, p, h)
    remembered = ca.vertcat(ca.vec(cost), force, after, acting, strain, jet[-DIMENSION:], h, longest, offset)
    return ca.Function(f"feedback_{time}", list(given.values()), [ca.densify(remembered), inputs])


def _design(
    parts: _Parts, time: str, cost: ca.MX, model: tuple[ca.MX, ...], h: ca.MX, longest: ca.MX
) -> tuple[Any, ...]:
    """Return M a step later and the matrices of the law.

    With *start* it determines v, the inputs at the end of a step of length H from w; w+ = w + (v - w) h / H. The slope
    of the input is (v - w) / H for all h, and v enters the cost: a steep input would cost little at its beginning.
    With *end* v = w+. Then z = A e + B' w, v = -F z - K (C z + D w) by `riccati_functions`.

    Parameters
    ----------
    model : tuple of casadi.MX
        Whether the step is short; state, inputs, efforts, weights in the controlled step; d, p.
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
    ways = zip(("even", "uneven"), _ways(parts, time, *symbols), strict=True)
    even, uneven = (ca.Function(name, symbols, results) for name, results in ways)
    cost, *rule = ca.Function.if_else("design", even, uneven).call([h == longest, *given])
    rule.insert(3, (1 - share) * old)
    return cost, share, *rule


def _ways(parts: _Parts, time: str, cost: ca.MX, *given: ca.MX) -> tuple[list[ca.MX], list[ca.MX]]:
    """Return the results of `_design` without D, for a step of length H and for any step."""
    A, new, old, alone, *shared = given[:9]
    after, gain = parts.riccati(cost, *shared)
    even = [after, A, new, old, alone, shared[0], gain]
    short, state, u, efforts, weights, force, p, h, share = given[9:]
    if time == "end":
        now, begun, ended = _linear(parts, time, short, state, u, force, p, h)
    else:
        now, begun, ended = A, new + (share - 1) * (new + old), old + (1 - share) * (new + old)
    alone, goes_on, _, _, acting, effort = parts.shared(A, begun, share * old, efforts, weights)
    return even, [after, now, begun, ended, alone, goes_on, parts.gain(cost, acting, effort)]


def _situation(parts: _Parts, time: str, *given: ca.SX) -> Sequence[ca.SX]:
    """Return the quantities before the design, from the memory after M, paths, measured and acting values, p and h.

    These are: whether the step is short; H; state; force on the load; state and inputs on the path now and a step
    later, and the state on the path after the controlled step; slopes of the inputs of the path and of the acting
    ones; state and inputs in the controlled step; efforts and weights; the memory from `known` on.
    """
    memory, jet, before, measured, acting, p, h = given
    sizes = [size for name, size in SIZES.items() if name != "cost"]
    known = dict(zip(list(SIZES)[1:], ca.vertsplit(memory, [0, *accumulate(sizes)]), strict=True))
    goes_on, none = known["step"] > 0, ca.SX.zeros(DRIVES)
    last = ca.fmax(known["step"], 1e-9)
    crackle = ca.if_else(goes_on, (jet[-DIMENSION:] - known["snap"]) / last, none)
    led = known["offset"], known["return"]
    longest = ca.fmax(h, known["longest"] - FORGETTING * h)
    short = fastest_pendulum(before, measured[2], p) * longest <= SHORT_TURN
    state = parts.measured(measured)
    # The force on the load is corrected by the prediction error of the load's velocity over the last step.
    missed, learning = (state - known["predicted"])[POINTS + LOAD.start :], 1 - ca.exp(-LEARNING_RATE * last)
    share = ca.fmin(learning, LEARNING_SHARE)
    pulled = ca.if_else(known["known"] > 0, share / last * parts.resisting(state, p) @ missed, none)
    most = LARGEST_FORCE * p[2] * p[5]
    force = ca.fmax(-most, ca.fmin(most, known["force"] + pulled))
    places = _places(parts, [before, jet, crackle], led, force, p, (h, longest), time)
    (_, u_here, _, u_there, _), middle = places[:5], places[5:]
    slope = (u_there - u_here) / h
    ran = ca.if_else(goes_on, (acting - known["before"]) / last, slope)
    worth = _efforts(p, middle[0]), _weights(longest, known["strain"])
    knew = ca.SX(1) if time == "end" else ca.if_else(goes_on, 1, 0)
    then = ca.vertcat(knew, forgotten(parts.offset(*led, h)[0]), led[1])
    return [short, longest, state, force, *places[:5], slope, ran, *middle, *worth, then]


def _bounded(time: str, *given: ca.SX) -> Sequence[ca.SX]:
    """Return inputs within the limits of rope and drives, and the saturation; see `_feedback`.

    The rope stays taut, extrapolation of the winch's torque included. The direction of the feedback is kept.
    """
    flat, more, feedforward, acting, jet, p, h, longest, share, limits, strain = given
    load, winch, radius = p[2], p[3], p[4]
    most = feedforward[2] + SLACK_SHARE * (p[5] + jet[8]) * (load + winch / radius**2) * radius
    further = 0 if time == "end" else longest / h
    inputs = flat + more
    inputs[2] = ca.fmin(inputs[2], (most + further * acting[2]) / (1 + further))
    feedback = share * (inputs - feedforward)
    base = ca.fmax(-limits, ca.fmin(limits, feedforward))
    room = ca.if_else(feedback > 0, limits - base, limits + base) / ca.fmax(ca.fabs(feedback), 1e-9)
    kept = ca.fmin(1, ca.mmin(room))
    strain = ca.fmin(ca.fmax(strain - RECOVERY * h, 0) - ca.log(ca.fmax(kept, 0.5)), 3)
    return base + kept * feedback, strain


def _places(
    parts: _Parts, path: Sequence[ca.SX], led: tuple[ca.SX, ca.SX], force: ca.SX, p: ca.SX, steps: tuple[ca.SX, ca.SX],
    time: str,
) -> tuple[Any, ...]:  # fmt: skip
    """Return state and inputs on the path now and a step later, the state after the controlled step, and more.

    These are state and inputs in the controlled step. A disturbance force is an additional acceleration of the load.
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
