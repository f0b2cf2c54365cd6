"""The projected equations: (29) on redundant coordinates, (19) on generalized ones.

`project` returns the matrices D and W, for C M^-1, that split the momentum equation, (14) to (28).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.dae import Dae, Equation
from servocore.errors import InvalidModel
from servocore.formulations.base import mechanical_dae
from servocore.model.system import MechanicalSystem
from servocore.numerics.components import parts_of
from servocore.structure.derivative_array import derivative_array


@dataclass(frozen=True)
class Projected:
    """Equation (29), and (19) when the system has generalized coordinates: index 3 for the crane.

    The momentum equation is split by D^T and C M^-1; the second part, with the servo constraint differentiated
    twice in place of the accelerations, is algebraic. Needs inertia in the servo constrained directions; elsewhere
    M may be singular.

    Attributes
    ----------
    name : str
        Name in solutions and messages.
    """

    name: str = "projected"

    def dae(self, system: MechanicalSystem) -> Dae:
        """Return q_dot = v, D^T M v_dot = -D^T {...}, 0 = C M^-1 {...} - xi, 0 = c, 0 = g."""
        D, W = project(system)
        forces = system.bias + system.constraint_forces
        # c'' = 0 yields C v_dot = gamma'' - C_dot v = -xi, so that the algebraic rows contain no v_dot.
        xi = ca.jtimes(ca.mtimes(system.C, system.v), system.q, system.v) - system.path[:, 2]
        return mechanical_dae(
            system,
            "projected",
            # C D = 0: these rows are the momentum along the directions in which no servo output moves.
            H=ca.mtimes(D.T, system.mass),
            f=-ca.mtimes(D.T, forces),
            # W^T replaces C M^-1, which does not exist where massless coordinates make M singular.
            h=ca.mtimes(W.T, forces) - xi,
            described=[
                *(Equation(f"projected momentum {k + 1}", 2) for k in range(D.size2())),
                *(Equation(f"servo acceleration of {quantity.name}", 2) for quantity in system.outputs),
            ],
            index=_index(system, W),
        )


def _index(system: MechanicalSystem, W: ca.SX) -> int:
    """Return the differentiation index of (29) from the numbers of differentiations of (1).

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


def project(system: MechanicalSystem) -> tuple[ca.SX, ca.SX]:
    """Return the matrices D and W that split the momentum equation.

    D, shape (n, n - m), is a basis of the kernel of C, equation (26). W, shape (n, m), satisfies M W = C^T, so that W^T
    replaces C M^-1 in (27) even where M is singular.

    C = [C_d, C_i] is split into dependent and independent columns, and D = [-C_d^-1 C_i; I]: the Boolean complement
    of a Boolean C.

    Raises
    ------
    InvalidModel
        If the servo Jacobian loses rank at the system's home, or a servo constrained direction has no mass.
    """
    C, dependent = system.C, system.dependent_coordinates()
    free = [k for k in range(C.size2()) if k not in dependent]
    D = ca.SX.zeros(C.size2(), len(free))
    D[free, :] = ca.SX.eye(len(free))
    if free:
        D[dependent, :] = -ca.solve(C[:, dependent], C[:, free])
    return ca.sparsify(D), mass_inverse_times(system, C.T)


def mass_inverse_times(system: MechanicalSystem, right: ca.SX) -> ca.SX:
    """Return W with M W = right, using only the coordinates that inertia couples to the servo constrained ones."""
    n = len(system.coordinates)
    constrained = right.sparsity().row()
    parts = parts_of(system.mass.sparsity())
    coupled = sorted(k for part in parts if np.isin(part.rows, constrained).any() for k in part.rows.tolist())
    M = system.mass[coupled, coupled]
    q, p = system.home_configuration()
    values = np.asarray(ca.Function("M", [system.q, system.p], [M])(q, p))
    if np.linalg.matrix_rank(values) < len(coupled):
        names = ", ".join(system.coordinates.names[k] for k in coupled)
        raise InvalidModel(
            f"{system.name}: the projection needs inertia in the servo constrained directions,"
            f" but the mass matrix is singular on {names}"
        )
    W = ca.SX(n, right.size2())
    if M.sparsity().is_diag():
        W[coupled, :] = right[coupled, :] / ca.repmat(ca.diag(M), 1, right.size2())
    else:
        # M is symmetric positive definite here; LDL^T gives far smaller expressions than a general solution.
        W[coupled, :] = ca.ldl_solve(ca.densify(right[coupled, :]), *ca.ldl(M))
    return ca.sparsify(W)
