"""`Program`: a servo constraint problem compiled to a few functions of plain vectors, ready to run anywhere.

This module and what it imports need NumPy and CasADi only: an FMU carries them with the saved functions and nothing of
the modelling side. The state is one flat float64 vector, history included: copy it to roll back, list it to serialize.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from servocore.errors import IntegrationFailed, InvalidReference, ServocoreError
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.serialization import from_json, to_json

_FORMAT = "servocore program 3"


class CompiledWhenUsed:
    """Descriptor of a dataclass field that holds a CasADi function, or a callable that compiles it at the first access.

    Newton's method for a system takes longer to compile than anything else, and an exact inversion seldom needs it.
    """

    def __set_name__(self, _: type, name: str) -> None:
        self._name = name

    def __set__(self, holder: object, function: ca.Function | Callable[[], ca.Function]) -> None:
        holder.__dict__[self._name] = function

    def __get__(self, holder: object, _: type | None = None) -> ca.Function:
        if holder is None:
            raise AttributeError(self._name)  # to a dataclass: a field without a default
        held: ca.Function | Callable[[], ca.Function] = holder.__dict__[self._name]
        if isinstance(held, ca.Function):
            return held
        compiled: ca.Function = held()
        holder.__dict__[self._name] = compiled
        return compiled


@dataclass(frozen=True)
class LimitText:
    """What to say when a margin is not positive: the quantity, its unit and the reason."""

    quantity: str
    unit: str
    reason: str
    bound: float


@dataclass(frozen=True)
class StepReport:
    """How a step or a start went.

    Attributes
    ----------
    converged : bool
        False if Newton's method failed; the state is then NaN.
    newton_iterations, factorisations : int
        Iterations of the slowest block; factorizations of all blocks.
    residual : float
        Largest residual of all equations at the solution, scaled by the step size to the level of accelerations.
    """

    converged: bool
    newton_iterations: int
    factorisations: int
    residual: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Program:
    """Compiled functions of one problem: model, formulation and method together.

    Each function may also be given as what compiles it: a callable without arguments.

    Attributes
    ----------
    name : str
        Model, formulation and method, for messages.
    start : casadi.Function
        (gamma (m, (`start_order` + 1) * instants), h, p) -> (state, counts (2,), residual).
    step : casadi.Function
        (state, gamma (m, (`order` + 1) * nodes), h, p) -> (state, counts, residual).
    observe : casadi.Function
        (state, gamma (m, `start_order` + 1), p) -> (values, violations (4,)): the latter ``|c|, |c'|, |g|, |g'|``.
    margins : casadi.Function
        (gamma (m, `start_order` + 1), p) -> how far each limit of the scene is, positive where it is kept.
    guess_residual : casadi.Function
        Like `step`, to the residual of every equation at the first guess, for messages.
    rescale : casadi.Function
        (state, ratio) -> the state made ready for steps of another size, `ratio` times the old.
    between : casadi.Function
        (state, fraction, h) -> the state with its own instant moved to a fraction of the last step.
    index : int
        Differentiation index of the form.
    smaller_steps_help : bool
        False for forms without a step, and where errors grow from step to step, more so the smaller the step.
    order, start_order : int
        Highest derivative of the reference that a step takes, and that start and observation take.
    nodes : tuple of float
        Where a step takes the reference, in steps from its beginning.
    start_instants : tuple of float
        Where the start takes the reference, in steps from the initial time.
    channels : tuple of Quantity
        What is observed.
    parameters, equations : tuple of str
        Names of the entries of p, and of the equations of a step.
    limits : tuple of LimitText
        What messages say of each limit of the scene.
    """

    name: str
    start: CompiledWhenUsed = CompiledWhenUsed()
    step: CompiledWhenUsed = CompiledWhenUsed()
    observe: CompiledWhenUsed = CompiledWhenUsed()
    margins: CompiledWhenUsed = CompiledWhenUsed()
    guess_residual: CompiledWhenUsed = CompiledWhenUsed()
    rescale: CompiledWhenUsed = CompiledWhenUsed()
    between: CompiledWhenUsed = CompiledWhenUsed()
    index: int
    smaller_steps_help: bool
    order: int
    start_order: int
    nodes: tuple[float, ...]
    start_instants: tuple[float, ...]
    channels: tuple[Quantity, ...]
    parameters: tuple[str, ...]
    equations: tuple[str, ...]
    limits: tuple[LimitText, ...]
    _calls: dict[str, Call] = field(init=False, repr=False, default_factory=dict)

    def _call(self, name: str) -> Call:
        if name not in self._calls:
            self._calls[name] = Call(getattr(self, name))
        return self._calls[name]

    @property
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
            The state, shape (state_size,), and how the start went.
        """
        jets = np.repeat(gamma[None], len(self.start_instants), axis=0) if gamma.ndim == 2 else gamma
        # CasADi maps column by column: (instants, orders, m) becomes (m, orders * instants).
        used = jets[:, : self.start_order + 1]
        return _outcome(*self._call("start")(used.reshape(-1, used.shape[2]).T, h, p))

    def advance(self, state: Array, gamma: Array, h: float, p: Array) -> tuple[Array, StepReport]:
        """Take one step; gamma holds the reference jets at the nodes, shape (nodes, orders, m).

        Parameters
        ----------
        state : ndarray, shape (state_size,)
            Before the step.
        gamma : ndarray, shape (nodes, orders, m)
            Reference jets at the nodes of the step.
        h : float
            Step in s.
        p : ndarray
            Parameters.

        Returns
        -------
        tuple of (ndarray, StepReport)
            The state after the step, and how it went.
        """
        return _outcome(*self._call("step")(state, self._at_nodes(gamma), h, p))

    def rescaled(self, state: Array, ratio: float) -> Array:
        """Make a state ready for steps of another size; for forms of index one and less.

        Parameters
        ----------
        state : ndarray, shape (state_size,)
            After a step of the old size.
        ratio : float
            New size divided by the old one.

        Returns
        -------
        ndarray, shape (state_size,)
            The state from which to go on.
        """
        # Interpolating a history at its own instants would cost round-off for nothing.
        return state if ratio == 1.0 else self._call("rescale")(state, ratio)[0]

    def moved(self, state: Array, fraction: float, h: float) -> Array:
        """Move a state's own instant to a fraction of its last step, for `values` there: dense output.

        Parameters
        ----------
        state : ndarray, shape (state_size,)
            After a step.
        fraction : float
            0 at the beginning of that step, 1 at its end.
        h : float
            Its size in s.

        Returns
        -------
        ndarray, shape (state_size,)
            A state for `values` alone.
        """
        return self._call("between")(state, fraction, h)[0]

    def values(self, state: Array, gamma: Array, p: Array) -> Array:
        """Observed values in the order of `channels`, for a reference jet of shape (orders, m).

        Parameters
        ----------
        state : ndarray, shape (state_size,)
            After a step.
        gamma : ndarray, shape (orders, m)
            Reference jet at the state's own instant.
        p : ndarray
            Parameters.

        Returns
        -------
        ndarray, shape (channels,)
            In the units of `channels`.
        """
        return self._call("observe")(state, gamma[: self.start_order + 1].T, p)[0]

    def require_within_limits(self, gamma: Array, p: Array, time: float) -> None:
        """Raise `InvalidReference` with the time if a reference jet breaks a limit of the scene.

        Parameters
        ----------
        gamma : ndarray, shape (orders, m)
            Reference jet.
        p : ndarray
            Parameters.
        time : float
            Of the jet, in s, for the message.
        """
        if self.limits:
            (margins,) = self._call("margins")(gamma[: self.start_order + 1].T, p)
            require_margins(self.limits, margins, time)

    def require_branch(self, values: Array, time: float) -> None:
        """Raise `IntegrationFailed` if observed values belong to another branch of the equations.

        Parameters
        ----------
        values : ndarray, shape (channels,)
            From `values`.
        time : float
            Of the values, in s, for the message.
        """
        for channel, value in zip(self.channels, values, strict=True):
            # Newton's method may land on a mirror image, such as a rope that pushes; only signs tell.
            if channel.positive and not value > 0.0:
                helps = self.smaller_steps_help and not channel.tension
                cure = "; a smaller step keeps to its own" if helps else ""
                raise IntegrationFailed(
                    f"{self.name}: at t = {time:.6g} s {channel.name} is {value:.4g} {channel.unit},"
                    f" {channel.wrong_sign}{cure}"
                )

    def worst_equation(self, state: Array, gamma: Array, h: float, p: Array) -> str:
        """Name the equation that the first guess of a step violates most.

        Parameters
        ----------
        state : ndarray, shape (state_size,)
            Before the step.
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
        # A form without a step is given more derivatives of the path than its equations hold.
        orders = self.guess_residual.size2_in(1) // len(self.nodes)
        (residual,) = self._call("guess_residual")(state, self._at_nodes(gamma[:, :orders]), h, p)
        return self.equations[int(np.nan_to_num(np.abs(residual), nan=np.inf).argmax())]

    def _at_nodes(self, gamma: Array) -> Array:
        """Lay the reference jets at the nodes side by side: (m, orders * nodes)."""
        used = gamma[:, : self.order + 1]
        return used.reshape(-1, used.shape[2]).T

    def to_json(self) -> str:
        """Serialize, with the functions in CasADi's own format; raises `ServocoreError` if they are machine code.

        Returns
        -------
        str
            What `from_json` reads.
        """
        if self.step.class_name() == "External":
            raise ServocoreError(f"{self.name}: machine code cannot be saved; save the program without native")
        return to_json(self, _FORMAT)

    @classmethod
    def from_json(cls, text: str) -> Program:
        """Undo `to_json`; raises `ServocoreError` if the text is not a program.

        Parameters
        ----------
        text : str
            From `to_json`.

        Returns
        -------
        Program
            The same program.
        """
        return from_json(cls, text, _FORMAT, {"channels": Quantity, "limits": LimitText})


def require_margins(limits: Sequence[LimitText], margins: Array, time: float) -> None:
    """Raise `InvalidReference` for the first margin that is not positive (NaN included)."""
    for limit, margin in zip(limits, margins, strict=True):
        # Written so that NaN is refused: it is neither above nor below.
        if not margin > 0.0:
            raise InvalidReference(
                f"at t = {time:.6g} s {limit.reason}: {limit.quantity} is {margin + limit.bound:.4g} {limit.unit},"
                f" it must stay above {limit.bound:g} {limit.unit}"
            )


def _outcome(state: Array, counts: Array, residual: Array) -> tuple[Array, StepReport]:
    # CasADi's fast_newton takes NaN for convergence, and failed blocks answer NaN: look at the numbers.
    converged = bool(np.isfinite(state).all() and np.isfinite(residual[0]))
    most, total = (round(count) if np.isfinite(count) else 0 for count in counts)
    return state, StepReport(converged, most, total, float(residual[0]))
