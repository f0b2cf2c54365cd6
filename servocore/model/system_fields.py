"""Steps in the construction of a `servocore.model.system.MechanicalSystem` that need its fields only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from servocore.errors import InvalidModel, require_kind

_SYMBOLS = ("multipliers", "gamma", "u")

_Named = tuple[Sequence[str], ca.SX]


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


def require_positions(system: str, v: ca.SX, outputs: _Named, constraints: _Named) -> None:
    """Raise `InvalidModel` if outputs or constraints hold velocities, with what can be done instead.

    Parameters
    ----------
    system : str
        Name for messages.
    v : casadi.SX
        Velocities.
    outputs, constraints : sequence of names, and casadi.SX
        What the rows are called, and the rows.
    """
    for name, expression in _rows(*outputs):
        velocities = _listed(expression, v)
        if velocities:
            raise InvalidModel(
                f"{system}: the output {name} depends on velocities ({velocities}), but a servo constraint prescribes a"
                " function of the coordinates alone; where the output is the rate of such a function, prescribe that"
                " function, along the integral of the path"
            )
    for name, expression in _rows(*constraints):
        velocities = _listed(expression, v)
        if velocities:
            raise InvalidModel(
                f"{system}: the constraint {name} depends on velocities ({velocities}), and nonholonomic constraints"
                " are not solved; give its integral if it has one (rolling along a line has), or let a force f(q, v)"
                " oppose what it forbids"
            )


def _rows(names: Sequence[str], column: ca.SX) -> list[tuple[str, ca.SX]]:
    return list(zip(names, ca.vertsplit(ca.SX(column)), strict=False))


def _listed(expression: ca.SX, v: ca.SX) -> str:
    """Names of the velocities that an expression depends on."""
    return ", ".join(str(v[int(k)]) for k in sorted(set(ca.jacobian_sparsity(expression, v).get_col())))
