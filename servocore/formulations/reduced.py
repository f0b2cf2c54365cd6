"""The index-reduced problem: the derivative array of the signature method."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from servocore.dae import Dae, Equation, Unknown
from servocore.errors import InvalidSetting
from servocore.model.system import MechanicalSystem
from servocore.structure.derivative_array import DerivativeArray, derivative_array, nominal


@dataclass(frozen=True)
class Reduced:
    """The derivative array as a `Dae` of index at most one; exact where there are no internal dynamics.

    The equations and their derivatives, as often as the signature method requires, determine all derivatives of all
    variables but the states of the internal dynamics; those become the differential unknowns. Without internal
    dynamics (every crane here) nothing is integrated: the inputs at an instant follow from the reference and its
    derivatives at that instant, to round-off, for any step.

    Parameters
    ----------
    name : str
        Name in solutions and messages.
    states : tuple of (str, int), optional
        States of the internal dynamics, each a variable and the order of its derivative: ("q.s", 0), ("q.s", 1). Chosen
        by pivoting when not given, and again by `solve` during a run where they become ill-conditioned.
    """

    name: str = "reduced"
    states: tuple[tuple[str, int], ...] = ()

    def array(self, system: MechanicalSystem) -> DerivativeArray:
        """Return the derivative array with these states, or with those that suit the system's home.

        Parameters
        ----------
        system : MechanicalSystem
            Whose equations are differentiated.

        Returns
        -------
        DerivativeArray
            The derivative array, the same object for the same system.
        """
        array = derivative_array(system)
        if not self.states:
            return array
        return replace(array, states=tuple(_entry(array, state) for state in self.states))

    def dae(self, system: MechanicalSystem) -> Dae:
        """Return x_dot = next derivative of x, 0 = derivative array."""
        array = self.array(system)
        unknowns = (*array.states, *array.determined)
        n = len(system.coordinates)
        size_x = len(array.states)
        return Dae(
            name=f"{system.name}, reduced",
            x=array.column(array.states),
            z=array.column(array.determined),
            H=ca.SX.eye(size_x),
            # The next derivative of a state is an unknown of the array, so that the ODE is explicit: H = 1.
            f=array.column(tuple((j, order + 1) for j, order in array.states)),
            h=array.residual,
            gamma=system.gamma,
            p=system.p,
            unknowns=tuple(Unknown(array.names[j], order, nominal(system, j)) for j, order in unknowns),
            equations=(
                *(Equation(f"rate of {array.names[j]}" + "'" * order, 0) for j, order in array.states),
                *(
                    Equation(array.signature.equations.equations[i] + _times_differentiated(order), 0)
                    for i, order in array.rows
                ),
            ),
            physical={
                "q": array.y[:n, 0],
                "v": array.y[:n, 1],
                "lam": array.y[n : n + system.lam.numel(), 0],
                "u": array.y[n + system.lam.numel() :, 0],
            },
            # All of z follows from the array, whose Jacobian is regular at points that the signature method accepts.
            index=1 if size_x else 0,
        )


def _entry(array: DerivativeArray, state: object) -> tuple[int, int]:
    """Return variable and order of a state; raises `InvalidSetting` if it is none."""
    entries = {(array.names[j], order): (j, order) for j, order in array.unknowns}
    if not isinstance(state, tuple) or state not in entries:
        raise InvalidSetting(
            f"{array.system.name}: a state is a variable and the order of its derivative, such as"
            f" {next(iter(entries))}, not {state!r}"
        )
    return entries[state]


def _times_differentiated(order: int) -> str:
    return f", differentiated {order} times" if order > 1 else (", differentiated" if order else "")
