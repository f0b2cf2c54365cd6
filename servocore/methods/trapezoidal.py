"""The trapezoidal rule, kept to show what happens without damping."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.dae import Dae
from servocore.methods.base import (
    Discretisation,
    Orders,
    at,
    labels,
    reference_symbols,
    scales,
    start_symbols,
)
from servocore.numerics.square_systems import SquareSystem


@dataclass(frozen=True)
class Trapezoidal:
    """The trapezoidal rule.

        (H(x0) + H(x1)) / 2 (x1 - x0) = h (f(x0, z0, t0) + f(x1, z1, t1)) / 2,    0 = h(x1, z1, t1)

    Order two on forms of index one. On projected forms an error of the velocities alternates undamped from step to
    step, and the inputs with it: whatever disturbs the start stays. Kept to show that; not a route to results.
    """

    name: str = "trapezoidal"

    def orders(self, index: int) -> Orders:
        """Return the orders of convergence on a form of the given index, where nothing disturbs the method."""
        if index > 3:
            return Orders(5 - index, 4 - index, 3 - index)
        return Orders(2, 2, 2)

    def discretise(self, dae: Dae) -> Discretisation:
        """Return the equations of one step."""
        size_x, size = dae.x.numel(), dae.x.numel() + dae.z.numel()
        old, older, h = ca.SX.sym("old", size), ca.SX.sym("older", size), ca.SX.sym("h")
        reference, (gamma0, gamma1) = reference_symbols(dae, 2)
        old_x, old_z = old[:size_x], old[size_x:]
        H = (at(dae, dae.H, old_x, old_z, gamma0) + at(dae, dae.H, dae.x, dae.z, gamma1)) / 2
        f = (at(dae, dae.f, old_x, old_z, gamma0) + at(dae, dae.f, dae.x, dae.z, gamma1)) / 2
        unknowns, start = ca.vertcat(dae.x, dae.z), start_symbols(dae)
        ratio, fraction = ca.SX.sym("ratio"), ca.SX.sym("fraction")
        unknown_scale, residual_scale = scales(dae, h)
        equations = SquareSystem(
            unknowns=unknowns,
            givens=ca.vertcat(old, older, ca.vec(reference), h, dae.p),
            residual=ca.vertcat(ca.mtimes(H, (dae.x - old_x) / h) - f, at(dae, dae.h, dae.x, dae.z, gamma1)),
            guess=2 * old - older,
            unknown_scale=unknown_scale,
            residual_scale=residual_scale,
        )
        return Discretisation(
            equations=equations,
            state=ca.vertcat(old, older),
            next_state=ca.vertcat(unknowns, old),
            start=start,
            first_state=ca.repmat(start.values[:, 0], 2, 1),
            x=old_x,
            z=old_z,
            nodes=(0.0, 1.0),
            reference=reference,
            step=h,
            ratio=ratio,
            rescaled=ca.vertcat(old, old - ratio * (old - older)),
            fraction=fraction,
            between=ca.vertcat(old - (1 - fraction) * (old - older), older),
            labels=labels(dae),
        )
