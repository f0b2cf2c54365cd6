"""Runs at constant step, on the reduced form with states that are chosen again where they become a bad choice.

States of internal dynamics are picked from redundant variables by pivoting at one configuration. A pendulum given by
its x and y, say, starts with x as state; where it hangs level, x no longer determines y. The run is watched, cut
there, and continued with other states from the same values.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from servocore.checks.before_run import internal_dynamics
from servocore.checks.better_solutions import LARGEST_UNWARNED, NOTICED, BetterSolver, excited_mode, stated_branch
from servocore.errors import InconsistentStart, IntegrationFailed
from servocore.formulations.base import Formulation
from servocore.formulations.original import Original
from servocore.formulations.reduced import Reduced
from servocore.methods.base import Method, errs_less_with_smaller_steps
from servocore.methods.collocation import RadauIIA
from servocore.numerics.compiled_calls import Array, Places, call_of, side_by_side
from servocore.numerics.memoization import made_once
from servocore.problem import Problem
from servocore.references.base import subdivided
from servocore.solution import Solution
from servocore.solvers.exact_inversion import EXACT
from servocore.solvers.route import Adaptive, JudgedRoute
from servocore.solvers.runs import (
    Progress,
    Run,
    advance_chunk,
    chunk_length,
    first_state,
    run_steps,
    solution_of,
    step_failure,
    step_of,
)
from servocore.solvers.stable_inversion import StableInversion
from servocore.stepping.exact_evaluation import along_path, guessed_unknowns
from servocore.stepping.program import program_of
from servocore.structure.derivative_array import DerivativeArray, choose_states
from servocore.structure.inversion import system_jacobian

BETTER_METHOD = RadauIIA(5)
"""What steps are compared with, on the reduced form."""

_EVERY, _GOOD = 8, 0.5  # instants at which so good states are judged: they do not turn poor and good again in between
_POOR = 0.1  # of the smallest singular value that all candidates together have

States = tuple[tuple[int, int], ...]
Block = tuple[Places, ...]


@dataclass(frozen=True)
class Stepped(JudgedRoute):
    """Steps of a method, one after the other.

    Parameters
    ----------
    formulation, method : Formulation, Method
        The form and the method that steps it.
    native : bool, optional
        Whether as machine code; in the background where there is much to do when not given.
    """

    formulation: Formulation
    method: Method
    native: bool | None = None

    def better(self, problem: Problem) -> BetterSolver:
        """Return the exact inversion, the bounded one, or a method of high order; see `JudgedRoute`."""
        if problem.flat:
            return EXACT
        if internal_dynamics(problem).grows:
            return BetterSolver(StableInversion().run, True, "the stable inversion")
        form = self.formulation if isinstance(self.formulation, Reduced) else Reduced()
        return BetterSolver(FixedStep(form, BETTER_METHOD).run, False, f"{BETTER_METHOD.name} on the reduced form")

    def branch_statement(self, problem: Problem, solution: Solution) -> str:
        """Compare a solution with the exact motion, or with a better solution where it is doubtful."""
        better, motion = None, solution.motion
        if motion is not None and motion.values is not None:
            exact = replace(solution, t=motion.t, values=motion.values.T)
            better = replace(EXACT, run=lambda *_: exact)
        # Of unstable dynamics its user was warned before the run.
        elif not (problem.flat or internal_dynamics(problem).grows):
            excited = excited_mode(problem, solution)
            if self._is_doubtful(problem, solution, *excited):
                better = replace(self.better(problem), excited=excited)
        return stated_branch(problem, solution, better, self._advice(problem))

    def _is_doubtful(self, problem: Problem, solution: Solution, radians: float, share: float) -> bool:
        """Whether inputs may be far from right, with internal dynamics that do not grow.

        Free motion of z radians in a step (`excited_mode`) errs by z^(order + 1) in each, and tolerances are kept by
        two runs that both damp it. Other stable results of collocation on a form of index one are right where third
        differences of all values are small.
        """
        index, values, summary = problem.dae(self.formulation).index, solution.values, solution.statistics
        order = self.method.orders(index).forces
        if share > LARGEST_UNWARNED and summary.steps * radians ** (max(order, 0) + 1) > NOTICED:
            return True
        if summary.error_estimate is not None:
            return not summary.error_estimate <= NOTICED
        stable = index <= 1 and isinstance(self.method, RadauIIA) and order > 1
        allowed = NOTICED * np.ptp(values, axis=0)
        return not (stable and len(values) > 3 and (np.abs(np.diff(values, 3, axis=0)).max(axis=0) <= allowed).all())

    def _advice(self, problem: Problem) -> str:
        """Return the advice: the default route, unless this is it, and smaller steps only where the inputs converge."""
        index, advice = problem.dae(self.formulation).index, list[str]()
        if problem.flat:
            advice.append("the default route, solve without a form and a method, has no step")
        elif index > 1 or self.method != RadauIIA(3):
            advice.append("the default route, solve without a form and a method, errs less")
        converges = self.method.orders(index).forces >= 1 and errs_less_with_smaller_steps(self.method, index)
        if converges and not isinstance(self.formulation, Original):
            advice.append("a smaller step errs less")
        return "; ".join(advice)


class FixedStep(Stepped):
    """One step of a method from instant to instant.

    On the reduced form with other states wherever the chosen ones become a bad choice; those of its formulation are the
    ones to begin with.
    """

    def run(self, problem: Problem, times: Array, progress: Progress = lambda *_: None) -> Solution:
        """Step through the instants and report every one; see `Route`.

        Raises
        ------
        IntegrationFailed
            If a step is not solved and no other choice of states helps.
        """
        formulation, step, count = self.formulation, step_of(times), len(times) - 1
        program = program_of(problem, formulation, self.method, self.native, len(times))
        if not isinstance(formulation, Reduced):
            return solution_of(problem, [run_steps(problem, program, times, progress)])
        try:
            state, _ = first_state(problem, program, step)
        except InconsistentStart:
            # States were chosen where nothing is symmetric: where a linkage starts stretched, others may be needed.
            formulation = _states_at_start(problem, formulation)
            program = program_of(problem, formulation, self.method, self.native, len(times))
            state, _ = first_state(problem, program, step)
        length, segments = chunk_length(count), list[Run]()
        at, restarted_at = 0, -1
        while at < count:
            part, complete = advance_chunk(problem, program, times[at : at + length + 1], step, state, length)
            array = program.array
            # States begin with [x; z] of the reduced form.
            entries = (*array.states, *array.determined)
            values = part.states[[entries.index(unknown) for unknown in array.unknowns]]
            good, better = _watch(problem, array, times[at : at + values.shape[1]], values)
            if better is None and not complete:
                better = _best_states(problem, array, times[at + good], values[:, good])
                # Without this a run would restart at the same instant without end.
                if better == array.states or restarted_at == at:
                    raise step_failure(problem, program, part.states[:, good], times[at + good], step)
            segments.append(part.at(slice(good + 1)))
            at, state = at + good, part.states[:, good]
            if better is not None and at < count:
                restarted_at = at
                formulation = replace(formulation, states=array.named(better))
                program = program_of(problem, formulation, self.method, self.native, len(times))
                gamma = problem.reference.jet(times[at] + step * np.array(program.start_instants), program.start_order)
                state = call_of(program.restart)(values[:, good], side_by_side(gamma), step, problem.p)[0]
            progress(at, count)
        return solution_of(problem, segments)


def _watch(problem: Problem, array: DerivativeArray, t: Array, values: Array) -> tuple[int, States | None]:
    """Return the first instant at which other states are much better, and these; or the last instant and None."""
    last = values.shape[1] - 1
    some = np.append(np.arange(0, last, _EVERY), last)
    if (_quality(array, _system_jacobians(problem, t[some], values[:, some])) > _GOOD).all():
        return last, None
    J = _system_jacobians(problem, t, values)
    for k in np.flatnonzero(_quality(array, J) < _POOR):
        better = choose_states(array.signature, J[k])
        # A change at the first instant of a chunk would gain no step.
        if k > 0 and better != array.states:
            return int(k), better
    return last, None


def _best_states(problem: Problem, array: DerivativeArray, time: float, values: Array) -> States:
    return choose_states(array.signature, _system_jacobians(problem, np.array([time]), values[:, None])[0])


def _system_jacobians(problem: Problem, t: Array, states: Array) -> Array:
    """Return the system Jacobians at instants, shape (N, size, size), zeros for what is not finite."""
    (rows,) = along_path(problem, system_jacobian(problem.array), t, states)
    return np.asarray(np.where(np.isfinite(rows), rows, 0.0).reshape(len(rows), len(t), -1).transpose(1, 0, 2))


def _states_at_start(problem: Problem, formulation: Reduced) -> Reduced:
    """Return a form with the best states at the guess of the model where the path starts."""
    array, time = problem.array, problem.reference.start_time
    values = guessed_unknowns(problem, np.array([time]))[:, 0]
    return replace(formulation, states=array.named(_best_states(problem, array, time, values)))


def _quality(array: DerivativeArray, J: Array) -> Array:
    """Smallest singular value of the chosen columns relative to that of all candidates, over all levels; shape (N,)."""
    # Rows of one size: units must not decide which states are good.
    scaled = J / np.maximum(np.abs(J).max(axis=2, keepdims=True), 1e-300)
    worst = np.ones(len(J))
    for places in _candidates(array):
        present, best = (np.linalg.svd(scaled[:, *each], compute_uv=False)[:, -1] for each in places)
        worst = np.minimum(worst, np.divide(present, best, out=np.zeros(len(J)), where=best > 0.0))
    return worst


@made_once
def _candidates(array: DerivativeArray) -> list[tuple[Block, Block]]:
    """Return rows and columns of the system Jacobian by level: those that are solved for, and all candidates.

    Derivatives that are no states are solved for: their columns must stay far from singular.
    """
    c, d = array.signature.equation_offsets, array.signature.variable_offsets
    found = dict[tuple[tuple[int, ...], ...], tuple[Block, Block]]()  # levels often have the same
    for level in range(1, max(d) + 1):
        rows = tuple(i for i in range(len(c)) if c[i] >= level)
        candidates = tuple(j for j in range(len(d)) if d[j] >= level)
        chosen = tuple(j for j in candidates if (j, d[j] - level) not in array.states)
        if rows and len(chosen) < len(candidates):
            found[rows, chosen, candidates] = np.ix_(rows, chosen), np.ix_(rows, candidates)
    return [*found.values()]


# Error control --------------------------------------------------------------------------------------------------------

# On projected forms (index 3) the local error of the inputs scales like tolerance / h^2, so that a test of it rejects
# steps without end, and steps that vary add an error that does not fall with the step. So whole runs at constant step
# are repeated with half the step until the inputs agree.

_STAGNATION = 1.3  # a halved step that improves the inputs by less has met a floor
_MOST_STEPS = 1_000_000


@dataclass(frozen=True)
class ToTolerance(Stepped):
    """So accurate that every input meets a tolerance at the instants.

    Parameters
    ----------
    control : Adaptive
        The accuracy wanted.
    """

    control: Adaptive = field(default_factory=Adaptive)

    def run(self, problem: Problem, times: Array, progress: Progress = lambda *_: None) -> Solution:
        """Solve to the tolerance; see `Route`.

        Raises
        ------
        IntegrationFailed
            If the tolerance cannot be met, with the accuracy that was reached and the reason.
        """
        program = program_of(problem, self.formulation, self.method, self.native, len(times))
        control, order = self.control, self.method.orders(program.index).forces
        inputs, coarse, last_change, division = len(problem.system.inputs), None, None, 1
        while (count := (len(times) - 1) * division) <= _MOST_STEPS:
            done = run_steps(problem, program, subdivided(times, division), progress)
            fine = solution_of(problem, [done.at(slice(None, None, division))], refuse_turns=False)
            if coarse is not None:
                peaks = np.abs(fine.values[:, :inputs]).max(axis=0)
                change = np.abs(fine.values - coarse.values)[:, :inputs].max(axis=0)
                ratio = None if last_change is None else last_change / np.maximum(change, 1e-300)
                # Richardson: with order p the difference of two runs is (2^p - 1) times the error of the finer one. The
                # order is that observed, and one while only one difference is known.
                observed = 1.0 if ratio is None else np.clip(np.log2(np.maximum(ratio, 1e-300)), 0.5, max(1, order))
                estimate = change / (2.0**observed - 1.0)
                unmet, relative = estimate > control.allowed(peaks), estimate / np.maximum(peaks, 1e-300)
                if not unmet.any():
                    total, error = 2 * count - len(times) + 1, float(relative.max())  # of all runs
                    return replace(fine, statistics=replace(fine.statistics, steps=total, error_estimate=error))
                # Halving no longer helps: round-off, or errors that nothing damps, have met the error of the method.
                if ratio is not None and ratio[unmet].min() < _STAGNATION:
                    worst = int(relative.argmax())
                    raise IntegrationFailed(
                        f"{program.name}: {problem.system.inputs[worst].name} stopped improving at"
                        f" {relative[worst]:.2g} of its peak after {count} steps, but rtol is {control.rtol:g}; likely"
                        " causes: round-off, which grows like 1/h^2 on this form, a method that does not damp errors of"
                        " the inputs, or a path that is not smooth enough"
                    )
                last_change = change
            coarse, division = fine, 2 * division
        raise IntegrationFailed(f"{program.name}: {_MOST_STEPS} steps are not enough")
