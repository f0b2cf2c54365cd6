"""Steps of constant size, one from each instant to the next."""

from __future__ import annotations

from dataclasses import dataclass

from servocore.formulations.base import Formulation
from servocore.methods.base import Method
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.solvers.fixed_step_loop import Progress, run_steps
from servocore.solvers.results import Segment, solution_of
from servocore.stepping.compilation import prescribed_start_of, program_of


@dataclass(frozen=True)
class FixedStep:
    """One step of a method from instant to instant.

    Parameters
    ----------
    formulation, method : Formulation, Method
        What is stepped, and how.
    native : bool, optional
        Whether as machine code; in the background where there is much to do when not given.
    """

    formulation: Formulation
    method: Method
    native: bool | None = None

    def run(self, problem: Problem, times: Array, progress: Progress | None = None) -> Solution:
        """Step through the instants and report every one; see `Route`."""
        first = prescribed_start_of(self.formulation, self.method)
        program = program_of(problem, self.formulation, self.method, self.native, len(times))
        return solution_of(problem, [Segment(program, times, run_steps(problem, program, times, first, progress))])
