"""The protocol of methods: the equations of one step, as a value."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import casadi as ca
import numpy as np

from servocore.dae import Dae
from servocore.numerics.interpolation import lagrange
from servocore.numerics.square_systems import SquareSystem


@dataclass(frozen=True)
class Orders:
    """Orders of convergence by kind of variable, at constant step on a reference that is smooth enough.

    Parameters
    ----------
    positions, velocities : int
        Of q and v.
    forces : int
        Of multipliers and inputs.
    damped : bool
        Whether errors of the forces die out from step to step on forms of index two and three. Where they do not,
        advice is not to take smaller steps.
    """

    positions: int
    velocities: int
    forces: int
    damped: bool = True


@dataclass(frozen=True, eq=False)
class Start:
    """Start of a method as symbols: values at past instants, and rates at the initial time.

    Attributes
    ----------
    instants : tuple of float
        Instants of the values, in steps from the initial time: 0, -1, -2, ...
    values : casadi.SX
        [x; z] at the instants, shape (len x + len z, number of instants).
    rates : casadi.SX
        x_dot at the initial time, shape (len x,).
    """

    instants: tuple[float, ...]
    values: ca.SX
    rates: ca.SX

    @classmethod
    def of(cls, dae: Dae, instants: int = 1) -> Start:
        """Make the symbols of values at 0, -1, ..., 1 - `instants` steps.

        Parameters
        ----------
        dae : Dae
            The form.
        instants : int
            Number of instants.

        Returns
        -------
        Start
            One column per instant.
        """
        size_x, size = dae.x.numel(), len(dae.unknowns)
        history, rates = ca.SX.sym("history", size, instants), ca.SX.sym("rates", size_x)
        return cls(tuple(-float(k) for k in range(instants)), history, rates)


UNNEEDED = ca.SX()
"""Default of optional fields of a `Discretization`."""


@dataclass(frozen=True, eq=False)
class Discretization:
    """One time step of a method on a `Dae`: a square system, and how the state of the step moves on.

    Parameters
    ----------
    equations : SquareSystem
        Its givens are [state; reference at the nodes; step; parameters].
    state : casadi.SX
        The flat state at the start of the step, history included.
    next_state : casadi.SX
        The state at the end, an expression of unknowns and givens.
    start : Start
        Symbols in `first_state`.
    first_state : casadi.SX
        The state at the initial time, an expression of `start` and `step`.
    x, z : casadi.SX
        Unknowns of the `Dae` at the instant of `state`.
    nodes : tuple of float
        Instants of the reference, as fractions of the step.
    reference : casadi.SX
        Symbols of the reference at the nodes, shape (m, orders * len nodes), node after node.
    step : casadi.SX
        Symbol of the step size h.
    labels : tuple of str
        Names of the rows of the equations in messages.
    fraction, between : casadi.SX, optional
        Symbol of a fraction of the last step, and the state moved there: dense output. An
        expression of state, fraction and step; the end of the step when not given.
    """

    equations: SquareSystem
    state: ca.SX
    next_state: ca.SX
    start: Start
    first_state: ca.SX
    x: ca.SX
    z: ca.SX
    nodes: tuple[float, ...]
    reference: ca.SX
    step: ca.SX
    labels: tuple[str, ...]
    fraction: ca.SX = field(default_factory=lambda: ca.SX.sym("fraction"))
    between: ca.SX = UNNEEDED

    def __post_init__(self) -> None:
        if self.between is UNNEEDED:
            object.__setattr__(self, "between", self.state)


class Method(Protocol):
    """A one-step or multi-step method; implementations are frozen dataclasses that use `Dae` only."""

    @property
    def name(self) -> str:
        """Name on command lines and in tables."""

    def __hash__(self) -> int: ...

    def orders(self, index: int) -> Orders:
        """Return the orders of convergence on a form of the given index.

        Parameters
        ----------
        index : int
            Differentiation index of the form.

        Returns
        -------
        Orders
            Of positions, velocities and forces.
        """

    def discretize(self, dae: Dae) -> Discretization:
        """Return the equations of one step.

        Parameters
        ----------
        dae : Dae
            The form.

        Returns
        -------
        Discretization
            With the symbols of one step.
        """


def errs_less_with_smaller_steps(method: Method, index: int) -> bool:
    """Whether smaller steps help on forms of an index: above 3, or above 1 undamped, errors grow with them."""
    return index <= 1 or (index <= 3 and method.orders(index).damped)


def differenced(dae: Dae, start: Start, h: ca.SX, alpha: list[float]) -> ca.SX:
    """Return the history of a multistep method, shape (len x + len z, len alpha).

    On forms of index two and more its velocities follow from the positions by the difference formula
    sum_i alpha_i x(t - i h) / h, as in every step: between exact and differenced velocities there would be a jump of
    the size of their error, which the inputs amplify by 1/h. With
    h = 0 (a start whose step is not known yet) the velocities stay exact. A start with one instant only is
    continued backwards at rest.
    """
    available = start.values.size2()
    # One instant only: at rest before the start all past values are the present one.
    if available < len(alpha):
        return ca.repmat(start.values[:, 0], 1, len(alpha))
    history = ca.SX(start.values[:, : len(alpha)])
    if dae.index <= 1:
        return history
    places = {(unknown.variable, unknown.order): place for place, unknown in enumerate(dae.unknowns)}
    for place, unknown in enumerate(dae.unknowns[: dae.x.numel()]):
        position = places.get((unknown.variable, unknown.order - 1))
        if position is None:
            continue
        # Only velocities whose whole stencil lies in the known past are replaced; the oldest ones stay exact.
        for j in range(min(len(alpha), available - len(alpha) + 1)):
            past = start.values[position, j : j + len(alpha)]
            quotient = ca.dot(past.T, ca.DM(alpha)) / ca.if_else(h == 0, 1, h)
            history[place, j] = ca.if_else(h == 0, history[place, j], quotient)
    return history


def instantaneous(dae: Dae) -> Discretization:
    """Return the one discretization of a `Dae` without differential states: its equations, at the new instant."""
    reference, (gamma,) = dae.reference_symbols(1)
    old, h, start = ca.SX.sym("old", dae.z.numel()), ca.SX.sym("h"), Start.of(dae)
    residual, first = dae.at(dae.h, dae.x, dae.z, gamma), start.values[:, 0]
    return on_history(dae, old, residual, h=h, reference=reference, nodes=(1.0,), start=start, first=first)


def backward_differences(dae: Dae, alpha: list[float], start: Start) -> Discretization:
    """Return one step of H(x1) (sum_i alpha_i x_(1-i)) = h f(x1, z1, t1), 0 = h(x1, z1, t1)."""
    size_x, h = dae.x.numel(), ca.SX.sym("h")
    # One column more than the formula needs serves to extrapolate the first guess with its order.
    history = ca.SX.sym("past", size_x + dae.z.numel(), len(alpha))
    reference, (gamma,) = dae.reference_symbols(1)
    past = sum((a * history[:size_x, i] for i, a in enumerate(alpha[1:])), ca.SX.zeros(size_x))
    rate = (alpha[0] * dae.x + past) / h
    residual = dae.at(ca.vertcat(ca.mtimes(dae.H, rate) - dae.f, dae.h), dae.x, dae.z, gamma)
    first = differenced(dae, start, h, alpha)
    return on_history(dae, history, residual, h=h, reference=reference, nodes=(1.0,), start=start, first=first)


def on_history(
    dae: Dae,
    history: ca.SX,
    residual: ca.SX,
    *,
    h: ca.SX,
    reference: ca.SX,
    nodes: tuple[float, ...],
    start: Start,
    first: ca.SX,
) -> Discretization:
    """Return one step of a method whose state is the unknowns at equidistant instants, the newest first.

    First guess and dense output come from the polynomial through these instants.

    Parameters
    ----------
    dae : Dae
        The form; its x and z are the unknowns of the step.
    history : casadi.SX
        Symbols of the state, shape (len x + len z, instants).
    residual : casadi.SX
        Equations of the step, in the unknowns, history, reference and h.
    h, reference, nodes, start
        See `Discretization`.
    first : casadi.SX
        The history at the initial time.
    """
    size_x, places = dae.x.numel(), -np.arange(float(history.size2()))  # in steps
    unknowns, fraction = ca.vertcat(dae.x, dae.z), ca.SX.sym("fraction")
    # Newton's matrix of the overhead crane on index 3, h = 1e-4 s: condition 1e14 without these scales, 200 with them.
    unknown_scale, residual_scale = dae.scales(h)
    equations = SquareSystem(
        unknowns=unknowns,
        givens=ca.vertcat(ca.vec(history), ca.vec(reference), h, dae.p),
        residual=residual,
        # Extrapolation with the order of the method halves Newton's iterations.
        guess=ca.mtimes(history, lagrange(places, [1.0])),
        unknown_scale=unknown_scale,
        residual_scale=residual_scale,
    )
    return Discretization(
        equations=equations,
        state=ca.vec(history),
        next_state=ca.vertcat(unknowns, ca.vec(history[:, :-1])),
        start=start,
        first_state=ca.vec(first),
        x=history[:size_x, 0],
        z=history[size_x:, 0],
        nodes=nodes,
        reference=reference,
        step=h,
        fraction=fraction,
        between=ca.vertcat(ca.mtimes(history, lagrange(places, [fraction - 1])), ca.vec(history[:, 1:])),
        labels=dae.labels,
    )
