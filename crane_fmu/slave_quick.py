"""The usual communication step as one compiled call, where `slave_motion` takes several.

A step that is like the one before, not divided and within all limits needs no decision: the path's continuation,
limits, step and outputs become one function. Anything else, mistakes included, is left to `slave_motion`, which
finds the words; so this module changes what a step costs and nothing that a host can see.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from functools import cache
from struct import Struct

import casadi as ca
import numpy as np

from crane_fmu.interface import DIMENSION
from crane_fmu.slave_motion import JITTER, SHORTEST_STEP, Snapshot
from crane_fmu.slave_paths import ROWS, Array
from servocore import Program


class QuickStep:
    """One step of the method from the jet that the host tells, evaluated in arrays that are allocated once.

    Parameters
    ----------
    program : Program
        Model, formulation and method; the last with one node, at the end of the step.
    """

    def __init__(self, program: Program) -> None:
        function = _compiled(program)
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
        if h < SHORTEST_STEP or not abs(h - before.step) <= JITTER * h:
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
            turns = round((before.values.item(k) - values.item(k)) / (2.0 * math.pi))
            if turns:
                values[k] += 2.0 * math.pi * turns
        jets = found[state:reached].reshape(ROWS, DIMENSION)
        return Snapshot(before.time + h, h, found[:state], jets, values)


@cache
def quick_step(program: Program) -> QuickStep | None:
    """Return the quick step of a program, or None if its method has other nodes; it is compiled once in a process."""
    return QuickStep(program) if program.nodes == (1.0,) else None


def _compiled(program: Program) -> ca.Function:
    """Return (state, jet, tau, h, parameters) -> (state, jet, values, 1 if all is well) of flat vectors."""
    sizes = (program.state_size, ROWS * DIMENSION, 1, 1, len(program.parameters))
    given = ca.MX.sym("given", sum(sizes))
    state, told, tau, h, p = ca.vertsplit(given, np.cumsum([0, *sizes]).tolist())
    now = ca.reshape(told, DIMENSION, ROWS)
    then = _continuation()(now, tau)
    after, _, residual = program.step(state, _columns(then, program.order + 1), h, p)
    values, _ = program.observe(after, _columns(then, program.start_order + 1), p)
    margins = [program.margins(_columns(each, program.start_order + 1), p) for each in (now, then)]
    well = _judgement(program.state_size + 1, 2 * len(program.limits))(
        ca.vertcat(after, residual), ca.vertcat(*margins)
    )
    return ca.Function("quick", [given], [ca.densify(ca.vertcat(after, ca.vec(then), values, well))])


def _continuation() -> ca.Function:
    """Return Taylor's polynomial: (jet, tau) -> jet; one column a derivative."""
    jet, tau = ca.SX.sym("jet", DIMENSION, ROWS), ca.SX.sym("tau")
    columns = []
    for k in range(ROWS):
        column = jet[:, ROWS - 1]
        for j in reversed(range(k, ROWS - 1)):  # Horner: column becomes jet_j + tau / (j - k + 1) column
            column = jet[:, j] + tau / (j - k + 1) * column
        columns.append(column)
    return ca.Function("continuation", [jet, tau], [ca.horzcat(*columns)])


def _columns(jet: ca.MX, count: int) -> ca.MX:
    """Return the first derivatives of a jet; those beyond what is told are zero, no result depends on them."""
    return jet[:, :count] if count <= ROWS else ca.horzcat(jet, ca.MX.zeros(DIMENSION, count - ROWS))


def _judgement(numbers: int, margins: int) -> ca.Function:
    """Return (numbers, margins) -> 1 if the former are finite and the latter positive, else 0; NaN is neither."""
    x, m = ca.SX.sym("x", numbers), ca.SX.sym("m", margins)
    good = ca.vertcat(ca.fabs(x) <= sys.float_info.max, m > 0.0)
    return ca.Function("judgement", [x, m], [ca.sum1(good) == numbers + margins])
