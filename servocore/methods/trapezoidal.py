"""The trapezoidal rule, for comparison: a method without damping."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.dae import Dae
from servocore.methods.base import Discretization, Orders, Start, on_history


@dataclass(frozen=True)
class Trapezoidal:
    """The trapezoidal rule.

        (H(x0) + H(x1)) / 2 (x1 - x0) = h (f(x0, z0, t0) + f(x1, z1, t1)) / 2,    0 = h(x1, z1, t1)

    Order two on forms of index one. On projected forms an error of the velocities alternates undamped from step to
    step, and the inputs with it: an error at the start persists. For comparison only.

    Attributes
    ----------
    name : str
        Name in solutions and messages.
    """

    name: str = "trapezoidal"

    def orders(self, index: int) -> Orders:
        """Return the orders of convergence on a form of the given index, without an error at the start."""
        if index > 3:
            # Every index above 3 costs an order; a negative one means errors that grow as steps fall.
            return Orders(5 - index, 4 - index, 3 - index, damped=False)
        return Orders(2, 2, 2, damped=False)

    def discretize(self, dae: Dae) -> Discretization:
        """Return the equations of one step."""
        size_x, h, start = dae.x.numel(), ca.SX.sym("h"), Start.of(dae)
        history = ca.SX.sym("past", size_x + dae.z.numel(), 2)
        reference, (gamma0, gamma1) = dae.reference_symbols(2)
        old_x, old_z = history[:size_x, 0], history[size_x:, 0]
        H, f = (
            (dae.at(expression, old_x, old_z, gamma0) + dae.at(expression, dae.x, dae.z, gamma1)) / 2
            for expression in (dae.H, dae.f)
        )
        # Algebraic equations at the new instant: averaged, their residual at the start would alternate.
        residual = ca.vertcat(ca.mtimes(H, (dae.x - old_x) / h) - f, dae.at(dae.h, dae.x, dae.z, gamma1))
        # The column before the start is unknown, and used by the extrapolated guess of the first step only.
        first = ca.repmat(start.values[:, 0], 1, 2)
        return on_history(dae, history, residual, h=h, reference=reference, nodes=(0.0, 1.0), start=start, first=first)
