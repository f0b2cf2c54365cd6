"""Values and explicit expressions of unknowns, in a compiled graph that solves a square system block by block.

Tearing substitutes unknowns of a block that a row gives explicitly, so that fewer remain to be iterated. Small linear
systems are solved as expressions: by Cramer's rule, determinants by Laplace's expansion, or QR.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.numerics.components import filled
from servocore.numerics.memoization import made_once
from servocore.numerics.newton import NEWTON_TOLERANCE
from servocore.numerics.step_operations import without_jumps

_LARGEST = 6  # rows to develop determinants of: each one more doubles the minors
_DEAREST = 1.5  # times the cube of the rows, about what QR takes: so many products, when most entries are there
_FILL = 0  # a substitution must not leave more entries than it removes

_Columns = int  # their bits
Value = TypeVar("Value", ca.SX, ca.MX)


@dataclass(eq=False)
class KnownValues(ABC, Generic[Value]):
    """Unknowns solved so far, as expressions of symbols with values.

    Attributes
    ----------
    explicit : list of (casadi.SX, casadi.SX)
        Columns of symbols, and their expressions in symbols with values.
    iterated : list of casadi.SX or casadi.MX
        Counts of blocks and of isomorphic parts with iterations, as `counts` returns them, in columns.
    residuals : list of casadi.SX or casadi.MX
        Largest scaled residuals of isomorphic parts, shape (1, parts) each.
    linear_blocks : int
        Number of blocks solved without iterations.
    """

    explicit: list[tuple[ca.SX, ca.SX]] = field(default_factory=list)
    iterated: list[Value] = field(default_factory=list)
    residuals: list[Value] = field(default_factory=list)
    linear_blocks: int = 0

    @abstractmethod
    def add_values(self, symbols: ca.SX, values: Value) -> None:
        """Add a column of symbols with their values."""

    @abstractmethod
    def evaluated(self, name: str, *expressions: ca.SX) -> list[Value]:
        """Return the values of `expressions` of solved unknowns, by a function of this name if by one."""

    @abstractmethod
    def linear_solution(self, matrix: ca.SX, right: ca.SX) -> Value:
        """Return the value of matrix^-1 right."""

    def resolved(self, *expressions: ca.SX, also: Sequence[tuple[ca.SX, ca.SX]] = ()) -> list[ca.SX]:
        """Return `expressions` in terms of symbols with values and of unknowns not solved yet, `also` substituted."""
        return substituted([*self.explicit, *also], *expressions)

    def final(self, outputs: list[ca.SX]) -> list[Value]:
        """Return the values of outputs once all unknowns are solved, dense."""
        return self.evaluated("sc_finish", *map(ca.densify, outputs))

    def counts(self) -> Value:
        """Return the iterations of the slowest block, and the factorizations of all."""
        every = ca.horzcat(ca.DM([0, self.linear_blocks]), *self.iterated)
        return ca.vertcat(ca.mmax(every[0, :]), ca.sum2(every[1, :]))


@dataclass(eq=False)
class WrittenOut(KnownValues[ca.SX]):
    """Unknowns as expressions of the givens: a function of them is compiled once all are solved.

    Attributes
    ----------
    corrections : list of casadi.SX
        Squared scaled corrections of guesses that should be exact.
    """

    corrections: list[ca.SX] = field(default_factory=list)

    def add_values(self, symbols: ca.SX, values: ca.SX) -> None:
        """See above."""
        self.explicit.append((symbols, values))

    def evaluated(self, name: str, *expressions: ca.SX) -> list[ca.SX]:  # noqa: ARG002
        """See above; nothing is evaluated."""
        return self.resolved(*expressions)

    def linear_solution(self, matrix: ca.SX, right: ca.SX) -> ca.SX:
        """See above."""
        return symbolic_solution(*self.resolved(matrix, right))

    def final(self, outputs: list[ca.SX]) -> list[ca.SX]:
        """See above; NaN where a correction exceeds the tolerance."""
        results = super().final(outputs)
        if not self.corrections:
            return results
        # At the end, outside the critical path. A sum of squares that is NaN is below no tolerance.
        exact = ca.sum1(ca.vertcat(*self.corrections)) < NEWTON_TOLERANCE**2
        return [result + ca.if_else(exact, 0.0, np.nan) for result in results]


@dataclass(eq=False)
class CompiledValues(KnownValues[ca.MX]):
    """Unknowns by compiled functions, each of the symbols that it needs: many parts cost the sum of their costs."""

    _pieces: list[tuple[ca.SX, ca.MX]] = field(default_factory=list)
    _places: dict[int, tuple[int, int]] = field(default_factory=dict)

    def add_values(self, symbols: ca.SX, values: ca.MX) -> None:
        """See above."""
        for position, symbol in enumerate(ca.vertsplit(symbols) if symbols.numel() else ()):
            self._places[symbol.element_hash()] = len(self._pieces), position
        self._pieces.append((symbols, values))

    def evaluated(self, name: str, *expressions: ca.SX) -> list[ca.MX]:
        """See above; their common subexpressions are computed once."""
        resolved = self.resolved(*expressions)
        symbols, values = self.needed(*resolved)
        results: list[ca.MX] = ca.Function(name, [symbols], resolved, {"cse": True}).call([values])
        return results

    def evaluate_explicit(self) -> None:
        """Evaluate the explicit unknowns found so far, so that later iterations need not repeat them."""
        if self.explicit:
            # All at once in one function: their common subexpressions are computed once.
            symbols, expressions = (ca.vertcat(*column) for column in zip(*self.explicit, strict=True))
            self.explicit = []
            self.add_values(symbols, *self.evaluated("sc_explicit", expressions))

    def linear_solution(self, matrix: ca.SX, right: ca.SX) -> ca.MX:
        """See above, by a sparse QR factorization."""
        self.evaluate_explicit()
        left, side = self.evaluated("sc_linear", matrix, right)
        return ca.solve(left, side, "qr")

    def needed(self, *expressions: ca.SX) -> tuple[ca.SX, ca.MX]:
        """Return the evaluated symbols in `expressions`, and their values."""
        keys = (symbol.element_hash() for symbol in ca.symvar(ca.veccat(*expressions)))
        wanted: dict[int, list[int]] = {}
        for piece, position in sorted(self._places[key] for key in keys if key in self._places):
            wanted.setdefault(piece, []).append(position)
        symbols, values = [ca.SX(0, 1)], [ca.MX(0, 1)]
        for piece, positions in wanted.items():
            known, at = self._pieces[piece]
            whole = len(positions) == known.numel()
            # A whole piece needs no indexing: each index would be an operation of its own in the graph.
            symbols.append(known if whole else known[positions])
            values.append(at if whole else at[positions])
        return ca.vertcat(*symbols), ca.vertcat(*values)


def substituted(pairs: list[tuple[ca.SX, ca.SX]], *expressions: ca.SX) -> list[ca.SX]:
    """Return `expressions` with all pairs of (symbol, replacement) substituted at once."""
    if not pairs:
        return list(expressions)
    symbols, values = zip(*pairs, strict=True)
    results: list[ca.SX] = ca.substitute(list(expressions), symbols, values)
    return results


def tear(unknowns: ca.SX, residual: ca.SX) -> tuple[list[int], list[int], list[tuple[ca.SX, ca.SX]]]:
    """Eliminate unknowns that a row of a block gives explicitly with a constant coefficient.

    Returns the remaining unknowns and rows, and the substitutions in an order in which each holds unknowns that remain
    or come later in the list; they are returned already resolved among themselves.
    """
    jacobian = ca.jacobian(without_jumps(residual), unknowns)
    pattern = filled(ca.DM(jacobian.sparsity(), 1)) > 0.0
    constant = {(int(i), int(j)) for i, j in zip(*np.nonzero(pattern), strict=True) if jacobian[i, j].is_constant()}
    active_rows, active_columns = set(range(len(pattern))), set(range(len(pattern)))
    pivots: list[tuple[int, int]] = []
    while len(active_rows) > 1:
        best = _cheapest_pivot(pattern, constant, active_rows)
        if best is None:
            break
        i, j = best
        touched = [k for k in active_rows if pattern[k, j] and k != i]
        # Structural fill: cancellation is neglected, so that the estimate is an upper bound.
        pattern[touched] |= pattern[i]
        constant = {(r, c) for r, c in constant if c != j and not (r in touched and pattern[i, c])}
        active_rows.remove(i)
        active_columns.remove(j)
        pivots.append(best)
    torn: list[tuple[ca.SX, ca.SX]] = []
    for i, j in pivots:
        (row,), unknown = substituted(torn, residual[i]), unknowns[j]
        # Constant, so that dividing by it can hit no zero at run time.
        coefficient = ca.jacobian(row, unknown)
        value = -ca.substitute(row, unknown, ca.SX(0)) / coefficient
        torn = [(s, ca.substitute(e, unknown, value)) for s, e in torn]
        torn.append((unknown, value))
    return sorted(active_columns), sorted(active_rows), torn


def is_linear(residual: ca.SX, unknowns: ca.SX, jacobian: ca.SX) -> bool:
    """Whether a residual with this Jacobian is linear in unknowns; one that jumps is not."""
    if ca.depends_on(jacobian, unknowns):
        return False
    stand_in = without_jumps(residual)
    return stand_in is residual or not ca.depends_on(ca.jacobian(stand_in, unknowns), unknowns)


def nonlinear_rows(residual: ca.SX, unknowns: ca.SX, slopes: ca.SX) -> set[int]:
    """Return the rows that are not linear in the one unknown that each of them holds, with these derivatives by it."""
    found = set(ca.jacobian_sparsity(slopes, unknowns).row())
    stand_in = without_jumps(residual)
    if stand_in is not residual:
        found |= set(ca.jacobian_sparsity(own_slopes(stand_in, unknowns), unknowns).row())
    return found


def own_slopes(residual: ca.SX, unknowns: ca.SX) -> ca.SX:
    """Return the derivative of every row by the one unknown that it holds, all by one sweep, as a dense column."""
    return ca.densify(ca.jtimes(residual, unknowns, ca.SX.ones(unknowns.numel())))


def _cheapest_pivot(
    pattern: npt.NDArray[np.bool_],
    constant: set[tuple[int, int]],
    active_rows: set[int],
) -> tuple[int, int] | None:
    """Return the constant entry whose elimination creates the fewest new entries, if those are few enough."""

    def fill(i: int, j: int) -> int:
        touched = [k for k in active_rows if pattern[k, j] and k != i]
        return int((pattern[i] & ~pattern[touched]).sum()) - len(touched)

    best = min(((fill(i, j), i, j) for i, j in constant if i in active_rows), default=None)
    return best[1:] if best is not None and best[0] <= _FILL else None


def symbolic_solution(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Return matrix^-1 right as an expression.

    Parameters
    ----------
    matrix : casadi.SX
        Square and sparse.
    right : casadi.SX
        Column vector.

    Returns
    -------
    casadi.SX
        Column vector.
    """
    if matrix.size1() == 1:
        return right / matrix
    if matrix.size1() <= _LARGEST:
        solution = _by_determinants(matrix.size1(), tuple(zip(*matrix.sparsity().get_triplet(), strict=True)))
        if solution is not None:
            return ca.SX(solution(matrix, right))
    # QR is Gram and Schmidt's here: its error grows with the square of the condition, which is large where equations of
    # forces stand beside such of lengths. Rows of length one do better, and remain differentiable.
    length = ca.sqrt(ca.sum2(matrix**2))
    return ca.solve(ca.mtimes(ca.diag(1 / length), matrix), right / length)


