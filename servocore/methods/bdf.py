"""Backward differentiation formulas at constant step, of order one to six."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import comb
from numbers import Integral

from servocore.dae import Dae
from servocore.errors import InvalidSetting, require_kind
from servocore.methods.base import Discretization, Orders, Start, backward_differences


def coefficients(order: int) -> tuple[Fraction, ...]:
    """Return alpha_0, ..., alpha_k of x_dot(t1) = (sum_i alpha_i x(t1 - i h)) / h, exactly.

    They are the sum of the backward differences nabla^j / j, j = 1 ... k, and are checked to differentiate
    polynomials up to degree k.
    """
    steps = range(order + 1)
    alpha = tuple(sum((Fraction((-1) ** i * comb(j, i), j) for j in steps[1:]), Fraction(0)) for i in steps)
    for degree in steps:
        # A formula of order k differentiates t^0 ... t^k exactly at t = 0; rationals leave no room for round-off.
        moment = sum(a * Fraction(-i) ** degree for i, a in enumerate(alpha))
        if moment != (degree == 1):
            raise AssertionError(f"BDF{order} does not differentiate degree {degree}")
    return alpha


@dataclass(frozen=True)
class BDF:
    """Backward differentiation of order k at constant step.

        H(x1) (sum_i alpha_i x_{1-i}) = h f(x1, z1, t1),    0 = h(x1, z1, t1)

    Order k in all variables of a projected form (index 3) at constant step, A(alpha)-stable, for k up to 6. The start
    needs a history: positions come from the exact inversion before the initial time, on the reference continued
    backwards. On forms of index two and more their velocities are formed by the scheme's own difference formula:
    a jump between exact and differenced velocities would cost the inputs an order.

    Parameters
    ----------
    order : int
        Order k of the method, 1 to 6.
    """

    order: int = 2

    def __post_init__(self) -> None:
        require_kind(self.order, Integral, "the order of BDF", "a whole number", InvalidSetting)
        # Order 7 and above is not zero-stable: errors grow at every step size.
        if self.order not in range(1, 7):
            raise InvalidSetting(f"BDF of order {self.order} does not exist or is unstable; use 1 to 6")

    @property
    def name(self) -> str:
        """Name on command lines and in tables."""
        return f"bdf{self.order}"

    def orders(self, index: int) -> Orders:  # noqa: ARG002 - the same on every form up to index 3
        """Return the orders of convergence on a form of the given index."""
        return Orders(self.order, self.order, self.order)

    def discretize(self, dae: Dae) -> Discretization:
        """Return the equations of one step."""
        alpha = [float(coefficient) for coefficient in coefficients(self.order)]
        # k + 1 instants make the history; differencing the velocities at each of them takes k more.
        return backward_differences(dae, alpha, Start.of(dae, 2 * self.order + 1))
