"""Feedback on the measured motion of the crane: calls the functions that `crane_fmu.build.feedback_law` has made."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from crane_fmu.slave.carried_functions import Call, called
from crane_fmu.slave.interface import INPUT_TIMES
from crane_fmu.slave.paths import Array


@dataclass(frozen=True)
class Feedback:
    """The feedback for one input time.

    Attributes
    ----------
    begin : callable
        (jet, measured, p, h) -> [memory].
    follow : callable
        (memory, jet, jet before, measured, acting, feedforward, p, h, share, limits) -> [memory, inputs].
    size : int
        Length of the memory.
    """

    begin: Call
    follow: Call
    size: int


def feedbacks(functions: Mapping[str, ca.Function]) -> dict[str, Feedback]:
    """Return the feedback by input time."""
    found = {}
    for time in INPUT_TIMES:
        begin, follow = (functions[f"{name}_{time}"] for name in ("begin", "feedback"))
        found[time] = Feedback(called(begin), called(follow), follow.numel_in(0))
    return found


def fastest_pendulum(p: Sequence[float] | Array, length: float, lift: float) -> float:
    """Return the angular frequency in rad/s of a load on a rope below a trolley that is free to roll.

    Parameters
    ----------
    p : sequence of float
        The crane's parameters.
    length, lift : float
        Of the rope in m, and upward acceleration of the load in m/s2.
    """
    return math.sqrt(max(p[5] + lift, 0.0) / length * (1.0 + p[2] / p[1]))
