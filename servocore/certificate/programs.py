"""Sums and products of Chebyshev models, thousands at once: in machine code where it is there, in NumPy elsewhere.

T_i T_j = (T_(i+j) + T_|i-j|)/2 in each variable. Both ways add up the same products of coefficients, in orders of their
own: the bounds of their rounding errors hold for any.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from servocore.numerics.compiled_calls import Array
from servocore.numerics.just_in_time import JustInTime
from servocore.numerics.memoization import made_once

if TYPE_CHECKING:
    from servocore.numerics.machine_code import Build

UNIT = 2.3e-16
"""Twice the unit roundoff of double precision: room for the rounding of the bounds themselves."""

UP = 1.0 + 1e-14
"""A radius is computed in some ten operations with non-negative terms, and norms in as many as there are terms."""

PLUS, MINUS, TIMES = range(3)
"""Operations of a program."""

_TINY = 1e-290  # underflow
_SOURCE = Path(__file__).with_name("programs.c")
_LANES = 16  # boxes side by side in machine code

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
    def places(self) -> Places:
        """Places of the results of every pair of coefficients, shape (terms^2, 2^variables)."""
        orders = np.indices([d + 1 for d in self.degrees]).reshape(len(self.degrees), -1)
        places = np.zeros((orders.shape[1] ** 2, 1), dtype=np.intp)
        for d, order in zip(self.degrees, orders, strict=True):
            up, down = (order[:, None] + order).ravel(), np.abs(order[:, None] - order).ravel()
            both = (up, down) if d else (up,)
            places = np.concatenate([places * (2 * d + 1) + each[:, None] for each in both], axis=1)
        return np.ascontiguousarray(places)

    @cached_property
    def kept(self) -> Places:
        """Number of each coefficient of a product among those within the degrees, -1 for those beyond."""
        orders = np.indices([2 * d + 1 for d in self.degrees]).reshape(len(self.degrees), -1)
        within = (orders <= np.array(self.degrees)[:, None]).all(axis=0)
        return np.where(within, np.cumsum(within) - 1, -1)

    @cached_property
    def additions(self) -> list[list[tuple[Places, Places]]]:
        """For each coefficient of a, terms of b and places of their products, which differ: `np.add.at` is slow."""
        terms, found = prod(d + 1 for d in self.degrees), list[list[tuple[Places, Places]]]()
        for places in self.places.reshape(terms, terms, -1):
            found.append([])
            for place in places.T:
                left = np.arange(terms)
                while left.size:
                    different, first = np.unique(place[left], return_index=True)
                    found[-1].append((left[first], different))
                    left = np.delete(left, first)
        return found

    @cached_property
    def addresses(self) -> tuple[int, ...]:
        """Number of terms, of results of a pair and of coefficients of a product, and where the tables are."""
        sizes = prod(d + 1 for d in self.degrees), self.places.shape[1], len(self.kept)
        return *sizes, self.places.ctypes.data, self.kept.ctypes.data

    @cached_property
    def rounding(self) -> float:
        """Bound of the rounding errors of a product, as a share of |a|_1 |b|_1.

        A coefficient is a sum of at most N = prod(2 d + 2) products of two coefficients, added up in any order: all
        of them together are off by at most N + 2 units (Higham, *Accuracy and Stability*, section 3.1).
        """
        return (prod(2 * d + 2 for d in self.degrees) + 2) * UNIT / 2.0

    def multiplied(self, a: Array, b: Array) -> Array:
        """Return products of models with the radius below the coefficients, shape (terms + 1, N, boxes).

        Terms beyond the degrees go into the radius, and so does (p + e)(q + f) - p q with |e|, |f| the radii.
        """
        full = np.zeros((len(self.kept), *a.shape[1:]))
        for coefficient, parts in zip(a[:-1], self.additions, strict=True):
            products = coefficient * b[:-1] / self.places.shape[1]
            for terms, places in parts:
                full[places] += products[terms]
        beyond, size_a, size_b = self.kept < 0, norm(a[:-1]), norm(b[:-1])
        crossed = size_a * b[-1] + size_b * a[-1] + a[-1] * b[-1]
        r = (norm(full[beyond]) + self.rounding * size_a * size_b + crossed) * UP
        return np.concatenate([full[~beyond], (r + _TINY * (r > 0))[None]])


def summed(a: Array, b: Array, sign: float) -> Array:
    """Return a + b or a - b, coefficients and below them the radius: a coefficient is rounded by a unit of itself."""
    found = a + sign * b
    found[-1] = (a[-1] + b[-1] + UNIT * norm(found[:-1])) * UP
    return found


@dataclass(frozen=True, eq=False)
class Program:
    """Sums, differences and products of models, one after the other.

    Parameters
    ----------
    steps : ndarray of int, shape (N, 4)
        Operation, place of the result, places of the arguments.
    wanted : set of int
        Places of the results that are read afterwards.
    """

    steps: Places
    wanted: set[int]

    @cached_property
    def inputs(self) -> Places:
        """Places of models that are known before."""
        return np.setdiff1d(self.steps[:, 2:], self.steps[:, 1])

    @cached_property
    def outputs(self) -> Places:
        """Places of the results that are read afterwards."""
        return np.array(sorted(self.wanted.intersection(self.steps[:, 1].tolist())), dtype=np.intp)

    @cached_property
    def levels(self) -> list[tuple[int, Places]]:
        """Operations of one kind with known arguments together, each with places (3, N)."""
        level: dict[int, int] = {}
        grouped: dict[tuple[int, int], list[list[int]]] = {}
        for operation, *places in self.steps.tolist():
            level[places[0]] = 1 + max(level.get(each, 0) for each in places[1:])
            grouped.setdefault((level[places[0]], operation), []).append(places)
        return [(operation, np.array(members, dtype=np.intp).T) for (_, operation), members in sorted(grouped.items())]

    @cached_property
    def slots(self) -> tuple[list[Places], int]:
        """Steps, inputs and outputs with places that are used again, and how many of them there are."""
        last = {place: at for at, (_, *places) in enumerate(self.steps.tolist()) for place in places}
        last |= dict.fromkeys(self.outputs.tolist(), len(self.steps))
        slot = {place: k for k, place in enumerate(self.inputs.tolist())}
        free, count, found = list[int](), len(slot), list[list[int]]()
        for at, (operation, result, *arguments) in enumerate(self.steps.tolist()):
            if not free:
                free, count = [count], count + 1
            # A result has a slot of its own: its arguments are read while it is written.
            slot[result] = free.pop()
            found.append([operation, slot[result], *(slot[each] for each in arguments)])
            free += {slot[each] for each in (result, *arguments) if last[each] == at}
        both = ([slot[each] for each in some.tolist()] for some in (self.inputs, self.outputs))
        return [np.array(each, dtype=np.intp) for each in (found, *both)], count

    @cached_property
    def addresses(self) -> tuple[tuple[int, ...], int]:
        """How many steps, inputs and outputs there are, and where they are; how many places they need."""
        (steps, read, written), count = self.slots
        arrays = (steps, read, self.inputs, written, self.outputs)
        return (len(steps), len(read), len(written), *(each.ctypes.data for each in arrays)), count

    def __call__(self, tables: Products, models: Array) -> None:
        """Carry the steps out on models (terms + 1, places, boxes), radii below the coefficients; results in place."""
        if not len(self.steps):
            return
        run = machine_code().best(len(self.steps) * models.shape[2])
        if run is not None:
            own, count = self.addresses
            scratch = np.empty((count * len(models) + len(tables.kept)) * _LANES)
            run(*tables.addresses, *own, *models.shape[1:], models.ctypes.data, scratch.ctypes.data, tables.rounding)
            return
        work = np.zeros((len(models), max(models.shape[1], self.steps.max(initial=0) + 1), models.shape[2]))
        work[:, : models.shape[1]] = models
        for operation, (result, a, b) in self.levels:
            left, right = work[:, a], work[:, b]
            work[:, result] = (
                tables.multiplied(left, right)
                if operation == TIMES
                else summed(left, right, 1.0 if operation == PLUS else -1.0)
            )
        models[:] = work[:, : models.shape[1]]


@made_once
def machine_code() -> JustInTime[_Run]:
    """Return programs in machine code, once it is built."""

    def make() -> Build:
        from servocore.numerics.machine_code import Build  # noqa: PLC0415 - few compile

        return Build(_SOURCE.read_text(encoding="utf-8"), "products of Chebyshev polynomials", vectors=True)

    def load(library: Path) -> _Run:
        run = ctypes.CDLL(str(library)).sc_programs
        some, many = ctypes.c_ssize_t, ctypes.c_void_p
        run.restype, run.argtypes = None, [
            some, some, some, many, many, some, some, some, many, many, many, many, many, some, some, many, many,
            ctypes.c_double,
        ]  # fmt: skip
        return run

    return JustInTime(make, load)


def program_of(steps: Iterable[tuple[int, int, int, int]], wanted: set[int]) -> Program:
    """Return a program of steps: operation, place of the result, places of the arguments."""
    return Program(np.array(list(steps), dtype=np.intp).reshape(-1, 4), wanted)
