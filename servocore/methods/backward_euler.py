"""The scheme of the paper, equation (31)."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.dae import Dae
from servocore.methods.base import Discretisation, scales
from servocore.newton import SquareSystem


@dataclass(frozen=True)
class BackwardEuler:
    """Backward Euler, equation (31).

        H(x1) (x1 - x0) = h f(x1, z1, t1),    0 = h(x1, z1, t1)

    First order in all variables of a projected form (index 3) at constant step; L-stable. With H(x) evaluated at the
    new instant. On a `Dae` without differential states it degenerates to the solution of 0 = h per instant.

    The state holds the unknowns at the last two instants: the older one serves to extrapolate the first guess.
    """

    name: str = "backward-euler"

    def discretise(self, dae: Dae) -> Discretisation:
        """Return the equations of one step of (31)."""
        nx, nz = dae.x.numel(), dae.z.numel()
        old, older = ca.SX.sym("old", nx + nz), ca.SX.sym("older", nx + nz)
        h, p = ca.SX.sym("h"), dae.p
        gamma = ca.SX.sym("gamma1", dae.gamma.size1(), dae.reference_order + 1)
        rate = (dae.x - old[:nx]) / h
        residual = ca.vertcat(ca.mtimes(dae.H, rate) - dae.f, dae.h)
        residual = ca.substitute(residual, dae.gamma[:, : dae.reference_order + 1], gamma)
        unknowns, state = ca.vertcat(dae.x, dae.z), ca.vertcat(old, older)
        unknown_scale, residual_scale = scales(dae, h)
        equations = SquareSystem(
            unknowns=unknowns,
            givens=ca.vertcat(state, ca.vec(gamma), h, p),
            residual=residual,
            guess=2 * old - older,
            unknown_scale=unknown_scale,
            residual_scale=residual_scale,
        )
        return Discretisation(
            equations=equations,
            state=state,
            next_state=ca.vertcat(unknowns, old),
            first_state=ca.vertcat(unknowns, unknowns),
            x=old[:nx],
            z=old[nx:],
            nodes=(1.0,),
            reference=gamma,
            step=h,
        )
