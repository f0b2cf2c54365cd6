"""Chebyshev models: a polynomial with a bound of its distance from a function, and operations that keep the bound true.

A model stands for all functions f on the box [-1, 1]^d with |f - p| <= r: p is a sum of products of Chebyshev
polynomials (their coefficients are stored), r the radius. The first variable is time on an interval, the others are
parameters. A model of degree 0 is a ball, and the operations are then ball arithmetic.

Sums and products, thousands at once, are carried out in machine code where it is there, in NumPy elsewhere:
T_i T_j = (T_(i+j) + T_|i-j|)/2 in each variable. Both ways add up the same products of coefficients and bound their
rounding errors alike, beforehand. Everything else is interpolated in plain floating point, and its distance from the
function bounded afterwards, from an equation that the function satisfies: so no rounding of the interpolation matters
(Brisebarre & Joldes, *Chebyshev interpolation polynomial-based tools for rigorous computing*, ISSAC 2010; Tucker,
*Validated Numerics*, 2011, chapter 3). NumPy's sin, cos, exp and tanh are trusted to 4 ulp.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev

from servocore.numerics.compiled_calls import Array, Places
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

LANES = 16
"""Boxes side by side in machine code, and the least number of them that it takes."""

_TINY = 1e-290  # underflow
_ULPS = 8.0 * UNIT  # relative error of an elementary function of NumPy, with its argument's own rounding
_NARROW = 1e-8  # radius
_EXPONENT = 1.0 + 1e-11  # an exponent below 710 is off by less than that, added up from a hundred terms
_PRODUCT = np.array([[TIMES, 2, 0, 1]], dtype=np.intp)

Model = Array
"""Coefficients and below them radii, (terms + 1, count, boxes): `count` functions on each of a number of boxes."""


def norm(c: Array) -> Array:
    """Return the sum of the magnitudes of the coefficients: |T_k| <= 1, so no value is larger."""
    return np.asarray(np.abs(c).sum(axis=0))


def model_of(c: Array, r: Array | float = 0.0) -> Model:
    """Return models with coefficients (terms, count, boxes) and radii (count, boxes)."""
    a = np.empty((len(c) + 1, *c.shape[1:]))
    a[:-1], a[-1] = c, r
    return a


def magnitude(a: Model) -> Array:
    """Return upper bounds of the magnitudes of models, shape (count, boxes)."""
    return norm(a) * UP


@dataclass(frozen=True)
class Arithmetic:
    """Operations on Chebyshev models of some degree in each variable.

    Attributes
    ----------
    degrees : tuple of int
        In time, and in each parameter.
    """

    degrees: tuple[int, ...]

    @cached_property
    def orders(self) -> Places:
        """Order of each coefficient in each variable, shape (variables, terms)."""
        return np.indices([d + 1 for d in self.degrees]).reshape(len(self.degrees), -1)

    @cached_property
    def places(self) -> Places:
        """Places of the results of every pair of coefficients, shape (terms, terms, 2^variables).

        Those within the degrees come first, then those beyond.
        """
        up = self.orders[:, :, None] + self.orders[:, None]
        down = np.abs(self.orders[:, :, None] - self.orders[:, None])
        both, shape = zip(up, down, strict=True), [2 * d + 1 for d in self.degrees]
        places = np.stack([np.ravel_multi_index(choice, shape) for choice in product(*both)], axis=-1)
        beyond = np.any([each > d for each, d in zip(np.indices(shape), self.degrees, strict=True)], axis=0).ravel()
        return np.asarray(np.argsort(np.argsort(beyond, kind="stable"))[places])

    @cached_property
    def sums(self) -> csr_array:
        """Matrix from the products of coefficients, those with the last of a first, to the results."""
        from scipy.sparse import csr_array  # noqa: PLC0415 - all commands import this module

        terms, _, targets = self.places.shape
        shares, pairs = np.full(self.places.size, 1.0 / targets), np.repeat(np.arange(terms**2), targets)
        return csr_array((shares, (self.places[::-1].ravel(), pairs)), (self.tape[2], terms**2))

    @cached_property
    def tape(self) -> Places:
        """For machine code: numbers of terms, results of a pair, all results, additions to one; the places."""
        sizes = prod(2 * d + 1 for d in self.degrees), 3 ** len(self.degrees)
        return np.array([*self.places.shape[1:], *sizes, *self.places.ravel()])

    @cached_property
    def rounding(self) -> Array:
        """Weights (terms,) of the coefficients of a in a bound of the rounding errors of a b, shares of |b|_1.

        Products are added up from the last coefficient of a to the first, so that large partial sums come last. Each of
        the results takes at most 3^variables products with a coefficient of a: one whose orders add up to its own, two
        whose orders differ by it. An addition is off by a unit of the partial sum (Higham, *Accuracy and Stability*,
        section 4.2), and all partial sums together are at most the sum of the |a_k| so far times |b|_1. In time alone
        machine code adds such pairs of b first: their product is rounded twice, and added once.
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
        some = (size_a + a[-1] > 0.0) & (size_b + b[-1] > 0.0)
        return np.concatenate([full[:terms], (r + _TINY * some)[None]])

    @cached_property
    def nodes(self) -> Array:
        """Chebyshev points of the first kind, shape (terms, variables)."""
        return np.array([*product(*(chebyshev.chebpts1(d + 1) for d in self.degrees))])

    @cached_property
    def at_nodes(self) -> Array:
        """Matrix from coefficients to values at the nodes."""
        return self.rows(self.nodes)

    @cached_property
    def at_middle(self) -> Array:
        """Matrix from coefficients to the value in the middle of the box."""
        return self.rows(np.zeros((1, len(self.degrees))))

    @cached_property
    def interpolation(self) -> Array:
        """Matrix from values at the nodes to coefficients."""
        return np.asarray(np.linalg.inv(self.at_nodes), dtype=np.float64)

    def rows(self, points: Array) -> Array:
        """Return the matrix from coefficients to values at `points` (N, variables): entries within 4 ulp."""
        found: Array = np.ones((len(points), 1))
        for k, d in enumerate(self.degrees):
            found = (found[:, :, None] * chebyshev.chebvander(points[:, k], d)[:, None, :]).reshape(len(points), -1)
        return found

    @cached_property
    def derivatives(self) -> list[Array]:
        """Matrices of the derivative by each variable; entries are whole numbers."""
        found, each = list[Array](), [np.eye(d + 1) for d in self.degrees]
        for k, one in enumerate(each):
            slopes = np.zeros_like(one)
            slopes[:-1] = chebyshev.chebder(one)[: len(one) - 1]
            found.append(reduce(np.kron, [*each[:k], slopes, *each[k + 1 :]]))  # type: ignore[arg-type]  # of NumPy
        return found

    @cached_property
    def halves(self) -> list[list[Array]]:
        """Matrices to the coefficients on the lower and the upper half of the box, by each variable."""
        points = [[np.where(own, (self.nodes + side) / 2.0, self.nodes) for side in (-1.0, 1.0)]
                  for own in np.eye(len(self.degrees), dtype=bool)]  # fmt: skip
        return [[self.interpolation @ self.rows(half) for half in each] for each in points]

    def halved(self, a: Model, k: int) -> Model:
        """Return models on lower, then on upper halves of boxes by variable k: rounding is units of coefficients."""
        r = a[-1] + 8 * (len(a) + 7) * UNIT * norm(a[:-1])
        return np.concatenate([model_of(_applied(each, a[:-1]), r) for each in self.halves[k]], axis=2)

    def ends(self, a: Model) -> tuple[Array, Array]:
        """Return polynomials in the parameters at the ends in time: (terms, count, boxes) each."""
        c = a[:-1].reshape(self.degrees[0] + 1, -1, *a.shape[1:])
        return np.tensordot((-1.0) ** np.arange(len(c)), c, 1), c.sum(axis=0)

    def constant(self, values: Array) -> Model:
        """Return models of constants, shape (count, boxes)."""
        a = np.zeros((self.orders.shape[1] + 1, *values.shape))
        a[0] = values
        return a

    def tried(self, values: Array) -> Model:
        """Return interpolants of values (nodes, count, boxes) as models without a radius, zero where one is not finite.

        Any polynomial may be tried.
        """
        c = _applied(self.interpolation, values)
        return model_of(np.where(np.isfinite(c).all(axis=0), c, 0.0))

    def values(self, a: Model) -> Array:
        """Return values of the polynomials at the nodes (nodes, count, boxes)."""
        return _applied(self.at_nodes, a[:-1])

    def span(self, a: Model) -> tuple[Array, Array]:
        """Return lower and upper bounds of models, shape (count, boxes) each: about the constant coefficient."""
        rest = magnitude(a[1:])
        low, high = a[0] - rest, a[0] + rest
        slack = 2.0 * UNIT * (np.abs(low) + np.abs(high))
        return low - slack, high + slack

    def product(self, a: Model, b: Model) -> Model:
        """Return a times b."""
        places = np.stack([a, b, a]).reshape(3, len(a), -1)
        carry_out(_PRODUCT, self, places)
        return np.asarray(places[2].reshape(a.shape))

    # Interpolated and bounded afterwards ----------------------------------------------------------------------------

    def _off(self, ratio: Model) -> Array:
        """Return e/(1 - e) for a bound e of |ratio - 1|: a bound of |1/ratio - 1| too, infinite unless e < 1."""
        apart = ratio.copy()
        apart[0] -= 1.0
        e = magnitude(apart) + UNIT * np.abs(ratio[0])
        return np.asarray(np.where(e < 1.0, e / np.where(e < 1.0, 1.0 - e, 1.0) * UP, np.inf))

    def inverse(self, a: Model) -> Model:
        """Return 1/a for a without a zero: with q a = 1 + d, it is q/(1 + d)."""
        q = self.tried(1.0 / self.values(a))
        q[-1] = norm(q[:-1]) * self._off(self.product(q, a)) * UP
        return q

    def root(self, a: Model, least: float = -np.inf) -> Model:
        """Return the square root of a, of which no value is below `least`: infinite radii where one may be negative.

        With q^2 a = 1 + d, q positive, it is q a (1 + d)^(-1/2).
        """
        q = self.tried(1.0 / np.sqrt(self.values(a)))
        s = self.product(q, a)
        s[-1] = (s[-1] + magnitude(s) * self._off(self.product(q, s))) * UP
        return self._or_range(s, lambda x: np.sqrt(np.maximum(x, least)), a)

    def logarithm(self, a: Model) -> Model:
        """Return log(a) for positive a: with a e^(-y) = 1 + d, it is y + log(1 + d)."""
        y = self.tried(np.log(self.values(a)))
        y[-1] = self._off(self.product(a, self.exponential(-y)))
        return self._or_range(y, np.log, a)

    def sine_and_cosine(self, a: Model) -> tuple[Model, Model]:
        """Return sin(a) and cos(a): both change by at most the radius of a."""
        v, (at, e) = self.values(a), self._middle(a)
        c, s = self.tried(np.cos(v)), self.tried(np.sin(v))
        off = self._flowed(a, [(c, s, -1.0, np.cos(at)), (s, c, 1.0, np.sin(at))])
        c[-1] = s[-1] = (off + 2.0 * (e + _ULPS) + a[-1]) * UP
        return s, c

    def exponential(self, a: Model) -> Model:
        """Return e^a: within the box it grows by at most e^(2 R), with R the sum of all but the first coefficient."""
        (at, e), rest, y = self._middle(a), norm(a[1:-1]), self.tried(np.exp(self.values(a)))
        off = self._flowed(a, [(y, y, 1.0, np.exp(at))]) + np.exp(at) * (np.expm1(2.0 * e) + _ULPS)
        y[-1] = (np.exp(2.0 * rest) * off + np.exp(a[0] + rest) * np.expm1(a[-1])) * _EXPONENT
        return bounded(y)

    def _flowed(self, p: Model, parts: list[tuple[Model, Model, float, Array]]) -> Array:
        """Bound what polynomials y are off a solution of y' = p' L y, divided by the growth of such solutions.

        Each part is y, the other one in L y and its sign, and the value in the middle of the box. From there to a point
        on a straight line, of a length of 1 at most in each variable, an error grows by its rate and the defects
        y' - p' L y.
        """
        off = np.zeros(p.shape[1:])
        for y, other, sign, begin in parts:
            value, e = self._middle(y)
            off = off + np.abs(value - begin) + e
            for matrix in self.derivatives:
                slope, change = derivative(matrix, p), derivative(matrix, y)
                off = off + magnitude(summed(change, self.product(slope, other), -sign))
        return off

    def _middle(self, a: Model) -> tuple[Array, Array]:
        """Return values of polynomials in the middle of the box and bounds of their rounding errors."""
        return _applied(self.at_middle, a[:-1])[0], (len(a) + 7) * UNIT * norm(a[:-1])

    def rising(self, function: Callable[[Array], Array], a: Model) -> Model:
        """Return an exact function that nowhere falls: any value between those at the ends of the range of a."""
        least, most = (function(each) for each in self.span(a))
        found = self.constant((least + most) / 2.0)
        found[-1] = (most - least) / 2.0 + _ULPS * (np.abs(least) + np.abs(most)) * (least != most)
        found[-1, ~np.isfinite(a[-1])] = np.inf  # there may be no value
        return found

    def _or_range(self, found: Model, function: Callable[[Array], Array], a: Model) -> Model:
        """Return a model of a function that nowhere falls, or its range where that has the smaller radius."""
        if (found[-1] <= _NARROW).all():  # narrow anyway: they are not compared
            return found
        around = self.rising(function, a)
        around[-1] += 2.0 * _ULPS * magnitude(around)
        return np.where(around[-1] < bounded(found)[-1], around, found)

    def hyperbolic_tangent(self, a: Model) -> Model:
        """Return tanh(a) = 1 - 2/(e^(2 a) + 1)."""
        one = self.constant(np.ones_like(a[0]))
        found = summed(one, 2.0 * self.inverse(summed(self.exponential(2.0 * a), one)), -1.0)
        return self._or_range(found, np.tanh, a)

    def angle(self, y: Model, x: Model) -> Model:
        """Return atan2(y, x) away from the negative x axis.

        Turned back by an approximation b, (x, y) has the components x cos b + y sin b ahead and y cos b - x sin b
        aside. Where the first is positive, the angle is off b by at most the second over the first: by whole turns
        nowhere, as it is not at the nodes and goes on continuously.
        """
        (low_x, _), (low_y, high_y) = self.span(x), self.span(y)
        b = self.tried(np.arctan2(self.values(y), self.values(x)))
        s, c = self.sine_and_cosine(b)
        low, _ = self.span(summed(self.product(x, c), self.product(y, s)))
        aside = magnitude(summed(self.product(y, c), self.product(x, s), -1.0))
        good = ((low_x > 0.0) | (low_y > 0.0) | (high_y < 0.0)) & (low > 0.0)
        b[-1] = np.where(good, aside / np.where(good, low, 1.0) * UP, np.inf)
        return b


