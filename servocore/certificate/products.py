"""Products of Chebyshev polynomials, many at once: in machine code where it is there, in NumPy elsewhere.

T_i T_j = (T_(i+j) + T_|i-j|)/2 in each variable. Both ways add up the same products of coefficients, in orders of their
own: the bound of rounding in `Arithmetic.product` holds for any.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from math import prod
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from servocore.numerics.compiled_calls import Array
from servocore.numerics.just_in_time import JustInTime
from servocore.numerics.memoization import made_once

if TYPE_CHECKING:
    from pathlib import Path

    from servocore.numerics.machine_code import Build

_Run: TypeAlias = Callable[..., None]
_NAME = "sc_products"

# One pass over all pairs of coefficients for sixteen products side by side; pairs with a coefficient that is zero in
# all of them, as of what does not depend on a parameter, are left out. The places of the results come as a table.
_SOURCE = """
#define LANES 16
void sc_products(long terms, long targets, long full, const long *table, double share, long count,
                 const double *a, const double *b, double *results)
{
    for (long first = 0; first < count; first += LANES) {
        long lanes = count - first < LANES ? count - first : LANES;
        double x[LANES], y[LANES], z[LANES];
        for (long k = 0; k < full; ++k)
            for (long l = 0; l < lanes; ++l) results[k * count + first + l] = 0.0;
        for (long i = 0; i < terms; ++i) {
            int used = 0;
            for (long l = 0; l < LANES; ++l) x[l] = 0.0;
            for (long l = 0; l < lanes; ++l) { x[l] = share * a[i * count + first + l]; used |= x[l] != 0.0; }
            if (!used) continue;
            for (long j = 0; j < terms; ++j) {
                const long *place = table + (i * terms + j) * targets;
                const double *right = b + j * count + first;
                if (lanes == LANES) {
                    for (long l = 0; l < LANES; ++l) z[l] = x[l] * right[l];
                    for (long k = 0; k < targets; ++k) {
                        double *to = results + place[k] * count + first;
                        for (long l = 0; l < LANES; ++l) to[l] += z[l];
                    }
                } else {
                    for (long l = 0; l < lanes; ++l) y[l] = x[l] * right[l];
                    for (long k = 0; k < targets; ++k)
                        for (long l = 0; l < lanes; ++l) results[place[k] * count + first + l] += y[l];
                }
            }
        }
    }
}
"""


def convolved(degrees: tuple[int, ...], a: Array, b: Array) -> Array:
    """Return the coefficients (prod(2 d + 1), count, boxes) of products of polynomials (terms, count, boxes)."""
    shape = np.broadcast_shapes(a.shape, b.shape)
    run = machine_code().best(prod(shape))
    if run is None:
        return _in_numpy(degrees, np.broadcast_to(a, shape), np.broadcast_to(b, shape))
    left, right = (np.ascontiguousarray(np.broadcast_to(each, shape)) for each in (a, b))
    table, full = _table(degrees), prod(2 * d + 1 for d in degrees)
    results = np.empty((full, *shape[1:]))
    share = 0.5 ** sum(d > 0 for d in degrees)
    run(
        len(left), table.shape[1], full, table.ctypes.data, share, prod(shape[1:]), left.ctypes.data,
        right.ctypes.data, results.ctypes.data,
    )  # fmt: skip
    return results


@made_once
def machine_code() -> JustInTime[_Run]:
    """Return the products in machine code, once they are built."""

    def make() -> Build:
        from servocore.numerics.machine_code import Build  # noqa: PLC0415 - few compile

        return Build(_SOURCE, "products of Chebyshev polynomials", vectors=True)

    def load(library: Path) -> _Run:
        run = getattr(ctypes.CDLL(str(library)), _NAME)
        some, many = ctypes.c_long, ctypes.c_void_p
        run.restype, run.argtypes = None, [some, some, some, many, ctypes.c_double, some, many, many, many]
        return run  # type: ignore[no-any-return]  # ctypes finds functions by name

    return JustInTime(make, load)


@made_once
def _table(degrees: tuple[int, ...]) -> np.ndarray[tuple[int, int], np.dtype[np.int_]]:
    """Return the places of the results of every pair of coefficients, shape (terms^2, 2^variables)."""
    orders = np.indices([d + 1 for d in degrees]).reshape(len(degrees), -1)
    places = np.zeros((orders.shape[1] ** 2, 1), dtype=np.int_)
    for d, order in zip(degrees, orders, strict=True):
        both = [(order[:, None] + order).ravel(), np.abs(order[:, None] - order).ravel()] if d else [0 * places[:, 0]]
        places = np.concatenate([places * (2 * d + 1) + each[:, None] for each in both], axis=1)
    return np.ascontiguousarray(places)


def _in_numpy(degrees: tuple[int, ...], a: Array, b: Array) -> Array:
    """Return the same, one coefficient of `a` after the other: matrices of zeros and ones take products to places."""
    table, terms = _table(degrees), len(a)
    places = np.zeros((terms, terms, prod(2 * d + 1 for d in degrees)))
    for each in table.T:
        np.add.at(places, (*np.indices((terms, terms)), each.reshape(terms, terms)), 1.0 / table.shape[1])
    products = (places[i].T @ (a[i] * b).reshape(terms, -1) for i in range(terms))
    return np.asarray(sum(products)).reshape(-1, *a.shape[1:])
