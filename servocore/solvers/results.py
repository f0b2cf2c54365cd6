"""From states to a `Solution`: the one place where values are observed, judged and summed up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from servocore.errors import IntegrationFailed, InvalidReference
from servocore.model.quantity import run_quantities
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import Solution, Statistics
from servocore.stepping.exact_evaluation import along_path
from servocore.stepping.program import Program

_DIFFERENCES, _FEWEST_FOR_NOISE = 8, 32
_NORMAL_MEDIAN = 0.6745  # of the magnitude of a normal variable with deviation one


def require_derivatives(problem: Problem, program: Program) -> None:
    """Raise `InvalidReference` if the path lacks derivatives that a program needs."""
    most = problem.reference.max_order
    if most < program.start_order:
        raise InvalidReference(
            f"the path has derivatives up to order {most}, {program.name} needs order {program.start_order}"
        )


@dataclass(frozen=True, eq=False)
class Run:
    """States at all instants, and the totals of the run.

    Attributes
    ----------
    states : ndarray, shape (size, N + 1)
        The first column is the consistent start.
    newton_iterations, factorizations : int
        Totals.
    worst_residual : float
        Largest of all steps.
    """

    states: Array
    newton_iterations: int
    factorizations: int
    worst_residual: float


def joined_runs(parts: list[Run]) -> Run:
    """Put runs of the same program one after the other."""
    return Run(
        np.hstack([part.states for part in parts]),
        sum(part.newton_iterations for part in parts),
        sum(part.factorizations for part in parts),
        max(part.worst_residual for part in parts),
    )


@dataclass(frozen=True, eq=False)
class Segment:
    """Part of a run by one program: the instants, its states there and the totals.

    `observed` holds values (channels, N) and violations (4, N) where they are known already.
    """

    program: Program
    t: Array
    run: Run
    observed: tuple[Array, Array] | None = None


def solution_of(
    problem: Problem, segments: list[Segment], route: str = "", *, refuse_turns: bool = True, **statistics: Any
) -> Solution:
    """Observe the states of a run, each part by its own program, and sum the run up.

    Parameters
    ----------
    problem : Problem
        The problem that was solved.
    segments : list of Segment
        Parts that follow one another; the instant that two have in common is taken from the later one.
    route : str
        How it was solved, if the name of the last program does not say it.
    refuse_turns : bool
        Whether an angle that turns by half a turn within a step is refused, since its direction is ambiguous.
    **statistics
        Entries of `Statistics` that do not follow from the states.

    Raises
    ------
    IntegrationFailed
        If the states have left the branch of the equations that is wanted, or an angle turns so far between two
        instants that its direction is ambiguous.
    """
    tables, violations = [], []
    for segment in segments:
        table, violation = _observed(problem, segment, refuse_turns)
        tables.append(table if segment is segments[-1] else table[:-1])
        violations.append(violation)
    program = segments[-1].program
    if len(segments) == 1:  # without copies, which take as long as a check where there are many instants
        t, values, violation = segments[0].t, tables[0], violations[0]
    else:
        t = np.concatenate([*(part.t[:-1] for part in segments[:-1]), segments[-1].t])
        values, violation = np.vstack(tables), np.hstack(violations)
        for k, channel in enumerate(program.channels):
            if channel.wraps:
                values[:, k] = np.unwrap(values[:, k])
    summary = _summed_up(segments, values[:, : len(problem.system.inputs)], violation)
    return Solution(
        t, program.channels, values, route or program.name, replace(summary, **statistics), problem.reference.fit_error
    )


def _observed(problem: Problem, segment: Segment, refuse_turns: bool) -> tuple[Array, Array]:
    """Return observed values (N, channels), angles made continuous, and violations (4, N)."""
    program, t, states = segment.program, segment.t, segment.run.states
    if segment.observed is None:
        observed, violations = along_path(problem, program.observe, t, states)
    else:
        observed, violations = segment.observed
    table = observed.T
    _require_numbers(problem, program, t, table)
    if refuse_turns and program.index > 1:  # else velocities are unknowns too, and decide
        from servocore.checks.angles import require_less_than_half_a_turn  # noqa: PLC0415 - few forms need it

        require_less_than_half_a_turn(problem, program, t, table)
    for k, channel in enumerate(program.channels):
        if channel.wraps and (np.abs(np.diff(table[:, k])) >= np.pi).any():
            table[:, k] = np.unwrap(table[:, k])
        if channel.positive and not (table[:, k] > 0.0).all():
            first = int((~(table[:, k] > 0.0)).argmax())
            program.require_branch(table[first], float(t[first]))
    return table, violations


def _require_numbers(problem: Problem, program: Program, t: Array, table: Array) -> None:
    """Raise `IntegrationFailed` if an input is not finite: no equation of the derivative array may show that."""
    finite = np.isfinite(table[:, : len(problem.system.inputs)])
    if not finite.all():
        k, j = np.argwhere(~finite)[0]
        raise IntegrationFailed(
            f"{program.name}: at t = {t[k]:.6g} s {program.channels[j].name} is {table[k, j]}: a term of the model is"
            " no finite number there, as v/|v| is none at rest"
        )


def _summed_up(segments: list[Segment], inputs: Array, violations: Array) -> Statistics:
    servo, servo_rate, constraint, constraint_rate = (float(largest) for largest in violations.max(axis=1))
    return Statistics(
        steps=len(inputs) - 1,
        newton_iterations=sum(segment.run.newton_iterations for segment in segments),
        factorizations=sum(segment.run.factorizations for segment in segments),
        worst_residual=max(segment.run.worst_residual for segment in segments),
        servo_violation=servo,
        servo_rate_violation=servo_rate,
        constraint_violation=constraint,
        constraint_rate_violation=constraint_rate,
        choices_of_states=1 + sum(a.program is not b.program for a, b in pairwise(segments)),
        input_noise=input_noise(inputs),
    )


def input_noise(inputs: Array) -> float | None:
    """Estimate the noise of trajectories (N, m) relative to their peaks, from differences of order eight.

    Of white noise they keep sqrt(16 over 8) times the deviation; of a smooth trajectory they leave h^8 times its eighth
    derivative. The median of their magnitudes passes over kinks.
    """
    if len(inputs) < _FEWEST_FOR_NOISE:
        return None
    deviations = np.array([_median_difference(row) for row in inputs.T]) / _NORMAL_MEDIAN
    peaks = np.array([max(row.max(), -row.min(), 1e-300) for row in inputs.T])
    return float((deviations / math.sqrt(math.comb(2 * _DIFFERENCES, _DIFFERENCES)) / peaks).max())


def _median_difference(row: Array) -> float:
    """Return the median of the magnitudes of the differences of order eight; one row at a time stays in the cache."""
    here, there = row.copy(), np.empty_like(row)
    for size in range(len(row) - 1, len(row) - 1 - _DIFFERENCES, -1):
        np.subtract(here[1 : size + 1], here[:size], out=there[:size])
        here, there = there, here
    differences = np.abs(here[:size])
    middle = size // 2
    differences.partition(middle)  # one place at a time, which runs side by side
    upper = differences[middle]
    return float(upper if size % 2 else 0.5 * (upper + differences[:middle].max()))


def with_run_quantities(solution: Solution) -> Solution:
    """Return a solution with energies of powers and effective torques of motors up to every instant."""
    found, t = run_quantities(solution.channels), solution.t
    if not found or len(t) < 2:
        return solution
    table = np.column_stack([solution.values, *(each.course(t, solution[each.of]) for each in found)])
    return replace(solution, channels=(*solution.channels, *(each.quantity for each in found)), values=table)


def without_run_quantities(solution: Solution) -> Solution:
    """Return a solution with the quantities of its instants alone, for comparisons with other runs."""
    added = [each.quantity for each in run_quantities(solution.channels)]
    own = [k for k, channel in enumerate(solution.channels) if channel not in added]
    return replace(solution, channels=tuple(solution.channels[k] for k in own), values=solution.values[:, own])
