"""Time laws s(t) that rise from 0 to 1: how far along its line a rest-to-rest path has come.

Near the end of a motion 1 - s is tiny, and a polynomial summed in powers of T = t/duration leaves noise of
1e-12 there, which inputs of a high index amplify by 1/h^2 or more. So every formula here takes *both* the time
elapsed and the time remaining, and is written in products and sums of positive terms of the two.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import comb, factorial, isfinite

import numpy as np
from numpy.polynomial.polynomial import polyadd, polyder, polymul, polymulx

from servocore.errors import InvalidReference, require_kind, require_real
from servocore.references.base import FloatArray, Values, either, least, most, powers, where

DEFAULT_RAMP = 0.25
"""Part of the duration that `three_phase` accelerates when no ramp is given."""

_BESIDE = np.array([-1, 0, 1], dtype=object)  # v^2 - 1


@dataclass(frozen=True)
class Profile(ABC):
    """A time law from s = 0 to s = 1 with s(t) + s(duration - t) = 1.

    Attributes
    ----------
    name : str
        Its name on command lines and in charts.
    """

    name: str

    @property
    @abstractmethod
    def smoothness(self) -> int:
        """The k of C^k, with rest before and after: the highest derivative that starts and ends at zero."""

    @property
    def highest_power(self) -> int | None:
        """Degree of the polynomials that the law is made of; None if it is made of none."""
        return None

    @property
    def shortest_duration(self) -> float:
        """Time in s that the law needs at least; 0 for one that stretches to any duration."""
        return 0.0

    def junctions(self, duration: float) -> tuple[float, ...]:  # noqa: ARG002 - one piece has none
        """Return the times since the start, in s, where analytic pieces meet.

        Parameters
        ----------
        duration : float
            Of the motion, in s.

        Returns
        -------
        tuple of float
            In rising order; empty for one piece.
        """
        return ()

    def jet(self, elapsed: FloatArray, remaining: FloatArray, duration: float, order: int) -> FloatArray:
        """Evaluate s, s', ..., s^(order), derivatives by time.

        Parameters
        ----------
        elapsed, remaining : ndarray, shape (N,)
            Times since the start and until the end in s, in [0, duration]; each exact where it is small.
        duration : float
            Their sum, in s.
        order : int
            Highest derivative.

        Returns
        -------
        ndarray, shape (N, order+1)
            s^(k) in 1/s^k.
        """
        return np.stack(self.law(elapsed, remaining, self.numbers(duration, order), order), axis=1)

    @abstractmethod
    def numbers(self, duration: Values, order: int) -> list[Values]:
        """Return the coefficients that `law` takes, of the duration: the same number for any.

        Parameters
        ----------
        duration : float or casadi.SX
            Of the motion, in s.
        order : int
            Highest derivative that `law` will give.

        Returns
        -------
        list
            As many for each duration.
        """

    @abstractmethod
    def law(self, elapsed: Values, remaining: Values, numbers: Sequence[Values], order: int) -> list[Values]:
        """Evaluate as `jet` says, with arrays or with expressions of CasADi: the same operations in the same order.

        Parameters
        ----------
        elapsed, remaining : ndarray or casadi.SX
            Times since the start and until the end, in s.
        numbers : sequence
            From `numbers`.
        order : int
            Highest derivative.

        Returns
        -------
        list
            s, s', ..., s^(order), each of the shape of `elapsed`.
        """


@dataclass(frozen=True)
class PolynomialProfile(Profile):
    """The polynomial of degree 2k+1 with k vanishing derivatives at both ends.

    With T = elapsed/duration and R = 1 - T it is the regularized incomplete beta function I_T(k+1, k+1):

        s  = T^(k+1) sum_i binom(k+i, i) R^i        (all terms positive)
        s' = c (T R)^k,   c = (2k+1)!/(k!)^2

    and with w = T R, v = R - T the higher derivatives are s^(j+1) = c w^(k-j) G_j(v), where
    G_0 = 1, G_(j+1) = (k-j) v G_j - (1 - v^2)/2 G_j'.

    Attributes
    ----------
    degree : int
        2k+1, odd and at least 1.

    Raises
    ------
    InvalidReference
        If the degree is even or less than 1.
    """

    degree: int
    _weights: tuple[float, ...] = field(init=False, repr=False, compare=False)
    _slopes: tuple[tuple[float, ...], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_kind(self.degree, int, "the degree of a polynomial", "a whole number", InvalidReference)
        if self.degree < 1 or self.degree % 2 == 0:
            raise InvalidReference(f"a rest-to-rest polynomial has an odd degree of 1 or more, not {self.degree}")
        k = self.smoothness
        object.__setattr__(self, "_weights", tuple(float(comb(k + i, i)) for i in range(k + 1)))
        object.__setattr__(self, "_slopes", _slope_factors(k))

    @property
    def smoothness(self) -> int:
        """The k of degree 2k+1."""
        return (self.degree - 1) // 2

    @property
    def highest_power(self) -> int:
        """The degree."""
        return self.degree

    @property
    def coefficients(self) -> tuple[int, ...]:
        """Integer coefficients of T^0 ... T^degree, for formulas and for code generation.

        Do not sum them near T = 1: see the head of this module.
        """
        k = self.smoothness
        scale = factorial(2 * k + 1) // factorial(k) ** 2
        return (0,) * (k + 1) + tuple((-1) ** i * scale * comb(k, i) // (k + 1 + i) for i in range(k + 1))

    def numbers(self, duration: Values, order: int) -> list[Values]:
        """Return the powers of the duration."""
        return powers(duration, max(order, 1))

    def law(self, elapsed: Values, remaining: Values, numbers: Sequence[Values], order: int) -> list[Values]:
        """Evaluate as `Profile.law` says; `numbers` are those of `numbers`, of which the second is the duration."""
        k = self.smoothness
        T, R = elapsed / numbers[1], remaining / numbers[1]
        w, v = T * R, R - T
        small, large = least(T, R), most(T, R)
        near = powers(small, k + 1)[-1] * _horner(self._weights, large)
        s = [where(T <= R, near, 1.0 - near)]
        of_w = powers(w, k)
        for m, factor in enumerate(self._slopes[:order], 1):
            value = _horner(factor, v)
            s.append((of_w[k + 1 - m] * value if m <= k else value) / numbers[m])
        return s + [0.0 * T] * (order + 1 - len(s))


@dataclass(frozen=True)
class ThreePhaseProfile(Profile):
    """Accelerate for `ramp` seconds, cruise, decelerate for `ramp` seconds (theory.md, section 3).

    With x = t/ramp the speed in the first phase is that of the degree-7 polynomial S_7(x):

        s' = S_7(x)/(duration - ramp),
        s  = ramp x^5 (7 - 14 x + 10 x^2 - 5/2 x^3)/(duration - ramp)
           = ramp x^5 (1 + 3 y + 5 y^2 + 5 y^3)/(2 (duration - ramp)),   y = 1 - x,

    then s = (t - ramp/2)/(duration - ramp), then the first phase mirrored. Hence C^4.

    Attributes
    ----------
    ramp : float or None
        Length of the first and of the last phase in s; None means a quarter of the duration.

    Raises
    ------
    InvalidReference
        If the ramp is not a positive number.
    """

    ramp: float | None = None

    def __post_init__(self) -> None:
        if self.ramp is not None:
            require_real(self.ramp, "the ramp of a three-phase profile", "a time in s", InvalidReference)
        if self.ramp is not None and not (isfinite(self.ramp) and self.ramp > 0.0):
            raise InvalidReference(f"the ramp of a three-phase profile must be a positive time, not {self.ramp} s")

    @property
    def smoothness(self) -> int:
        """Four: s' has the three vanishing derivatives of the degree-7 polynomial."""
        return 4

    @property
    def highest_power(self) -> int:
        """Eight: the speed has the degree-7 polynomial."""
        return 8

    @property
    def shortest_duration(self) -> float:
        """Two ramps, in s."""
        return 0.0 if self.ramp is None else 2.0 * self.ramp

    def junctions(self, duration: float) -> tuple[float, ...]:
        """Return the end of the first ramp and the begin of the last."""
        ramp = self._ramp(duration)
        return (ramp, duration - ramp)

    def _ramp(self, duration: float) -> float:
        return DEFAULT_RAMP * duration if self.ramp is None else self.ramp

    def numbers(self, duration: Values, order: int) -> list[Values]:
        """Return the time of the cruise at full speed that would take as long, and the powers of the ramp."""
        return self.numbers_with(self._ramp(duration), duration, order)

    @staticmethod
    def numbers_with(ramp: Values, duration: Values, order: int) -> list[Values]:
        """Return the same for a ramp that may be an expression, as the duration may be.

        Parameters
        ----------
        ramp, duration : float or casadi.SX
            In s.
        order : int
            Highest derivative that `law` will give.

        Returns
        -------
        list
            Coefficients of `law`.
        """
        return [duration - ramp, *powers(ramp, max(order, 1))]

    def law(self, elapsed: Values, remaining: Values, numbers: Sequence[Values], order: int) -> list[Values]:
        """Evaluate as `Profile.law` says."""
        cruise_time, ramp = numbers[0], numbers[2]
        near = least(elapsed, remaining)
        ramping = either(elapsed < ramp, remaining <= ramp)
        on = least(near, ramp)
        off = ramp - on
        x, y = on / ramp, off / ramp
        way = ramp * powers(x, 5)[-1] * (1.0 + y * (3.0 + y * (5.0 + y * 5.0))) / (2.0 * cruise_time)
        s = [where(ramping, way, (near - ramp / 2.0) / cruise_time)]
        if order:
            rising = DEGREE7.law(on, off, numbers[1:], order - 1)
            cruising = [1.0 / cruise_time] + [0.0] * (order - 1)
            s += [where(ramping, a / cruise_time, b) for a, b in zip(rising, cruising, strict=True)]
        late = elapsed > remaining  # s(t) = 1 - s(duration - t)
        mirrored = [1.0 - s[0], *(derivative if m % 2 else -derivative for m, derivative in enumerate(s[1:], 1))]
        return [where(late, a, b) for a, b in zip(mirrored, s, strict=True)]