arithmetic = made_once(Arithmetic)
"""Return the operations for degrees in time and parameters, with their matrices."""


def _applied(matrix: Array, c: Array) -> Array:
    """Return a matrix applied to the first axis."""
    return np.asarray((matrix @ c.reshape(len(c), prod(c.shape[1:]))).reshape(len(matrix), *c.shape[1:]))


def derivative(matrix: Array, a: Model) -> Model:
    """Return derivatives of polynomials: sums of `terms` products with whole numbers, rounded once each."""
    (size,) = _applied(np.abs(matrix).sum(axis=0)[None], np.abs(a[:-1]))
    return model_of(_applied(matrix, a[:-1]), (len(a) + 1) * UNIT * size)


def bounded(a: Model) -> Model:
    """Return models with infinity in the place of a radius that is not a number."""
    a[-1] = np.where(np.isnan(a[-1]), np.inf, a[-1])
    return a


def summed(a: Array, b: Array, sign: float = 1.0) -> Array:
    """Return a + b, or a - b for `sign` -1: a coefficient is rounded by a unit of itself."""
    found = a + sign * b
    found[-1] = (a[-1] + b[-1] + UNIT * norm(found[:-1])) * UP
    return found


def carry_out(steps: Places, ring: Arithmetic, models: Array) -> None:
    """Carry out sums, differences and products of models, one after the other.

    Parameters
    ----------
    steps : ndarray of int, shape (N, 4)
        Operation, place of the result, places of the arguments.
    ring : Arithmetic
        Of the polynomials.
    models : ndarray, shape (places, terms + 1, boxes)
        The models by their places, contiguous; results in place.
    """
    boxes = models.shape[2]
    run = machine_code().best(len(steps) * boxes) if boxes >= LANES else None
    if run is not None:
        results = np.empty((ring.tape[0] + ring.tape[2] + 1) * LANES)
        run(ring.tape.ctypes.data, steps.ctypes.data, models.ctypes.data, results.ctypes.data, len(steps), boxes)
        return
    rules = [summed, lambda a, b: summed(a, b, -1.0), ring.multiplied]  # of PLUS, MINUS and TIMES
    for operation, result, a, b in steps.tolist():
        models[result] = rules[operation](models[a], models[b])


@made_once
def machine_code() -> JustInTime[Callable[..., None]]:
    """Return programs in machine code, once it is built."""

    def make() -> Build:
        from servocore.numerics.machine_code import Build  # noqa: PLC0415 - few compile

        source = Path(__file__).with_suffix(".c").read_text(encoding="utf-8")
        return Build(source, "products of Chebyshev polynomials", vectors=True)

    return JustInTime(make, loader(None, *[ctypes.c_void_p] * 4, *[ctypes.c_ssize_t] * 2))
