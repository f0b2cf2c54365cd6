"""Steps in the construction of a `servocore.model.system.MechanicalSystem` that need its fields only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, require_kind
from servocore.numerics.compiled_calls import Array

_SYMBOLS = ("multipliers", "gamma", "u")


def require_shapes(name: str, expressions: Mapping[str, ca.SX], shapes: Mapping[str, tuple[int, int]]) -> None:
    """Refuse fields of another shape, and expressions where symbols belong."""
    for field, expression in expressions.items():
        if expression.shape != shapes[field]:
            raise InvalidModel(f"{name}: {field} has shape {expression.shape}, expected {shapes[field]}")
        if field in _SYMBOLS and not expression.is_valid_input():
            raise InvalidModel(f"{name}: {field} must be symbols of casadi.SX.sym, not expressions")


def require_freedom(name: str, n: int, m: int, rows: int, rank: int, *, assembled: bool) -> None:
    """Refuse more inputs m than n coordinates have degrees of freedom under constraints of this rank."""
    if not assembled:
        raise InvalidModel(
            f"{name}: {m} inputs are too many for {n} coordinates with {rows} holonomic constraints, unless"
            " these are redundant in part; no configuration that satisfies them was found from the guess at home"
        )
    if m > n - rank:
        raise InvalidModel(
            f"{name}: {m} inputs exceed the {n - rank} degrees of freedom"
            f" ({n} coordinates, {rank} independent ones of {rows} holonomic constraints)"
        )


def require_independent_rows(name: str, G: Array, C: Array) -> None:
    """Refuse Jacobians of constraints (m_h, n) and outputs (m, n) whose rows are dependent."""
    m_h, m = len(G), len(C)
    for matrix, rows, what in (
        (G, m_h, f"the {m_h} holonomic constraints are"),
        (np.vstack([G, C]), m_h + m, f"the {m} servo outputs and {m_h} holonomic constraints are"),
    ):
        rank = int(np.linalg.matrix_rank(matrix)) if rows else 0
        if rank < rows:
            raise InvalidModel(f"{name}: {what} dependent here (rank {rank} of {rows})")


def home_names(outputs: Sequence[str], time: ca.SX, home: object) -> tuple[str, ...]:
    """Return names of the entries of home: the time is the last one in a system that is made from another."""
    again = ca.SX(time).numel() == 1 and isinstance(home, tuple) and len(home) == len(outputs) + 1
    return (*outputs, "time") if again else tuple(outputs)


def clock(name: str, time: ca.SX, gamma: ca.SX, home: tuple[float, ...], m: int) -> dict[str, object]:
    """Return gamma with the time as its last row, and home with it as its last entry, where there is a time."""
    fields: dict[str, object] = {}
    if isinstance(time, ca.SX) and not time.numel():
        return fields
    require_kind(time, ca.SX, f"{name}: the time", "a symbol of casadi.SX.sym", InvalidModel)
    if not time.is_symbolic():
        raise InvalidModel(f"{name}: the time must be one symbol, not {time}")
    if gamma.size1() == m:  # a system made from another has that row already
        rates = ca.SX.sym("time", 1, gamma.size2() - 1)
        fields["gamma"] = ca.vertcat(gamma, ca.horzcat(time, rates))
    if len(home) == m:
        fields["home"] = (*home, 0.0)
    return fields
