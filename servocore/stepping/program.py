"""`Program`: a model, a formulation and a method together, as a few compiled functions of plain vectors.

Compiled once for a system, for all paths. The state is one flat float64 vector, history included: a copy serves for
rollback, a list for serialization.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from servocore.dae import Dae
from servocore.errors import IntegrationFailed, InvalidSetting
from servocore.formulations.base import Formulation
from servocore.formulations.reduced import Reduced
from servocore.methods.base import Discretization, Method, errs_less_with_smaller_steps, instantaneous
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array, call_of
from servocore.numerics.just_in_time import in_machine_code
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.observation import compile_observation, observed
from servocore.stepping.step_functions import (
    compile_following_step,
    compile_guess_residual,
    compile_pointwise_step,
    compile_restart,
    compile_start,
    compile_step,
    start_instants,
)
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import inversion


@dataclass(frozen=True)
class StepReport:
    """Report of a step or a start.

    Attributes
    ----------
    converged : bool
        False if Newton's method failed; the state is then NaN.
    newton_iterations, factorizations : int
        Iterations of the slowest block; factorizations of all blocks.
    residual : float
        Largest residual of all equations at the solution, scaled by the step size to the level of accelerations.
    """

    converged: bool
    newton_iterations: int
    factorizations: int
    residual: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Program:
    """Compiled functions of one problem: model, formulation and method together.

    Each is compiled at its first use: Newton's method takes longest to compile, and an exact inversion seldom needs it.

    Attributes
    ----------
    name : str
        Model, formulation and method, for messages.
    array : DerivativeArray
        Derivative array of the system, with the states of the formulation.
    dae, reduced : Dae
        The form that is stepped, and the reduced form of the same array.
    discretization : Discretization
        The equations of a step.
    start_order : int
        Highest derivative of the reference in start and observation.
    smaller_steps_help : bool
        False for forms without a step, and where errors grow from step to step, more so the smaller the step.
    follow_branch : bool
        Whether an exact inversion starts from the extrapolated previous instant instead of the model's guess.
    """

    name: str
    array: DerivativeArray
    dae: Dae
    reduced: Dae
    discretization: Discretization
    start_order: int
    smaller_steps_help: bool
    follow_branch: bool

    @property
    def index(self) -> int:
        """Differentiation index of the form."""
        return self.dae.index

    @cached_property  # used in every step
    def order(self) -> int:
        """Highest derivative of the reference in a step."""
        return self.dae.reference_order if self.dae.x.numel() else self.start_order

    @property
    def nodes(self) -> tuple[float, ...]:
        """Instants of the reference in a step, as fractions of the step."""
        return self.discretization.nodes

    def node_times(self, ends: Array, h: float) -> Array:
        """Return the instants of the reference in steps that end at given ones, one step after the other.

        Parameters
        ----------
        ends : ndarray, shape (N,)
            In s.
        h : float
            Step in s.

        Returns
        -------
        ndarray, shape (N * nodes,)
            In s.
        """
        return np.asarray(ends[:, None] - (1.0 - np.array(self.nodes)) * h).ravel()

    @property
    def equations(self) -> tuple[str, ...]:
        """Names of the equations of a step."""
        return self.discretization.labels

    @cached_property  # used in every step
    def start_instants(self) -> tuple[float, ...]:
        """Instants of the reference in the start, in steps from the initial time."""
        return start_instants(self.array, self.discretization)

    @cached_property
    def channels(self) -> tuple[Quantity, ...]:
        """Observed quantities."""
        return tuple(quantity for quantity, _ in observed(self.array.system))

    @cached_property
    def start(self) -> ca.Function:
        """(gamma (m, (`start_order` + 1) * instants), h, p) -> (state, counts (2,), residual)."""
        inverse = inversion(self.array)
        return compile_start(self.array, inverse, self.dae, self.reduced, self.discretization, self.start_order)

    @cached_property
    def restart(self) -> ca.Function:
        """(unknowns of the array, gamma as for `start`, h, p) -> state."""
        inverse = inversion(self.array)
        return compile_restart(self.array, inverse, self.dae, self.reduced, self.discretization, self.start_order)

    @cached_property
    def step(self) -> ca.Function:
        """(state, gamma (m, (`order` + 1) * nodes), h, p) -> (state, counts, residual)."""
        if self.dae.x.numel():
            return compile_step(self.discretization)
        # Without differential states instants are independent: a step is a start.
        if self.follow_branch:
            return compile_following_step(self.array, self.start_order)
        return compile_pointwise_step(self.start)

    @cached_property
    def observe(self) -> ca.Function:
        """(state, gamma (m, `start_order` + 1), p) -> (values, violations (4,)), the largest sizes of c, c', g, g'."""
        system = self.array.system
        return compile_observation(system, self.dae, self.discretization, observed(system), self.start_order)

    @cached_property
    def guess_residual(self) -> ca.Function:
        """Like `step`, to the residual of every equation at the first guess, for messages."""
        return compile_guess_residual(self.discretization)

    @cached_property
    def between(self) -> ca.Function:
        """(state, fraction, h) -> the state moved to a fraction of the last step."""
        step = self.discretization
        return ca.Function("sc_between", [step.state, step.fraction, step.step], [ca.densify(step.between)])

    @cached_property
    def state_size(self) -> int:
        """Length of the state vector."""
        return int(self.step.size1_in(0))

    def begin(self, gamma: Array, p: Array, h: float = 0.0) -> tuple[Array, StepReport]:
        """Return consistent initial values as a state.

        Parameters
        ----------
        gamma : ndarray, shape (orders, m), or (instants, orders, m) for a method with several `start_instants`
            Reference jets. One jet serves for all instants while the step is not known.
        p : ndarray
            Parameters.
        h : float
            Step size in s; 0 while it is not known.

        Returns
        -------
        tuple of (ndarray, StepReport)
            The state, shape (state_size,), and a report.
        """
        jets = np.repeat(gamma[None], len(self.start_instants), axis=0) if gamma.ndim == 2 else gamma
        # CasADi maps column by column: (instants, orders, m) becomes (m, orders * instants).
        used = jets[:, : self.start_order + 1]
        return _outcome(*call_of(self.start)(used.reshape(-1, used.shape[2]).T, h, p))

    def advance(self, state: Array, gamma: Array, h: float, p: Array) -> tuple[Array, StepReport]:
        """Take one step; gamma holds the reference jets at the nodes, shape (nodes, orders, m).

        Parameters
        ----------
        state : ndarray, shape (state_size,)
            State before the step.
        gamma : ndarray, shape (nodes, orders, m)
            Reference jets at the nodes of the step.
        h : float
            Step in s.
        p : ndarray
            Parameters.

        Returns
        -------
        tuple of (ndarray, StepReport)
            The state after the step, and a report.
        """
        return _outcome(*call_of(self.step)(state, self._at_nodes(gamma), h, p))

    def moved(self, state: Array, fraction: float, h: float) -> Array:
        """Move a state to a fraction of its last step, for `values` there: dense output.

        Parameters
        ----------
        state : ndarray, shape (state_size,)
            State after a step.
        fraction : float
            0 at the beginning of that step, 1 at its end.
        h : float
            Its size in s.

        Returns
        -------
        ndarray, shape (state_size,)
            A state for `values` alone.
        """
        return call_of(self.between)(state, fraction, h)[0]

    def values(self, state: Array, gamma: Array, p: Array) -> Array:
        """Observed values in the order of `channels`, for a reference jet of shape (orders, m).

        Parameters
        ----------
        state : ndarray, shape (state_size,)
            State after a step.
        gamma : ndarray, shape (orders, m)
            Reference jet at the instant of the state.
        p : ndarray
            Parameters.

        Returns
        -------
        ndarray, shape (channels,)
            In the units of `channels`.
        """
        return call_of(self.observe)(state, gamma[: self.start_order + 1].T, p)[0]

    def require_branch(self, values: Array, time: float) -> None:
        """Raise `IntegrationFailed` if observed values belong to another branch of the equations.

        Parameters
        ----------
        values : ndarray, shape (channels,)
            From `values`.
        time : float
            Time of the values in s, for the message.
        """
        for channel, value in zip(self.channels, values, strict=True):
            # Newton's method may converge to a mirror image, such as a rope that pushes; signs reveal it.
            if channel.positive and not value > 0.0:
                helps = self.smaller_steps_help and not channel.tension
                remedy = "; reduce the step" if helps else ""
                raise IntegrationFailed(
                    f"{self.name}: at t = {time:.6g} s {channel.name} is {value:.4g} {channel.unit},"
                    f" {channel.wrong_sign}{remedy}"
                )

    def worst_equation(self, state: Array, gamma: Array, h: float, p: Array) -> str:
        """Name the equation that the first guess of a step violates most.

        Parameters
        ----------
        state : ndarray, shape (state_size,)
            State before the step.
        gamma : ndarray, shape (nodes, orders, m)
            Reference jets at the nodes of the step.
        h : float
            Step in s.
        p : ndarray
            Parameters.

        Returns
        -------
        str
            Name of the equation.
        """
        # Without a step, gamma has more derivatives of the path than the equations.
        orders = self.guess_residual.size2_in(1) // len(self.nodes)
        (residual,) = call_of(self.guess_residual)(state, self._at_nodes(gamma[:, :orders]), h, p)
        return self.equations[int(np.nan_to_num(np.abs(residual), nan=np.inf).argmax())]

    def _at_nodes(self, gamma: Array) -> Array:
        """Lay the reference jets at the nodes side by side: (m, orders * nodes)."""
        used = gamma[:, : self.order + 1]
        return used.reshape(-1, used.shape[2]).T


def _outcome(state: Array, counts: Array, residual: Array) -> tuple[Array, StepReport]:
    # CasADi's fast_newton treats NaN as convergence, and failed blocks return NaN: test the values.
    converged = bool(np.isfinite(state).all() and np.isfinite(residual[0]))
    most, total = (round(count) if np.isfinite(count) else 0 for count in counts)
    return state, StepReport(converged, most, total, float(residual[0]))


def program_of(
    problem: Problem,
    formulation: Formulation,
    method: Method | None = None,
    native: bool | None = False,
    steps: int = 0,
) -> Program:
    """Return the program of a problem; the same object for the same system and settings.

    Parameters
    ----------
    problem : Problem
        The problem.
    formulation : Formulation
        Formulation.
    method : Method, optional
        Of no effect on a form without differential states, on which all methods are one.
    native : bool or None
        Whether to compile to machine code; with None in the background, for a program that is used again or for many
        steps.
    steps : int
        Number of steps to be taken.

    Raises
    ------
    InvalidSetting
        If a form with differential states has no method.
    """
    dae = problem.dae(formulation)
    if not dae.x.numel():
        method = None
    elif method is None:
        raise InvalidSetting(f"{dae.name} has differential states, which need a method")
    program = _program(problem.resolved, formulation, method, problem.follow_branch)
    return _in_machine_code(program, ("start", "step", "observe"), program.name, native).best(steps) or program


_in_machine_code = made_once(in_machine_code)


@made_once
def _program(resolved: ResolvedSystem, formulation: Formulation, method: Method | None, follow_branch: bool) -> Program:
    array, dae = resolved.array, resolved.dae(formulation)
    if isinstance(formulation, Reduced):
        array = formulation.array(resolved.system)
    if array.states == resolved.array.states:
        array = resolved.array  # the usual states share one inversion with all other users
    return Program(
        name=f"{dae.name}, {method.name}" if method else dae.name,
        array=array,
        dae=dae,
        reduced=resolved.dae(Reduced(states=array.named_states)),
        discretization=method.discretize(dae) if method else instantaneous(dae),
        start_order=max(array.reference_order, dae.reference_order, 2),
        smaller_steps_help=method is not None and errs_less_with_smaller_steps(method, dae.index),
        follow_branch=follow_branch,
    )
