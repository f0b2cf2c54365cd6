"""Exact inversion: every instant by itself, as a route of `solve`, and prepared once for inputs alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.checks.before_run import require_feasible
from servocore.checks.better_solutions import BetterSolver
from servocore.checks.between_instants import continuous_angles
from servocore.checks.branches import FOLLOWED
from servocore.checks.findings import told
from servocore.checks.motion import Motion, enough, motion_of
from servocore.errors import IntegrationFailed, InvalidModel
from servocore.formulations.base import Formulation
from servocore.formulations.reduced import Reduced
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene, require_scene
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import numbers_of
from servocore.solution import Solution
from servocore.solvers.route import JudgedRoute
from servocore.solvers.runs import Progress, Run, require_derivatives, run_steps, solution_of, step_failure, step_of
from servocore.stepping.exact_evaluation import (
    ExactEvaluation,
    along_path,
    exact_evaluation,
    unknowns_from,
)
from servocore.stepping.program import Program, program_of
from servocore.stepping.readings import exact_quantities
from servocore.structure.inversion import block_determinants, determinants

_CHUNK = 2048  # instants that are interpreted at once: more do not fit into the caches, and take twice the memory


@dataclass(frozen=True)
class Pointwise(JudgedRoute):
    """Every instant by itself, on a form without differential states: exact, whatever the distance of the instants.

    Parameters
    ----------
    formulation : Formulation
        The form; all methods are one on it.
    native : bool, optional
        Whether as machine code; see `ExactInversion`.
    """

    formulation: Formulation
    native: bool | None = None

    def run(self, problem: Problem, times: Array, progress: Progress = lambda *_: None) -> Solution:
        """Invert at every instant; see `Route`.

        The guess of the model is a start, not a law: answers that do not continue their neighbours are found again,
        each from where the one before was heading.
        """
        parts, followed = 1, problem.follow_branch
        program = program_of(problem, self.formulation, native=bool(self.native) and followed)
        if followed:
            done = self._looked_at(problem, run_steps(problem, program, times, progress))
        else:
            times, parts = enough(times)
            done = self._at_every_instant(problem, program, times, progress)
        try:
            motion = motion_of(problem, times, done.states, block_determinants(problem.array, *done.observed[2:]))
        except IntegrationFailed as error:
            solved = np.isfinite(done.states).all(axis=0)
            if solved.all():
                solution_of(problem, [done])  # a sign that is wrong is a better reason
            if solved.any():
                raise
            raise step_failure(problem, program, done.states[:, 0], times[0], step_of(times)) from error
        if motion.states is not done.states:
            done = self._looked_at(problem, replace(done, states=motion.states))
        motion = replace(motion, values=done.observed[0], branch=FOLLOWED if followed else motion.branch)
        continuous_angles(motion, program, done.observed[0])
        solution = solution_of(problem, [done], motion=motion)
        return replace(solution, t=solution.t[::parts], values=solution.values[::parts]) if parts > 1 else solution

    @staticmethod
    def _looked_at(problem: Problem, run: Run) -> Run:
        """Return a run with the results of `_looking`."""
        return replace(run, observed=along_path(problem, _looking(problem.resolved, run.program), run.t, run.states))

    def better(self, _: Problem) -> BetterSolver:
        """Return the exact inversion again, from guesses beside the answers."""
        return BetterSolver(_perturbed, True, "the exact inversion, solved again,")

    def _at_every_instant(self, problem: Problem, program: Program, times: Array, progress: Progress) -> Run:
        """Solve every instant from the guess of the model, NaN where that fails; with the results of `_looking`."""
        require_derivatives(problem, program.start_order, f"{program.name} needs")
        evaluation = exact_evaluation(problem.resolved, _looking(problem.resolved, program), self.native, True)
        evaluation.by_expression.prepare(problem.reference)
        count, results = len(times), list[Array]()
        chunk = count if count <= _CHUNK or evaluation.by_expression.ready(problem, count) else _CHUNK
        for k in range(0, count, chunk):
            columns = evaluation(problem, times[k : k + chunk])
            # Each row is contiguous, for the results are processed row by row.
            results = results or (columns if chunk >= count else [np.empty((len(column), count)) for column in columns])
            for result, part in zip(results, columns, strict=True):
                result[:, k : k + chunk] = part
            progress(min(k + chunk, count) - 1, count - 1)
        states, counts, residuals, *looked = results
        worst = float(residuals.max())
        if not np.isfinite(worst):
            good = np.isfinite(residuals)
            states, counts = np.where(good, states, np.nan), np.where(good, counts, 0.0)
            worst = float(residuals.max(where=good, initial=0.0))
        iterations, factorizations = counts.sum(axis=1).round()
        return Run(program, times, states, int(iterations), int(factorizations), worst, tuple(looked))


EXACT = BetterSolver(Pointwise(Reduced()).run, True, "the exact inversion")
"""What solutions of flat problems are compared with."""


@made_once
def _looking(resolved: ResolvedSystem, program: Program) -> ca.Function:
    """Compile (unknowns, gamma, p) -> observed values, violations, and what `determinants` returns."""
    array, observe = resolved.array, program.observe
    arguments = [ca.SX.sym(name, *observe.size_in(k)) for k, name in enumerate(("x", "gamma", "p"))]
    regular = determinants(array).call([arguments[0], arguments[1][:, : array.reference_order + 1], arguments[2]])
    return ca.Function("sc_look", arguments, [*observe.call(arguments), *regular], {"cse": True})


_ASIDE = 1e-7  # relative


def _perturbed(problem: Problem, times: Array) -> Solution:
    """Return the inputs again, from guesses beside the exact answers: the change is what Newton's method left."""
    motion, array = Pointwise(Reduced()).run(problem, times).motion, problem.array
    states = motion.states[:, np.isin(motion.t, times)]
    aside = states * (1.0 + _ASIDE * np.sin(1.0 + np.arange(len(states))))[:, None]
    found = unknowns_from(problem, times, aside)[array.inputs].T
    return Solution(times, problem.system.inputs, found, "the exact inversion, solved again")


