"""Jets: a function of time together with its first derivatives, computed with as one number.

Jet (truncated Taylor) arithmetic differentiates a formula exactly, to any order and without differences: the
formula is written once, for the value, and run on jets. theory.md section 4 differentiates the crane's closed
form this way. The recurrences are those of Griewank and Walther, *Evaluating Derivatives*, 2nd ed. (2008),
section 13.2.

>>> t = Jet.from_derivatives([3.0, 1.0, 0.0])  # the time itself, at t = 3
>>> (1 / t).derivatives()  # 1/t, -1/t^2, 2/t^3
array([ 0.33333333, -0.11111111,  0.07407407])
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from math import factorial
from operator import mul
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Iterable

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Jet:
    """Truncated Taylor series of a function of time, at one instant or at many.

    The result of an operation on two jets has the lower of their orders. Numbers and arrays count as
    constant in time. Where a function is not smooth (division by zero, root of zero, angle at the origin)
    NumPy's floating-point rules hold: infinities, nan and a RuntimeWarning.

    Attributes
    ----------
    coefficients : ndarray, shape (order+1, *shape)
        Normalized Taylor coefficients f^(k)/k!.
    """

    coefficients: FloatArray

    __array_ufunc__ = None  # so that `array * jet` is left to `Jet.__rmul__`

    @classmethod
    def from_derivatives(cls, derivatives: npt.ArrayLike) -> Jet:
        """Jet of the plain derivatives f, f', ..., shape (order+1, *shape)."""
        values = np.asarray(derivatives)
        return cls(values / _factorials(values))

    @classmethod
    def constant(cls, value: npt.ArrayLike, order: int) -> Jet:
        """Jet of something that does not change in time, shape of `value`."""
        first = np.asarray(value)
        return cls(np.concatenate([first[None], np.zeros((order, *first.shape))]))

    @property
    def order(self) -> int:
        """Highest derivative known."""
        return len(self.coefficients) - 1

    @property
    def value(self) -> FloatArray:
        """The function itself, shape (*shape)."""
        return np.asarray(self.coefficients[0])

    def derivatives(self) -> FloatArray:
        """Plain derivatives f, f', ..., f^(order), shape (order+1, *shape)."""
        return np.asarray(self.coefficients * _factorials(self.coefficients))

    def d(self) -> Jet:
        """Differentiate by time; the order drops by one.

        Raises
        ------
        ValueError
            If the jet has order 0, whose derivative is unknown.
        """
        if self.order == 0:
            raise ValueError("the derivative of a jet of order 0 is unknown: start with one order more")
        return Jet(np.stack([k * coefficient for k, coefficient in enumerate(self.coefficients[1:], 1)]))

    def __neg__(self) -> Jet:
        return Jet(-self.coefficients)

    def __add__(self, other: Jet | npt.ArrayLike) -> Jet:
        jet = other if isinstance(other, Jet) else Jet.constant(other, self.order)
        return Jet(np.stack([a + b for a, b in zip(self.coefficients, jet.coefficients, strict=False)]))

    __radd__ = __add__

    def __sub__(self, other: Jet | npt.ArrayLike) -> Jet:
        return self + (-other if isinstance(other, Jet) else np.negative(other))

    def __rsub__(self, other: Jet | npt.ArrayLike) -> Jet:
        return -self + other

    def __mul__(self, other: Jet | npt.ArrayLike) -> Jet:
        a, b = _factors(self, other)
        return Jet(np.stack([_sum_of_products(b, a[k::-1]) for k in range(len(a))]))

    __rmul__ = __mul__

    def __truediv__(self, other: Jet | npt.ArrayLike) -> Jet:
        a, b = _factors(self, other)
        c: list[FloatArray] = []
        for each in a:
            c.append((each - _sum_of_products(b[1:], c[::-1])) / b[0])
        return Jet(np.stack(c))

    def __rtruediv__(self, other: npt.ArrayLike) -> Jet:
        return Jet.constant(other, self.order) / self

    def __pow__(self, exponent: int) -> Jet:
        """Integer power of at least 1, by repeated products."""
        if not (isinstance(exponent, int) and exponent >= 1):
            raise ValueError(f"a jet can be raised to whole powers of 1 or more, not {exponent!r}")
        return reduce(mul, [self] * exponent)


def components(derivatives: npt.ArrayLike) -> tuple[Jet, ...]:
    """Split what `Reference.jet` returned into one jet a component.

    Parameters
    ----------
    derivatives : array_like, shape (..., order+1, dimension)
        Plain derivatives.

    Returns
    -------
    tuple of Jet, length dimension
        Each with coefficients of shape (order+1, ...).
    """
    values = np.asarray(derivatives)
    return tuple(Jet.from_derivatives(np.moveaxis(values[..., i], -1, 0)) for i in range(values.shape[-1]))


def sqrt(x: Jet) -> Jet:
    """Positive square root c: from c^2 = x follows 2 c_0 c_k = x_k - sum_(0<i<k) c_i c_(k-i)."""
    c = [np.sqrt(x.value)]
    for coefficient in x.coefficients[1:]:
        c.append((coefficient - _sum_of_products(c[1:], c[:0:-1])) / (2.0 * c[0]))
    return Jet(np.stack(c))


def atan2(y: Jet, x: Jet) -> Jet:
    """Angle of the point (x, y) in (-pi, pi] rad: angle' = (x y' - y x')/(x^2 + y^2).

    The value jumps by 2 pi across the negative x axis from one instant to another; derivatives do not.
    """
    angle = np.arctan2(y.value, x.value)
    if min(x.order, y.order) == 0:
        return Jet(angle[None])
    rate = (x * y.d() - y * x.d()) / (x * x + y * y)
    return Jet(np.stack([angle, *(coefficient / k for k, coefficient in enumerate(rate.coefficients, 1))]))


def _factors(a: Jet, b: Jet | npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Coefficients of both, up to the lower of their orders; of what is no jet the only one."""
    if not isinstance(b, Jet):
        return a.coefficients, np.asarray(b)[None]
    count = min(a.order, b.order) + 1
    return a.coefficients[:count], b.coefficients[:count]


def _sum_of_products(a: Iterable[FloatArray], b: Iterable[FloatArray]) -> FloatArray:
    """Sum of the products of pairs, as many as there are; zero if there are none."""
    return sum((x * y for x, y in zip(a, b, strict=False)), np.zeros(()))


def _factorials(values: FloatArray) -> FloatArray:
    """0!, 1!, ... along the first axis, ready to broadcast against `values`."""
    row = np.array([float(factorial(k)) for k in range(len(values))])
    return row.reshape(-1, *(1,) * (values.ndim - 1))
