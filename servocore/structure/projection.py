"""The matrices C, D and C M^-1 by which the projection method splits the momentum equation, (14) to (28)."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.model.system import MechanicalSystem


@dataclass(frozen=True, eq=False)
class Projection:
    """The matrices that split the momentum equation.

    Attributes
    ----------
    C : casadi.SX
        Servo Jacobian, shape (m, n), equation (23).
    D : casadi.SX
        Basis of its kernel, shape (n, n - m), equation (26).
    W : casadi.SX
        Shape (n, m) with M W = C^T, so that W^T stands for C M^-1 in (27) even when M is singular.
    boolean : bool
        Whether C and D hold zeros and ones only, each row of C a single one.
    """

    C: ca.SX
    D: ca.SX
    W: ca.SX
    boolean: bool


def project(system: MechanicalSystem) -> Projection:
    """Find C, D and W of a system.

    D is the Boolean complement of a Boolean C. Otherwise C = [C_d, C_i] is split into dependent and independent
    columns, and D = [-C_d^-1 C_i; I].

    Raises
    ------
    InvalidModel
        If the servo Jacobian loses rank at the system's home, or a servo constrained direction has no mass.
    """
    C = system.C
    selected = _boolean_columns(C)
    W = mass_inverse_times(system, C.T)
    if selected is not None:
        free = [k for k in range(C.size2()) if k not in selected]
        return Projection(C, ca.SX.eye(C.size2())[:, free], W, boolean=True)
    dependent = system.dependent_coordinates()
    free = [k for k in range(C.size2()) if k not in dependent]
    D = ca.SX.zeros(C.size2(), len(free))
    D[free, :] = ca.SX.eye(len(free))
    if free:
        D[dependent, :] = -ca.solve(C[:, dependent], C[:, free])
    return Projection(C, ca.sparsify(D), W, boolean=False)


def _boolean_columns(C: ca.SX) -> list[int] | None:
    """Return the column of the single one in every row, or None if C is not a selection."""
    if not C.is_constant():
        return None
    values = np.asarray(ca.DM(C))
    is_selection = np.isin(values, (0.0, 1.0)).all() and (values.sum(axis=1) == 1).all()
    if not (is_selection and (values.sum(axis=0) <= 1).all()):
        return None
    return [int(column) for column in values.argmax(axis=1)]


def mass_inverse_times(system: MechanicalSystem, right: ca.SX) -> ca.SX:
    """Return W with M W = right, using only the coordinates that inertia couples to the servo constrained ones."""
    n = len(system.coordinates)
    coupled = _coupled(system.mass, {row for row in range(n) if right[row, :].nnz()})
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


def _coupled(M: ca.SX, start: set[int]) -> list[int]:
    """Return the indices that the sparsity pattern of M connects to those in `start`."""
    rows, columns = M.sparsity().get_triplet()
    reached, frontier = set(start), set(start)
    while frontier:
        frontier = {i for i, j in zip(rows, columns, strict=True) if j in frontier} - reached
        reached |= frontier
    return sorted(reached)