def three_phase(ramp: float | None = None) -> ThreePhaseProfile:
    """Accelerate, cruise, decelerate.

    Parameters
    ----------
    ramp : float, optional
        Time to accelerate and time to decelerate in s, 0 < ramp <= duration/2; a quarter of the duration if
        not given.

    Returns
    -------
    ThreePhaseProfile
        To be handed to `rest_to_rest`.

    Raises
    ------
    InvalidReference
        If the ramp is not a positive number.
    """
    return ThreePhaseProfile("three-phase", ramp)


def polynomial(degree: int) -> PolynomialProfile:
    """Rest-to-rest polynomial of an odd degree 2k+1, C^k.

    Parameters
    ----------
    degree : int
        Odd, at least 1.

    Returns
    -------
    PolynomialProfile
        To be handed to `rest_to_rest`.

    Raises
    ------
    InvalidReference
        If the degree is even or less than 1.
    """
    return PolynomialProfile(f"degree-{degree}", degree)


def _horner(coefficients: tuple[float, ...], x: Values) -> Values:
    """Value of a polynomial, lowest coefficient first; arrays in place, for NumPy's own makes two a coefficient."""
    value = np.full_like(x, coefficients[-1]) if isinstance(x, np.ndarray) else coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value *= x
        value += coefficient
    return value