@made_once  # blocks of derivatives repeat, and so do those of bodies
def _by_determinants(size: int, entries: tuple[tuple[int, int], ...]) -> ca.Function | None:
    """Return (matrix, right) -> solution for a matrix with these entries; None if that takes too many products.

    Determinants are developed row after row by Laplace, with every minor computed once: all unknowns share most of
    them. How rows and columns are scaled does not matter to round-off, nothing but the determinant is divided by, and
    the chain of operations is short where a factorization has a division and a root in every row.
    """
    pattern = ca.Sparsity.triplet(size, size, *([entry[k] for entry in entries] for k in range(2)))
    matrix, right = ca.SX.sym("A", pattern), ca.SX.sym("b", size)
    rows = [1 << size] * size  # the right side is one column more
    for i, j in entries:
        rows[i] |= 1 << j
    products, order = _cheapest_order(rows)
    if products > _DEAREST * size**3:
        return None
    all_columns, columns, minors = ca.densify(ca.horzcat(matrix, right)), [0], ca.SX(1)
    for i in order:
        columns, minors = _with_row(columns, minors, rows[i], all_columns[i, :].T)
    every, found = (1 << size) - 1, dict(zip(columns, ca.vertsplit(minors), strict=True))
    # In the place of column j stands the right side: moved there from the end past all columns between.
    signs = [(-1) ** (size - 1 - j) for j in range(size)]
    numerators = ca.vertcat(*[sign * found.get(every ^ 1 << j | 1 << size, ca.SX(0)) for j, sign in enumerate(signs)])
    return ca.Function("sc_determinants", [matrix, right], [numerators / found[every]])


