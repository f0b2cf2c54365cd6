"""Helpers for CasADi expressions: norms, derivatives, conversion of users' values to expressions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, described


def largest(values: ca.SX) -> ca.SX:
    """Return the maximum norm, NaN if any entry is NaN: CasADi's own norm ignores NaN."""
    if not values.numel():
        return ca.SX(0)
    return ca.if_else(ca.norm_1(values) < np.inf, ca.norm_inf(values), np.nan)


def highest_derivative(expression: ca.SX, gamma: ca.SX) -> int:
    """Return the last column of `gamma`, the reference and its derivatives, that an expression depends on."""
    columns = ca.jacobian_sparsity(expression, ca.vec(gamma)).get_col()
    return max((column // gamma.size1() for column in columns), default=0)


def time_derivative(expression: ca.SX, *jets: ca.SX) -> ca.SX:
    """Differentiate by time an expression of quantities and their derivatives.

    Parameters
    ----------
    expression : casadi.SX
        Of all columns of the jets but the last.
    *jets : casadi.SX
        Symbols, each column the derivative of the one before.
    """
    # Chain rule: each column of a jet has the next one as its rate.
    values, rates = (ca.veccat(*[jet[:, some] for jet in jets]) for some in (slice(None, -1), slice(1, None)))
    return ca.jtimes(expression, values, rates)


def as_expression(value: object, what: str) -> ca.SX:
    """Return a number, an array, a nested list of numbers and expressions, or an expression as one of CasADi's SX.

    Raises
    ------
    InvalidModel
        If it is of another kind, such as a text or an expression of the kind MX.
    """
    if isinstance(value, ca.SX):
        return value
    if isinstance(value, ca.MX):
        raise InvalidModel(f"{what} is a casadi.MX; models are written with the symbols of casadi.SX")
    if isinstance(value, ca.DM):
        return ca.SX(value)
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.ndim <= 2:
        return ca.SX(ca.DM(value.astype(np.float64)))
    rows = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(rows, list | tuple):
        return _stacked(rows, what)
    if isinstance(rows, bool) or not isinstance(rows, int | float | np.integer | np.floating):
        raise InvalidModel(f"{what} must be a casadi.SX, an array or a real number, not {described(value)}")
    return ca.SX(float(rows))


def _stacked(rows: Sequence[object], what: str) -> ca.SX:
    """Stack rows; those that are lists become rows of a matrix."""
    columns = []
    for k, row in enumerate(rows):
        listed = row.tolist() if isinstance(row, np.ndarray) else row
        if isinstance(listed, list | tuple):
            columns.append(ca.horzcat(*[_scalar(entry, f"{what}[{k}, {j}]") for j, entry in enumerate(listed)]))
        else:
            columns.append(as_expression(listed, f"{what}[{k}]"))
    lengths = [column.size2() for column in columns]
    if len(set(lengths)) > 1:
        raise InvalidModel(f"the rows of {what} have different lengths: {', '.join(map(str, lengths))}")
    return ca.vertcat(ca.SX(0, lengths[0] if lengths else 1), *columns)


def _scalar(value: object, what: str) -> ca.SX:
    expression = as_expression(value, what)
    if expression.numel() != 1:
        raise InvalidModel(f"{what} has shape {expression.shape}, one number or expression belongs there")
    return expression


def gyroscopic_forces(mass: ca.SX, q: ca.SX, v: ca.SX) -> ca.SX:
    """Return M_dot v - grad(v^T M v) / 2, which vanishes where M is constant."""
    # Lagrange: d/dt (M v) - grad(v^T M v / 2) = M v_dot + these; M_dot v is the derivative of M v along v.
    momentum = ca.mtimes(mass, v)
    return ca.jtimes(momentum, q, v) - ca.gradient(ca.dot(v, momentum) / 2, q)


def diagonal(entries: Sequence[ca.SX | float]) -> ca.SX:
    """Return the matrix with these entries on its diagonal, sparse."""
    return ca.sparsify(ca.diag(ca.vertcat(*entries)))


def expressions_of(name: str, fields: Mapping[str, object], n: int) -> dict[str, ca.SX]:
    """Return the fields of a system with n coordinates, given as numbers, arrays or lists, as expressions."""
    taken = {}
    for field, value in fields.items():
        matrix = as_expression(value, f"{name}: {field}")
        column = matrix is not value and matrix.shape == (n, 1)
        if field in ("mass", "input_matrix"):  # zeros of an array are not structural entries
            matrix = ca.sparsify(matrix)
        taken[field] = matrix.T if column and field == "input_matrix" else matrix
    return taken
