"""Feedback on the measured motion of the crane: calls the functions that `crane_fmu.build.feedback_law` has made."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from crane_fmu.slave.interface import FEEDBACK_FORMAT, INPUT_TIMES
from crane_fmu.slave.paths import Array
from servocore import InvalidSetting

Call = Callable[..., list[Array]]


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


def feedbacks(text: str, library: Path) -> dict[str, Feedback]:
    """Return the feedback by input time.

    Parameters
    ----------
    text : str
        What the FMU carries.
    library : Path
        File with the same as machine code; without it, or where the system cannot load it, CasADi interprets the text.
    """
    plain = json.loads(text)
    if plain.get("format") != FEEDBACK_FORMAT:
        raise InvalidSetting("the FMU's feedback has another format than this slave reads")
    functions = dict(zip(plain["names"], ca.StringDeserializer(plain["functions"]).unpack(), strict=True))
    found = {}
    for time in INPUT_TIMES:
        begin, follow = (functions[f"{name}_{time}"] for name in ("begin", "feedback"))
        found[time] = Feedback(_call(begin), _call(_loaded(follow, library)), follow.numel_in(0))
    return found


def _loaded(function: ca.Function, library: Path) -> ca.Function:
    if not (sys.platform == "linux" and library.is_file()):
        return function
    try:
        compiled = ca.external(function.name(), str(library))
    except Exception:  # made for another system: what CasADi raises is not documented
        return function
    sizes = [[each.numel_in(k) for k in range(each.n_in())] for each in (compiled, function)]
    return compiled if sizes[0] == sizes[1] else function


def _call(function: ca.Function) -> Call:
    """Return a function of arrays, evaluated in arrays that are allocated once."""
    buffer, evaluate = function.buffer()
    arguments = [np.zeros(function.numel_in(k)) for k in range(function.n_in())]
    results = [np.zeros(function.numel_out(k)) for k in range(function.n_out())]
    for k, each in enumerate(arguments):
        buffer.set_arg(k, each.data)
    for k, each in enumerate(results):
        buffer.set_res(k, each.data)

    def call(*given: Array | Sequence[float] | float) -> list[Array]:
        for place, value in zip(arguments, given, strict=True):
            place[:] = value
        evaluate()
        return [each.copy() for each in results]

    call.keeps = buffer, function  # type: ignore[attr-defined]  # they must live as long
    return call


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
