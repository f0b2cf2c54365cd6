"""The linear combination method (Tan, Nedialkov and Pryce, BIT 57 (2017) 845), where the signature method fails.

Where the system Jacobian J is singular as an expression, u^T J = 0 for some u(y) != 0. With c the smallest offset of
the equations involved,

    f = sum_i u_i f_i^(c_i - c)

is free of the derivatives y_j^(d_j - c), provided that u is too. In place of an equation of offset c it lowers the sum
of the offsets, so that after finitely many such steps the Jacobian is regular or no combination is left.

u is found by elimination. Expressions carry their values at some points, which reveal terms that cancel. Rows of equal
offset are rotated like (sine, cosine), which never vanish together: then no regular configuration is lost.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import itemgetter

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.numerics.components import equilibrated
from servocore.numerics.expressions import time_derivative
from servocore.numerics.step_operations import UNIT, Array, evaluate
from servocore.structure.signature import (
    Point,
    SecondOrderEquations,
    Signature,
    is_regular,
    jacobian_function,
    jacobians,
    lost_rank,
    probe_points,
    signature,
    without_vanishing,
)

_DEPENDENT = 1e-9  # of an equilibrated Jacobian: singular values and factors below count as zero
_CONSTANT = 1e-12  # relative spread over the points
_WEAK = 0.1  # of the largest entry of its column at home: a pivot that may vanish nearby
_MOST_OPERATIONS = 20_000  # of combined equations, which are differentiated further
_COMBINED = ", combined"


@dataclass(frozen=True, eq=False)
class _Traced:
    """Expressions with their values at the points, and bounds of the errors of these.

    CasADi evaluates products of constants at once, so that expressions do not show which constants are round-off. The
    last point is home, with its symmetries. A linear combination of equations has 2 N columns: the factors of the
    equations, and the combined row of the system Jacobian.

    Attributes
    ----------
    expression : casadi.SX
        Shape (1, columns).
    values, errors : ndarray, shape (points, columns)
    """

    expression: ca.SX
    values: Array
    errors: Array

    def __mul__(self, other: _Traced) -> _Traced:
        values = self.values * other.values
        errors = np.abs(self.values) * other.errors + np.abs(other.values) * self.errors
        return _Traced(self.expression * other.expression, values, errors + UNIT * np.abs(values))

    def __add__(self, other: _Traced) -> _Traced:
        values = self.values + other.values
        errors = self.errors + other.errors + UNIT * np.abs(values)
        return _Traced(self.expression + other.expression, values, errors).without_round_off()

    def __neg__(self) -> _Traced:
        return _Traced(-self.expression, -self.values, self.errors)

    @property
    def constant(self) -> bool:
        return bool(np.ptp(self.values[:-1]) <= _CONSTANT * np.abs(self.values[:-1]).max())

    @property
    def equations(self) -> list[int]:
        """The equations that are combined."""
        return [j for j in self.expression.sparsity().get_col() if j < self._size]

    @property
    def columns(self) -> list[int]:
        """Columns of the system Jacobian with an entry."""
        return [j - self._size for j in self.expression.sparsity().get_col() if j >= self._size]

    @property
    def _size(self) -> int:
        return self.expression.size2() // 2

    def entry(self, column: int) -> _Traced:
        """Return an entry of the row of the system Jacobian."""
        k = self._size + column
        return _Traced(self.expression[k], self.values[:, [k]], self.errors[:, [k]])

    def without_round_off(self) -> _Traced:
        """Return the combination without entries that are round-off at all points but home."""
        kept = np.asarray(~(np.abs(self.values) <= self.errors)[:-1].all(axis=0))
        kept[: self._size] = True
        columns = [j for j in self.expression.sparsity().get_col() if kept[j]]
        pattern = ca.Sparsity.triplet(1, len(kept), [0] * len(columns), columns)
        values, errors = (np.where(kept, each, 0.0) for each in (self.values, self.errors))
        return _Traced(ca.project(self.expression, pattern), values, errors)

    def scaled(self) -> _Traced:
        """Divide by a power of two, so that products of products do not grow."""
        size = float(np.abs(self.values[0, : self._size]).max())
        power = 0.5 ** round(math.log2(size)) if math.isfinite(size) and size > 0.0 else 1.0
        return _Traced(self.expression * power, self.values * power, self.errors)


@dataclass(frozen=True, eq=False)
class _Combination:
    """Combinations that replace equations of the least offset; `null` is the one free of highest derivatives."""

    null: int
    rows: dict[int, _Traced]


def convert(equations: SecondOrderEquations) -> Signature:
    """Combine equations until their system Jacobian is regular, and return their signature.

    Raises
    ------
    InvalidModel
        If it stays singular, with the reason.
    """
    structure = signature(equations)
    names: list[str] = []
    while not is_regular(structure):
        combination = _combination(structure)
        names += [equations.equations[i] for i in combination.rows]
        structure = signature(_replaced(structure, combination))
    listed = ", ".join(dict.fromkeys(names))
    remedy = f"combined with others so that highest derivatives cancel: {listed}"
    return replace(structure, equations=replace(structure.equations, remedy=remedy)) if names else structure


def _combination(structure: Signature) -> _Combination:
    """Find a combination of equations that is free of the highest derivatives."""
    refusal = "round-off hides their linear dependence"
    points = probe_points(structure.equations, jacobian_function(structure))
    y, gamma, p = points[0]
    y = y.copy()  # the home configuration, with velocities and forces without symmetry
    y[: len(structure.equations.home.q), 0] = structure.equations.home.q
    points.append((y, gamma, p))
    for taking_part in _dependent_rows(structure, points[-1]):
        combination = _eliminate(structure, taking_part, points)
        if combination is not None:
            obstacle = _obstacle(structure, combination)
            if not obstacle:
                return combination
            refusal = obstacle
    lost = lost_rank(structure, jacobians(structure)[0])
    raise InvalidModel(f"{structure.equations.name}: the system Jacobian is singular everywhere: {lost}; {refusal}")


def _dependent_rows(structure: Signature, home: Point) -> Iterator[list[int]]:
    """Yield equations whose rows of the system Jacobian have one linear dependence; the last has the least offset.

    Rows that are independent at home are taken first.
    """
    c = structure.equation_offsets
    matrices = [equilibrated(J) for J in jacobians(structure) if np.isfinite(J).all()]
    if not matrices:
        raise InvalidModel(f"{structure.equations.name}: the equations have no finite values near home")
    (at_home,) = jacobians(structure, [home])
    rows: list[int] = []
    for offset in sorted(set(c), reverse=True):
        rows_of_offset = [i for i in range(len(c)) if c[i] == offset]
        first: list[int] = []
        for i in rows_of_offset:
            first += (
                [i] if _rank([equilibrated(np.nan_to_num(at_home))], [*rows, *first, i]) > len(rows + first) else []
            )
        for row in (*first, *(i for i in rows_of_offset if i not in first)):
            if _rank(matrices, [*rows, row]) > len(rows):
                rows.append(row)
                continue
            factors = [np.linalg.lstsq(J[rows].T, J[row], rcond=None)[0] for J in matrices]
            needed = np.flatnonzero(np.abs(factors).max(axis=0, initial=0.0) > _DEPENDENT)
            yield [*(rows[k] for k in needed), row]


def _rank(matrices: list[Array], rows: list[int]) -> int:
    return max((int(np.linalg.matrix_rank(J[rows], tol=_DEPENDENT)) for J in matrices), default=0)


def _rows(structure: Signature, taking_part: list[int], points: list[Point]) -> dict[int, _Traced]:
    """Return rows of the system Jacobian as combinations of one equation each."""
    values, errors = evaluate(jacobian_function(structure), points)
    both = ca.horzcat(ca.SX.eye(len(structure.equation_offsets)), structure.jacobian)
    ones = np.broadcast_to(np.eye(values.shape[1]), values.shape)
    values, errors = np.concatenate([ones, values], axis=2), np.concatenate([0.0 * ones, errors], axis=2)
    return {i: _Traced(both[i, :], values[:, i], errors[:, i]).without_round_off() for i in taking_part}


def _eliminate(structure: Signature, taking_part: list[int], points: list[Point]) -> _Combination | None:
    """Eliminate until a row of the system Jacobian vanishes; None if round-off hides it.

    Equations of higher offset are eliminated first: the replaced one has the least.
    """
    c = structure.equation_offsets
    least = min(c[i] for i in taking_part)
    left = _rows(structure, taking_part, points)
    turned: dict[int, _Traced] = {}
    while all(row.columns for row in left.values()):
        chosen = _pivot(c, least, left)
        if chosen is None:
            return None
        pivot, column = chosen
        for other in [i for i in left if i != pivot and column in left[i].columns]:
            first, second = left[pivot], left[other]
            a, b = first.entry(column), second.entry(column)
            left[other] = (a * second + -b * first).scaled()
            if not a.constant and c[other] == c[pivot]:
                left[pivot] = (a * first + b * second).scaled()
                turned |= {pivot: left[pivot], other: left[other]} if c[pivot] == least else {}
        turned |= {i: left[i] for i in turned if i in left}
        del left[pivot]
    null = next(i for i, row in left.items() if not row.columns)
    return _Combination(null, {null: left[null], **turned}) if c[null] == least else None


def _pivot(c: tuple[int, ...], least: int, left: dict[int, _Traced]) -> tuple[int, int] | None:
    """Choose the row and column of the next pivot: constant if possible, not weak at home, and of few neighbours."""
    last = sum(c[i] == least for i in left) == 1
    choices: list[tuple[tuple[bool, bool, int, float], tuple[int, int]]] = []
    for column in sorted({j for row in left.values() for j in row.columns}):
        involved = {i: np.abs(row.entry(column).values[:, 0]) for i, row in left.items() if column in row.columns}
        highest, largest = max(c[i] for i in involved), max(np.nan_to_num(size[-1]) for size in involved.values())
        for i, size in involved.items():
            if c[i] < highest or (last and c[i] == least):
                continue
            sure = left[i].entry(column).constant or len(involved) == 1
            weak = not sure and not np.nan_to_num(size[-1]) > _WEAK * largest
            neighbours = (len(involved) - 1) * (len(left[i].columns) - 1)
            choices.append(((not sure, weak, neighbours, -float(size[0])), (i, column)))
    return min(choices, key=itemgetter(0))[1] if choices else None


def _obstacle(structure: Signature, combination: _Combination) -> str:
    """Return, as a sentence, on which of the cancelling derivatives the factors depend; empty if on none."""
    y, names = structure.equations.y, structure.equations.names
    least = structure.equation_offsets[combination.null]
    factors = ca.vertcat(*[row.expression[row.equations].T for row in combination.rows.values()])
    for order in range(y.size2()):
        for j in ca.jacobian_sparsity(factors, y[:, order]).get_col():
            if order >= structure.variable_offsets[j] - least:
                combined = combination.rows[combination.null].equations
                where = ", ".join(structure.equations.equations[i] for i in combined)
                return (
                    f"combining {where} needs factors that depend on a derivative that should cancel,"
                    f" {names[j]}{chr(39) * order}, which structural analysis cannot treat"
                )
    return ""


def _replaced(structure: Signature, combination: _Combination) -> SecondOrderEquations:
    """Return the equations with the combination in place of the equations that it replaces."""
    equations, c, d = structure.equations, structure.equation_offsets, structure.variable_offsets
    least = c[combination.null]
    most = max(c[i] - least for row in combination.rows.values() for i in row.equations)
    size, orders = equations.y.shape
    y = ca.horzcat(equations.y, ca.SX.sym("y", size, most))
    residual, embedded, names = ca.SX(equations.residual), list(equations.embedded), list(equations.equations)
    special = equations.special
    for row, combined in combination.rows.items():
        terms = []
        for i in combined.equations:
            term = equations.residual[i]
            for _ in range(c[i] - least):
                term = time_derivative(term, y, equations.home.gamma)
            terms.append(combined.expression[i] * term)
        residual[row], only_here, _ = without_vanishing(replace(equations, y=y), terms)
        special = special or only_here
        embedded[row] = max(c[i] - least + equations.embedded[i] for i in combined.equations)
        names[row] = names[row].removesuffix(_COMBINED) + _COMBINED
    length = ca.Function("sc_size", [y, *equations.arguments[1:]], [residual]).n_instructions()
    if length > _MOST_OPERATIONS:
        raise InvalidModel(
            f"{equations.name}: the system Jacobian is singular everywhere, and combinations of equations that could"
            f" help become too long ({length} operations)"
        )
    null = residual[combination.null]
    if any(ca.jacobian_sparsity(null, y[j, d[j] - least :]).nnz() for j in range(size) if d[j] >= least):
        raise InvalidModel(f"{equations.name}: round-off hides whether the highest derivatives of its equations cancel")
    used = max(order for order in range(orders + most) if ca.jacobian_sparsity(residual, y[:, order]).nnz())
    return replace(
        equations, y=y[:, : max(3, used + 1)], residual=residual, embedded=tuple(embedded),
        equations=tuple(names), special=special, combined=True,
    )  # fmt: skip
