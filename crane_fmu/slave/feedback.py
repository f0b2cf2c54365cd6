"""Feedback on the measured motion of the crane: discrete LQR about the reference, with an estimate of disturbances.

The error e of the state (angles, lengths, swing and their rates) is predicted over the step by the plant linearised at
the reference, so that the outputs, which act one step later than what was measured, lose nothing by it:

    e+ = A e + B0 u + B1 u- + E d        u: feedback in this step, u-: in the one before (first-order hold)
    d+ = d + L (e - predicted e)         d: force on the load, from the velocity that the prediction missed
    u+ = u_d - K (e+ - e_d, u - u_d)     e_d, u_d: where the load rests on its path in spite of d

K minimises the sum of |w C e|^2 + |u/f|^2 with C e the error of the load's position; f makes one unit of u one m/s2 of
the part it moves. Everything is a function of the present reference, parameters and step: nothing is scheduled by hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crane_fmu.slave.paths import Array
from crane_fmu.slave.state import PlainState
from servocore import Plant

WEIGHT = 1000.0
"""Of an error of the load's position in m against an input worth 1 m/s2."""

EFFORT = (1.5, 0.7, 1.0)
"""How freely bridge, trolley and winch are used."""

RATE_OF_LEARNING = 0.5
"""Fraction of a missed velocity of the load by which the estimated force is corrected in a step."""

_FEWEST_DOUBLINGS, _MOST_DOUBLINGS = 4, 60
_TERMS = 12


@dataclass(frozen=True, eq=False)
class Control(PlainState):
    """What the feedback remembers from one step to the next.

    Attributes
    ----------
    predicted : ndarray, shape (10,)
        Error expected for the next measurement.
    force : ndarray, shape (3,)
        Estimated disturbance of the load in N.
    now, before : ndarray, shape (3,)
        Feedback that acts in the coming step, and in the one before.
    """

    predicted: Array
    force: Array
    now: Array
    before: Array


def controlled(
    plant: Plant, p: Array, jet: Array, inputs: Array, measured: Array, h: float, memory: Control | None
) -> Control:
    """Return the feedback for the next step in `now` of what it returns.

    Parameters
    ----------
    plant : Plant
        The crane in the coordinates phi, s, l and two swing angles.
    p : ndarray
        Its parameters, bridge inertia, trolley mass, load mass, winch inertia, winch radius and gravity first.
    jet : ndarray, shape (5, 3)
        The load's path at the time of the measurement.
    inputs : ndarray, shape (3,)
        What the path takes then.
    measured : ndarray, shape (12,)
        phi, s, l, their rates, position and velocity of the load.
    h : float
        Step in s.
    memory : Control or None
        None when there was no feedback in the step before.
    """
    wanted = crane_state(_flat(jet, p[5]), jet[0], jet[1])
    error = crane_state(measured[:6], measured[6:9], measured[9:12]) - wanted
    error[0] -= 2.0 * math.pi * round(error[0] / (2.0 * math.pi))
    A, B, E, C = plant.linearised(wanted, inputs, p)
    Ad, B0, B1, Ed = _sampled(A, B, E, h)
    zero = np.zeros(3)
    force, now, before = (zero, zero, zero) if memory is None else (memory.force, memory.now, memory.before)
    if memory is not None:
        velocity = np.hstack([np.zeros((3, 5)), C[:, :5]])
        missed = velocity @ (error - memory.predicted)
        force = force + RATE_OF_LEARNING * np.linalg.solve(velocity @ Ed, missed)
    predicted = Ad @ error + B0 @ now + B1 @ before + Ed @ force
    balance = np.block([[A, B], [C, np.zeros((3, 3))]])
    target = np.linalg.solve(balance, -np.concatenate([E @ force, zero]))
    gain = _gain(Ad, B0, B1, C, _efforts(p, wanted[1]))
    feedback = target[10:] - gain @ np.concatenate([predicted - target[:10], now - target[10:]])
    return Control(predicted, force, feedback, now)


def _efforts(p: Array, s: float) -> Array:
    """Return the inputs worth 1 m/s2 of bridge (at the trolley), trolley and winch with load, as freely as wanted."""
    bridge, trolley, load, winch, radius = p[:5]
    efforts: Array = np.array(EFFORT) * np.array(
        [bridge / s + trolley * s, trolley, (load + winch / radius**2) * radius]
    )
    return efforts


