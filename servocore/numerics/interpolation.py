"""Interpolation by Lagrange's formula, for numbers and for symbols."""

from __future__ import annotations

from collections.abc import Iterable
from math import prod
from typing import overload

import casadi as ca
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@overload
def lagrange(nodes: npt.ArrayLike, points: Iterable[float]) -> ca.DM: ...
@overload
def lagrange(nodes: npt.ArrayLike, points: Iterable[ca.SX]) -> ca.SX: ...
def lagrange(nodes: npt.ArrayLike, points: Iterable[float] | Iterable[ca.SX]) -> ca.DM | ca.SX:
    """Return the weights W with values(nodes) @ W = values(points), for polynomials of degree len(nodes) - 1.

    Parameters
    ----------
    nodes : array_like, shape (n,)
        Points of the known values, all different.
    points : iterable of float or casadi.SX, length m
        Points of interpolation, in the unit of the nodes.

    Returns
    -------
    casadi.DM or casadi.SX, shape (n, m)
        For values in columns, one column per node. Each column of W sums to one.
    """
    places = np.asarray(nodes, dtype=np.float64)
    return ca.horzcat(*[ca.vertcat(*_weights(places, point)) for point in points])


def _weights(nodes: Array, point: float | ca.SX) -> list[float | ca.SX]:
    """Return the values at a point of the Lagrange polynomials, one per node."""
    weights = []
    for i, node in enumerate(nodes):
        others = np.delete(nodes, i)
        # Products before the quotient: between equidistant nodes they are integers, and the quotient is exact.
        weights.append(
            prod((point - float(other) for other in others), start=point * 0.0 + 1.0) / float(prod(node - others))
        )
    return weights
