"""Runs of the reduced form whose states are chosen again where they become a bad choice.

States of internal dynamics are picked from redundant variables by pivoting at one configuration. A pendulum given by
its x and y, say, starts with x as state; where it hangs level, x no longer determines y. The run is watched, cut
there, and continued with other states from the same values.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.numerics.calls import Call
from servocore.structure.derivative_array import DerivativeArray, choose_states
from servocore.checks.limits import side_by_side
from servocore.formulations import Reduced
from servocore.solvers.fixed_step import CHUNK, Progress, Run, advance, begin, failure, observe, statistics
from servocore.methods import Method
from servocore.methods.base import instantaneous
from servocore.stepping.program import Program
from servocore.solution import Solution
from servocore.stepping.initial_values import compile_restart
from servocore.stepping.stepper import Stepper
from servocore.structure.structural_analysis import system_jacobian
from servocore.model.symbols import Array
from servocore.model.system import MechanicalSystem

_POOR = 0.1  # of the smallest singular value that all candidates together have

States = tuple[tuple[int, int], ...]


@dataclass(frozen=True, eq=False)
class _Segment:
    """Part of a run with one choice of states: its program, the instants and what happened."""

    program: Program
    t: Array
    run: Run


def solve_with_states(stepper: Stepper, formulation: Reduced, t: Array, progress: Progress | None = None) -> Solution:
    """Step a reduced form with internal dynamics through the instants `t`.

    Raises
    ------
    IntegrationFailed
        If a step is not solved and no other choice of states helps.
    """
    reference, p, count = stepper.scene.reference, stepper.parameters, len(t) - 1
    state, _ = begin(reference, stepper.program, p, stepper.step)
    length = -(-count // -(-count // CHUNK))
    segments: list[_Segment] = []
    at, restarted_at = 0, -1
    while at < count:
        program = stepper.program
        part, complete = advance(reference, program, p, t[at : at + length + 1], stepper.step, state, length)
        array = formulation.array(stepper.system)
        values = _array_values(array, part.states)
        good, better = _watch(array, reference.jet(t[at : at + values.shape[1]], array.reference_order), values, p)
        if better is None and not complete:
            better = _best_states(array, reference.jet(t[at + good], array.reference_order), values[:, good], p)
            if better == array.states or restarted_at == at:
                raise failure(reference, program, p, part.states[:, good], t[at + good], stepper.step)
        segments.append(_Segment(program, t[at : at + good + 1], replace(part, states=part.states[:, : good + 1])))
        at, state = at + good, part.states[:, good]
        if better is not None and at < count:
            restarted_at = at
            formulation = Reduced(states=tuple((array.names[j], order) for j, order in better))
            stepper = replace(stepper, formulation=formulation)
            state = _restarted(stepper, formulation, float(t[at]), values[:, good])
        if progress is not None:
            progress(at, count)
    return _put_together(stepper, segments, t)


def _array_values(array: DerivativeArray, states: Array) -> Array:
    """Unknowns of the derivative array (unknowns, N), from states that begin with [x; z] of the reduced form."""
    entries = (*array.states, *array.determined)
    return states[[entries.index(each) for each in array.unknowns]]


def _watch(array: DerivativeArray, gamma: Array, values: Array, p: Array) -> tuple[int, States | None]:
    """Return the first instant at which other states are much better, and these; or the last instant and None."""
    J = _jacobians(array, gamma, values, p)
    for k in np.flatnonzero(_quality(array, J) < _POOR):
        better = choose_states(array.signature, J[k])
        if k > 0 and better != array.states:
            return int(k), better
    return values.shape[1] - 1, None


def _best_states(array: DerivativeArray, gamma: Array, values: Array, p: Array) -> States:
    return choose_states(array.signature, _jacobians(array, gamma[None], values[:, None], p)[0])


def _quality(array: DerivativeArray, J: Array) -> Array:
    """Smallest singular value of the chosen columns relative to that of all candidates, over all levels; shape (N,)."""
    c, d = array.signature.equation_offsets, array.signature.variable_offsets
    scaled = J / np.maximum(np.abs(J).max(axis=2, keepdims=True), 1e-300)
    worst = np.ones(len(J))
    for level in range(1, max(d) + 1):
        rows = [i for i in range(len(c)) if c[i] >= level]
        candidates = [j for j in range(len(d)) if d[j] >= level]
        chosen = [j for j in candidates if (j, d[j] - level) not in array.states]
        if rows and len(chosen) < len(candidates):
            own, best = (np.linalg.svd(scaled[:, rows][:, :, k], compute_uv=False)[:, -1] for k in (chosen, candidates))
            worst = np.minimum(worst, np.divide(own, best, out=np.zeros(len(J)), where=best > 0.0))
    return worst


def _jacobians(array: DerivativeArray, gamma: Array, values: Array, p: Array) -> Array:
    """Return the system Jacobian (N, size, size) for jets (N, orders, m) and unknowns (unknowns, N)."""
    count = len(gamma)
    (found,) = _mapped(array, count)(values, side_by_side(gamma), np.tile(p[:, None], count))
    size = len(array.names)
    return found.reshape(size, count, size).transpose(1, 0, 2)


@lru_cache(maxsize=32)
def _mapped(array: DerivativeArray, count: int) -> Call:
    """Return (unknowns, gamma, p) -> system Jacobian, for `count` instants side by side."""
    reference = array.system.gamma[:, : array.reference_order + 1]
    J = ca.substitute(system_jacobian(array.signature), array.signature.equations.y, array.y[:, :3])
    arguments = [array.column(array.unknowns), reference, array.system.p]
    return Call(ca.Function("sc_J", arguments, [ca.densify(J)]).map(count))


def _restarted(stepper: Stepper, formulation: Reduced, time: float, values: Array) -> Array:
    """Return the state of the stepper's program at a time where all unknowns of the derivative array are known."""
    program = stepper.program
    instants = time + stepper.step * np.array(program.start_instants)
    gamma = stepper.scene.reference.jet(instants, program.start_order)
    restart = _restart(stepper.system, formulation, stepper.method, program.start_order)
    return restart(values, side_by_side(gamma), stepper.step, stepper.parameters)[0]


