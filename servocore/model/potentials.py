"""Potentials with their summands, for integration that conserves energy exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca

from servocore.errors import InvalidModel, described
from servocore.numerics.expressions import as_expression

Energy: TypeAlias = Callable[[ca.SX], ca.SX]
"""W(pi): a smooth function of one number."""


_CLOSE = 1e-4  # relative change of an invariant below which the series is better than the quotient


@dataclass(frozen=True, eq=False)
class Stored:
    """The energy W(pi(q)) of a part of the potential.

    Parameters
    ----------
    energy : callable
        W, from a CasADi expression to another; in J.
    invariant : casadi.SX
        pi(q, p), scalar, at most quadratic in q and invariant under rotations if the energy is: the square of a length,
        the product of two directors.
    """

    energy: Energy
    invariant: ca.SX

    def slope(self, before: ca.SX, after: ca.SX) -> ca.SX:
        """Return the difference quotient of W between two values of the invariant, J per its unit.

        Where they are close, the series about the middle with the third derivative avoids cancellation.
        """
        x, middle, change = ca.SX.sym("x"), (before + after) / 2, after - before
        first = ca.gradient(self._at(x), x)
        third = ca.gradient(ca.gradient(first, x), x)
        slope_there, bend_there = ca.substitute([first, third], [x], [middle])
        near = slope_there + bend_there * change**2 / 24
        close = ca.fabs(change) < _CLOSE * (1 + ca.fabs(middle))
        quotient = (self._at(after) - self._at(before)) / ca.if_else(close, 1, change)
        return ca.if_else(close, near, quotient)

    def _at(self, value: ca.SX) -> ca.SX:
        return as_expression(self.energy(value), "a stored energy")


class Potential(ca.SX):
    """A potential V(q) = V2(q) + sum of W_a(pi_a(q)) that keeps its summands.

    As an expression it is their sum, and serves as any potential; `EnergyMomentum` uses the summands.

    Parameters
    ----------
    quadratic : casadi.SX
        V2, at most quadratic in q: weight, linear springs between coordinates.
    stored : sequence of (callable, casadi.SX)
        Pairs (W, pi); pi at most quadratic in q and invariant: for a spring between two points the square of their
        distance.

    Examples
    --------
    A spring of stiffness c and free length l0 between two points a and b:

    >>> import casadi as ca
    >>> import servocore as sc
    >>> a, b, c, l0 = ca.SX.sym("a", 3), ca.SX.sym("b", 3), 100.0, 0.5
    >>> spring = sc.Potential(0.0, [(lambda x: c / 2 * (ca.sqrt(x) - l0) ** 2, ca.sumsqr(b - a))])
    >>> len(spring.stored)
    1
    """

    def __init__(self, quadratic: ca.SX | float, stored: Sequence[tuple[Energy, ca.SX]] = ()) -> None:
        self.quadratic = as_expression(quadratic, "the quadratic part of a potential")
        for energy in stored:
            if not (isinstance(energy, tuple) and len(energy) == 2 and callable(energy[0])):
                raise InvalidModel(
                    f"a stored energy is a pair (W, pi) of a function and an expression, not {described(energy)}"
                )
        self.stored = tuple(Stored(W, as_expression(pi, "an invariant")) for W, pi in stored)
        total = self.quadratic
        for part in self.stored:
            if part.invariant.numel() != 1:
                raise InvalidModel(f"an invariant is one expression, not one of shape {part.invariant.shape}")
            total = total + as_expression(part.energy(part.invariant), "a stored energy")
        super().__init__(total)


def summands(potential: ca.SX) -> tuple[ca.SX, tuple[Stored, ...]]:
    """Return V2 and the stored energies of a potential; a plain expression has none."""
    if isinstance(potential, Potential):
        return potential.quadratic, potential.stored
    return potential, ()
