"""Structural analysis of a servo constraint problem by the signature method of Pryce (BIT 41 (2001) 364).

The second-order equations (1) in the variables y = (q, lam, u) are looked at as they stand: sigma_ij is the highest
derivative of variable j in equation i. A transversal of maximum weight and the smallest offsets c, d with
d_j - c_i >= sigma_ij say which equations to differentiate how often (c) and which derivatives they then determine (d).

The method sees structure, not values. In generalised coordinates accelerations that cancel hide the true index: the
system Jacobian is then singular everywhere. The remedy is a linear combination of equations: the momentum equations
that no input enters, less what the servo constraints say of the same accelerations (`combine`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel
from servocore.structure.projection import dependent_columns
from servocore.model.symbols import Array
from servocore.model.system import MechanicalSystem

ABSENT = -1
"""Entry of the signature matrix for a variable that does not occur."""

_PROBES = 3  # points at which a coefficient must vanish to count as absent
_COPIES, _TREMOR = 16, 1e-7  # of each point, to tell a coefficient from the round-off of terms that cancel
_SWEEPS = 6


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
    embedded : tuple of int
        How often the servo constraint was differentiated to make each row: 2 for combined rows, else 0.
    remedy : str
        What was done to the equations first; empty if nothing.
    special : bool
        Whether that holds for the home parameters only.
    """

    system: MechanicalSystem
    residual: ca.SX
    y: ca.SX
    names: tuple[str, ...]
    equations: tuple[str, ...]
    embedded: tuple[int, ...]
    remedy: str = ""
    special: bool = False


def second_order_equations(system: MechanicalSystem) -> SecondOrderEquations:
    """Write equation (1) in the variables y = (q, lam, u)."""
    n, size = len(system.coordinates), system.q.numel() + system.lam.numel() + system.u.numel()
    y = ca.SX.sym("y", size, 3)
    residual = ca.vertcat(system.momentum_balance(y[:n, 2]), system.output - system.gamma[:, 0], system.constraints)
    return SecondOrderEquations(
        system=system,
        residual=_in_variables(system, residual, y),
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
        embedded=(0,) * size,
    )


def _in_variables(system: MechanicalSystem, expression: ca.SX, y: ca.SX) -> ca.SX:
    n = len(system.coordinates)
    old = ca.vertcat(system.q, system.lam, system.u, system.v)
    return ca.substitute(expression, old, ca.vertcat(y[:, 0], y[:n, 1]))


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
    """

    equations: SecondOrderEquations
    sigma: npt.NDArray[np.int64]
    equation_offsets: tuple[int, ...]
    variable_offsets: tuple[int, ...]

    @property
    def degrees_of_freedom(self) -> int:
        """Sum d - sum c: dimension of the internal dynamics of the inverse problem."""
        return sum(self.variable_offsets) - sum(self.equation_offsets)

    @property
    def index(self) -> int:
        """Structural index: the most differentiations, plus one if a variable occurs algebraically."""
        differentiated = [
            c + embedded for c, embedded in zip(self.equation_offsets, self.equations.embedded, strict=True)
        ]
        return max(differentiated, default=0) + int(0 in self.variable_offsets)


@lru_cache(maxsize=64)
def analyse_structure(system: MechanicalSystem) -> Signature:
    """Apply the signature method at the system's home, with a remedy if the equations as they stand mislead it.

    Raises
    ------
    InvalidModel
        If some holonomic constraints are redundant, the equations are structurally singular, or the system Jacobian
        stays singular.
    """
    system.require_independent_constraints()
    equations = second_order_equations(system)
    tried = []
    for remedy in (None, leave_out_vanishing, combine):
        changed = equations if remedy is None else remedy(equations)
        if changed is None:
            continue
        try:
            found = signature(changed)
        except InvalidModel as error:
            tried.append(str(error))
            continue
        if regular(found):
            return found
        tried.append(_left_over(found))
    raise InvalidModel(
        f"{system.name}: the system Jacobian of the signature method is singular, with every remedy; {tried[-1]}"
    )


def specialised(system: MechanicalSystem, p: Array) -> MechanicalSystem:
    """Return `system` with its home moved to the parameter values `p`, if these change its structure.

    A parameter can decide about the index: an inclination of zero, a damper of zero. Where the structure stays the
    same the same object is returned, and what was compiled for it serves on.
    """
    return _specialised(system, tuple(float(value) for value in p))


@lru_cache(maxsize=256)
def _specialised(system: MechanicalSystem, p: tuple[float, ...]) -> MechanicalSystem:
    if p == system.home_parameters:
        return system
    found = _structure_or_none(system)
    if found is not None and not found.equations.special and regular(found, np.array(p)):
        return system
    return replace(system, home_parameters=p)


def _structure_or_none(system: MechanicalSystem) -> Signature | None:
    try:
        return analyse_structure(system)
    except InvalidModel:
        return None


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
        raise InvalidModel(f"{equations.system.name}: structurally singular, nothing is left for {missing[0]}")
    # Velocities are wanted too, also of a coordinate that no equation differentiates.
    floor = np.array([int(name.startswith("q.")) for name in equations.names])
    return Signature(equations, sigma, *_smallest_offsets(sigma, columns, floor))


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


def system_jacobian(found: Signature) -> ca.SX:
    """Return J_ij = df_i / dy_j^(d_j - c_i), shape (N, N), an expression of y, gamma and p."""
    equations, size = found.equations, len(found.sigma)
    c, d = np.array(found.equation_offsets), np.array(found.variable_offsets)
    leading = d[None, :] - c[:, None]
    J = ca.SX(size, size)
    for order in range(3):
        part = ca.jacobian(equations.residual, equations.y[:, order])
        J += part * ca.DM(leading == order)
    return ca.sparsify(J)


def system_jacobian_at_home(found: Signature) -> Array:
    """Return the system Jacobian as numbers, at a point without symmetry near the system's home."""
    return _jacobian_at_probes(found, None)[0]


