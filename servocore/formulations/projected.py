"""The projected equations: (29) on redundant coordinates, (19) on generalized ones."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.dae import Dae, Equation
from servocore.formulations.base import mechanical_dae
from servocore.model.system import MechanicalSystem
from servocore.structure.derivative_array import derivative_array
from servocore.structure.projection import project


@dataclass(frozen=True)
class Projected:
    """Equation (29), and (19) when the system has generalized coordinates: index 3 for the crane.

    The momentum equation is split by D^T and C M^-1; the second part, with the servo constraint differentiated
    twice in place of the accelerations, is algebraic. Needs inertia in the servo constrained directions; elsewhere
    M may be singular.

    Attributes
    ----------
    name : str
        What solutions and messages call it.
    """

    name: str = "projected"

    def dae(self, system: MechanicalSystem) -> Dae:
        """Return q_dot = v, D^T M v_dot = -D^T {...}, 0 = C M^-1 {...} - xi, 0 = c, 0 = g."""
        projection = project(system)
        forces = system.bias + system.constraint_forces
        # c'' = 0 gives C v_dot = gamma'' - C_dot v; xi is minus that, and no v_dot is left in the algebraic rows.
        xi = ca.jtimes(ca.mtimes(system.C, system.v), system.q, system.v) - system.path[:, 2]
        return mechanical_dae(
            system,
            "projected",
            # C D = 0: these rows are the momentum along the directions in which no servo output moves.
            H=ca.mtimes(projection.D.T, system.mass),
            f=-ca.mtimes(projection.D.T, forces),
            # W^T stands for C M^-1, which does not exist where massless coordinates make M singular.
            h=ca.mtimes(projection.W.T, forces) - xi,
            described=[
                *(Equation(f"projected momentum {k + 1}", 2) for k in range(projection.D.size2())),
                *(Equation(f"servo acceleration of {quantity.name}", 2) for quantity in system.outputs),
            ],
            index=_index(system, projection.W),
        )


def _index(system: MechanicalSystem, W: ca.SX) -> int:
    """Return the differentiation index of (29) from what (1) has to be differentiated.

    The second derivative of c = 0 stands among the rows of (29) already, which saves two differentiations of it. But
    c = 0 itself has to be differentiated twice, for v_dot along C occurs nowhere else, and once more unless that row
    determines all forces: others follow from rows with v_dot.
    """
    signature, n, m = derivative_array(system).signature, len(system.coordinates), len(system.outputs)
    # C M^-1 B^T: regular means that the algebraic rows determine the inputs without another differentiation.
    by_input = ca.Function("sc_by_input", [system.q, system.p], [ca.mtimes(W.T, system.input_matrix.T)])
    rank = np.linalg.matrix_rank(np.asarray(by_input(*system.home_configuration())))
    forces_follow = rank == m and not system.lam.numel()
    offsets = signature.equation_offsets
    others = max((*offsets[:n], *offsets[n + m :]), default=0)
    return max(2 if forces_follow else 3, max(others, max(offsets[n : n + m]) - 2) + signature.algebraic)
