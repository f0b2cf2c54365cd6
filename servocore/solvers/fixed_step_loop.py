"""The loop over time at constant step, in compiled chunks, and the message of a step that failed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from servocore.errors import InconsistentStart, IntegrationFailed
from servocore.numerics.compiled_calls import Array, chained, side_by_side
from servocore.numerics.step_operations import JUMPS
from servocore.problem import Problem
from servocore.solvers.results import Run, joined_runs, require_derivatives
from servocore.stepping.prescribed_initial_values import prescribed_start
from servocore.stepping.program import Program

Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

CHUNK = 512
"""Most steps in one compiled loop: cheap to build, and progress can be shown in between."""


def first_state(problem: Problem, program: Program, step: float) -> tuple[Array, float]:
    """Return the consistent first state of a form and method, and its residual.

    Raises
    ------
    InvalidReference
        If the reference lacks derivatives.
    InconsistentStart
        If no consistent initial values are found.
    InvalidSetting
        If the start of the problem does not name the states of its internal dynamics.
    """
    require_derivatives(problem, program)
    reference = problem.reference
    time = reference.start_time
    past = reference.jet(time + step * np.array(program.start_instants), program.start_order)
    if problem.start:
        return prescribed_start(problem, program.restart, past, step)
    state, report = program.begin(past, problem.p, step)
    if not report.converged:
        raise InconsistentStart(
            f"{program.name}: no consistent initial values at t = {time:.6g} s were found from the guess of the model"
        )
    return state, report.residual


def run_steps(problem: Problem, program: Program, t: Array, progress: Progress | None = None) -> Run:
    """Step a form by a method from the start through the instants `t`, evenly apart.

    Raises
    ------
    InvalidReference, InconsistentStart
        As `first_state`.
    IntegrationFailed
        If a step is not solved.
    """
    step, length = step_of(t), chunk_length(len(t) - 1)
    state, first_residual = first_state(problem, program, step)
    run, complete = _advanced(problem, program, t, step, state, length, progress)
    if not complete:
        raise step_failure(problem, program, run.states[:, -1], run.t[-1], step)
    return replace(run, worst_residual=max(run.worst_residual, first_residual))


def _advanced(
    problem: Problem, program: Program, t: Array, step: float, state: Array, length: int, progress: Progress | None
) -> tuple[Run, bool]:
    """Step from t[0] through the other instants in loops of one length; see `advance_chunk`."""
    parts, complete, count = [Run(program, t[:1], state[:, None])], True, len(t) - 1
    for done in range(0, count, length):
        now = parts[-1].states[:, -1]
        part, complete = advance_chunk(problem, program, t[done : done + length + 1], step, now, length)
        parts.append(part.at(slice(1, None)))
        if not complete:
            break
        if progress is not None:
            progress(min(done + length, count), count)
    return joined_runs(parts), complete


def step_of(t: Array) -> float:
    """Return the step between instants evenly apart."""
    return float(t[-1] - t[0]) / (len(t) - 1)


def chunk_length(count: int) -> int:
    """Return how many of `count` steps go into one compiled loop, so that all loops are of one length."""
    return -(-count // -(-count // CHUNK))


def advance_chunk(
    problem: Problem, program: Program, t: Array, step: float, state: Array, length: int
) -> tuple[Run, bool]:
    """Step from t[0], where `state` belongs, through the other instants, in one compiled loop of `length` steps.

    Returns the states from t[0] on, up to the last good one, and whether that is the last of all. A loop that is
    not full is padded with the final instant; its results there are dropped.
    """
    used = len(t) - 1
    # All chunks are of one length, so that one compiled loop serves them: to build another costs more than padding.
    ends = t[np.minimum(np.arange(1, length + 1), used)]
    nodes = (ends[:, None] - (1.0 - np.array(program.nodes)) * step).ravel()
    states_after, counts, worst = chained(program.step, length)(
        state,
        side_by_side(problem.reference.jet(nodes, program.order)),
        np.full((1, length), step),
        np.tile(problem.p[:, None], length),
    )
    states_after, counts = (array.reshape(-1, length, order="F")[:, :used] for array in (states_after, counts))
    worst = worst.ravel()[:used]
    # CasADi reports no failure from within a loop: a step that is not solved answers NaN.
    failed = ~np.isfinite(states_after).all(axis=0) | ~np.isfinite(worst)
    good = int(failed.argmax()) if failed.any() else used
    if good == 0 and length > 1:
        # Where CasADi gives up, all of the loop is lost; step by step it ends at the last good state.
        return _advanced(problem, program, t, step, state, 1, None)
    iterations, factorizations = counts[:, :good].sum(axis=1)
    states = np.hstack([state[:, None], states_after[:, :good]])
    worst_residual = float(worst[:good].max(initial=0.0))
    return Run(program, t[: good + 1], states, round(iterations), round(factorizations), worst_residual), good == used


_STICKS = (
    ", or a force that jumps, as dry friction does: where the body sticks, no step has a solution; use a smooth"
    " form such as tanh(v/e) for sign(v)"
)


def step_failure(problem: Problem, program: Program, state: Array, time: float, step: float) -> IntegrationFailed:
    """Return the error that says where a step failed and why that may be."""
    nodes = np.array([time + c * step for c in program.nodes])
    worst = program.worst_equation(state, problem.reference.jet(nodes, program.order), step, problem.p)
    return IntegrationFailed(
        f"{program.name}: the step from t = {time:.6g} s to {time + step:.6g} s was not solved;"
        f" the worst equation is the {worst}. Likely causes: {_likely_causes(program)}"
        + (_STICKS if problem.resolved.holds(JUMPS) else "")
    )


def _likely_causes(program: Program) -> str:
    """Say why a step may have failed. A smaller step is no cure where there is none, or where errors grow with it."""
    if program.index == 0:
        return "a configuration close to a singular one, or a guess of the model far from the answer"
    if program.index > 3:
        return (
            f"errors that this form of index {program.index} amplifies from step to step, more so the smaller the step,"
            " or a configuration close to a singular one"
        )
    if not program.smaller_steps_help:
        return (
            f"errors that this method does not damp on a form of index {program.index}, or a configuration close to a"
            " singular one"
        )
    return "a step too large for the path, or a configuration close to a singular one"
