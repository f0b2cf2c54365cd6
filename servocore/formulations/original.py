"""The equations of motion as they stand, equation (1), or (10) on generalized coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.dae import Dae, Equation
from servocore.formulations.base import mechanical_unknowns, physical_variables
from servocore.model.system import MechanicalSystem
from servocore.structure.derivative_array import derivative_array


@dataclass(frozen=True)
class Original:
    """Equation (1): index 5 for the crane, 2 n + 1 for n cars.

    A backward Euler step divides position errors by h^4 to get the inputs, so small steps destroy them. The form
    is kept to show that, and for systems of lower index.

    Attributes
    ----------
    name : str
        What solutions and messages call it.
    """

    name: str = "original"

    def dae(self, system: MechanicalSystem) -> Dae:
        """Return q_dot = v, M v_dot = -(bias + G^T lam + B^T u), 0 = g, 0 = c."""
        x, z, unknowns = mechanical_unknowns(system)
        n = len(system.coordinates)
        # Equation (1)_2 solved for M v_dot; the paper's bias is grad V + gyroscopic forces - f.
        momentum = -(system.bias + system.constraint_forces)
        names = system.coordinates.names
        return Dae(
            name=f"{system.name}, original",
            x=x,
            z=z,
            H=ca.diagcat(ca.SX.eye(n), system.mass),
            f=ca.vertcat(system.v, momentum),
            # The constraints stay at the level of positions: that is what makes the index 5, and a step divides by h^4.
            h=ca.vertcat(system.output - system.path[:, 0], system.constraints),
            gamma=system.gamma,
            p=system.p,
            unknowns=unknowns,
            equations=(
                *(Equation(f"velocity of {name}", 1) for name in names),
                *(Equation(f"momentum of {name}", 2) for name in names),
                *(Equation(f"servo constraint on {quantity.name}", 0) for quantity in system.outputs),
                *(Equation(f"holonomic constraint {k + 1}", 0) for k in range(system.lam.numel())),
            ),
            physical=physical_variables(system),
            index=derivative_array(system).signature.index,
        )