@lru_cache(maxsize=32)
def _restart(system: MechanicalSystem, formulation: Reduced, method: Method, order: int) -> Call:
    array, dae = formulation.array(system), formulation.dae(system)
    discretisation = method.discretise(dae) if dae.x.numel() else instantaneous(dae)
    return Call(compile_restart(array, dae, discretisation, order))


def _put_together(stepper: Stepper, segments: list[_Segment], t: Array) -> Solution:
    """Observe every segment by its own program and join them; instants in common are taken from the later one."""
    reference, tables, violations = stepper.scene.reference, [], []
    for segment in segments:
        table, violation = observe(segment.program, reference, stepper.parameters, segment.t, segment.run.states)
        last = segment is segments[-1]
        tables.append(table if last else table[:-1])
        violations.append(violation)
    values = np.vstack(tables)
    program = segments[-1].program
    for k, channel in enumerate(program.channels):
        if channel.wraps:
            values[:, k] = np.unwrap(values[:, k])
    total = Run(
        np.empty((0, len(t))),
        sum(segment.run.newton_iterations for segment in segments),
        sum(segment.run.factorisations for segment in segments),
        max(segment.run.worst_residual for segment in segments),
    )
    choices = 1 + sum(a.program is not b.program for a, b in itertools.pairwise(segments))
    summary = statistics(total, values[:, : len(stepper.system.inputs)], np.hstack(violations))
    summary = replace(summary, choices_of_states=choices)
    return Solution(t, program.channels, values, program.name, summary, reference.fit_error)
