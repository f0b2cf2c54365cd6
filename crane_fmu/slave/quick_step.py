"""The usual communication step as one compiled call, where `motion` takes several.

A step that is like the one before, not divided and within all limits needs no decision: the path's continuation,
limits, step and outputs become one function. Anything else, mistakes included, is left to `motion`, which
finds the words; so this module changes what a step costs and nothing that a host can see.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from struct import Struct

import casadi as ca
import numpy as np

from crane_fmu.slave.interface import DIMENSION, SHORTEST_STEP
from crane_fmu.slave.motion import JITTER, Snapshot
from crane_fmu.slave.paths import ROWS, Array, continued
from servocore import Program

_NAME = "usual_step"


class QuickStep:
    """One step of the method from the jet that the host tells, evaluated in arrays that are allocated once.

    Parameters
    ----------
    program : Program
        Model, formulation and method; the last with one node, at the end of the step.
    function : casadi.Function
        Its `usual_step`, interpreted or compiled.

    Attributes
    ----------
    is_compiled : bool
        False where CasADi interprets the function.
    """

    def __init__(self, program: Program, function: ca.Function) -> None:
        self.is_compiled = function.class_name() == "External"
        self._arguments, self._results = np.zeros(function.numel_in(0)), np.zeros(function.numel_out(0))
        self._buffer, self._evaluate = function.buffer()
        self._buffer.set_arg(0, self._arguments.data)
        self._buffer.set_res(0, self._results.data)
        n, told = program.state_size, ROWS * DIMENSION
        self._state, self._parameters = self._arguments[:n], self._arguments[n + told + 2 :]
        self._told = Struct(f"{told + 2}d")  # jet, tau, h: packed in a third of the time that NumPy takes
        self._place, self._memory = n * self._arguments.itemsize, self._arguments.data.cast("B")
        self._known: Array | None = None  # the parameters that are in place
        self._ends = n, n + told, n + told + len(program.channels)
        self._turning = [k for k, channel in enumerate(program.channels) if channel.wraps]

    def __call__(self, before: Snapshot, jet: Sequence[float], tau: float, h: float, p: Array) -> Snapshot | None:
        """Take one step.

        Parameters
        ----------
        before : Snapshot
            At the start of the step.
        jet : sequence of 15 floats
            The path as the host tells it.
        tau : float
            For so many seconds the path is continued: h, or 0 when it is told for the end of the step.
        h : float
            The step in s.
        p : ndarray
            The program's parameters; an array is never changed in place.

        Returns
        -------
        Snapshot or None
            None when the step is not a usual one.
        """
        if h < SHORTEST_STEP or (h != before.step and not abs(h - before.step) <= JITTER * h):
            return None
        self._state[:] = before.state
        self._told.pack_into(self._memory, self._place, *jet, tau, h)
        if p is not self._known:
            self._parameters[:] = p
            self._known = p
        self._evaluate()
        if self._results.item(-1) != 1.0:
            return None
        found = self._results.copy()
        state, reached, observed = self._ends
        values = found[reached:observed]
        for k in self._turning:
            change = before.values.item(k) - values.item(k)
            if not -math.pi <= change <= math.pi:
                values[k] += 2.0 * math.pi * round(change / (2.0 * math.pi))
        jets = found[state:reached].reshape(ROWS, DIMENSION)
        after = object.__new__(Snapshot)  # its own way sets every field by a call and takes three times as long
        after.__dict__.update(time=before.time + h, step=h, state=found[:state], jet=jets, values=values)
        return after


def quick_step(program: Program, library: Path) -> QuickStep | None:
    """Return the quick step of a program, or None if its method has other nodes.

    Parameters
    ----------
    program : Program
        Model, formulation and method.
    library : Path
        File with the compiled function; without it, or where the system cannot load it, CasADi interprets the same.
    """
    if program.nodes != (1.0,):
        return None
    return QuickStep(program, _loaded(program, library) or usual_step(program))


def _loaded(program: Program, library: Path) -> ca.Function | None:
    if not (sys.platform == "linux" and library.is_file()):
        return None
    try:
        function = ca.external(_NAME, str(library))
    except Exception:  # made for another system: what CasADi raises is not documented
        return None
    fits = (function.n_in(), function.n_out()) == (1, 1) and function.numel_in(0) == sum(_sizes(program))
    return function if fits else None


def _sizes(program: Program) -> tuple[int, ...]:
    """Return the sizes of what a usual step is given: state, jet, tau, h, parameters."""
    return program.state_size, ROWS * DIMENSION, 1, 1, len(program.parameters)


def usual_step(program: Program) -> ca.Function:
    """Return (state, jet, tau, h, parameters) -> (state, jet, values, 1 if all is well) of flat vectors.

    What comes before and after the step is one function each: calls among compiled functions cost time as well.
    """
    sizes = _sizes(program)
    given = ca.MX.sym("given", sum(sizes))
    state, told, tau, h, p = ca.vertsplit(given, np.cumsum([0, *sizes]).tolist())
    then, gamma, margins = _before(program)(told, tau, p)
    after, _, residual = program.step(state, gamma, h, p)
    values, well = _after(program)(after, then, p, residual, margins)
    return ca.Function(_NAME, [given], [ca.densify(ca.vertcat(after, then, values, well))])


def _before(program: Program) -> ca.Function:
    """Return (jet, tau, parameters) -> (jet tau later, what the step reads of it, all margins)."""
    told, tau, p = ca.SX.sym("told", ROWS * DIMENSION), ca.SX.sym("tau"), ca.SX.sym("p", len(program.parameters))
    now = ca.reshape(told, DIMENSION, ROWS)
    then = ca.horzcat(*continued(ca.horzsplit(now), tau))
    margins = [program.margins(_columns(each, program.start_order + 1), p) for each in (now, then)]
    gamma = _columns(then, program.order + 1)
    return ca.Function("before", [told, tau, p], [ca.vec(then), ca.densify(gamma), ca.densify(ca.vertcat(*margins))])


def _after(program: Program) -> ca.Function:
    """Return (state, jet, parameters, residual, margins) -> (values, 1 if all is well)."""
    state, jet = ca.SX.sym("state", program.state_size), ca.SX.sym("jet", ROWS * DIMENSION)
    p, residual = ca.SX.sym("p", len(program.parameters)), ca.SX.sym("residual")
    margins = ca.SX.sym("margins", 2 * len(program.limits))
    values, _ = program.observe(state, _columns(ca.reshape(jet, DIMENSION, ROWS), program.start_order + 1), p)
    positive = values[[k for k, channel in enumerate(program.channels) if channel.positive]]  # else a wrong branch
    limited = ca.fabs(ca.vertcat(state, residual)) <= sys.float_info.max
    good = ca.vertcat(limited, margins > 0.0, positive > 0.0)  # NaN is none of it
    return ca.Function("after", [state, jet, p, residual, margins], [values, ca.sum1(good) == good.numel()])


def _columns(jet: ca.SX, count: int) -> ca.SX:
    """Return the first derivatives of a jet; those beyond what is told are zero, no result depends on them."""
    return jet[:, :count] if count <= ROWS else ca.horzcat(jet, ca.SX.zeros(DIMENSION, count - ROWS))