def prepared_motion(problem: Problem) -> Motion:
    """Return the exact motion along the path of a flat problem, to be asked for any instants.

    Raises
    ------
    InvalidModel
        If a constraint that was left out as redundant does not hold.
    InvalidReference, IntegrationFailed
        If the path is out of reach, the branch cannot be followed, or the motion jumps, with the cause.
    """
    from servocore.checks.along_motion import jumps, left_out  # noqa: PLC0415 - `solve` needs them for few models
    from servocore.checks.failure_causes import explained  # noqa: PLC0415

    try:
        motion = motion_of(problem)
        told(problem.system.name, "", jumps(motion))
    except IntegrationFailed as error:
        raise explained(problem, error) from None
    told(problem.system.name, "", left_out(problem, motion.t, motion.q))
    return motion


class ExactInversion:
    """The inputs of a scene at any instants, in any order, by exact inversion.

    The equations are differentiated and compiled, and the path is checked, once. An instant then takes a microsecond or
    two among many, some twenty alone. For real-time loops, optimizations, and tables that are read as they are needed;
    `solve` gives the motion as well, and checks the result more closely.

    Parameters
    ----------
    scene : Scene
        Without internal dynamics: its inputs depend on the path at the same instant only.
    model : str, optional
        Model of the scene; its smallest when not given.
    native : bool, optional
        Whether a C compiler shall turn the equations into machine code: some twenty times faster among many instants.
        When not given, it does so in the background where there is much to do; False leaves it out, True waits for it.

    Attributes
    ----------
    inputs : tuple of str
        Names of the columns that a call returns.

    Raises
    ------
    InvalidModel
        If the model has internal dynamics, or the scene follows a branch from instant to instant, or a constraint that
        is redundant at home does not hold along the path.
    InvalidReference
        If the path or the motion breaks a limit of the scene, or the path is out of reach or lacks derivatives.
    IntegrationFailed
        If the equations are singular on the path.
    InvalidSetting
        If there is no C compiler for `native`.

    Examples
    --------
    >>> import numpy as np
    >>> import servocore as sc
    >>> inputs = sc.ExactInversion(sc.scenes.rotary_crane())
    >>> M_b, F, M_w = inputs(3.2)
    >>> inputs(np.linspace(0.0, 20.0, 201)).shape
    (201, 3)
    """

    def __init__(self, scene: Scene, model: str | None = None, *, native: bool | None = None) -> None:
        require_scene(scene, "ExactInversion")
        problem = Problem.of(scene, model)
        if not problem.flat or scene.follow_branch:
            why = "follows a branch" if problem.flat else "has internal dynamics"
            raise InvalidModel(f"{scene.name} {why}: its inputs depend on the past of the path; use solve")
        require_derivatives(problem, problem.array.reference_order, f"the inputs of {scene.name} need")
        require_feasible(problem)
        self._problem = problem
        self._evaluation = input_evaluation(problem, native)
        self._evaluation.by_expression.prepare(scene.reference)
        self._motion = prepared_motion(problem)
        if problem.motion_limits:
            from servocore.checks.motion_limits import require_limits  # noqa: PLC0415 - few scenes have limits

            require_limits(self._motion)
        self._signs = [quantity for quantity in problem.system.observables if quantity.positive]
        self.inputs = tuple(channel.name for channel in problem.system.inputs)

    def __call__(self, t: npt.ArrayLike) -> Array:
        """Return the inputs at the times `t`.

        Parameters
        ----------
        t : array_like, shape (N,) or ()
            Times in s, in any order.

        Returns
        -------
        ndarray, shape (N, inputs) or (inputs,)
            In the units of the scene's inputs.

        Raises
        ------
        IntegrationFailed
            If an instant is not solved, or on another branch of the equations than the one wanted.
        """
        times = numbers_of(t, "the times of inputs")
        instants = times.reshape(-1)
        if not len(instants):
            return np.empty((*times.shape, len(self.inputs)))
        if self._motion.direct:
            (values,) = self._evaluation(self._problem, instants)
        else:
            (values,) = along_path(self._problem, self._evaluation.read, instants, self._motion.at(instants))
        require_answers(self._problem.system.name, instants, values.T, self._signs)
        return values[: len(self.inputs)].T.reshape(*times.shape, len(self.inputs))


def require_answers(name: str, t: Array, values: Array, positive: Sequence[Quantity]) -> None:
    """Raise `IntegrationFailed` if values (N, columns) are not solved, or one of the last columns is not `positive`."""
    unsolved = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(unsolved):
        raise IntegrationFailed(f"{name}: the equations were not solved at t = {t[unsolved[0]]:.6g} s")
    signs = values[:, values.shape[1] - len(positive) :]
    if not (signs > 0.0).all():
        at, which = (int(index) for index in np.argwhere(~(signs > 0.0))[0])
        quantity = positive[which]
        raise IntegrationFailed(
            f"{name}: at t = {t[at]:.6g} s {quantity.name} is {signs[at, which]:.4g} {quantity.unit},"
            f" {quantity.wrong_sign}"
        )


def input_evaluation(problem: Problem, native: bool | None) -> ExactEvaluation:
    """Return the exact evaluation of the inputs and, behind them, of the observables that must be positive."""
    system = problem.system
    names = *(channel.name for channel in system.inputs), *(each.name for each in system.observables if each.positive)
    return exact_quantities(problem.resolved, names, native)
