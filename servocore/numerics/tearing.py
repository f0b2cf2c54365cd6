"""Tearing: unknowns of a block that a row gives explicitly are substituted, so that fewer remain to be iterated."""

from __future__ import annotations

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.numerics.known_values import substituted
from servocore.numerics.step_operations import without_jumps

_FILL = 0  # a substitution must not leave more entries than it removes


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