def _slope_factors(k: int) -> tuple[tuple[float, ...], ...]:
    """Coefficients in v of c G_0 ... c G_k, then of the derivatives of c G_k by T: the power of w is used up."""
    # 2^j c G_j has integer coefficients: exact, until each is divided and rounded once.
    factor, power = np.array([factorial(2 * k + 1) // factorial(k) ** 2], dtype=object), 1
    factors = []
    for j in range(2 * k + 1):
        factors.append(tuple(value / power for value in factor.tolist()))
        slope = polyder(factor)
        if j < k:  # 2 (k - j) v G + (v^2 - 1) G'
            factor = polyadd(2 * (k - j) * polymulx(factor), polymul(_BESIDE, slope))
            power *= 2
        else:
            factor = -2 * slope
    return tuple(factors)


DEGREE3 = polynomial(3)
"""C^1: inputs that contain its fourth derivative need impulses. Kept to show why it fails."""
DEGREE5 = polynomial(5)
"""C^2; kept to show why it fails."""
DEGREE7 = polynomial(7)
"""C^3: inputs that contain its fourth derivative jump at start and end. Kept to show why it fails."""
DEGREE9 = polynomial(9)
"""126 T^5 - 420 T^6 + 540 T^7 - 315 T^8 + 70 T^9, C^4: the default."""
DEGREE13 = polynomial(13)
"""1716 T^7 - 9009 T^8 + 20020 T^9 - 24024 T^10 + 16380 T^11 - 6006 T^12 + 924 T^13, C^6."""

TIME_LAWS: Mapping[str, Profile] = {"degree9": DEGREE9, "degree13": DEGREE13, "three-phase": three_phase()}
"""Time laws that commands, pages and FMUs offer, by name, the default first; smooth enough for inputs of a crane."""
