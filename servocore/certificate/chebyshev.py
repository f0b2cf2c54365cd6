"""Chebyshev models: a polynomial with a bound of its distance from a function, and operations that keep the bound true.

A model stands for all functions f on the box [-1, 1]^d with |f - p| <= r: p is a sum of products of Chebyshev
polynomials (their coefficients are stored), r the radius. The first variable is time on an interval, the others are
parameters. A model of degree 0 is a ball, and the operations are then ball arithmetic.

Sums and products bound their rounding errors beforehand. Everything else is interpolated in plain floating point, and
its distance from the function bounded afterwards, from an equation that the function satisfies: so no rounding of the
interpolation matters (Brisebarre & Joldes, *Chebyshev interpolation polynomial-based tools for rigorous computing*,
ISSAC 2010; Tucker, *Validated Numerics*, 2011, chapter 3). NumPy's sin, cos, exp and tanh are trusted to 4 ulp.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, reduce
from math import prod

import numpy as np
from numpy.polynomial import chebyshev

from servocore.certificate.programs import TIMES, UNIT, UP, Products, norm, program_of, summed
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once

__all__ = ["UNIT", "Arithmetic", "Model", "arithmetic", "bounded", "magnitude", "norm"]

_ULPS = 8.0 * UNIT  # relative error of an elementary function of NumPy, with its argument's own rounding
_EXPONENT = 1.0 + 1e-11  # an exponent below 710 is off by less than that, added up from a hundred terms
_NARROW = 1e-8  # radius
_PRODUCT = program_of([(TIMES, 2, 0, 1)], {2})

Model = tuple[Array, Array]
"""Coefficients (terms, count, boxes) and radii (count, boxes): `count` functions on each of a number of boxes."""


def magnitude(a: Model) -> Array:
    """Return upper bounds of the magnitudes of models, shape (count, boxes)."""
    return np.asarray((norm(a[0]) + a[1]) * UP)


class Arithmetic(Products):
    """Operations on Chebyshev models of some degree in each variable."""

    @cached_property
    def nodes(self) -> Array:
        """Chebyshev points of the first kind, shape (terms, variables)."""
        return _grid([_points(d + 1) for d in self.degrees])

    @cached_property
    def at_nodes(self) -> Array:
        """Matrix from coefficients to values at the nodes."""
        return self.rows(self.nodes)

    @cached_property
    def interpolation(self) -> Array:
        """Matrix from values at the nodes to coefficients."""
        return np.asarray(np.linalg.inv(self.at_nodes), dtype=np.float64)

    def rows(self, points: Array) -> Array:
        """Return the matrix from coefficients to values at `points` (N, variables): entries within 4 ulp."""
        each = [chebyshev.chebvander(points[:, k], d) for k, d in enumerate(self.degrees)]
        return np.asarray(reduce(lambda a, b: (a[:, :, None] * b[:, None, :]).reshape(len(a), -1), each))

    @cached_property
    def derivatives(self) -> list[Array]:
        """Matrices of the derivative by each variable that a polynomial depends on; entries are whole numbers."""
        return [self._slopes(k) for k, d in enumerate(self.degrees) if d]

    def _slopes(self, k: int) -> Array:
        own = np.vstack([chebyshev.chebder(np.eye(self.degrees[k] + 1)), np.zeros((1, self.degrees[k] + 1))])
        return reduce(np.kron, [own if j == k else np.eye(e + 1) for j, e in enumerate(self.degrees)])

    def constant(self, values: Array) -> Model:
        """Return models of constants, shape (count, boxes)."""
        c = np.zeros((prod(d + 1 for d in self.degrees), *values.shape))
        c[0] = values
        return c, np.zeros_like(values)

    def interpolated(self, values: Array) -> Array:
        """Return the coefficients of interpolants of values (nodes, count, boxes)."""
        return _applied(self.interpolation, values)

    def values(self, c: Array) -> Array:
        """Return values at the nodes (nodes, count, boxes)."""
        return _applied(self.at_nodes, c)

    def span(self, a: Model) -> tuple[Array, Array]:
        """Return lower and upper bounds of models, shape (count, boxes) each: about the constant coefficient."""
        c, rest = a[0], magnitude((a[0][1:], a[1]))
        low, high = c[0] - rest, c[0] + rest
        slack = 2.0 * UNIT * (np.abs(low) + np.abs(high))
        return low - slack, high + slack

    # Sums and products ----------------------------------------------------------------------------------------------

    def sum(self, a: Model, b: Model, sign: float = 1.0) -> Model:
        """Return a + b, or a - b for `sign` -1."""
        found = summed(_stacked(a), _stacked(b), sign)
        return found[:-1], found[-1]

    def product(self, a: Model, b: Model) -> Model:
        """Return a times b."""
        c, r = a
        models = np.empty((len(c) + 1, 3, r.size))
        for place, (coefficients, radii) in enumerate((a, b)):
            models[:-1, place], models[-1, place] = coefficients.reshape(len(c), -1), radii.ravel()
        _PRODUCT(self, models)
        return models[:-1, 2].reshape(c.shape), models[-1, 2].reshape(r.shape)

    # Interpolated and bounded afterwards ----------------------------------------------------------------------------

    def _tried(self, values: Array) -> Model:
        """Return interpolants as models without a radius, zero for what is not finite: any polynomial may be tried."""
        c = self.interpolated(values)
        return np.where(np.isfinite(c).all(axis=0), c, 0.0), np.zeros(c.shape[1:])

    def _off(self, ratio: Model) -> Array:
        """Return e/(1 - e) for a bound e of |ratio - 1|: a bound of |1/ratio - 1| too, infinite unless e < 1."""
        c = ratio[0].copy()
        c[0] -= 1.0
        e = magnitude((c, ratio[1] + UNIT * np.abs(ratio[0][0])))
        return np.asarray(np.where(e < 1.0, e / np.where(e < 1.0, 1.0 - e, 1.0) * UP, np.inf))

    def inverse(self, a: Model) -> Model:
        """Return 1/a for a without a zero: with q a = 1 + d, it is q/(1 + d)."""
        q = self._tried(1.0 / self.values(a[0]))
        return q[0], norm(q[0]) * self._off(self.product(q, a)) * UP

    def root(self, a: Model) -> Model:
        """Return the square root of a: with q^2 a = 1 + d, q positive, it is q a (1 + d)^(-1/2).

        Where a may come to zero, from 0 to the root of its upper bound, for values with which the root is defined.
        """
        q = self._tried(1.0 / np.sqrt(self.values(a[0])))
        s = self.product(q, a)
        off = self._off(self.product(q, s))
        return self._or_range((s[0], (s[1] + magnitude(s) * off) * UP), np.sqrt, a, 0.0)

    def logarithm(self, a: Model) -> Model:
        """Return log(a) for positive a: with a e^(-y) = 1 + d, it is y + log(1 + d)."""
        y = self._tried(np.log(self.values(a[0])))
        off = self._off(self.product(a, self.exponential((-y[0], y[1]))))
        return self._or_range((y[0], off), np.log, a, 0.0)

    def _or_range(self, found: Model, function: Callable[[Array], Array], a: Model, lowest: float) -> Model:
        """Return a model, or where that has the smaller radius the range of a function that rises from `lowest` on.

        Models that are narrow anyway are not compared.
        """
        if (found[1] <= _NARROW).all():
            return found
        low, high = self.span(a)
        least, most = function(np.maximum(low, lowest)), function(np.where(high >= lowest, high, np.nan))
        half = (most - least) / 2.0 + _ULPS * (np.abs(least) + np.abs(most))
        better = np.isfinite(half) & ~(found[1] <= half)
        around = self.constant(np.where(better, (least + most) / 2.0, 0.0))[0]
        return np.where(better, around, found[0]), np.where(better, half, bounded(found[1]))

    def sine_and_cosine(self, a: Model) -> tuple[Model, Model]:
        """Return sin(a) and cos(a): both change by at most the radius of a."""
        v, (at, e) = self.values(a[0]), self._middle(a[0])
        c, s = self._tried(np.cos(v)), self._tried(np.sin(v))
        off = self._flowed(a[0], [(c, s, -1.0, np.cos(at)), (s, c, 1.0, np.sin(at))])
        radius = (off + 2.0 * (e + _ULPS) + a[1]) * UP
        return (s[0], radius), (c[0], radius.copy())

    def exponential(self, a: Model) -> Model:
        """Return e^a: within the box it grows by at most e^(2 R), with R the sum of all but the first coefficient."""
        (at, e), rest = self._middle(a[0]), norm(a[0][1:])
        y = self._tried(np.exp(self.values(a[0])))
        off = self._flowed(a[0], [(y, y, 1.0, np.exp(at))]) + np.exp(at) * (np.expm1(2.0 * e) + _ULPS)
        radius = np.exp(2.0 * rest) * off + np.exp(a[0][0] + rest) * np.expm1(a[1])
        return y[0], bounded(radius * _EXPONENT)

    def _flowed(self, p: Array, parts: list[tuple[Model, Model, float, Array]]) -> Array:
        """Bound what polynomials y are off a solution of y' = p' L y, divided by the growth of such solutions.

        Each part is y, the other one in L y and its sign, and the value in the middle of the box. From there to a point
        on a straight line, an error grows by its rate and the defects y' - p' L y, whose bounds are added up over the
        variables.
        """
        off = np.zeros(p.shape[1:])
        for y, other, sign, begin in parts:
            value, e = self._middle(y[0])
            off = off + np.abs(value - begin) + e
            for matrix in self.derivatives:
                slope, change = self._derivative(matrix, p), self._derivative(matrix, y[0])
                off = off + magnitude(self.sum(change, self.product(slope, other), -sign))
        return off

    def _derivative(self, matrix: Array, c: Array) -> Model:
        """Return derivatives of polynomials: sums of `terms` products with whole numbers, rounded once each."""
        return _applied(matrix, c), (len(c) + 2) * UNIT * _applied(np.abs(matrix).sum(axis=0)[None], np.abs(c))[0]

    def _middle(self, c: Array) -> tuple[Array, Array]:
        """Return values in the middle of the box and bounds of their rounding errors."""
        row = self.rows(np.zeros((1, len(self.degrees))))
        return _applied(row, c)[0], (len(c) + 8) * UNIT * norm(c)

    def hyperbolic_tangent(self, a: Model) -> Model:
        """Return tanh(a) = 1 - 2/(e^(2 a) + 1)."""
        one = self.constant(np.ones_like(a[1]))
        share = self.inverse(self.sum(self.exponential((2.0 * a[0], 2.0 * a[1])), one))
        return self._or_range(self.sum(one, (2.0 * share[0], 2.0 * share[1]), -1.0), np.tanh, a, -np.inf)

    def angle(self, y: Model, x: Model) -> Model:
        """Return atan2(y, x) away from the negative x axis.

        Turned back by an approximation b, (x, y) has the components x cos b + y sin b ahead and y cos b - x sin b
        aside. Where the first is positive, the angle is off b by at most the second over the first: by whole turns
        nowhere, as it is not at the nodes and goes on continuously.
        """
        (low_x, _), (low_y, high_y) = self.span(x), self.span(y)
        b = self._tried(np.arctan2(self.values(y[0]), self.values(x[0])))
        s, c = self.sine_and_cosine(b)
        low, _ = self.span(self.sum(self.product(x, c), self.product(y, s)))
        aside = magnitude(self.sum(self.product(y, c), self.product(x, s), -1.0))
        good = ((low_x > 0.0) | (low_y > 0.0) | (high_y < 0.0)) & (low > 0.0)
        return b[0], np.where(good, aside / np.where(good, low, 1.0) * UP, np.inf)

    # Boxes ----------------------------------------------------------------------------------------------------------

    @cached_property
    def halves(self) -> list[tuple[Array, Array]]:
        """Matrices to the coefficients on the lower and the upper half of the box, by each variable."""
        return [self._half(k) for k in range(len(self.degrees))]

    def _half(self, k: int) -> tuple[Array, Array]:
        both = []
        for shift in (-0.5, 0.5):
            points = self.nodes.copy()
            points[:, k] = points[:, k] / 2.0 + shift
            both.append(self.interpolation @ self.rows(points))
        return both[0], both[1]

    def halved(self, a: Model, k: int) -> tuple[Model, Model]:
        """Return models on both halves of their boxes by variable k: rounding is some units of all coefficients."""
        noise = 8 * (len(a[0]) + 8) * UNIT * norm(a[0])
        first, second = (_applied(matrix, a[0]) for matrix in self.halves[k])
        return (first, a[1] + noise), (second, a[1] + noise)


@made_once
def arithmetic(degrees: tuple[int, ...]) -> Arithmetic:
    """Return the operations for degrees in time and parameters, with their matrices."""
    return Arithmetic(degrees)


def _points(count: int) -> Array:
    return np.asarray(np.cos((2 * np.arange(count) + 1) * np.pi / (2 * count))) if count > 1 else np.zeros(1)


def _grid(each: list[Array]) -> Array:
    return np.stack([axis.ravel() for axis in np.meshgrid(*each, indexing="ij")], axis=1)


def _applied(matrix: Array, c: Array) -> Array:
    """Return a matrix applied to the first axis."""
    return np.asarray((matrix @ c.reshape(len(c), prod(c.shape[1:]))).reshape(len(matrix), *c.shape[1:]))


def _stacked(a: Model) -> Array:
    """Return coefficients with the radii below them."""
    return np.concatenate([a[0], a[1][None]])


def bounded(radius: Array) -> Array:
    """Return radii with infinity in the place of what is not a number."""
    return np.asarray(np.where(np.isnan(radius), np.inf, radius))
