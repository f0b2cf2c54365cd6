"""Error control: local where the index allows it, by whole runs where it does not.

On forms of index one and less the usual test of the local error works: each step
is repeated as two halves, and a PI controller chooses the next. On projected forms (index 3) the local error of the
inputs scales like tolerance / h^2 and a local test rejects steps without end; steps that vary add an error that does
not fall with the step. There whole runs at constant step are repeated with half the step until the inputs agree.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from servocore.checks.better_solutions import LOOSE_TOLERANCE
from servocore.errors import IntegrationFailed
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.solvers.fixed_step import Stepped
from servocore.solvers.fixed_step_loop import Progress, first_state, run_steps, step_of
from servocore.solvers.results import Run, Segment, joined_runs, solution_of
from servocore.solvers.route import Adaptive
from servocore.stepping.program import Program, program_of

_SAFETY, _LEAST, _MOST = 0.9, 0.2, 5.0
_STAGNATION = 1.3  # a halved step that improves the inputs by less has met a floor
_MOST_HALVINGS = 14


@dataclass(frozen=True)
class ToTolerance(Stepped):
    """So accurate that every input meets a tolerance at the instants.

    Parameters
    ----------
    control : Adaptive
        The accuracy wanted.
    """

    control: Adaptive = field(default_factory=Adaptive)

    def is_doubtful(self, _: Problem, solution: Solution) -> bool:
        """Whether the tolerance was too loose to prove that inputs are right."""
        return not (solution.statistics.error_estimate or np.inf) <= LOOSE_TOLERANCE

    def run(self, problem: Problem, times: Array, progress: Progress | None = None) -> Solution:
        """Solve to the tolerance; see `Route`.

        Raises
        ------
        IntegrationFailed
            If the tolerance cannot be met, with the accuracy that was reached and the reason.
        """
        program = program_of(problem, self.formulation, self.method, self.native, len(times))
        order = self.method.orders(program.index).forces
        if program.index <= 1:
            return _by_steps(problem, StepControl(self.control, program, problem, order), times, progress)
        return _by_runs(problem, program, self.control, order, times, progress)


def _by_runs(
    problem: Problem, program: Program, control: Adaptive, order: int, t: Array, progress: Progress | None
) -> Solution:
    """Halve the step of whole runs until the inputs at the instants `t` agree to the tolerance."""
    inputs = len(problem.system.inputs)
    coarse, last_change, total = None, None, 0
    for halvings in range(_MOST_HALVINGS):
        division = 2**halvings
        count = (len(t) - 1) * division
        if total + count > control.max_steps:
            raise IntegrationFailed(f"{program.name}: {control.max_steps} steps are not enough")
        total += count
        done = run_steps(problem, program, np.interp(np.arange(count + 1) / division, np.arange(len(t)), t), progress)
        segment = Segment(program, t, replace(done, states=done.states[:, ::division]))
        fine = solution_of(problem, [segment], refuse_turns=False, steps=total)
        if coarse is not None:
            peaks = np.abs(fine.values[:, :inputs]).max(axis=0)
            change = np.abs(fine.values - coarse.values)[:, :inputs].max(axis=0)
            ratio = None if last_change is None else last_change / np.maximum(change, 1e-300)
            # Richardson: with order p the difference of two runs is (2^p - 1) times the error of the finer one.
            estimate = change / (2.0 ** _observed_order(ratio, order) - 1.0)
            unmet = estimate > control.allowed(peaks)
            if not unmet.any():
                error = float((estimate / np.maximum(peaks, 1e-300)).max())
                return replace(fine, statistics=replace(fine.statistics, error_estimate=error))
            # Halving no longer helps: round-off, or errors that nothing damps, have met the error of the method.
            if ratio is not None and ratio[unmet].min() < _STAGNATION:
                raise IntegrationFailed(
                    _stagnation(problem, program, control, estimate / np.maximum(peaks, 1e-300), count)
                )
            last_change = change
        coarse = fine
    raise IntegrationFailed(f"{program.name}: {_MOST_HALVINGS} halvings of the step are not enough")


def _observed_order(ratio: Array | None, order: int) -> Array | float:
    """Order by which a difference of two runs is turned into an error; cautious while only one is known."""
    if ratio is None:
        return 1.0
    clipped: Array = np.clip(np.log2(np.maximum(ratio, 1e-300)), 0.5, max(1, order))
    return clipped


def _stagnation(problem: Problem, program: Program, control: Adaptive, relative: Array, count: int) -> str:
    worst = int(relative.argmax())
    return (
        f"{program.name}: {problem.system.inputs[worst].name} stopped improving at {relative[worst]:.2g} of its peak"
        f" after {count} steps, but rtol is {control.rtol:g}; likely causes: round-off, which grows like 1/h^2 on"
        f" this form, a method that does not damp errors of the inputs, or a path that is not smooth enough"
    )


@dataclass(frozen=True, eq=False)
class Reached:
    """How far a run with local error control has come: a value, which an attempt to step turns into the next.

    Attributes
    ----------
    run : Run
        The state of the program at `time`, and the counts of the accepted steps.
    time : float
        In s.
    spacing : float
        Step by which the history in the state is spaced, in s.
    peaks : ndarray
        Largest magnitude of every input so far.
    h : float
        Step to try next, in s.
    last_error : float
        Of the last accepted step, as a fraction of what is allowed.
    steps, rejected : int
        Totals.
    largest_error : float
        Of all accepted steps.
    """

    run: Run
    time: float
    spacing: float
    peaks: Array
    h: float
    last_error: float = 1.0
    steps: int = 0
    rejected: int = 0
    largest_error: float = 0.0

    @property
    def state(self) -> Array:
        """The state of the program."""
        return self.run.states[:, -1]


@dataclass(frozen=True, eq=False)
class StepControl:
    """Local error control of a program: the error of a trial step, and the size of the next one."""

    control: Adaptive
    program: Program
    problem: Problem
    order: int

    def error(self, now: Reached, time: float, fine: Array, coarse: Array) -> tuple[float, Array]:
        """Return the error of a step to `time` as a fraction of what is allowed, and the new peaks."""
        jet, inputs = self.problem.reference.jet(time, self.program.start_order), len(self.problem.system.inputs)
        fine, coarse = (self.program.values(state, jet, self.problem.p)[:inputs] for state in (fine, coarse))
        peaks = np.maximum(now.peaks, np.abs(fine))
        # Error per unit of time: the sum over all steps then meets the tolerance.
        weight = self.control.allowed(np.maximum(peaks, 1e-3)) * (time - now.time) / self.problem.reference.duration
        return float((np.abs(fine - coarse) / (2.0**self.order - 1.0) / weight).max()), peaks

    def next_step(self, h: float, error: float, last_error: float) -> float:
        """Return the step after one of size `h` with this error: a PI controller after success, smaller otherwise."""
        exponent = 1.0 / self.order
        if error <= 1.0:
            # PI control (Gustafsson 1991): the error before steadies the step where it lies near its limit.
            factor = _SAFETY * max(error, 1e-10) ** (-0.7 * exponent) * last_error ** (0.4 * exponent)
        else:
            factor = min(1.0, _SAFETY * error**-exponent) if np.isfinite(error) else _LEAST
        return h * float(np.clip(factor, _LEAST, _MOST))

    def require_possible(self, now: Reached, h: float) -> None:
        """Raise `IntegrationFailed` if too many steps were needed, or one too small to change the time."""
        if now.steps + now.rejected > self.control.max_steps or h < 1e-12 * max(1.0, abs(now.time)):
            raise IntegrationFailed(
                f"{self.program.name}: the tolerance rtol = {self.control.rtol:g}, atol = {self.control.atol:g} needs"
                f" steps of {h:.2g} s at t = {now.time:.6g} s, {now.steps} steps after the start; a method of"
                f" higher order or a larger tolerance is needed"
            )


def _by_steps(problem: Problem, control: StepControl, t: Array, progress: Progress | None) -> Solution:
    """Control the local error by comparing each step with two halves; steps end on the instants `t`."""
    program, step = control.program, step_of(t)
    state, residual = first_state(problem, program, step)
    first_values = program.values(state, problem.reference.jet(float(t[0]), program.start_order), problem.p)
    peaks = np.abs(first_values[: len(problem.system.inputs)])
    now = Reached(Run(state[:, None], 0, 0, residual), float(t[0]), step, peaks, step)
    columns = [state]
    for k, end in enumerate(t[1:]):
        while end - now.time > 1e-9 * step:
            now = _attempt(control, now, float(end))
        now = replace(now, time=float(end))
        columns.append(now.state)
        if progress is not None:
            progress(k + 1, len(t) - 1)
    segments, error = [Segment(program, t, replace(now.run, states=np.array(columns).T))], now.largest_error
    return solution_of(problem, segments, steps=now.steps, rejected=now.rejected, error_estimate=error)


def _attempt(control: StepControl, now: Reached, end: float) -> Reached:
    """Try one step towards `end`; return its result, or the same place with a smaller step to try."""
    left = end - now.time
    # Divide the rest evenly rather than end with a very short step.
    h = left / max(1, np.ceil(left / now.h * (1 - 1e-9)))
    control.require_possible(now, h)
    # Two halves against the whole: needs no embedded method, and the halves are the result.
    whole, halves = (_steps(control, now, h, parts) for parts in (1, 2))
    if whole is None or halves is None:
        return replace(now, rejected=now.rejected + 1, h=control.next_step(h, np.inf, now.last_error))
    error, peaks = control.error(now, now.time + h, halves.states[:, -1], whole.states[:, -1])
    h_next = control.next_step(h, error, now.last_error)
    if not error <= 1.0:
        return replace(now, peaks=peaks, rejected=now.rejected + 1, h=h_next)
    return Reached(
        run=replace(joined_runs([now.run, halves]), states=halves.states),
        time=now.time + h,
        spacing=h / 2,
        peaks=peaks,
        h=h_next,
        last_error=max(error, 1e-4),
        steps=now.steps + 2,
        rejected=now.rejected,
        largest_error=max(now.largest_error, error * control.control.rtol),
    )


def _steps(control: StepControl, now: Reached, h: float, parts: int) -> Run | None:
    """Take a step in `parts` equal parts; None if one of them fails."""
    program, problem, part = control.program, control.problem, h / parts
    # Its history is spaced by the last step; on index one interpolation of it costs no order.
    state = program.rescaled(now.state, part / now.spacing)
    iterations, factorizations, residual = 0, 0, 0.0
    for k in range(parts):
        times = now.time + k * part + part * np.array(program.nodes)
        state, report = program.advance(state, problem.reference.jet(times, program.order), part, problem.p)
        if not report.converged:
            return None
        iterations += report.newton_iterations
        factorizations += report.factorizations
        residual = max(residual, report.residual)
    return Run(state[:, None], iterations, factorizations, residual)