def regular(found: Signature, p: Array | None = None) -> bool:
    """Whether the system Jacobian is nonsingular at a point without symmetry near the system's home."""
    return any(
        np.linalg.matrix_rank(equilibrated(J)) == len(J) for J in _jacobian_at_probes(found, p) if np.isfinite(J).all()
    )


def _left_over(found: Signature) -> str:
    """Name the equations and variables between which a singular system Jacobian has lost rank."""
    J = equilibrated(_jacobian_at_probes(found, None)[0])
    left, _, right = np.linalg.svd(np.nan_to_num(J))
    names = found.equations.equations, found.equations.names
    worst = [
        ", ".join(labels[k] for k in np.flatnonzero(np.abs(vector) > 0.3 * np.abs(vector).max())[:4])
        for labels, vector in zip(names, (left[:, -1], right[-1]), strict=True)
    ]
    return f"it loses rank in the equations {worst[0]} and the variables {worst[1]}"


@lru_cache(maxsize=64)
def _system_jacobian_function(found: Signature) -> ca.Function:
    equations = found.equations
    arguments = [equations.y, equations.system.gamma, equations.system.p]
    return ca.Function("sc_system_jacobian", arguments, [system_jacobian(found)])


def _jacobian_at_probes(found: Signature, p: Array | None) -> list[Array]:
    evaluate = _system_jacobian_function(found)
    return [np.asarray(evaluate(*point)) for point in _probe_points(found.equations, p)]


def equilibrated(matrix: Array) -> Array:
    """Scale rows and columns to unit maximum (Ruiz 2001), so that units do not decide about rank and condition."""
    scaled = matrix.copy()
    for sweep in range(_SWEEPS):
        for axis in (1, 0):
            largest = np.abs(scaled).max(axis=axis, keepdims=True)
            factor = np.where(largest > 0.0, largest, 1.0)
            scaled = scaled / (np.sqrt(factor) if sweep < _SWEEPS - 1 else factor)
    return scaled


def _probe_points(
    equations: SecondOrderEquations, p: Array | None = None, *, disturbed: bool = False
) -> list[tuple[Array, Array, Array]]:
    """Return points (y, gamma, p) near the system's home: fixed numbers without symmetry.

    With `disturbed` the parameters leave their home as well, by a few per cent of themselves and of one.
    """
    system = equations.system
    q, home = system.home_configuration()
    generator = np.random.default_rng(20090601)
    points = []
    for _ in range(_PROBES):
        y = 0.3 * generator.uniform(0.5, 1.0, equations.y.shape) * generator.choice([-1.0, 1.0], equations.y.shape)
        y[: len(q), 0] += q
        gamma = generator.uniform(-0.3, 0.3, system.gamma.shape)
        gamma[:, 0] = system.home
        values = home if p is None else p
        if disturbed:
            values = values * generator.uniform(1.01, 1.05, len(values)) + generator.uniform(0.01, 0.05, len(values))
        points.append((y, gamma, values))
    return points


