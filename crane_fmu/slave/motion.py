"""What the FMU computes, without anything of FMI: pure functions from one `Snapshot` to the next.

A communication step is divided into equal steps of the method. A method that reads few derivatives of the path
rebuilds the others from the history in its state; that history holds the step size. So when the step changes the
history is *rebuilt* for the new one: from exact values a few steps back, along the path's Taylor polynomial, up to
the present. Without that the first step after a change would have an error that no small step size reduces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from crane_fmu.slave.interface import SHORTEST_STEP
from crane_fmu.slave.paths import ROWS, Array, LoadPath, taylor
from crane_fmu.slave.saved_state import PlainState
from servocore import InconsistentStart, IntegrationFailed, Program

JITTER = 1e-6
"""Relative change of the step up to which it counts as the same: hosts compute it from rounded times."""

_FULL_DERIVATIVES = 3  # of the path: a step that reads so many needs no history of it


@dataclass(frozen=True, eq=False)
class Snapshot(PlainState):
    """All that the crane's motion knows at an instant; never changed in place.

    Attributes
    ----------
    time : float
        In s.
    step : float
        Last step of the method in s; 0 before the first.
    state : ndarray
        The program's flat state.
    jet : ndarray, shape (5, 3)
        The path at `time`.
    values : ndarray
        Values of the program's channels, angles continuous.
    """

    time: float
    step: float
    state: Array
    jet: Array
    values: Array


def begin(program: Program, jet: Array, p: Array, time: float) -> Snapshot:
    """Return exact values for a jet.

    Raises
    ------
    InvalidReference
        If the jet breaks a limit of the crane.
    InconsistentStart
        If the values are not found.
    IntegrationFailed
        If they are those of another branch of the equations.
    """
    gamma = _padded(program, jet)
    program.require_within_limits(gamma, p, time)
    state, report = program.begin(gamma, p)
    if not report.converged:
        raise InconsistentStart(f"{program.name}: no consistent values at t = {time:.6g} s")
    values = program.values(state, gamma, p)
    program.require_branch(values, time)
    return Snapshot(time, 0.0, state, jet, values)


def advance(program: Program, before: Snapshot, path: LoadPath, h: float, count: int, p: Array) -> Snapshot:
    """Take `count` equal steps along a path, a communication step of h seconds in all.

    Parameters
    ----------
    program : Program
        Model, formulation and method.
    before : Snapshot
        At the start of the communication step; its jet is used to rebuild the history.
    path : callable
        (time after the start) -> jet.
    h : float
        Communication step in s.
    count : int
        Into how many steps it is divided.
    p : ndarray
        The program's parameters.

    Raises
    ------
    InvalidReference
        If the path breaks a limit of the crane at the end of a step.
    InconsistentStart, IntegrationFailed
        If a start or a step is not solved, or its solution is on another branch of the equations.
    """
    step = h / count
    if step < SHORTEST_STEP:
        exact = begin(program, path(h), p, before.time + h)
        return replace(exact, step=step, values=_continuous(program, exact.values, before.values))
    if abs(step - before.step) > JITTER * step:
        before = replace(before, state=_history(program, before, step, p))
    start = before.time
    for k in range(count):
        end = start + h if k == count - 1 else start + (k + 1) * step
        jets = np.stack([_padded(program, path((k + c) * step)) for c in program.nodes])
        before = _one_step(program, before, jets, step, end, p)
    return before


def with_path(program: Program, now: Snapshot, jet: Array, p: Array) -> Snapshot:
    """Return the present with the path told for it, which so far was only extrapolated.

    Raises
    ------
    InvalidReference
        If the jet breaks a limit of the crane.
    InconsistentStart
        If inputs came only after the initialization and no values are found for them.
    """
    if now.step == 0.0 and not np.array_equal(jet, now.jet):
        return begin(program, jet, p, now.time)
    program.require_within_limits(_padded(program, jet), p, now.time)
    return replace(now, jet=jet)


def _one_step(program: Program, before: Snapshot, jets: Array, h: float, end: float, p: Array) -> Snapshot:
    """Take one step to the time `end`; the jets belong to the nodes of the step."""
    program.require_within_limits(jets[-1], p, end)
    state, report = program.advance(before.state, jets, h, p)
    if not report.converged:
        worst = program.worst_equation(before.state, jets, h, p)
        raise IntegrationFailed(
            f"{program.name}: the step from t = {before.time:.6g} s to {end:.6g} s was not solved; the worst"
            f" equation is the {worst}. Likely causes: a step too large for the path, or inputs that are not"
            f" derivatives of each other"
        )
    values = _continuous(program, program.values(state, jets[-1], p), before.values)
    program.require_branch(values, end)
    return Snapshot(end, h, state, jets[-1, :ROWS], values)


def _history(program: Program, now: Snapshot, h: float, p: Array) -> Array:
    """Return the state that the method would have now had it always taken the step h."""
    # Before the first step the method's own start will do; later, what it would have come to.
    steps = max(0, _FULL_DERIVATIVES - program.order) if now.step > 0.0 else 0
    instants = [(c - steps) * h for c in program.start_instants]
    state, report = program.begin(np.stack([_padded(program, taylor(now.jet, instant)) for instant in instants]), p, h)
    for k in range(steps):
        if report.converged:
            offsets = [(k + c - steps) * h for c in program.nodes]
            jets = np.stack([_padded(program, taylor(now.jet, offset)) for offset in offsets])
            state, report = program.advance(state, jets, h, p)
    if not report.converged:
        raise IntegrationFailed(
            f"{program.name}: at t = {now.time:.6g} s the step cannot change from {now.step:.6g} s to {h:.6g} s;"
            f" the path continued backwards leaves the crane's range"
        )
    return state


def _continuous(program: Program, values: Array, before: Array) -> Array:
    """Return `values` with angles within half a turn of those `before`."""
    for k, channel in enumerate(program.channels):
        if channel.wraps:
            values[k] += 2.0 * math.pi * round((before[k] - values[k]) / (2.0 * math.pi))
    return values


def _padded(program: Program, jet: Array) -> Array:
    """Return a jet with as many rows as the program takes; its results do not depend on those beyond the fourth."""
    rows = program.start_order + 1
    if rows <= ROWS:
        return jet
    padded = np.zeros((rows, jet.shape[1]))
    padded[:ROWS] = jet
    return padded
