"""Structural analysis of a servo constraint problem by the signature method of Pryce (BIT 41 (2001) 364).

The second-order equations (1) in the variables y = (q, lam, u) are looked at as they stand: sigma_ij is the highest
derivative of variable j in equation i. A transversal of maximum weight and the smallest offsets c, d with
d_j - c_i >= sigma_ij say which equations to differentiate how often (c) and which derivatives they then determine (d).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel
from servocore.system import MechanicalSystem

ABSENT = -1
"""Entry of the signature matrix for a variable that does not occur."""


@dataclass(frozen=True, eq=False)
class SecondOrderEquations:
    """Equation (1) with v = q_dot inserted, as functions of the derivatives of y = (q, lam, u).

    Attributes
    ----------
    residual : casadi.SX
        Momentum balance (n), servo constraints (m), holonomic constraints (m_h); shape (N,).
    y : casadi.SX
        Symbols of the variables and their first two derivatives, shape (N, 3).
    names, equations : tuple of str
        What the variables and the rows are called.
    """

    system: MechanicalSystem
    residual: ca.SX
    y: ca.SX
    names: tuple[str, ...]
    equations: tuple[str, ...]


def second_order_equations(system: MechanicalSystem) -> SecondOrderEquations:
    """Write equation (1) in the variables y = (q, lam, u)."""
    n = len(system.coordinates)
    acceleration = ca.SX.sym("a", n)
    residual = ca.vertcat(
        system.momentum_balance(acceleration), system.output - system.gamma[:, 0], system.constraints
    )
    y = ca.SX.sym("y", residual.numel(), 3)
    old = ca.vertcat(system.q, system.lam, system.u, system.v, acceleration)
    new = ca.vertcat(y[:, 0], y[:n, 1], y[:n, 2])
    return SecondOrderEquations(
        system=system,
        residual=ca.substitute(residual, old, new),
        y=y,
        names=(
            *(f"q.{name}" for name in system.coordinates.names),
            *(f"lam.{k + 1}" for k in range(system.lam.numel())),
            *(f"u.{each.name}" for each in system.inputs),
        ),
        equations=(
            *(f"momentum of {name}" for name in system.coordinates.names),
            *(f"servo constraint on {each.name}" for each in system.outputs),
            *(f"holonomic constraint {k + 1}" for k in range(system.lam.numel())),
        ),
    )


@dataclass(frozen=True, eq=False)
class Signature:
    """Result of the signature method.

    Attributes
    ----------
    sigma : ndarray of int
        Shape (N, N); `ABSENT` where a variable does not occur.
    equation_offsets, variable_offsets : tuple of int
        c and d.
    """

    sigma: npt.NDArray[np.int64]
    equation_offsets: tuple[int, ...]
    variable_offsets: tuple[int, ...]

    @property
    def degrees_of_freedom(self) -> int:
        """Sum d - sum c: dimension of the internal dynamics of the inverse problem."""
        return sum(self.variable_offsets) - sum(self.equation_offsets)

    @property
    def index(self) -> int:
        """Structural index: max c, plus one if a variable occurs algebraically."""
        return max(self.equation_offsets, default=0) + int(0 in self.variable_offsets)


def signature(equations: SecondOrderEquations) -> Signature:
    """Apply the signature method.

    Raises
    ------
    InvalidModel
        If no transversal exists: the equations are structurally singular.
    """
    import scipy.optimize  # noqa: PLC0415 - kept out of the run time of an FMU

    sigma = np.full((len(equations.names),) * 2, ABSENT)
    for order in range(3):
        pattern = ca.jacobian_sparsity(equations.residual, equations.y[:, order])
        rows, columns = pattern.get_triplet()
        sigma[rows, columns] = order
    size = len(sigma)
    weights = np.where(sigma == ABSENT, -4 * (size + 1), sigma)
    rows, columns = scipy.optimize.linear_sum_assignment(weights, maximize=True)
    missing = [equations.equations[i] for i, j in zip(rows, columns, strict=True) if sigma[i, j] == ABSENT]
    if missing:
        raise InvalidModel(f"{equations.system.name}: structurally singular, nothing is left for {missing[0]}")
    return Signature(sigma, *_smallest_offsets(sigma, columns))


def _smallest_offsets(
    sigma: npt.NDArray[np.int64], transversal: npt.NDArray[np.intp]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the smallest c, d >= 0 with d_j - c_i >= sigma_ij, equality on the transversal."""
    rows = np.arange(len(sigma))
    c = np.zeros(len(sigma), dtype=np.int64)
    while True:
        d = np.where(sigma == ABSENT, ABSENT, sigma + c[:, None]).max(axis=0, initial=0)
        new = d[transversal] - sigma[rows, transversal]
        if (new == c).all():
            return tuple(int(k) for k in c), tuple(int(k) for k in d)
        c = new
