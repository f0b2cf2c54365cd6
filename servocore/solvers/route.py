"""`Route`: a way from a problem to its solution. `solve` chooses one by the accuracy required, and runs it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from servocore.checks.before_run import internal_dynamics
from servocore.checks.better_solutions import BetterSolver
from servocore.errors import InvalidModel, InvalidReference, InvalidSetting, require_real
from servocore.formulations.base import Formulation
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.solution import Solution
from servocore.solvers.runs import Progress


@runtime_checkable
class Route(Protocol):
    """A way to solve; implementations are frozen dataclasses that hold their settings.

    `solve` takes a user's own in the place of the method.
    """

    def run(self, problem: Problem, times: Array, progress: Progress = lambda *_: None) -> Solution:
        """Solve a problem and report it at the instants `times`.

        Parameters
        ----------
        problem : Problem
            The problem.
        times : ndarray, shape (N,)
            In s, from the start of the path to its end, evenly apart.
        progress : callable, optional
            Called with (steps done, steps in all) from time to time.

        Raises
        ------
        ServocoreError
            If it cannot be solved; the sentence says where and why.
        """


def require_tolerance(value: object, what: str = "the tolerance") -> None:
    """Raise `InvalidSetting` unless a tolerance is a number between 0 and 1."""
    require_real(value, what, "a number", InvalidSetting)
    if not 0.0 < value < 1.0:  # type: ignore[operator]  # a number by now
        raise InvalidSetting(f"{what} must lie between 0 and 1, not {value}")


def require_inside(reference: Reference, t: Array) -> None:
    """Raise `InvalidReference` if a time lies outside a path along which internal dynamics are integrated."""
    if t.size and not (t.min() >= reference.start_time and t.max() <= reference.end_time):
        raise InvalidReference(
            f"inputs follow from the motion since the start: times lie between {reference.start_time:g} s and"
            f" {reference.end_time:g} s, not from {t.min():g} s to {t.max():g} s"
        )


def require_stable(problem: Problem) -> None:
    """Raise `InvalidModel` if internal dynamics cannot be integrated forward in time."""
    if not problem.flat and internal_dynamics(problem).grows:
        raise InvalidModel(f"{problem.name} has unstable internal dynamics: solve with StableInversion bounds them")


@dataclass(frozen=True)
class Adaptive:
    """The accuracy required of every input; the only setting of error control.

    An error e of an input with peak P is accepted when e <= atol + rtol P. Newton's method always goes down to
    round-off, so it has no separate tolerance.

    Parameters
    ----------
    rtol : float
        Relative to the peak of each input over the run.
    atol : float
        In the input's own unit.
    """

    rtol: float = 1e-6
    atol: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rtol", "atol"):
            require_real(getattr(self, name), name, "a number", InvalidSetting)
        if not (0.0 <= self.rtol < 1.0 and 0.0 <= self.atol < float("inf") and self.rtol + self.atol > 0.0):
            raise InvalidSetting(
                f"tolerances must be finite and not negative, one of them positive, and rtol below 1;"
                f" they are rtol = {self.rtol}, atol = {self.atol}"
            )

    def allowed(self, peaks: Array) -> Array:
        """Return the error that is accepted of inputs with these peaks.

        Parameters
        ----------
        peaks : ndarray, shape (inputs,)
            Largest magnitude of each input so far, in its unit.

        Returns
        -------
        ndarray, shape (inputs,)
            In the same units.
        """
        return self.atol + self.rtol * peaks


class JudgedRoute(ABC):
    """A route of the library: `solve` checks its results, and it estimates their accuracy itself."""

    @abstractmethod
    def run(self, problem: Problem, times: Array, progress: Progress = lambda *_: None) -> Solution:
        """Solve; see `Route`."""

    @abstractmethod
    def better(self, problem: Problem) -> BetterSolver:
        """Return the reference for its solutions, to estimate the errors of inputs."""

    def branch_statement(self, problem: Problem, solution: Solution) -> str:  # noqa: ARG002 - others judge
        """Check the inputs of a solution as closely as needed, and return on which branch its motion is."""
        return solution.statistics.branch

    def require_suits(self, problem: Problem, formulation: Formulation, *, adaptive: bool) -> None:  # noqa: B027 - most do
        """Raise `InvalidSetting` if it does not go with a problem or a form, or with a tolerance for its steps."""
