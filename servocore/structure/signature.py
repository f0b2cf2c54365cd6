"""The signature method of Pryce (BIT 41 (2001) 364): which derivatives the structure of equations determines.

sigma_ij is the highest derivative of variable j in equation i. A transversal of maximum weight and the smallest offsets
c, d with d_j - c_i >= sigma_ij say which equations to differentiate how often (c) and which derivatives they then
determine (d), if the system Jacobian J_ij = df_i / dy_j^(d_j - c_i) is nonsingular.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel
from servocore.numerics.components import condition_numbers, equilibrated, filled, parts_of, places_of
from servocore.numerics.step_operations import UNIT, Array, evaluate

ABSENT = -1
"""Entry of the signature matrix for a variable that is absent."""

_DISTANCES = (0.3, 0.03, 0.003)  # of probes from home, tried in turn: a mechanism may have a small range
_PROBES = 3  # number of points at which a coefficient must vanish to count as absent
_SUSPICIOUS = 1e-9  # of the largest entry: perhaps round-off of terms that cancel, which equilibration would magnify

Point = tuple[Array, Array, Array]
"""y, gamma and p."""


@dataclass(frozen=True, eq=False)
class Home:
    """The point at which equations are analysed, and their symbols besides the variables.

    Attributes
    ----------
    gamma, p : casadi.SX
        Symbols of the reference and its derivatives, and of the parameters.
    q, parameters : ndarray
        Configuration and parameter values of the system's home.
    output, nominal : tuple of float
        Servo output there; typical magnitudes of the coordinates.
    """

    gamma: ca.SX
    p: ca.SX
    q: Array
    parameters: Array
    output: tuple[float, ...]
    nominal: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class SecondOrderEquations:
    """Equation (1) with v = q_dot inserted, as functions of the derivatives of y = (q, lam, u).

    Attributes
    ----------
    name : str
        Name of the system in messages.
    residual : casadi.SX
        Momentum balance (n), servo constraints (m), holonomic constraints (m_h); shape (N,).
    y : casadi.SX
        Symbols of the variables and their derivatives, shape (N, 3); more columns where equations were combined.
    names, equations : tuple of str
        Names of the variables and of the rows.
    embedded : tuple of int
        How often some equation of (1) was differentiated to make each row: 2 for most combined rows, else 0.
    home : Home
        The point at which they are analysed.
    remedy : str
        Remedy that was applied to the equations; empty if none.
    special : bool
        Whether the remedy holds for the home parameters only.
    combined : bool
        Whether equations were replaced by combinations of any (`servocore.structure.linear_combination`).
    """

    name: str
    residual: ca.SX
    y: ca.SX
    names: tuple[str, ...]
    equations: tuple[str, ...]
    embedded: tuple[int, ...]
    home: Home
    remedy: str = ""
    special: bool = False
    combined: bool = False

    @property
    def arguments(self) -> list[ca.SX]:
        """Arguments of the residual."""
        return [self.y, self.home.gamma, self.home.p]


@dataclass(frozen=True, eq=False)
class Signature:
    """Result of the signature method.

    Attributes
    ----------
    equations : SecondOrderEquations
        The analysed equations, after a remedy if one was needed.
    sigma : ndarray of int
        Shape (N, N); `ABSENT` where a variable is absent.
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
        """One if some variable occurs without derivatives, so that its rate takes one differentiation; else zero."""
        return int(0 in self.variable_offsets)


def signature(equations: SecondOrderEquations) -> Signature:
    """Apply the signature method to equations.

    Raises
    ------
    InvalidModel
        If no transversal exists: the equations are structurally singular.
    """
    size = len(equations.names)
    sigma = np.full((size, size), ABSENT)
    for order in range(equations.y.size2()):
        sigma[ca.jacobian_sparsity(equations.residual, equations.y[:, order]).get_triplet()] = order
    if ca.sprank(ca.DM(_pattern(size, *np.nonzero(sigma != ABSENT)), 1)) < size:
        raise InvalidModel(_no_transversal(equations, sigma))
    # Velocities are unknowns too, also of a coordinate that no equation differentiates.
    floor = np.array([int(name.startswith("q.")) for name in equations.names])
    c, d = _smallest_offsets(sigma, floor)
    return Signature(equations, sigma, c, d, _system_jacobian(equations, c, d))


def _pattern(size: int, rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp]) -> ca.Sparsity:
    return ca.Sparsity.triplet(size, size, rows.tolist(), columns.tolist())


