"""Paths as formulas: the same operations on arrays and on expressions of CasADi, so that they give the same digits."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

Values = Any
"""Numbers, an array of one number an instant, or an expression."""


@dataclass(frozen=True)
class Formula:
    """What a path is as an expression of time; formulas of one kind are equal.

    Attributes
    ----------
    kind : hashable
        Paths of one kind have the same expression.
    numbers : callable
        order -> what of the path stands in its place in the expression, up to some derivative.
    jet : callable
        (time, numbers, order) -> gamma, gamma', ..., one column of expressions each.
    """

    kind: Hashable
    numbers: Callable[[int], list[float]] = field(compare=False)
    jet: Callable[[ca.SX, list[ca.SX], int], list[ca.SX]] = field(compare=False)


def least(a: Values, b: Values) -> Values:
    """Return the smaller of each."""
    return ca.fmin(a, b) if isinstance(a, ca.SX) else np.minimum(a, b)


def most(a: Values, b: Values) -> Values:
    """Return the larger of each."""
    return ca.fmax(a, b) if isinstance(a, ca.SX) else np.maximum(a, b)


def where(condition: Values, a: Values, b: Values) -> Values:
    """Return one value where a condition holds, and another elsewhere."""
    return ca.if_else(condition, a, b) if isinstance(condition, ca.SX) else np.where(condition, a, b)


def either(a: Values, b: Values) -> Values:
    """Whether one of two conditions holds."""
    return ca.logic_or(a, b) if isinstance(a, ca.SX) else a | b


def powers(x: Values, highest: int) -> list[Values]:
    """Return 1, x, x^2, ..., each a product: a library's power has other last digits on every machine."""
    monomials = [1.0]
    for _ in range(highest):
        monomials.append(monomials[-1] * x if len(monomials) > 1 else x)
    return monomials