def _with_row(columns: list[_Columns], minors: ca.SX, held: _Columns, row: ca.SX) -> tuple[list[_Columns], ca.SX]:
    """Return the minors of these columns with a row more, above those that they have, developed by that row."""
    terms = [(k, j) for k, of_minor in enumerate(columns) for j in range(row.numel()) if held & ~of_minor & 1 << j]
    wider = [columns[k] | 1 << j for k, j in terms]
    places = {each: place for place, each in enumerate(dict.fromkeys(wider))}
    signs = [(-1) ** (columns[k] & (1 << j) - 1).bit_count() for k, j in terms]
    pattern = ca.Sparsity.triplet(len(places), len(terms), [places[each] for each in wider], list(range(len(terms))))
    products = ca.vec(row[[j for _, j in terms]]) * ca.vec(minors[[k for k, _ in terms]])
    return list(places), ca.mtimes(ca.SX(ca.DM(pattern, signs)), products)


def _cheapest_order(rows: list[_Columns]) -> tuple[int, list[int]]:
    """Return the fewest products that developing takes, and the order of rows for it, the lowest first.

    The set of minors depends on the rows, not on their order. By dynamic programming, the best order of some rows
    extends the best order of all but the last of them.
    """
    best: dict[int, tuple[int, list[int], set[_Columns]]] = {0: (0, [], {0})}  # by the bits of the rows taken
    for size in range(len(rows)):
        for taken in [some for some in best if some.bit_count() == size]:
            products, order, minors = best[taken]
            for i in (i for i in range(len(rows)) if not taken & 1 << i):
                total = products + sum((rows[i] & ~columns).bit_count() for columns in minors)
                if taken | 1 << i not in best or total < best[taken | 1 << i][0]:
                    bits = [1 << j for j in range(len(rows) + 1) if rows[i] & 1 << j]
                    grown = {columns | bit for columns in minors for bit in bits if not columns & bit}
                    best[taken | 1 << i] = total, [*order, i], grown
    return best[(1 << len(rows)) - 1][:2]