def _no_transversal(equations: SecondOrderEquations, sigma: npt.NDArray[np.int64]) -> str:
    """Name, in a sentence, an equation and a variable that a transversal of most entries leaves out."""
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - its import takes longer than an analysis

    columns = linear_sum_assignment(np.where(sigma == ABSENT, -4 * (len(sigma) + 1), sigma), maximize=True)[1]
    i = int((sigma[np.arange(len(sigma)), columns] == ABSENT).argmax())
    return (
        f"{equations.name}: structurally singular: no equation determines {equations.names[columns[i]]}, and"
        f" {equations.equations[i]} determines no variable; check for inputs that move nothing, and for outputs that"
        " no input moves or that follow from others"
    )


def _smallest_offsets(
    sigma: npt.NDArray[np.int64], floor: npt.NDArray[np.int64]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the smallest c >= 0, d >= floor with d_j - c_i >= sigma_ij, equality on a transversal.

    Rows that compete for too few columns with equality have to be differentiated once more each, since c and d are a
    lower bound so far: so an ascending auction (Demange, Gale and Sotomayor, J. Polit. Econ. 94 (1986) 863) finds the
    smallest pair. These rows are the overdetermined block of the decomposition of Dulmage and Mendelsohn.
    """
    size, (rows, columns) = len(sigma), np.nonzero(sigma != ABSENT)
    orders, c = sigma[rows, columns], np.zeros(len(sigma), dtype=np.int64)
    while True:
        d = floor.copy()
        np.maximum.at(d, columns, orders + c[rows])
        equal = d[columns] - c[rows] == orders
        _, order, _, _, _, coarse, _ = _pattern(size, rows[equal], columns[equal]).btf()
        if not coarse[2]:
            return tuple(c.tolist()), tuple(d.tolist())
        c[order[: coarse[2]]] += 1


def _system_jacobian(equations: SecondOrderEquations, c: tuple[int, ...], d: tuple[int, ...]) -> ca.SX:
    leading = np.array(d)[None, :] - np.array(c)[:, None]
    J = ca.SX(len(c), len(d))
    for order in range(equations.y.size2()):
        part = ca.jacobian(equations.residual, equations.y[:, order])
        rows, columns = places_of(part.sparsity())
        # Entries below d_j - c_i are of lower order and do not belong to the leading Jacobian.
        kept = np.flatnonzero(leading[rows, columns] == order)
        pattern = ca.Sparsity.triplet(*J.shape, rows[kept].tolist(), columns[kept].tolist())
        J += ca.SX(pattern, part.nz[kept.tolist()])
    return ca.sparsify(J)


def lost_rank(structure: Signature, J: Array) -> str:
    """Name the equations and variables between which a singular system Jacobian has lost rank."""
    left, _, right = np.linalg.svd(equilibrated(np.nan_to_num(J)))
    names = structure.equations.equations, structure.equations.names
    worst = [
        ", ".join(labels[k] for k in np.flatnonzero(np.abs(vector) > 0.3 * np.abs(vector).max())[:4])
        for labels, vector in zip(names, (left[:, -1], right[-1]), strict=True)
    ]
    return f"it loses rank in the equations {worst[0]} and the variables {worst[1]}"


def probe_points(
    equations: SecondOrderEquations,
    evaluate: ca.Function,
    p: Array | None = None,
    *,
    disturbed: bool = False,
) -> list[Point]:
    """Return points (y, gamma, p) near the system's home at which `evaluate` is finite: numbers without symmetry."""
    for distance in _DISTANCES:
        points = _points(equations, distance, p, disturbed)
        finite = [point for point in points if np.isfinite(evaluate(*point).nonzeros()).all()]
        if finite:
            return finite
    return points


def _points(equations: SecondOrderEquations, distance: float, p: Array | None, disturbed: bool) -> list[Point]:
    """Return fixed points (y, gamma, p), with coordinates and their derivatives near those of the system's home.

    They are up to `distance` of their nominal values away, or of one unit if that is less. With `disturbed` the
    parameters differ from home as well, by a few per cent of themselves and of one.
    """
    home, q = equations.home, equations.home.q
    generator = np.random.default_rng(20090601)
    points = []
    for _ in range(_PROBES):
        y = distance * generator.uniform(0.5, 1.0, equations.y.shape) * generator.choice([-1.0, 1.0], equations.y.shape)
        y[: len(q)] *= np.minimum(1.0, home.nominal)[:, None]
        y[: len(q), 0] += q
        gamma = generator.uniform(-0.3, 0.3, home.gamma.shape)
        gamma[:, 0] = home.output
        values = home.parameters if p is None else p
        if disturbed:
            values = values * generator.uniform(1.01, 1.05, len(values)) + generator.uniform(0.01, 0.05, len(values))
        points.append((y, gamma, values))
    return points


def jacobians(structure: Signature, points: list[Point] | None = None) -> list[Array]:
    """Return the system Jacobian at points, by default those of `probe_points`, zero where an entry is round-off."""
    function = jacobian_function(structure)
    points = probe_points(structure.equations, function) if points is None else points
    return [filled(ca.DM(function.sparsity_out(0), entries)) for entries in _entries_at(function, points)]


def jacobian_function(structure: Signature) -> ca.Function:
    """Compile (y, gamma, p) -> system Jacobian."""
    return ca.Function("sc_system_jacobian", structure.equations.arguments, [structure.jacobian])


def _entries_at(function: ca.Function, points: list[Point]) -> Array:
    """Return the entries of the system Jacobian at points, shape (points, nnz), zero where one is round-off."""
    entries = np.array([function(*point).nonzeros() for point in points])
    sizes = np.abs(entries)
    # An entry that is so small beside others may be round-off.
    if not ((sizes > 0.0) & (sizes < _SUSPICIOUS * sizes.max(axis=1, keepdims=True, initial=0.0))).any():
        return entries
    values, errors = (each[:, *places_of(function.sparsity_out(0))] for each in evaluate(function, points))
    return np.where(np.abs(values) <= errors, 0.0, values)


def is_regular(structure: Signature, p: Array | None = None) -> bool:
    """Whether the system Jacobian is nonsingular at a point without symmetry near the system's home."""
    function = jacobian_function(structure)
    entries = _entries_at(function, probe_points(structure.equations, function, p))
    conditions = condition_numbers(parts_of(function.sparsity_out(0)), entries.T)
    return bool((conditions * np.finfo(np.float64).eps * function.size1_out(0) < 1.0).any())


def _vanishing(equations: SecondOrderEquations, parts: Sequence[ca.SX]) -> tuple[npt.NDArray[np.bool_], bool]:
    """Return which entries of a sum of matrices, expressions of y, gamma and p, vanish at all probes.

    Such entries are expressions whose values are the round-off of terms that cancel. The second result is whether some
    vanish at the system's parameter values only.

    The parts are evaluated one by one: where constants cancel, their sum does not show the size of the terms.
    """
    pattern = reduce(operator.add, (part.sparsity() for part in parts))
    entries = ca.horzcat(*[ca.densify(ca.vec(ca.project(part, pattern).nz[:])) for part in parts])
    function = ca.Function("sc_entries", equations.arguments, [entries])
    points = probe_points(equations, function)
    values, errors = evaluate(function, [*points, *probe_points(equations, function, disturbed=True)])
    bound = errors.sum(axis=2) + (UNIT * np.abs(values).sum(axis=2) if len(parts) > 1 else 0.0)
    present = np.abs(values.sum(axis=2)) > bound
    here = present[: len(points)].any(axis=0)
    special = bool((present[len(points) :].any(axis=0) & ~here).any())
    vanishing = np.zeros(pattern.shape, dtype=bool)
    vanishing[places_of(pattern)] = ~here
    return vanishing, special


def without_vanishing(equations: SecondOrderEquations, parts: Sequence[ca.SX]) -> tuple[ca.SX, bool, bool]:
    """Set variables and their derivatives to constants in the rows whose derivatives by them vanish at all probes.

    The rows are the sum of the parts. Returns the rows, whether something vanishes for the home parameters only, and
    whether anything changed.
    """
    derivatives, rows = ca.vec(equations.y), reduce(operator.add, parts)
    rest = np.zeros(derivatives.numel())
    rest[: len(equations.home.q)] = equations.home.q
    vanishing, special = _vanishing(equations, [ca.jacobian(part, derivatives) for part in parts])
    cleaned = []
    for k in range(rows.numel()):
        absent = [int(j) for j in np.flatnonzero(vanishing[k])]
        cleaned.append(ca.substitute(rows[k], derivatives[absent], ca.SX(rest[absent])) if absent else rows[k])
    return ca.vertcat(*cleaned), special, bool(vanishing.any())