def _flat(jet: Array, g: float) -> tuple[float, ...]:
    """Return phi, s, l and their rates for a load path: the trolley stands where the rope pulls from."""
    r, v, a, j = jet[:4]
    k = -r[2] / (g + a[2])
    k_dot = (-v[2] + r[2] * j[2] / (g + a[2])) / (g + a[2])
    place, speed = r[:2] + k * a[:2], v[:2] + k_dot * a[:2] + k * j[:2]
    s = math.hypot(*place)
    rope, rope_dot = np.append(r[:2] - place, r[2]), np.append(v[:2] - speed, v[2])
    length = float(np.linalg.norm(rope))
    turning = (place[0] * speed[1] - place[1] * speed[0]) / s**2
    return math.atan2(place[1], place[0]), s, length, turning, place @ speed / s, rope @ rope_dot / length


def crane_state(motion: Sequence[float] | Array, r: Array, v: Array) -> Array:
    """Return (phi, s, l, swing in and out of the bridge's plane) and the rates, for a load at r with velocity v.

    The motion is that of the crane: phi, s, l and their rates.
    """
    phi, s, length, phi_dot, s_dot, length_dot = motion
    cos, sin = math.cos(phi), math.sin(phi)
    along, across, down = cos * r[0] + sin * r[1] - s, cos * r[1] - sin * r[0], -r[2]
    along_dot = cos * v[0] + sin * v[1] + phi_dot * across - s_dot
    across_dot = cos * v[1] - sin * v[0] - phi_dot * (along + s)
    down_dot = -v[2]
    plane = math.hypot(along, down)
    plane_dot = (along * along_dot + down * down_dot) / plane
    swing_in_dot = (along_dot * down - along * down_dot) / plane**2
    swing_out_dot = (across_dot * plane - across * plane_dot) / (across**2 + plane**2)
    swing = math.atan2(along, down), math.atan2(across, plane)
    return np.array([phi, s, length, *swing, phi_dot, s_dot, length_dot, swing_in_dot, swing_out_dot])


def _sampled(A: Array, B: Array, E: Array, h: float) -> tuple[Array, Array, Array, Array]:
    """Return the matrices over a step in which u goes on as from the step before, and d is constant."""
    n = len(A)
    generator = np.zeros((n + 9, n + 9))
    generator[:n, :n], generator[:n, n : n + 3], generator[:n, n + 6 :] = A, B, E
    generator[n : n + 3, n + 3 : n + 6] = np.eye(3)
    grown = _exponential(generator * h)[:n]
    slope = grown[:, n + 3 : n + 6] / h
    return grown[:, :n], grown[:, n : n + 3] + slope, -slope, grown[:, n + 6 :]


def _exponential(M: Array) -> Array:
    """Matrix exponential by Taylor's series of a small fraction, squared."""
    norm = float(np.abs(M).sum(axis=1).max())
    halvings = max(0, math.ceil(math.log2(max(norm, 1e-300))) + 2)
    small, term = M / 2.0**halvings, np.eye(len(M))
    total = term.copy()
    for k in range(1, _TERMS):
        term = term @ small / k
        total += term
    for _ in range(halvings):
        total = total @ total
    return total


def _gain(Ad: Array, B0: Array, B1: Array, C: Array, efforts: Array) -> Array:
    """Return K of the state (e, u of the step before)."""
    n = len(Ad)
    A = np.block([[Ad, B1], [np.zeros((3, n + 3))]])
    B = np.vstack([B0, np.eye(3)])
    weight = np.zeros((n + 3, n + 3))
    weight[:n, :n] = WEIGHT**2 * C.T @ C
    effort = np.diag(1.0 / efforts**2)
    cost = riccati(A, B, weight, effort)
    gain: Array = np.linalg.solve(effort + B.T @ cost @ B, B.T @ cost @ A)
    return gain


def riccati(A: Array, B: Array, Q: Array, R: Array) -> Array:
    """Solve X = A'XA - A'XB (R + B'XB)^-1 B'XA + Q by structure-preserving doubling (Chu, Fan, Lin and Wang 2004)."""
    G, H, F, one = B @ np.linalg.solve(R, B.T), Q, A, np.eye(len(A))
    for k in range(_MOST_DOUBLINGS):
        W = np.linalg.solve(one + G @ H, np.hstack([F, G]))
        WF, WG = W[:, : len(A)], W[:, len(A) :]
        growth = F.T @ H @ WF
        F, G, H = F @ WF, G + F @ WG @ F.T, H + (growth + growth.T) / 2.0
        if k >= _FEWEST_DOUBLINGS and np.abs(growth).max() < 1e-12 * np.abs(H).max():
            break
    return H
