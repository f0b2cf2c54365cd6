"""Error control: local where the index allows it, by whole runs where it does not.

On forms of index one and less the local error of a step is what it is elsewhere, and the usual test works: each step
is repeated as two halves, and a PI controller chooses the next. On projected forms (index 3) the local error of the
inputs scales like tolerance / h^2 and a local test rejects steps without end; steps that vary add an error that does
not fall with the step. There whole runs at constant step are repeated with half the step until the inputs agree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from servocore.solvers.accuracy import Adaptive
from servocore.errors import IntegrationFailed
from servocore.solvers.fixed_step import Progress, Run, begin, observe, run, statistics
from servocore.checks.wrong_inputs import follow_angles
from servocore.solution import Solution
from servocore.stepping.stepper import Stepper
from servocore.model.symbols import Array

_SAFETY, _LEAST, _MOST = 0.9, 0.2, 5.0
_STAGNATION = 1.3  # a halved step that improves the inputs by less has met a floor
_MOST_HALVINGS = 14


def solve_to_tolerance(stepper: Stepper, control: Adaptive, t: Array, progress: Progress | None) -> Solution:
    """Solve so accurately that every reported trajectory meets the tolerance at the instants `t`.

    Raises
    ------
    IntegrationFailed
        If the tolerance cannot be met, with what was reached and why.
    """
    if stepper.index == 0:
        return _exact(stepper, t, progress)
    if stepper.index == 1:
        return _by_steps(stepper, control, t, progress)
    return _by_runs(stepper, control, t, progress)


def _solution(stepper: Stepper, t: Array, done: Run) -> Solution:
    reference, program = stepper.scene.reference, stepper.program
    values, violations = observe(program, reference, stepper.parameters, t, done.states)
    follow_angles(stepper, t, done.states, values)
    summary = statistics(done, values[:, : len(stepper.system.inputs)], violations)
    return Solution(t, program.channels, values, program.name, summary, reference.fit_error)


def _exact(stepper: Stepper, t: Array, progress: Progress | None) -> Solution:
    done = run(stepper.scene.reference, stepper.program, stepper.parameters, t, stepper.step, progress)
    return _solution(stepper, t, done)


def _by_runs(stepper: Stepper, control: Adaptive, t: Array, progress: Progress | None) -> Solution:
    """Halve the step of whole runs until the inputs at the instants `t` agree to the tolerance."""
    inputs = len(stepper.system.inputs)
    order = stepper.method.orders(stepper.index).forces
    coarse, last_change, total = None, None, 0
    for halvings in range(_MOST_HALVINGS):
        division = 2**halvings
        count = (len(t) - 1) * division
        if total + count > control.most_steps:
            raise IntegrationFailed(f"{stepper.program.name}: {control.most_steps} steps are not enough")
        total += count
        fine_t = np.interp(np.arange(count + 1) / division, np.arange(len(t)), t)
        finer = replace(stepper, step=stepper.step / division)
        done = run(stepper.scene.reference, finer.program, finer.parameters, fine_t, finer.step, progress)
        at_output = replace(done, states=done.states[:, ::division])
        fine = _solution(finer, t, at_output)
        if coarse is not None:
            peaks = np.abs(fine.values[:, :inputs]).max(axis=0)
            change = np.abs(fine.values - coarse.values)[:, :inputs].max(axis=0)
            ratio = None if last_change is None else last_change / np.maximum(change, 1e-300)
            estimate = change / (2.0 ** _observed_order(ratio, order) - 1.0)
            unmet = estimate > control.atol + control.rtol * peaks
            if not unmet.any():
                summary = replace(
                    fine.statistics,
                    steps=total,
                    error_estimate=float((estimate / np.maximum(peaks, 1e-300)).max()),
                )
                return replace(fine, statistics=summary)
            if ratio is not None and ratio[unmet].min() < _STAGNATION:
                raise IntegrationFailed(_stagnation(stepper, control, estimate, peaks, count))
            last_change = change
        coarse = fine
    raise IntegrationFailed(f"{stepper.program.name}: {_MOST_HALVINGS} halvings of the step are not enough")


def _observed_order(ratio: Array | None, order: int) -> Array | float:
    """Order by which a difference of two runs is turned into an error; cautious while only one is known."""
    if ratio is None:
        return 1.0
    clipped: Array = np.clip(np.log2(np.maximum(ratio, 1e-300)), 0.5, max(1, order))
    return clipped


def _stagnation(stepper: Stepper, control: Adaptive, estimate: Array, peaks: Array, count: int) -> str:
    worst = int((estimate / np.maximum(peaks, 1e-300)).argmax())
    name = stepper.system.inputs[worst].name
    return (
        f"{stepper.program.name}: {name} stopped improving at {estimate[worst] / peaks[worst]:.2g} of its peak after"
        f" {count} steps, {control.rtol:g} was asked for; likely causes: round-off, which grows like 1/h^2 on this"
        f" form, a method that does not damp errors of the inputs, or a path that is not smooth enough"
    )


@dataclass
class _Progression:
    """What the stepwise control carries along."""

    state: Array
    time: float
    h: float
    spacing: float
    last_error: float
    peaks: Array
    steps: int = 0
    rejected: int = 0
    newton_iterations: int = 0
    factorisations: int = 0
    worst_residual: float = 0.0
    largest_error: float = 0.0


def _by_steps(stepper: Stepper, control: Adaptive, t: Array, progress: Progress | None) -> Solution:
    """Control the local error by comparing each step with two halves; steps end on the instants `t`."""
    reference, program, p = stepper.scene.reference, stepper.program, stepper.parameters
    state, residual = begin(reference, program, p, stepper.step)
    peaks = np.abs(program.values(state, reference.jet(float(t[0]), program.start_order), p))
    now = _Progression(state, float(t[0]), stepper.step, stepper.step, 1.0, peaks, worst_residual=residual)
    columns = [state]
    for k, end in enumerate(t[1:]):
        while end - now.time > 1e-9 * stepper.step:
            _advance_once(stepper, control, now, float(end))
        now.time = float(end)
        columns.append(now.state)
        if progress is not None:
            progress(k + 1, len(t) - 1)
    done = Run(np.array(columns).T, now.newton_iterations, now.factorisations, now.worst_residual)
    solution = _solution(stepper, t, done)
    summary = replace(solution.statistics, steps=now.steps, rejected=now.rejected, error_estimate=now.largest_error)
    return replace(solution, statistics=summary)


def _advance_once(stepper: Stepper, control: Adaptive, now: _Progression, end: float) -> None:
    """Try one step; accept it, or make the next one smaller."""
    program, p = stepper.program, stepper.parameters
    left = end - now.time
    # Share what is left evenly rather than leave a sliver for last.
    h = left / max(1, np.ceil(left / now.h * (1 - 1e-9)))
    if now.steps + now.rejected > control.most_steps or h < 1e-12 * max(1.0, abs(now.time)):
        raise IntegrationFailed(
            f"{program.name}: the tolerance rtol = {control.rtol:g}, atol = {control.atol:g} asked for steps of"
            f" {h:.2g} s at t = {now.time:.6g} s, {now.steps} steps after the start; a method of higher order or"
            f" a larger tolerance is needed"
        )
    whole = _steps(stepper, now, h, 1)
    halves = _steps(stepper, now, h, 2)
    order = stepper.method.orders(1).forces
    error = np.inf
    if whole is not None and halves is not None:
        jet = stepper.scene.reference.jet(now.time + h, program.start_order)
        fine, coarse = program.values(halves[0], jet, p), program.values(whole[0], jet, p)
        now.peaks = np.maximum(now.peaks, np.abs(fine))
        # Error per unit of time: so that what all steps leave behind together meets the tolerance.
        share = h / stepper.scene.reference.duration
        weight = (control.atol + control.rtol * np.maximum(now.peaks, 1e-3)) * share
        error = float((np.abs(fine - coarse) / (2.0**order - 1.0) / weight).max())
    exponent = 1.0 / order
    if error <= 1.0 and halves is not None:
        state, iterations, factorisations, residual = halves
        now.state, now.time, now.steps, now.spacing = state, now.time + h, now.steps + 2, h / 2
        now.newton_iterations += iterations
        now.factorisations += factorisations
        now.worst_residual = max(now.worst_residual, residual)
        now.largest_error = max(now.largest_error, error * control.rtol)
        factor = _SAFETY * max(error, 1e-10) ** (-0.7 * exponent) * now.last_error ** (0.4 * exponent)
        now.last_error = max(error, 1e-4)
    else:
        now.rejected += 1
        factor = _SAFETY * error**-exponent if np.isfinite(error) else _LEAST
        factor = min(1.0, factor)
    now.h = h * float(np.clip(factor, _LEAST, _MOST))


def _steps(stepper: Stepper, now: _Progression, h: float, parts: int) -> tuple[Array, int, int, float] | None:
    """Take a step in `parts` equal parts; None if one of them fails."""
    program, reference, part = stepper.program, stepper.scene.reference, h / parts
    state = program.rescaled(now.state, part / now.spacing)
    iterations, factorisations, residual = 0, 0, 0.0
    for k in range(parts):
        begin_time = now.time + k * part
        jets = reference.jet(begin_time + part * np.array(program.nodes), program.order)
        state, report = program.advance(state, jets, part, stepper.parameters)
        if not report.converged:
            return None
        iterations += report.newton_iterations
        factorisations += report.factorisations
        residual = max(residual, report.residual)
    return state, iterations, factorisations, residual
