"""Elimination: symbols with their values in the compiled graph, while a square system is solved block by block.

Tearing substitutes unknowns of a block that a row gives explicitly, so that fewer remain to be iterated.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.numerics.step_operations import without_jumps

_FILL = 0  # a substitution must not leave more entries than it removes


@dataclass(eq=False)
class KnownValues:
    """Symbols with values in a compiled graph, and unknowns that are expressions of these, not yet evaluated.

    Every compiled piece takes the symbols that it needs and no others, so that a system of many parts costs what its
    parts do.

    Attributes
    ----------
    explicit : dict of int to (casadi.SX, casadi.SX)
        By the hash of a symbol: the symbol and its expression in symbols that are evaluated.
    iterations : list of casadi.MX
        Counts of Newton's method.
    isomorphic_counts : list of casadi.MX
        Counts of isomorphic parts that were solved by one mapped function, shape (2, parts) each.
    corrections : list of casadi.MX
        Squared scaled corrections of guesses that should be exact.
    linear_blocks : int
        Blocks that needed no iterations.
    """

    explicit: dict[int, tuple[ca.SX, ca.SX]] = field(default_factory=dict)
    iterations: list[ca.MX] = field(default_factory=list)
    isomorphic_counts: list[ca.MX] = field(default_factory=list)
    corrections: list[ca.MX] = field(default_factory=list)
    linear_blocks: int = 0
    _pieces: list[tuple[ca.SX, ca.MX]] = field(default_factory=list)
    _places: dict[int, tuple[int, int]] = field(default_factory=dict)

    def add_values(self, symbols: ca.SX, values: ca.MX) -> None:
        """Add a column of symbols with their values."""
        for position, symbol in enumerate(ca.vertsplit(symbols) if symbols.numel() else ()):
            self._places[symbol.element_hash()] = len(self._pieces), position
        self._pieces.append((symbols, values))

    def add_explicit(self, symbol: ca.SX, expression: ca.SX) -> None:
        """Add an unknown as an expression of symbols that are known."""
        self.explicit[symbol.element_hash()] = symbol, self.resolved(expression)[0]

    def resolved(self, *expressions: ca.SX) -> list[ca.SX]:
        """Return `expressions` in terms of evaluated symbols and of unknowns still to come."""
        pairs = [self.explicit[key] for key in _symbols(expressions) if key in self.explicit]
        return substituted(pairs, *expressions)

    def evaluate_explicit(self) -> None:
        """Evaluate the explicit unknowns found so far, so that later iterations need not repeat them."""
        if self.explicit:
            # All at once in one function: their common subexpressions are computed once.
            symbols, expressions = (ca.vertcat(*column) for column in zip(*self.explicit.values(), strict=True))
            self.explicit = {}
            self.add_values(symbols, *self.evaluated("sc_explicit", expressions))

    def evaluated(self, name: str, *expressions: ca.SX, common: bool = True) -> list[ca.MX]:
        """Return the values of `expressions` of evaluated symbols, by one compiled function.

        What is `common` to subexpressions is computed once, if that is asked for.
        """
        symbols, values = self.needed(*expressions)
        results: list[ca.MX] = ca.Function(name, [symbols], list(expressions), {"cse": common}).call([values])
        return results

    def counts(self) -> ca.MX:
        """Return the iterations of the slowest block, and the factorizations of all."""
        most, total = ca.MX(0), ca.MX(self.linear_blocks)
        for count in self.iterations:
            most, total = ca.fmax(most, count), total + count
        for counts in self.isomorphic_counts:
            most, total = ca.fmax(most, ca.mmax(counts[0, :])), total + ca.sum2(counts[1, :])
        return ca.vertcat(most, total)

    def needed(self, *expressions: ca.SX) -> tuple[ca.SX, ca.MX]:
        """Return the evaluated symbols in `expressions`, and their values."""
        wanted: dict[int, list[int]] = {}
        for piece, position in sorted(self._places[key] for key in _symbols(expressions) if key in self._places):
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
    """Return `expressions` with (symbol, expression in its place) of all pairs put in at once."""
    if not pairs:
        return list(expressions)
    symbols, values = (ca.vertcat(*column) for column in zip(*pairs, strict=True))
    results: list[ca.SX] = ca.substitute(list(expressions), [symbols], [values])
    return results


def _symbols(expressions: tuple[ca.SX, ...]) -> list[int]:
    """Hashes of the symbols that occur."""
    return [symbol.element_hash() for symbol in ca.symvar(ca.veccat(*expressions))]


def tear(unknowns: ca.SX, residual: ca.SX) -> tuple[list[int], list[int], list[tuple[ca.SX, ca.SX]]]:
    """Take unknowns out of a block that one of its rows gives explicitly with a constant coefficient.

    Returns the remaining unknowns and rows, and the substitutions in an order in which each holds unknowns that remain
    or come later in the list; they are returned already resolved among themselves.
    """
    jacobian = ca.jacobian(without_jumps(residual), unknowns)
    pattern = dependence(jacobian)
    constant = {(int(i), int(j)) for i, j in zip(*np.nonzero(pattern), strict=True) if jacobian[i, j].is_constant()}
    active_rows, active_columns = set(range(len(pattern))), set(range(len(pattern)))
    pivots: list[tuple[int, int]] = []
    while len(active_rows) > 1:
        best = _cheapest_pivot(pattern, constant, active_rows)
        if best is None:
            break
        i, j = best
        touched = [k for k in active_rows if pattern[k, j] and k != i]
        # Structural fill: cancellation is not looked for, which only makes the estimate careful.
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
    """Whether a residual with this Jacobian is linear in unknowns; one that jumps is not, whatever that says."""
    if ca.depends_on(jacobian, unknowns):
        return False
    stand_in = without_jumps(residual)
    return stand_in is residual or not ca.depends_on(ca.jacobian(stand_in, unknowns), unknowns)


def dependence(jacobian: ca.SX) -> npt.NDArray[np.bool_]:
    """Where a sparse matrix has entries."""
    pattern = np.zeros(jacobian.shape, dtype=bool)
    pattern[tuple(np.array(jacobian.sparsity().get_triplet(), dtype=np.intp))] = True
    return pattern


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
