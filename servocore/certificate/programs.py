"""Sums and products of Chebyshev models, thousands at once: in machine code where it is there, in NumPy elsewhere.

A model is an array of coefficients with the radius below them, shape (terms + 1, count, boxes). T_i T_j =
(T_(i+j) + T_|i-j|)/2 in each variable. Both ways add up the same products of coefficients and bound their rounding
errors alike.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from servocore.numerics.compiled_calls import Array
from servocore.numerics.just_in_time import JustInTime
from servocore.numerics.memoization import made_once
from servocore.numerics.vectorized import loader

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from servocore.numerics.machine_code import Build

UNIT = 2.3e-16
"""Twice the unit roundoff of double precision: room for the rounding of the bounds themselves."""

UP = 1.0 + 1e-14
"""A radius is computed in some ten operations with non-negative terms, and norms in as many as there are terms."""

PLUS, MINUS, TIMES = range(3)
"""Operations of a program."""

_TINY = 1e-290  # underflow
_SOURCE = Path(__file__).with_name("programs.c")
LANES = 16
"""Boxes side by side in machine code, and the least number of them that it takes."""

Places: TypeAlias = npt.NDArray[np.intp]
_Run: TypeAlias = Callable[..., None]


def norm(c: Array) -> Array:
    """Return the sum of the magnitudes of the coefficients: |T_k| <= 1, so no value is larger."""
    return np.asarray(np.abs(c).sum(axis=0))


@dataclass(frozen=True)
class Products:
    """Where the products of coefficients go for polynomials of some degree in each variable.

    Attributes
    ----------
    degrees : tuple of int
        In time, and in each parameter.
    """

    degrees: tuple[int, ...]

    @cached_property
    def orders(self) -> Places:
        """Order of each coefficient in each variable, shape (variables, terms)."""
        return _orders(self.degrees)

    @cached_property
    def places(self) -> Places:
        """Places of the results of every pair of coefficients, shape (terms, terms, 2^variables).

        Those within the degrees come first, then those beyond.
        """
        up = self.orders[:, :, None] + self.orders[:, None]
        down = np.abs(self.orders[:, :, None] - self.orders[:, None])
        both, shape = zip(up, down, strict=True), [2 * d + 1 for d in self.degrees]
        places = np.stack([np.ravel_multi_index(choice, shape) for choice in product(*both)], axis=-1)
        beyond = (_orders([2 * d for d in self.degrees]) > np.array(self.degrees)[:, None]).any(axis=0)
        return np.asarray(np.argsort(np.argsort(beyond, kind="stable"))[places])

    @cached_property
    def sums(self) -> csr_array:
        """Matrix from the products of coefficients, those with the last of a first, to the results."""
        from scipy.sparse import csr_array  # noqa: PLC0415 - all commands import this module

        terms, _, targets = self.places.shape
        shares, pairs = np.full(self.places.size, 1.0 / targets), np.repeat(np.arange(terms**2), targets)
        return csr_array(
            (shares, (self.places[::-1].ravel(), pairs)), (prod(2 * d + 1 for d in self.degrees), terms**2)
        )

    @cached_property
    def tape(self) -> tuple[Places, int]:
        """For machine code: numbers of terms, results of a pair, all results, additions; the places; its address."""
        sizes = prod(2 * d + 1 for d in self.degrees), 3 ** len(self.degrees)
        tape = np.array([*self.places.shape[1:], *sizes, *self.places.ravel()])
        return tape, tape.ctypes.data

    @cached_property
    def rounding(self) -> Array:
        """Weights (terms,) of the coefficients of a in a bound of the rounding errors of a b, shares of |b|_1.

        Products are added up from the last coefficient of a to the first, so that large partial sums come last. Each of
        the results takes at most 3^variables products with a coefficient of a: one whose orders add up to its own, two
        whose orders differ by it. An addition is off by a unit of the partial sum (Higham, *Accuracy and Stability*,
        section 4.2), and all partial sums together are at most the sum of the |a_k| so far times |b|_1.
        """
        return (1.0 + 3.0 ** len(self.degrees) * np.arange(1.0, self.orders.shape[1] + 1.0)) * UNIT / 2.0

    def multiplied(self, a: Array, b: Array) -> Array:
        """Return products of models.

        Terms beyond the degrees go into the radius, and so does (p + e)(q + f) - p q with |e|, |f| the radii.
        """
        terms = len(a) - 1
        full = self.sums @ (a[-2::-1, None] * b[:-1]).reshape(terms**2, -1)
        full, size_a, size_b = full.reshape(-1, *a.shape[1:]), norm(a[:-1]), norm(b[:-1])
        crossed = size_a * b[-1] + size_b * a[-1] + a[-1] * b[-1]
        r = (norm(full[terms:]) + np.tensordot(self.rounding, np.abs(a[:-1]), 1) * size_b + crossed) * UP
        return np.concatenate([full[:terms], (r + _TINY * (r > 0))[None]])


def _orders(degrees: Sequence[int]) -> Places:
    return np.indices([d + 1 for d in degrees]).reshape(len(degrees), -1)


def summed(a: Array, b: Array, sign: float = 1.0) -> Array:
    """Return a + b, or a - b for `sign` -1: a coefficient is rounded by a unit of itself."""
    found = a + sign * b
    found[-1] = (a[-1] + b[-1] + UNIT * norm(found[:-1])) * UP
    return found


def carry_out(steps: Places, tables: Products, models: Array) -> None:
    """Carry out sums, differences and products of models, one after the other.

    Parameters
    ----------
    steps : ndarray of int, shape (N, 4)
        Operation, place of the result, places of the arguments.
    tables : Products
        Of the polynomials.
    models : ndarray, shape (places, terms + 1, boxes)
        The models by their places, contiguous; results in place.
    """
    boxes = models.shape[2]
    run = machine_code().best(len(steps) * boxes) if boxes >= LANES else None
    if run is not None:
        tape, address = tables.tape
        results = np.empty(tape[2] * LANES)
        run(address, steps.ctypes.data, models.ctypes.data, results.ctypes.data, len(steps), boxes)
        return
    rules = [summed, lambda a, b: summed(a, b, -1.0), tables.multiplied]  # of PLUS, MINUS and TIMES
    for operation, result, a, b in steps.tolist():
        models[result] = rules[operation](models[a], models[b])


@made_once
def machine_code() -> JustInTime[_Run]:
    """Return programs in machine code, once it is built."""

    def make() -> Build:
        from servocore.numerics.machine_code import Build  # noqa: PLC0415 - few compile

        return Build(_SOURCE.read_text(encoding="utf-8"), "products of Chebyshev polynomials", vectors=True)

    return JustInTime(make, loader(None, *[ctypes.c_void_p] * 4, *[ctypes.c_ssize_t] * 2))
