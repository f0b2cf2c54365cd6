"""Chebyshev models: a polynomial with a bound of its distance from a function, and operations that keep the bound true.

A model stands for all functions f on the box [-1, 1]^d with |f - p| <= r: p is a sum of products of Chebyshev
polynomials (their coefficients are stored), r the radius. The first variable is time on an interval, the others are
parameters. A model of degree 0 is a ball, and the operations are then ball arithmetic.

Sums and products bound their rounding errors beforehand. Everything else is interpolated in plain floating point, and
its distance from the function bounded afterwards, from an equation that the function satisfies: so no rounding of the
interpolation matters (Brisebarre & Joldes, *Chebyshev interpolation polynomial-based tools for rigorous computing*,
ISSAC 2010; Tucker, *Validated Numerics*, 2011, chapter 3). NumPy's sin, cos, arctan2, exp and log are trusted to 4 ulp.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce
from math import prod

import numpy as np
import numpy.typing as npt
from numpy.polynomial import chebyshev

from servocore.certificate.products import convolved
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once

UNIT = 2.3e-16
"""Twice the unit roundoff of double precision: room for the rounding of the bounds themselves."""

_UP = 1.0 + 1e-14  # a radius is computed in some ten operations with non-negative terms
_TINY = 1e-290  # underflow
_ULPS = 8.0 * UNIT  # relative error of an elementary function of NumPy, with its argument's own rounding

Model = tuple[Array, Array]
"""Coefficients (terms, count, boxes) and radii (count, boxes): `count` functions on each of a number of boxes."""


def norm(c: Array) -> Array:
    """Return the sum of the magnitudes of the coefficients: |T_k| <= 1, so no value is larger."""
    return np.asarray(np.abs(c).sum(axis=0))


def magnitude(a: Model) -> Array:
    """Return upper bounds of the magnitudes of models, shape (count, boxes)."""
    return np.asarray((norm(a[0]) + a[1]) * _UP)


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
    def _samples(self) -> tuple[Array, float]:
        """The matrix to values at 4 d + 1 Chebyshev points in each variable, and what their largest is to be times.

        A polynomial of degree d is at most 1/cos(d pi/(2 m)) times its largest magnitude at m Chebyshev points
        (Ehlich & Zeller, Math. Z. 86 (1964) 41); in several variables the factors multiply.
        """
        counts = [4 * d + 1 for d in self.degrees]
        factor = prod(1.0 / np.cos(d * np.pi / (2 * m)) for d, m in zip(self.degrees, counts, strict=True))
        return self.rows(_grid([_points(m) for m in counts])), factor * _UP

    def _slopes(self, k: int) -> Array:
        """Return the matrix from the coefficients of a polynomial to those of its derivative by variable k."""
        d = self.degrees[k]
        own = np.vstack([chebyshev.chebder(np.eye(d + 1)), np.zeros((1, d + 1))]) if d else np.zeros((1, 1))
        return reduce(np.kron, [own if j == k else np.eye(e + 1) for j, e in enumerate(self.degrees)])

    @cached_property
    def derivatives(self) -> list[Array]:
        """Matrices of the derivative by each variable that a polynomial depends on; entries are whole numbers."""
        return [self._slopes(k) for k, d in enumerate(self.degrees) if d]

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
        """Return lower and upper bounds of models, shape (count, boxes) each.

        About the constant coefficient, by the lesser of two bounds of the rest: the sum of its coefficients, and the
        samples. A sample is a sum of `terms` products, each off by some ulps of its coefficient.
        """
        c, r = a
        matrix, factor = self._samples
        rest = norm(c[1:])
        sampled = _applied(matrix[:, 1:], c[1:])
        noise = (len(c) + 8) * UNIT * rest
        above, below = ((np.maximum(sign * sampled, 0.0).max(axis=0)) for sign in (1.0, -1.0))
        # The rule is one of magnitudes: it is applied to the polynomial less the middle of its samples.
        half, middle = (above + below) / 2.0, (above - below) / 2.0
        width = (factor * half + noise + r) * _UP + UNIT * np.abs(middle)
        low, high = c[0] + middle - width, c[0] + middle + width
        least = (rest + r) * _UP
        slack = 2.0 * UNIT * (np.abs(low) + np.abs(high))
        return np.maximum(low, c[0] - least) - slack, np.minimum(high, c[0] + least) + slack

    # Sums and products ----------------------------------------------------------------------------------------------

    def sum(self, a: Model, b: Model, sign: float = 1.0) -> Model:
        """Return a + b, or a - b for `sign` -1: every coefficient is rounded once, by a unit of what results."""
        c = a[0] + sign * b[0]
        return c, (a[1] + b[1] + UNIT * norm(c)) * _UP

    def scaled(self, a: Model, b: Model) -> Model:
        """Return a times balls `b`, models of degree 0: every coefficient is rounded once."""
        c, factor = a[0] * b[0], np.abs(b[0][0])
        return c, (factor * a[1] + b[1] * (norm(a[0]) + a[1]) + UNIT * norm(c)) * _UP + _TINY * (norm(c) > 0)

    def product(self, a: Model, b: Model) -> Model:
        """Return a times b.

        T_i T_j = (T_(i+j) + T_|i-j|)/2. A coefficient of the product is a sum of at most N = prod(2 d + 1) products of
        two coefficients, added up in any order: all of them together are off by at most (N + 2) units of
        |a|_1 |b|_1 (Higham, *Accuracy and Stability*, section 3.1). Terms beyond the degree go into the radius,
        and so does (p + e)(q + f) - p q with |e|, |f| the radii.
        """
        full = convolved(self.degrees, a[0], b[0])
        size_a, size_b = norm(a[0]), norm(b[0])
        kept, beyond = self._within
        rounding = (prod(2 * d + 1 for d in self.degrees) + 2) * UNIT / 2.0
        crossed = size_a * b[1] + size_b * a[1] + a[1] * b[1]
        r = (norm(full[beyond]) + rounding * size_a * size_b + crossed) * _UP
        return full[kept], r + _TINY * (r > 0)

    @cached_property
    def _within(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Places, among the coefficients of a product, of those within the degree, and of those beyond."""
        orders = np.indices([2 * d + 1 for d in self.degrees]).reshape(len(self.degrees), -1)
        within = (orders <= np.array(self.degrees)[:, None]).all(axis=0)
        return np.flatnonzero(within), np.flatnonzero(~within)

    # Interpolated and bounded afterwards ----------------------------------------------------------------------------

    def quotient(self, a: Model, b: Model) -> Model:
        """Return a/b for b without a zero: |a/b - q| = |a - q b|/|b|."""
        low, high = self.span(b)
        least = np.maximum(low, -high)
        good = least > 0.0
        with np.errstate(all="ignore"):
            q = _finite(self.interpolated(self.values(a[0]) / self.values(b[0])))
            rest = self.sum(a, self.product((q, np.zeros_like(b[1])), b), -1.0)
            return q, np.where(good, magnitude(rest) / least * _UP, np.inf)

    def root(self, a: Model) -> Model:
        """Return the square root of a: |sqrt(a) - s| = |a - s^2|/(sqrt(a) + s) where a is positive.

        Where it may come to zero, from 0 to the root of its upper bound, for values with which the root is defined.
        """
        low, high = self.span(a)
        with np.errstate(all="ignore"):
            s = _finite(self.interpolated(np.sqrt(self.values(a[0]))))
            exact = s, np.zeros_like(a[1])
            rest = self.sum(a, self.product(exact, exact), -1.0)
            least = np.sqrt(low) * (1 - UNIT) + np.maximum(self.span(exact)[0], 0.0)
            half = np.sqrt(np.maximum(high, 0.0)) / 2.0
        around = self.constant(half)[0]
        good = low > 0.0
        wide = np.where(high >= 0.0, half * (1.0 + 1e-14), np.inf)
        return np.where(good, s, around), np.where(good, magnitude(rest) / np.where(good, least, 1.0) * _UP, wide)

    def _along(self, *coefficients: Array, defect: Callable[..., Model]) -> Array:
        """Return the sum over the variables of bounds of a defect, a model of polynomials and their derivatives.

        On the straight line from the middle of the box to a point, a quantity with these rates changes by at most
        that. A derivative is a sum of products with whole numbers, `terms` at most: its rounding is its radius.
        """
        total = np.zeros(coefficients[0].shape[1:])
        for matrix in self.derivatives:
            slopes = []
            for c in coefficients:
                d = _applied(matrix, c)
                slopes.append((d, (len(c) + 2) * UNIT * _applied(np.abs(matrix).sum(axis=0)[None], np.abs(c))[0]))
            total = total + magnitude(defect(*slopes))
        return total

    def _middle(self, c: Array) -> tuple[Array, Array]:
        """Return values in the middle of the box and bounds of their rounding errors."""
        row = self.rows(np.zeros((1, len(self.degrees))))
        return _applied(row, c)[0], (len(c) + 8) * UNIT * norm(c)

    def sine_and_cosine(self, a: Model) -> tuple[Model, Model]:
        """Return sin(a) and cos(a).

        z = c + i s is e^(i p) but for its defect z' - i p' z: d/dt (z e^(-i p)) = (z' - i p' z) e^(-i p), of the same
        magnitude. Sine and cosine then change by at most the radius of a.
        """
        p, r = a
        argument = self.values(p)
        s, c = self.interpolated(np.sin(argument)), self.interpolated(np.cos(argument))
        zero = np.zeros_like(r)

        def defect(slope: Model, of_s: Model, of_c: Model) -> Model:
            first = self.sum(of_s, self.product(slope, (c, zero)), -1.0)
            second = self.sum(of_c, self.product(slope, (s, zero)))
            return np.concatenate([first[0], second[0]]), first[1] + second[1]

        at, e = self._middle(p)
        (s0, e_s), (c0, e_c) = self._middle(s), self._middle(c)
        begin = np.abs(np.sin(at) - s0) + np.abs(np.cos(at) - c0) + e + e_s + e_c + 2 * _ULPS
        radius = (r + begin + self._along(p, s, c, defect=defect)) * _UP
        return (s, radius), (c, radius.copy())

    def exponential(self, a: Model) -> Model:
        """Return e^a: with y' - p' y the defect, |e^p - y| <= e^p (|1 - y e^(-p)| in the middle + |defect| e^(-p))."""
        p, r = a
        low, high = self.span((p, np.zeros_like(r)))
        with np.errstate(all="ignore"):
            y = _finite(self.interpolated(np.exp(self.values(p))))

            def defect(slope: Model, of_y: Model) -> Model:
                return self.sum(of_y, self.product(slope, (y, np.zeros_like(r))), -1.0)

            (at, e), (y0, e_y) = self._middle(p), self._middle(y)
            begin = np.exp(high - at) * (np.abs(np.exp(at) - y0) + e_y + (2 * e + _ULPS) * np.exp(at) * np.exp(e))
            distance = begin + np.exp(high - low) * self._along(p, y, defect=defect)
            radius = (distance + np.exp(high) * np.expm1(r) * np.exp(r)) * (1.0 + 4 * _ULPS)
        return y, _bounded(radius)

    def logarithm(self, a: Model) -> Model:
        """Return log(a) for positive a: (y - log p)' = (y' p - p')/p."""
        p, r = a
        low, _ = self.span((p, np.zeros_like(r)))
        with np.errstate(all="ignore"):
            y = _finite(self.interpolated(np.log(self.values(p))))

            def defect(slope: Model, of_y: Model) -> Model:
                return self.sum(self.product(of_y, (p, np.zeros_like(r))), slope, -1.0)

            (at, e), (y0, e_y) = self._middle(p), self._middle(y)
            begin = np.abs(np.log(at) - y0) + e_y + e / low + _ULPS * (1.0 + np.abs(np.log(at)))
            radius = (begin + (self._along(p, y, defect=defect) + r) / (low - r)) * _UP
        return y, np.where(low - r > 0.0, _bounded(radius), np.inf)

    def angle(self, y: Model, x: Model) -> Model:
        """Return atan2(y, x) away from the negative x axis.

        (a - atan2(y, x))' = (a' (x^2 + y^2) - (x y' - y x'))/(x^2 + y^2).
        A displacement of (x, y) by its radii turns the angle by at most their sum over the least distance.
        """
        zero = np.zeros_like(x[1])
        (low_x, high_x), (low_y, high_y) = self.span(x), self.span(y)
        least = np.maximum(np.maximum(low_x, -high_x), np.maximum(low_y, -high_y))
        good = (low_x > 0.0) | (low_y > 0.0) | (high_y < 0.0)
        p, q = (x[0], zero), (y[0], zero)
        with np.errstate(all="ignore"):
            a = _finite(self.interpolated(np.arctan2(self.values(y[0]), self.values(x[0]))))
            square = self.sum(self.product(p, p), self.product(q, q))

            def defect(of_a: Model, of_x: Model, of_y: Model) -> Model:
                turned = self.sum(self.product(p, of_y), self.product(q, of_x), -1.0)
                return self.sum(self.product(of_a, square), turned, -1.0)

            (x0, e_x), (y0, e_y), (a0, e_a) = self._middle(x[0]), self._middle(y[0]), self._middle(a)
            begin = np.abs(np.arctan2(y0, x0) - a0) + e_a + 2 * (e_x + e_y) / least + 4 * _ULPS
            along = self._along(a, x[0], y[0], defect=defect) / least**2
            radius = (begin + along + (x[1] + y[1]) / least) * _UP
        return a, np.where(good, _bounded(radius), np.inf)

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


def _finite(c: Array) -> Array:
    """Return coefficients with zero in the place of what is not finite: any polynomial may be tried."""
    return np.asarray(np.where(np.isfinite(c).all(axis=0), c, 0.0))


def _bounded(radius: Array) -> Array:
    return np.asarray(np.where(np.isnan(radius), np.inf, radius))
