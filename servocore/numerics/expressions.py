"""Small questions to CasADi expressions that several rooms ask."""

from __future__ import annotations

import casadi as ca
import numpy as np


def largest(values: ca.SX) -> ca.SX:
    """Return the maximum norm, and NaN if any entry is: CasADi's own passes over NaN."""
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
    terms = (ca.jtimes(expression, ca.vec(jet[:, :-1]), ca.vec(jet[:, 1:])) for jet in jets)
    return sum(terms, ca.SX.zeros(expression.shape))
