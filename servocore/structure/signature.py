"""The signature method of Pryce (BIT 41 (2001) 364): what the structure of equations says of derivatives.

sigma_ij is the highest derivative of variable j in equation i. A transversal of maximum weight and the smallest offsets
c, d with d_j - c_i >= sigma_ij say which equations to differentiate how often (c) and which derivatives they then
determine (d), if the system Jacobian J_ij = df_i / dy_j^(d_j - c_i) is nonsingular.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel
from servocore.numerics.calls import Array

ABSENT = -1
"""Entry of the signature matrix for a variable that does not occur."""

_SWEEPS = 6  # of equilibration


@dataclass(frozen=True, eq=False)
class SecondOrderEquations:
    """Equation (1) with v = q_dot inserted, as functions of the derivatives of y = (q, lam, u).

    Attributes
    ----------
    name : str
        Of the system, for messages.
    residual : casadi.SX
        Momentum balance (n), servo constraints (m), holonomic constraints (m_h); shape (N,).
    y : casadi.SX
        Symbols of the variables and their first two derivatives, shape (N, 3).
    names, equations : tuple of str
        What the variables and the rows are called.
    embedded : tuple of int
        How often the servo constraint was differentiated to make each row: 2 for combined rows, else 0.
    remedy : str
        What was done to the equations first; empty if nothing.
    special : bool
        Whether that holds for the home parameters only.
    """

    name: str
    residual: ca.SX
    y: ca.SX
    names: tuple[str, ...]
    equations: tuple[str, ...]
    embedded: tuple[int, ...]
    remedy: str = ""
    special: bool = False


@dataclass(frozen=True, eq=False)
class Signature:
    """Result of the signature method.

    Attributes
    ----------
    equations : SecondOrderEquations
        What was analysed, after a remedy if one was needed.
    sigma : ndarray of int
        Shape (N, N); `ABSENT` where a variable does not occur.
    equation_offsets, variable_offsets : tuple of int
        c and d.
    jacobian : casadi.SX
        System Jacobian J_ij = df_i / dy_j^(d_j - c_i), shape (N, N), an expression of y, gamma and p.
    """

    equations: SecondOrderEquations
    sigma: npt.NDArray[np.int64]
    equation_offsets: tuple[int, ...]
    variable_offsets: tuple[int, ...]
    jacobian: ca.SX

    @property
    def degrees_of_freedom(self) -> int:
        """Sum d - sum c: dimension of the internal dynamics of the inverse problem."""
        return sum(self.variable_offsets) - sum(self.equation_offsets)

    @property
    def index(self) -> int:
        """Structural index: the most differentiations, plus one if a variable occurs algebraically."""
        return max(self.differentiations, default=0) + self.algebraic

    @property
    def differentiations(self) -> tuple[int, ...]:
        """How often each equation of (1) is differentiated: its offset, and what a remedy did before."""
        return tuple(c + embedded for c, embedded in zip(self.equation_offsets, self.equations.embedded, strict=True))

    @property
    def algebraic(self) -> int:
        """One if some variable occurs without derivatives, so that its rate takes another differentiation, or zero."""
        return int(0 in self.variable_offsets)


def signature(equations: SecondOrderEquations) -> Signature:
    """Apply the signature method to equations as they stand.

    Raises
    ------
    InvalidModel
        If no transversal exists: the equations are structurally singular.
    """
    import scipy.optimize  # noqa: PLC0415 - kept out of the run time of an FMU

    sigma = np.full((len(equations.names),) * 2, ABSENT)
    for order in range(3):
        rows, columns = ca.jacobian_sparsity(equations.residual, equations.y[:, order]).get_triplet()
        sigma[rows, columns] = order
    size = len(sigma)
    weights = np.where(sigma == ABSENT, -4 * (size + 1), sigma)
    rows, columns = scipy.optimize.linear_sum_assignment(weights, maximize=True)
    missing = [equations.equations[i] for i, j in zip(rows, columns, strict=True) if sigma[i, j] == ABSENT]
    if missing:
        raise InvalidModel(f"{equations.name}: structurally singular, nothing is left for {missing[0]}")
    # Velocities are wanted too, also of a coordinate that no equation differentiates.
    floor = np.array([int(name.startswith("q.")) for name in equations.names])
    c, d = _smallest_offsets(sigma, columns, floor)
    return Signature(equations, sigma, c, d, _system_jacobian(equations, c, d))


def _smallest_offsets(
    sigma: npt.NDArray[np.int64], transversal: npt.NDArray[np.intp], floor: npt.NDArray[np.int64]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the smallest c >= 0, d >= floor with d_j - c_i >= sigma_ij, equality on the transversal."""
    rows = np.arange(len(sigma))
    c = np.zeros(len(sigma), dtype=np.int64)
    while True:
        d = np.maximum(floor, np.where(sigma == ABSENT, ABSENT, sigma + c[:, None]).max(axis=0))
        new = d[transversal] - sigma[rows, transversal]
        if (new == c).all():
            return tuple(int(k) for k in c), tuple(int(k) for k in d)
        c = new


def _system_jacobian(equations: SecondOrderEquations, c: tuple[int, ...], d: tuple[int, ...]) -> ca.SX:
    leading = np.array(d)[None, :] - np.array(c)[:, None]
    J = ca.SX(len(c), len(d))
    for order in range(3):
        part = ca.jacobian(equations.residual, equations.y[:, order])
        J += part * ca.DM(leading == order)
    return ca.sparsify(J)


def equilibrated(matrix: Array) -> Array:
    """Scale rows and columns to unit maximum (Ruiz 2001), so that units do not decide about rank and condition."""
    scaled = matrix.copy()
    for sweep in range(_SWEEPS):
        for axis in (1, 0):
            largest = np.abs(scaled).max(axis=axis, keepdims=True)
            factor = np.where(largest > 0.0, largest, 1.0)
            scaled = scaled / (np.sqrt(factor) if sweep < _SWEEPS - 1 else factor)
    return scaled


def condition_number(matrix: Array) -> float:
    """Return the condition number of a matrix after its rows and columns are scaled to unit maximum."""
    if not np.isfinite(matrix).all():
        return float("inf")
    values = np.linalg.svd(equilibrated(matrix), compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0.0 else float("inf")
