"""Runs at constant step, in compiled chunks, and solutions from their states: observed, judged and summed up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from servocore.checks.between_instants import require_less_than_half_a_turn
from servocore.checks.motion import Motion
from servocore.errors import InconsistentStart, IntegrationFailed, InvalidReference
from servocore.formulations.reduced import Reduced
from servocore.model.limits import run_quantities
from servocore.numerics.compiled_calls import Array, at_instants, chained, repeated, side_by_side
from servocore.numerics.step_operations import JUMPS
from servocore.problem import Problem
from servocore.solution import Solution, Statistics
from servocore.stepping.exact_evaluation import along_path, guessed_unknowns, unknowns_from
from servocore.stepping.prescribed_initial_values import prescribed_start
from servocore.stepping.program import Program, program_of


def require_derivatives(problem: Problem, order: int, who_needs: str) -> None:
    """Raise `InvalidReference` if the path lacks derivatives up to an order; `who_needs` them, for the message."""
    most = problem.reference.max_order
    if most < order:
        raise InvalidReference(f"the path has derivatives up to order {most}, {who_needs} order {order}")


@dataclass(frozen=True, eq=False)
class Run:
    """States of a program at instants, and the totals of the run.

    Attributes
    ----------
    program : Program
        It stepped, and observes.
    t : ndarray, shape (N,)
        Instants in s.
    states : ndarray, shape (size, N)
        The first column is the consistent start.
    newton_iterations, factorizations : int
        Totals.
    worst_residual : float
        Largest of all steps.
    observed : tuple of ndarray
        Values (channels, N), violations (4, N) and whatever was evaluated with them; empty where they are not known.
    jets : ndarray, shape (N, orders, m)
        Of the path at the instants, where the steps read them; empty elsewhere.
    """

    program: Program
    t: Array
    states: Array
    newton_iterations: int = 0
    factorizations: int = 0
    worst_residual: float = 0.0
    observed: tuple[Array, ...] = ()
    jets: Array = field(default_factory=lambda: np.empty((0, 0, 0)))

    def at(self, chosen: slice) -> Run:
        """Return the run at some of its instants."""
        return replace(self, t=self.t[chosen], states=self.states[:, chosen], jets=self.jets[chosen])


def solution_of(
    problem: Problem, segments: list[Run], route: str = "", *, refuse_turns: bool = True, motion: Motion | None = None
) -> Solution:
    """Observe the states of a run, each part by its own program, and sum the run up.

    Parameters
    ----------
    problem : Problem
        The problem that was solved.
    segments : list of Run
        Parts that follow one another; the instant that two have in common is taken from the later one.
    route : str
        How it was solved, if the name of the last program does not say it.
    refuse_turns : bool
        Whether an angle that turns by half a turn within a step is refused, since its direction is ambiguous.
    motion : Motion, optional
        The exact motion, for checks, which says how the run is known to be on one branch.

    Raises
    ------
    IntegrationFailed
        If the states have left the branch of the equations that is wanted, or an angle turns so far between two
        instants that its direction is ambiguous.
    """
    observed = [_observed(problem, segment, refuse_turns) for segment in segments]
    program, t, (values, violations) = segments[-1].program, segments[-1].t, observed[-1]
    if len(segments) > 1:
        t = np.concatenate([*(part.t[:-1] for part in segments[:-1]), t])
        values = np.vstack([*(table[:-1] for table, _ in observed[:-1]), values])
        violations = np.hstack([each for _, each in observed])
    for k, channel in enumerate(program.channels):
        if channel.wraps and (np.abs(np.diff(values[:, k])) >= np.pi).any():
            values[:, k] = np.unwrap(values[:, k])
    c, c_dot, g, g_dot = violations.max(axis=1).tolist()
    choices = 1 + sum(a.program is not b.program for a, b in pairwise(segments))
    totals, branch = (len(t) - 1, *_totals(segments)), "" if motion is None else motion.branch
    summary = Statistics(*totals, c, c_dot, g, g_dot, choices_of_states=choices, branch=branch)
    fit_error = problem.reference.fit_error
    return Solution(t, program.channels, values, route or program.name, summary, fit_error, motion=motion)


def of_states(problem: Problem, t: Array, states: Array) -> Array:
    """Return [x; z] of the reduced form (size, N) at instants, solved for internal states (len x, N)."""
    array, guess = problem.array, guessed_unknowns(problem, t)
    guess[array.places(array.states)] = states
    return np.asarray(unknowns_from(problem, t, guess)[array.places((*array.states, *array.determined))])


def solution_of_states(problem: Problem, t: Array, values: Array, route: str, iterations: int = 0) -> Solution:
    """Return the solution with [x; z] of the reduced form (size, N) at instants."""
    from servocore.methods.backward_euler import BackwardEuler  # noqa: PLC0415 - a flat scene takes no steps

    program = program_of(problem, Reduced(), BackwardEuler())
    states = np.pad(values, ((0, program.state_size - len(values)), (0, 0)))
    return solution_of(problem, [Run(program, t, states, iterations, iterations)], route)


def _observed(problem: Problem, segment: Run, refuse_turns: bool) -> tuple[Array, Array]:
    """Return observed values (N, channels) and violations (4, N)."""
    program, t, known, jets = segment.program, segment.t, segment.observed, segment.jets
    orders = program.observe.size2_in(1)
    if not known and len(jets) and jets.shape[1] >= orders:
        known = at_instants(program.observe, segment.states, jets=jets[:, :orders], p=problem.p)
    observed, violations, *_ = known or along_path(problem, program.observe, t, segment.states)
    table = observed.T
    finite = np.isfinite(table[:, : len(problem.system.inputs)])
    if not finite.all():  # no equation of the derivative array may show that
        k, j = np.argwhere(~finite)[0]
        raise IntegrationFailed(
            f"{program.name}: at t = {t[k]:.6g} s {program.channels[j].name} is {table[k, j]}: a term of the model is"
            " no finite number there, as v/|v| is none at rest"
        )
    if refuse_turns and program.index > 1:  # else velocities are unknowns too, and decide
        require_less_than_half_a_turn(problem, program, t, table)
    for k, channel in enumerate(program.channels):
        if channel.positive and not (table[:, k] > 0.0).all():
            first = int((~(table[:, k] > 0.0)).argmax())
            program.require_branch(table[first], float(t[first]))
    return table, violations


def with_run_quantities(solution: Solution) -> Solution:
    """Return a solution with energies of powers and effective torques of motors up to every instant."""
    found, t = run_quantities(solution.channels), solution.t
    if not found:
        return solution
    table = np.column_stack([solution.values, *(each.course(t, each.integrand(solution[each.of])) for each in found)])
    return replace(solution, channels=(*solution.channels, *found), values=table)


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
    require_derivatives(problem, program.start_order, f"{program.name} needs")
    time = problem.reference.start_time
    past = problem.reference.jet(time + step * np.array(program.start_instants), program.start_order)
    if problem.start:
        return prescribed_start(problem, program.restart, past, step)
    state, report = program.begin(past, problem.p, step)
    if not report.converged:
        raise InconsistentStart(
            f"{program.name}: no consistent initial values at t = {time:.6g} s were found from the guess of the model"
        )
    return state, report.residual


def run_steps(problem: Problem, program: Program, t: Array, progress: Progress = lambda *_: None) -> Run:
    """Step a form by a method from the start through the instants `t`, evenly apart.

    Raises
    ------
    InvalidReference, InconsistentStart
        As `first_state`.
    IntegrationFailed
        If a step is not solved.
    """
    step, count = step_of(t), len(t) - 1
    length, parts, at = chunk_length(count), list[Run](), 0
    state, first_residual = first_state(problem, program, step)
    while at < count:
        part, complete = advance_chunk(problem, program, t[at : at + length + 1], step, state, length)
        at, state = at + len(part.t) - 1, part.states[:, -1]
        if not complete:
            raise step_failure(problem, program, state, float(t[at]), step)
        parts.append(part.at(slice(int(len(parts) > 0), None)))  # it begins at the last instant of the one before
        progress(at, count)
    states, jets = np.hstack([part.states for part in parts]), np.concatenate([part.jets for part in parts])
    iterations, factorizations, worst = _totals(parts)
    return Run(program, t, states, iterations, factorizations, max(first_residual, worst), jets=jets)


def _totals(parts: list[Run]) -> tuple[int, int, float]:
    """Return Newton iterations and factorizations in all, and the largest residual."""
    each = [(part.newton_iterations, part.factorizations, part.worst_residual) for part in parts]
    iterations, factorizations, residuals = zip(*each, strict=True)
    return sum(iterations), sum(factorizations), max(residuals)


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

    Returns the states from t[0] on, up to the last good one, and whether no step failed; it may end before the last
    instant. A loop that is not full is padded with the final instant; its results there are dropped.
    """
    used = len(t) - 1
    # All chunks are of one length, so that one compiled loop serves them: to build another costs more than padding.
    nodes = program.node_times(t[np.minimum(np.arange(1, length + 1), used)], step)
    jets = problem.reference.jet(np.append(t[0], nodes), program.order)
    states_after, counts, worst = chained(program.step, length)(
        state,
        side_by_side(jets[1:]),
        np.full((1, length), step),
        repeated(problem.p, length),
    )
    states_after, counts = (array.reshape(-1, length, order="F")[:, :used] for array in (states_after, counts))
    worst = worst.ravel()[:used]
    # CasADi reports no failure from within a loop: a step that is not solved answers NaN.
    failed = ~np.isfinite(states_after).all(axis=0) | ~np.isfinite(worst)
    good = int(failed.argmax()) if failed.any() else used
    if good == 0 and length > 1:
        # Where CasADi gives up, all of the loop is lost: a part of it ends at a good state.
        half = length // 2
        return advance_chunk(problem, program, t[: half + 1], step, state, half)
    states = np.hstack([state[:, None], states_after[:, :good]])
    iterations, factorizations = (round(total) for total in counts[:, :good].sum(axis=1))
    residual = float(worst[:good].max(initial=0.0))
    at_ends = jets[:: len(program.nodes)][: good + 1] if program.nodes[-1] == 1.0 else jets[:0]
    return Run(program, t[: good + 1], states, iterations, factorizations, residual, jets=at_ends), good == used


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
