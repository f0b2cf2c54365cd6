"""Functions that an FMU carries, as text and as machine code."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca
import numpy as np

from crane_fmu.slave.interface import COMPILED, FEEDBACK_FORMAT
from crane_fmu.slave.paths import Array
from servocore import InvalidSetting

Call = Callable[..., list[Array]]


def carried(text: str, library: Path) -> dict[str, ca.Function]:
    """Return functions by name.

    Parameters
    ----------
    text : str
        What the FMU carries.
    library : Path
        File with some of them as machine code; without it, or where the system cannot load it, CasADi interprets the
        text.
    """
    plain = json.loads(text)
    if plain.get("format") != FEEDBACK_FORMAT:
        raise InvalidSetting("the FMU's feedback has another format than this slave reads")
    found = dict(zip(plain["names"], ca.StringDeserializer(plain["functions"]).unpack(), strict=True))
    return {name: _loaded(each, library) if name in COMPILED else each for name, each in found.items()}


def _loaded(function: ca.Function, library: Path) -> ca.Function:
    if not (sys.platform == "linux" and library.is_file()):
        return function
    try:
        compiled = ca.external(function.name(), str(library))
    except Exception:  # made for another system: what CasADi raises is not documented
        return function
    sizes = [[each.numel_in(k) for k in range(each.n_in())] for each in (compiled, function)]
    return compiled if sizes[0] == sizes[1] else function


def called(function: ca.Function) -> Call:
    """Return a function of arrays, evaluated in arrays that are allocated once."""
    buffer, evaluate = function.buffer()
    arguments = [np.zeros(function.numel_in(k)) for k in range(function.n_in())]
    results = [np.zeros(function.numel_out(k)) for k in range(function.n_out())]
    for k, argument in enumerate(arguments):
        buffer.set_arg(k, argument.data)
    for k, result in enumerate(results):
        buffer.set_res(k, result.data)

    def call(*given: Array | Sequence[float] | float) -> list[Array]:
        for place, value in zip(arguments, given, strict=True):
            place[:] = value
        evaluate()
        return [each.copy() for each in results]

    call.keeps = buffer, function  # type: ignore[attr-defined]  # they must live as long
    return call
