"""Error control by whole runs at constant step, repeated with half the step until the inputs agree.

On projected forms (index 3) the local error of the inputs scales like tolerance / h^2, so that a test of it rejects
steps without end, and steps that vary add an error that does not fall with the step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from servocore.checks.wrong_inputs import NOTICED
from servocore.errors import IntegrationFailed
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import subdivided
from servocore.solution import Solution
from servocore.solvers.fixed_step import Stepped
from servocore.solvers.fixed_step_loop import Progress, run_steps
from servocore.solvers.results import solution_of
from servocore.solvers.route import Adaptive
from servocore.stepping.program import Program, program_of

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
        return not (solution.statistics.error_estimate or np.inf) <= NOTICED

    def run(self, problem: Problem, times: Array, progress: Progress | None = None) -> Solution:
        """Solve to the tolerance; see `Route`.

        Raises
        ------
        IntegrationFailed
            If the tolerance cannot be met, with the accuracy that was reached and the reason.
        """
        program = program_of(problem, self.formulation, self.method, self.native, len(times))
        control, order = self.control, self.method.orders(program.index).forces
        inputs, coarse, last_change, total = len(problem.system.inputs), None, None, 0
        for halvings in range(_MOST_HALVINGS):
            division = 2**halvings
            count = (len(times) - 1) * division
            if total + count > control.max_steps:
                raise IntegrationFailed(f"{program.name}: {control.max_steps} steps are not enough")
            total += count
            done = run_steps(problem, program, subdivided(times, division), progress)
            fine = solution_of(problem, [done.at(slice(None, None, division))], refuse_turns=False, steps=total)
            if coarse is not None:
                peaks = np.abs(fine.values[:, :inputs]).max(axis=0)
                change = np.abs(fine.values - coarse.values)[:, :inputs].max(axis=0)
                ratio = None if last_change is None else last_change / np.maximum(change, 1e-300)
                # Richardson: with order p the difference of two runs is (2^p - 1) times the error of the finer one.
                estimate = change / (2.0 ** _observed_order(ratio, order) - 1.0)
                unmet, relative = estimate > control.allowed(peaks), estimate / np.maximum(peaks, 1e-300)
                if not unmet.any():
                    summary = replace(fine.statistics, error_estimate=float(relative.max()))
                    return replace(fine, statistics=summary)
                # Halving no longer helps: round-off, or errors that nothing damps, have met the error of the method.
                if ratio is not None and ratio[unmet].min() < _STAGNATION:
                    raise IntegrationFailed(_stagnation(problem, program, control, relative, count))
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
