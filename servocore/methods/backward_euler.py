"""The scheme of the paper, equation (31)."""

from __future__ import annotations

from dataclasses import dataclass

from servocore.dae import Dae
from servocore.methods.base import Discretization, Orders, Start, backward_differences


@dataclass(frozen=True)
class BackwardEuler:
    """Backward Euler, equation (31).

        H(x1) (x1 - x0) = h f(x1, z1, t1),    0 = h(x1, z1, t1)

    First order in all variables of a projected form (index 3) at constant step; L-stable. With H(x) evaluated at the
    new instant. On projected forms the velocity at the initial time is (q(t0) - q(t0 - h)) / h, with positions from the
    exact inversion: with the exact velocity the first step of a path that starts in motion would see half of the
    acceleration.

    The state holds the unknowns at the last two instants: the older one serves to extrapolate the first guess.

    Attributes
    ----------
    name : str
        Name in solutions and messages.
    """

    name: str = "backward-euler"

    def orders(self, index: int) -> Orders:  # noqa: ARG002 - the same on every form up to index 3
        """Return the orders of convergence on a form of the given index."""
        return Orders(1, 1, 1)

    def discretize(self, dae: Dae) -> Discretization:
        """Return the equations of one step of (31)."""
        # One instant more where the first velocity has to be a difference quotient, as in all later steps.
        return backward_differences(dae, [1.0, -1.0], Start.of(dae, 2 if dae.index > 1 else 1))
