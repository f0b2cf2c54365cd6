"""The scheme of the paper, equation (31)."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.dae import Dae
from servocore.methods.base import (
    Discretisation,
    Orders,
    Start,
    at,
    differenced,
    labels,
    reference_symbols,
    scales,
    start_symbols,
)
from servocore.numerics.square_systems import SquareSystem


@dataclass(frozen=True)
class BackwardEuler:
    """Backward Euler, equation (31).

        H(x1) (x1 - x0) = h f(x1, z1, t1),    0 = h(x1, z1, t1)

    First order in all variables of a projected form (index 3) at constant step; L-stable. With H(x) evaluated at the
    new instant. On projected forms the velocity at the initial time is (q(t0) - q(t0 - h)) / h, with positions from the
    exact inversion: with the exact velocity the first step of a path that starts in motion would see half of the
    acceleration.

    The state holds the unknowns at the last two instants: the older one serves to extrapolate the first guess.
    """

    name: str = "backward-euler"

    def orders(self, index: int) -> Orders:  # noqa: ARG002 - the same on every form up to index 3
        """Return the orders of convergence on a form of the given index."""
        return Orders(1, 1, 1)

    @staticmethod
    def _first_state(dae: Dae, start: Start, h: ca.SX) -> ca.SX:
        if dae.index <= 1:
            return ca.repmat(start.values, 2, 1)
        return ca.vec(differenced(dae, start, h, [1.0, -1.0]))

    def discretise(self, dae: Dae) -> Discretisation:
        """Return the equations of one step of (31)."""
        size_x, size = dae.x.numel(), dae.x.numel() + dae.z.numel()
        old, older, h = ca.SX.sym("old", size), ca.SX.sym("older", size), ca.SX.sym("h")
        reference, (gamma,) = reference_symbols(dae, 1)
        rate = (dae.x - old[:size_x]) / h
        unknowns, start = ca.vertcat(dae.x, dae.z), start_symbols(dae, 2 if dae.index > 1 else 1)
        ratio, fraction = ca.SX.sym("ratio"), ca.SX.sym("fraction")
        unknown_scale, residual_scale = scales(dae, h)
        equations = SquareSystem(
            unknowns=unknowns,
            givens=ca.vertcat(old, older, ca.vec(reference), h, dae.p),
            residual=at(dae, ca.vertcat(ca.mtimes(dae.H, rate) - dae.f, dae.h), dae.x, dae.z, gamma),
            guess=2 * old - older,
            unknown_scale=unknown_scale,
            residual_scale=residual_scale,
        )
        return Discretisation(
            equations=equations,
            state=ca.vertcat(old, older),
            next_state=ca.vertcat(unknowns, old),
            start=start,
            first_state=self._first_state(dae, start, h),
            x=old[:size_x],
            z=old[size_x:],
            nodes=(1.0,),
            reference=reference,
            step=h,
            ratio=ratio,
            rescaled=ca.vertcat(old, old - ratio * (old - older)),
            fraction=fraction,
            between=ca.vertcat(old - (1 - fraction) * (old - older), older),
            labels=labels(dae),
        )