def leave_out_vanishing(equations: SecondOrderEquations) -> SecondOrderEquations | None:
    """Take derivatives out of equations where their coefficients vanish, if there are any."""
    residual, special, changed = _without_vanishing(equations, equations.residual)
    if not changed:
        return None
    return replace(equations, residual=residual, remedy="vanishing coefficients left out", special=special)


def combine(equations: SecondOrderEquations) -> SecondOrderEquations | None:
    """Subtract servo accelerations from the momentum equations that no input enters.

    With C = [C_d, C_i] split into dependent and independent columns, a momentum row without inputs loses the
    accelerations of the dependent coordinates: its new form is row - M_d C_d^-1 (C a + C_dot v - gamma''). Where
    inertia couples the row to the servo constrained directions only, as the swing of a crane's load, the other
    accelerations and the velocities cancel as well. What vanishes at several points is taken out.

    Returns None if every momentum equation holds an input.
    """
    system, y = equations.system, equations.y
    n = len(system.coordinates)
    unactuated = [k for k in range(n) if not system.input_matrix[:, k].nnz()]
    if not unactuated:
        return None
    dependent = dependent_columns(system)
    acceleration = y[:n, 2]
    servo = (
        ca.mtimes(system.C, acceleration)
        + ca.jtimes(ca.mtimes(system.C, system.v), system.q, system.v)
        - system.gamma[:, 2]
    )
    factors = ca.solve(ca.densify(system.C[:, dependent]), servo)
    rows = system.momentum_balance(acceleration)[unactuated] - ca.mtimes(system.mass[unactuated, dependent], factors)
    residual = ca.SX(equations.residual)
    residual[unactuated] = _in_variables(system, rows, y)
    residual, special, _ = _without_vanishing(equations, residual)
    names = (
        f"{name} less servo accelerations" if k in unactuated else name for k, name in enumerate(equations.equations)
    )
    return replace(
        equations,
        residual=residual,
        equations=tuple(names),
        embedded=tuple(2 if k in unactuated else order for k, order in enumerate(equations.embedded)),
        remedy="momentum equations without inputs combined with servo accelerations",
        special=special,
    )


def _is_not_noise(evaluate: ca.Function, point: tuple[Array, Array, Array]) -> npt.NDArray[np.bool_]:
    """Tell which results are numbers of their own, however small, and which the round-off of terms that cancel.

    The arguments tremble by a relative 1e-7: a true number trembles as little, round-off changes altogether.
    """
    generator = np.random.default_rng(31)
    y, gamma, p = point
    copies = []
    for _ in range(_COPIES):
        factors = (1.0 + _TREMOR * generator.uniform(-1.0, 1.0, each.shape) for each in (y, p))
        trembling_y, trembling_p = (each * factor for each, factor in zip((y, p), factors, strict=True))
        copies.append(np.asarray(evaluate(trembling_y, gamma, trembling_p)))
    values = np.stack(copies)
    found: npt.NDArray[np.bool_] = np.abs(values.mean(axis=0)) > 3.0 * values.std(axis=0)
    return found


def _without_vanishing(equations: SecondOrderEquations, rows: ca.SX) -> tuple[ca.SX, bool, bool]:
    """Set variables and their derivatives to constants in the rows whose derivatives by them vanish at all probes.

    Returns the rows, whether something vanishes for the home parameters only, and whether anything changed.
    """
    y, system = equations.y, equations.system
    derivatives, rest = ca.vec(y), np.zeros(y.numel())
    q, _ = system.home_configuration()
    rest[: len(q)] = q
    by_derivatives = ca.jacobian(rows, derivatives)
    evaluate = ca.Function("by", [y, system.gamma, system.p], [by_derivatives])

    def present(disturbed: bool) -> npt.NDArray[np.bool_]:
        points = _probe_points(equations, disturbed=disturbed)
        found: npt.NDArray[np.bool_] = np.any([_is_not_noise(evaluate, point) for point in points], axis=0)
        return found

    structural = np.zeros(by_derivatives.shape, dtype=bool)
    structural[tuple(np.array(by_derivatives.sparsity().get_triplet()))] = True
    here = present(disturbed=False)
    cleaned = []
    for k in range(rows.numel()):
        absent = [int(j) for j in np.flatnonzero(structural[k] & ~here[k])]
        cleaned.append(ca.substitute(rows[k], derivatives[absent], ca.SX(rest[absent])) if absent else rows[k])
    special = bool((present(disturbed=True) & structural & ~here).any())
    return ca.vertcat(*cleaned), special, bool((structural & ~here).any())
