"""The loop over time at constant step: compiled chunks, and what a failed step has to say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from servocore.calls import Call
from servocore.errors import InconsistentStart, IntegrationFailed, InvalidReference
from servocore.feasibility import side_by_side
from servocore.program import Program
from servocore.references import Reference
from servocore.solution import Statistics
from servocore.symbols import Array

Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

CHUNK = 512
"""Most steps in one compiled loop: cheap to build, and progress can be shown in between."""


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
    chunks = -(-count // CHUNK)
    length = -(-count // chunks)
    loop = _accumulated(program.step, length)
    state, first_residual = begin(reference, program, p, step)
    states, counts, residuals = [state[:, None]], [np.zeros((2, 0))], [np.array([first_residual])]
    for done in range(0, count, length):
        used = min(length, count - done)
        # A last chunk that is not full is padded with the final instant; what it gives there is dropped.
        ends = t[np.minimum(np.arange(done + 1, done + length + 1), count)]
        nodes = [reference.jet(ends - (1.0 - c) * step, program.order) for c in program.nodes]
        gamma = np.concatenate(nodes, axis=1)
        found, count_rows, worst = loop(
            states[-1][:, -1],
            side_by_side(gamma),
            np.full((1, length), step),
            np.tile(p[:, None], length),
        )
        found, count_rows, worst = found[:, :used], count_rows[:, :used], worst.ravel()[:used]
        failed = ~np.isfinite(found).all(axis=0) | ~np.isfinite(worst)
        if failed.any():
            at = int(failed.argmax())
            before = found[:, at - 1] if at else states[-1][:, -1]
            raise failure(reference, program, p, before, t[done + at], step)
        states.append(found)
        counts.append(count_rows)
        residuals.append(worst)
        if progress is not None:
            progress(done + used, count)
    iterations, factorisations = np.hstack(counts).sum(axis=1)
    return Run(np.hstack(states), round(iterations), round(factorisations), float(np.concatenate(residuals).max()))


def failure(
    reference: Reference, program: Program, p: Array, state: Array, time: float, step: float
) -> IntegrationFailed:
    """Return the error that says where a step failed and why that may be."""
    nodes = np.array([time + c * step for c in program.nodes])
    worst = program.worst_equation(state, reference.jet(nodes, program.order), step, p)
    return IntegrationFailed(
        f"{program.name}: the step from t = {time:.6g} s to {time + step:.6g} s was not solved;"
        f" the worst equation is the {worst}. Likely causes: a step too large for the path, or a configuration"
        f" close to a singular one"
    )


def observe(program: Program, states: Array, jets: Array, p: Array) -> tuple[Array, Array]:
    """Return observed values (N, channels), angles made continuous, and violations (4, N)."""
    count = len(jets)
    values, violations = _mapped(program.observe, count)(states, side_by_side(jets), np.tile(p[:, None], count))
    table = values.T
    for k, channel in enumerate(program.channels):
        if channel.wraps:
            table[:, k] = np.unwrap(table[:, k])
    return table, violations


def statistics(done: Run, violations: Array) -> Statistics:
    """Sum up a run."""
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
    )


@lru_cache(maxsize=128)
def _mapped(function: ca.Function, count: int) -> Call:
    return Call(function.map(count))


@lru_cache(maxsize=128)
def _accumulated(function: ca.Function, count: int) -> Call:
    return Call(function.mapaccum(f"{function.name()}_loop", count))
