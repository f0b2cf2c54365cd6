"""The unchanged equations of motion, equation (1), or (10) on generalized coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.dae import Dae, Equation
from servocore.formulations.base import mechanical_dae
from servocore.model.system import MechanicalSystem
from servocore.structure.derivative_array import derivative_array


@dataclass(frozen=True)
class Original:
    """Equation (1): index 5 for the crane, 2 n + 1 for n cars.

    A backward Euler step divides position errors by h^4 to get the inputs, so that round-off spoils them at small
    steps. For comparison, and for systems of lower index.

    Attributes
    ----------
    name : str
        Name in solutions and messages.
    """

    name: str = "original"

    def dae(self, system: MechanicalSystem) -> Dae:
        """Return q_dot = v, M v_dot = -(bias + G^T lam + B^T u), 0 = g, 0 = c."""
        # Equation (1)_2 solved for M v_dot; the paper's bias is grad V + gyroscopic forces - f.
        momentum = -(system.bias + system.constraint_forces)
        described = [Equation(f"momentum of {name}", 2) for name in system.coordinates.names]
        index = derivative_array(system).signature.index
        # With constraints of positions the index is 5, and a step divides by h^4.
        return mechanical_dae(system, "original", system.mass, momentum, ca.SX(0, 1), described, index)
