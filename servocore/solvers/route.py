"""`Route`: a way from a problem to its solution. `solve` chooses one and runs it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.solvers.fixed_step_loop import Progress


@runtime_checkable
class Route(Protocol):
    """A way to solve; implementations are frozen dataclasses that hold their settings.

    `solve` takes one of its user's in the place of the method.
    """

    def run(self, problem: Problem, times: Array, progress: Progress | None = None) -> Solution:
        """Solve a problem and report it at the instants `times`.

        Parameters
        ----------
        problem : Problem
            What to solve.
        times : ndarray, shape (N,)
            In s, from the start of the path to its end, evenly apart.
        progress : callable, optional
            Called with (steps done, steps in all) from time to time.

        Raises
        ------
        ServocoreError
            If it cannot be solved; the sentence says where and why.
        """
