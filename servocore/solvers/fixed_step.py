"""The loop over time at constant step: compiled chunks, and what a failed step has to say."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.numerics.calls import Call
from servocore.errors import InconsistentStart, IntegrationFailed, InvalidReference
from servocore.checks.limits import side_by_side
from servocore.stepping.program import Program
from servocore.references import Reference
from servocore.solution import Statistics
from servocore.model.symbols import Array

Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

CHUNK = 512
"""Most steps in one compiled loop: cheap to build, and progress can be shown in between."""


_DIFFERENCES, _FEWEST_FOR_NOISE = 8, 32
_NORMAL_MEDIAN = 0.6745  # of the magnitude of a normal variable with deviation one


@dataclass(frozen=True, eq=False)
class Run:
    """States at all instants and what they took.

    Attributes
    ----------
    states : ndarray, shape (size, N + 1)
        The first column is the consistent start.
    newton_iterations, factorisations : int
        Totals.
    worst_residual : float
        Largest of all steps.
    """

    states: Array
    newton_iterations: int
    factorisations: int
    worst_residual: float


def begin(reference: Reference, program: Program, p: Array, step: float) -> tuple[Array, float]:
    """Return the consistent first state and its residual.

    Raises
    ------
    InvalidReference
        If the reference lacks derivatives.
    InconsistentStart
        If no consistent initial values are found.
    """
    if reference.max_order < program.start_order:
        raise InvalidReference(
            f"the path has derivatives up to order {reference.max_order},"
            f" {program.name} needs order {program.start_order}"
        )
    time = reference.start_time
    past = reference.jet(time + step * np.array(program.start_instants), program.start_order)
    state, report = program.begin(past, p, step)
    if not report.converged:
        raise InconsistentStart(f"{program.name}: no consistent initial values at t = {time:.6g} s")
    return state, report.residual


def run(
    reference: Reference, program: Program, p: Array, t: Array, step: float, progress: Progress | None = None
) -> Run:
    """Step from the start through the instants `t`, which lie one `step` apart.

    Raises
    ------
    InvalidReference, InconsistentStart
        As `begin`.
    IntegrationFailed
        If a step is not solved.
    """
    count = len(t) - 1
    length = -(-count // -(-count // CHUNK))
    state, first_residual = begin(reference, program, p, step)
    parts = [Run(state[:, None], 0, 0, first_residual)]
    for done in range(0, count, length):
        part, complete = advance(
            reference, program, p, t[done : done + length + 1], step, parts[-1].states[:, -1], length
        )
        if not complete:
            at = done + part.states.shape[1] - 1
            raise failure(reference, program, p, part.states[:, -1], t[at], step)
        parts.append(replace(part, states=part.states[:, 1:]))
        if progress is not None:
            progress(min(done + length, count), count)
    return joined(parts)


def joined(parts: list[Run]) -> Run:
    """Put runs of the same program one after the other."""
    return Run(
        np.hstack([part.states for part in parts]),
        sum(part.newton_iterations for part in parts),
        sum(part.factorisations for part in parts),
        max(part.worst_residual for part in parts),
    )


def advance(
    reference: Reference, program: Program, p: Array, t: Array, step: float, state: Array, length: int
) -> tuple[Run, bool]:
    """Step from t[0], where `state` belongs, through the other instants, in one compiled loop of `length` steps.

    Returns the states from t[0] on, up to the last good one, and whether that is the last of all. A loop that is
    not full is padded with the final instant; what it gives there is dropped.
    """
    used = len(t) - 1
    ends = t[np.minimum(np.arange(1, length + 1), used)]
    nodes = [reference.jet(ends - (1.0 - c) * step, program.order) for c in program.nodes]
    found, counts, worst = _accumulated(program.step, length)(
        state,
        side_by_side(np.concatenate(nodes, axis=1)),
        np.full((1, length), step),
        np.tile(p[:, None], length),
    )
    found, counts = (each.reshape(-1, length, order="F")[:, :used] for each in (found, counts))
    worst = worst.ravel()[:used]
    failed = ~np.isfinite(found).all(axis=0) | ~np.isfinite(worst)
    good = int(failed.argmax()) if failed.any() else used
    if good == 0 and length > 1:
        # Where CasADi gives up, all of the loop is lost; step by step it ends at the last good state.
        return _one_by_one(reference, program, p, t, step, state)
    iterations, factorisations = counts[:, :good].sum(axis=1)
    states = np.hstack([state[:, None], found[:, :good]])
    return Run(states, round(iterations), round(factorisations), float(worst[:good].max(initial=0.0))), good == used


def _one_by_one(
    reference: Reference, program: Program, p: Array, t: Array, step: float, state: Array
) -> tuple[Run, bool]:
    parts = [Run(state[:, None], 0, 0, 0.0)]
    for k in range(len(t) - 1):
        part, complete = advance(reference, program, p, t[k : k + 2], step, parts[-1].states[:, -1], 1)
        parts.append(replace(part, states=part.states[:, 1:]))
        if not complete:
            return joined(parts), False
    return joined(parts), True


def failure(
    reference: Reference, program: Program, p: Array, state: Array, time: float, step: float
) -> IntegrationFailed:
    """Return the error that says where a step failed and why that may be."""
    nodes = np.array([time + c * step for c in program.nodes])
    worst = program.worst_equation(state, reference.jet(nodes, program.order), step, p)
    causes = "a step too large for the path, or a configuration close to a singular one"
    if program.index > 3:
        causes = f"errors that this form of index {program.index} amplifies from step to step, {causes}"
    return IntegrationFailed(
        f"{program.name}: the step from t = {time:.6g} s to {time + step:.6g} s was not solved;"
        f" the worst equation is the {worst}. Likely causes: {causes}"
    )


def observe(
    program: Program, reference: Reference, p: Array, t: Array, states: Array, angles: tuple[int, ...] = ()
) -> tuple[Array, Array]:
    """Return observed values (N, channels), angles made continuous, and violations (4, N).

    Raises
    ------
    IntegrationFailed
        If the states have left the branch of the equations that is wanted, or one of the channels `angles` turns by
        half a turn or more from one instant to the next, which cannot be told from a turn the other way round.
    """
    jets, count = reference.jet(t, program.start_order), len(t)
    values, violations = _mapped(program.observe, count)(states, side_by_side(jets), np.tile(p[:, None], count))
    table = values.T
    for k in angles:
        _require_less_than_half_a_turn(program, k, t, table[:, k])
    for k, channel in enumerate(program.channels):
        if channel.wraps:
            table[:, k] = np.unwrap(table[:, k])
        if channel.positive and not (table[:, k] > 0.0).all():
            first = int((~(table[:, k] > 0.0)).argmax())
            program.require_branch(table[first], float(t[first]))
    return table, violations


def _require_less_than_half_a_turn(program: Program, channel: int, t: Array, angle: Array) -> None:
    turns = np.abs(np.diff(angle))
    if not (turns < np.pi).all():
        k = int((~(turns < np.pi)).argmax())
        raise IntegrationFailed(
            f"{program.name}: {program.channels[channel].name} turns by {turns[k]:.4g} rad in the step from"
            f" t = {t[k]:.6g} s to {t[k + 1]:.6g} s, a step tells turns of less than pi from those the other way round;"
            f" a smaller step is needed"
        )


def input_noise(inputs: Array) -> float | None:
    """Estimate the noise of trajectories (N, m) relative to their peaks, from differences of order eight.

    Of white noise they keep sqrt(16 over 8) times the deviation; of a smooth trajectory they leave h^8 times its eighth
    derivative. The median of their magnitudes passes over kinks.
    """
    if len(inputs) < _FEWEST_FOR_NOISE:
        return None
    deviation = np.median(np.abs(np.diff(inputs, _DIFFERENCES, axis=0)), axis=0) / _NORMAL_MEDIAN
    peaks = np.maximum(np.abs(inputs).max(axis=0), 1e-300)
    return float((deviation / math.sqrt(math.comb(2 * _DIFFERENCES, _DIFFERENCES)) / peaks).max())


def statistics(done: Run, inputs: Array, violations: Array) -> Statistics:
    """Sum up a run with the inputs (N, m) it gave."""
    servo, servo_rate, constraint, constraint_rate = (float(each) for each in violations.max(axis=1))
    return Statistics(
        steps=done.states.shape[1] - 1,
        newton_iterations=done.newton_iterations,
        factorisations=done.factorisations,
        worst_residual=done.worst_residual,
        servo_violation=servo,
        servo_rate_violation=servo_rate,
        constraint_violation=constraint,
        constraint_rate_violation=constraint_rate,
        input_noise=input_noise(inputs),
    )


@lru_cache(maxsize=128)
def _mapped(function: ca.Function, count: int) -> Call:
    return Call(function.map(count))


@lru_cache(maxsize=128)
def _accumulated(function: ca.Function, count: int) -> Call:
    return Call(function.mapaccum(f"{function.name()}_loop", count))
