"""Isomorphic parts of a square system: the same expressions of other unknowns and other givens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from servocore.numerics.components import Part, parts_of

_SMALL = 3  # unknowns: parts up to this size are solved by formula, which costs less than to call a function


@dataclass(frozen=True, eq=False)
class IsomorphicParts:
    """Parts that one solver serves.

    Attributes
    ----------
    parts : list of Part
        Rows and columns of each.
    givens : list of list of int
        Which of the system's givens each depends on, in the order in which the solver of the first takes them.
    """

    parts: list[Part]
    givens: list[list[int]]


def isomorphic_parts(residual: ca.SX, unknowns: ca.SX, givens: ca.SX, beside: Sequence[ca.SX]) -> list[IsomorphicParts]:
    """Return the groups of two and more independent parts of residual(unknowns, givens) = 0 that are alike.

    Parameters
    ----------
    residual, unknowns, givens : casadi.SX
        The equations; unknowns and givens are symbols.
    beside : sequence of casadi.SX
        Expressions of the givens, as long as the residual, that belong to a part too: by unknown, the last by row.
    """
    if unknowns.numel() <= 2 * _SMALL:
        return []
    parts = parts_of(ca.jacobian_sparsity(residual, unknowns))
    shapes: dict[tuple[int, int], list[Part]] = {}
    for part in parts:
        if len(part.rows) == len(part.columns) > _SMALL:
            shapes.setdefault((len(part.rows), len(part.entries)), []).append(part)
    candidates = [part for same in shapes.values() if len(same) > 1 for part in same]
    if not candidates:
        return []
    places = {entry.element_hash(): k for k, entry in enumerate(ca.vertsplit(givens) if givens.numel() else ())}
    groups: dict[str, IsomorphicParts] = {}
    for part in candidates:
        rows, columns = part.rows.tolist(), part.columns.tolist()
        expressions = [residual[rows], *(vector[columns] for vector in beside[:-1]), beside[-1][rows]]
        hashes = (symbol.element_hash() for symbol in ca.symvar(ca.vertcat(*expressions)))
        known = sorted(places[key] for key in hashes if key in places)
        # CasADi's own text of a function tells whether two parts are alike, names of symbols aside.
        group = groups.setdefault(_text(expressions, [unknowns[columns], givens[known]]), IsomorphicParts([], []))
        group.parts.append(part)
        group.givens.append(known)
    return [group for group in groups.values() if len(group.parts) > 1]


def _text(expressions: list[ca.SX], symbols: list[ca.SX]) -> str:
    """Return expressions of symbols as a text that does not depend on the names of the symbols."""
    renamed = [ca.SX.sym("x", symbol.numel()) for symbol in symbols]
    results = ca.Function("sc_part", symbols, expressions).call(renamed)
    text: str = ca.Function("sc_part", renamed, results).serialize()
    return text
