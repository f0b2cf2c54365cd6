"""The interface of reference paths gamma(t): exact derivatives at any times.

A reference is an immutable value. Paths of users are checked: their derivatives must be those of their positions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from math import factorial
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import (
    InvalidReference,
    InvalidSetting,
    ServocoreError,
    described,
    require_kind,
    require_positive,
    require_real,
)
from servocore.numerics.memoization import made_once

if TYPE_CHECKING:
    from servocore.references.likely_units import UndeclaredUnits

FloatArray = npt.NDArray[np.float64]

ANALYTIC_ORDER = 99
"""`Reference.max_order` of paths whose pieces are known in closed form: every order a solver could want."""


_INSTANTS = 9  # to estimate the extent of a path

_UNIT, _VALUES = 2.3e-16, 1.5e-14  # rounding errors: of a time, and of a derivative's values as a share of its peak
_PARTS = 16  # of an analytic piece, on each of which derivatives are bounded

LONGEST_TIME = 1e9
"""No path begins or ends farther from zero, in s: powers of a longer duration overflow."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference(ABC):
    """A path gamma(t) that the servo output shall follow, eq. (1): c(q, t) = Phi(q) - gamma(t) = 0.

    Attributes
    ----------
    start_time, end_time : float
        The path moves between these times (s). Outside, see each class.
    dimension : int
        Number of components of gamma.
    max_order : int
        Highest derivative that `jet` answers. Up to it, every derivative exists at all times but finitely
        many junctions (start, end, knots); there, an order above `smoothness` may jump, and the value just
        after the junction is given.
    smoothness : int
        The k of C^k over *all* time, before the start and after the end included.
    fit_error : float or None
        None for paths that are exact by definition; for fits, their own estimate of the largest deviation
        in position (m).
    undeclared : UndeclaredUnits or None
        Of a path from a file: units that its header does not declare, which a scene judges by its own size.
    """

    start_time: float
    end_time: float
    dimension: int
    max_order: int
    smoothness: int
    fit_error: float | None = None
    undeclared: UndeclaredUnits | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.start_time) and np.isfinite(self.end_time)):
            raise InvalidReference(f"path times must be finite, not {self.start_time} to {self.end_time} s")
        if not self.end_time > self.start_time:
            raise InvalidReference(
                f"the path must end after it starts, but it runs from {self.start_time} to {self.end_time} s"
            )
        if max(abs(self.start_time), abs(self.end_time)) > LONGEST_TIME:
            raise InvalidReference(
                f"path times must lie within {LONGEST_TIME:g} s of zero, not from {self.start_time:g} s"
                f" to {self.end_time:g} s"
            )

    @property
    def duration(self) -> float:
        """Time between start and end, in s."""
        return self.end_time - self.start_time

    @property
    def common(self) -> dict[str, Any]:
        """The common attributes by name, for paths that are made of this one."""
        return {each.name: getattr(self, each.name) for each in fields(Reference)}

    @property
    def stretches(self) -> FloatArray:
        """Times in s, start and end included, that divide the path into stretches: each analytic, with few turns."""
        return np.array([self.start_time, self.end_time])

    @property
    def joints(self) -> FloatArray:
        """Times in s, start and end included, between which the path is analytic."""
        return self.stretches

    @property
    def degree(self) -> int | None:
        """Degree of the polynomials between `joints`; None if the path is not made of polynomials.

        Bounds need all their derivatives: there are none if `max_order` is less.
        """
        return None

    @property
    def formula(self) -> Formula | None:
        """The path as an expression of time; None if it is none, but a table."""
        return None

    @cached_property  # every run reads it
    def extent(self) -> FloatArray:
        """Range of each component over some instants, in m for a path in m."""
        t = np.linspace(self.start_time, self.end_time, _INSTANTS)
        return np.asarray(np.ptp(self.jet(t, 0)[:, 0], axis=0))

    def jet(self, t: npt.ArrayLike, order: int) -> FloatArray:
        """Path and plain derivatives gamma, gamma', ..., gamma^(order) at the times `t`.

        Parameters
        ----------
        t : array_like, shape (N,) or ()
            Times in s, anywhere: also before the start and after the end.
        order : int
            Highest derivative wanted.

        Returns
        -------
        ndarray, shape (N, order+1, dimension) or (order+1, dimension)
            Entry k of the middle axis is the k-th derivative, in m/s^k for a path in m.

        Raises
        ------
        InvalidReference
            If the path has no derivative of that order, or a time is not finite.
        """
        times = numbers_of(t, "the times of a path")
        if times.ndim > 1:
            raise InvalidReference(f"times must be one number or one row of numbers, not shape {times.shape}")
        require_kind(order, (int, np.integer), "the order of a derivative", "a whole number", InvalidReference)
        if not 0 <= order <= self.max_order:
            raise InvalidReference(
                f"derivatives of order {order} are not available: this path has orders 0 to {self.max_order}"
            )
        bad = np.flatnonzero(~np.isfinite(times))
        if bad.size:
            raise InvalidReference(f"time number {bad[0]} is {times.flat[bad[0]]}, not a finite number")
        values = self._derivatives(np.atleast_1d(times), order)
        return values if times.ndim else values[0]

    def enclosure(self, a: FloatArray, b: FloatArray, order: int, degree: int = 10) -> tuple[FloatArray, FloatArray]:
        """Enclose the path and its derivatives on intervals by polynomials: interpolated at Chebyshev points.

        Parameters
        ----------
        a, b : ndarray, shape (N,)
            Begin and end of intervals in s; none has one of the `joints` inside.
        order : int
            Highest derivative wanted.
        degree : int
            Of the polynomials.

        Returns
        -------
        coefficients : ndarray, shape (N, order + 1, dimension, degree + 1)
            Of Chebyshev polynomials in time, scaled to [-1, 1] on the interval.
        radii : ndarray, shape (N, order + 1, dimension)
            Largest distance of a derivative from its polynomial; infinite where nothing bounds it.
        """
        nodes, inverse = _interpolation(degree)
        middle, half = (a + b) / 2.0, (b - a) / 2.0
        t = middle[:, None] + half[:, None] * nodes
        values = self.jet(t.ravel(), order).reshape(*t.shape, order + 1, self.dimension)
        bounds = self._bounds(a, b, order + degree + 1)
        # Chebyshev interpolation: |f - p| <= h^(n+1) sup|f^(n+1)| / (2^n (n+1)!).
        share = (half ** (degree + 1) / (2.0**degree * factorial(degree + 1)))[:, None, None]
        late = 4.0 * _UNIT * np.maximum(np.abs(a), np.abs(b))[:, None, None]
        # Values are rounded as shares of what is largest on the analytic piece around an interval, of any component:
        # where one of a fitted path rests, its derivatives are nothing but rounding errors, and jump at knots.
        piece = np.clip(np.searchsorted(self.joints, middle) - 1, 0, len(self.joints) - 2)
        radii = share * bounds[:, degree + 1 :] + late * bounds[:, 1 : order + 2] + _VALUES * _peaks(self, order)[piece]
        return np.tensordot(values, inverse, (1, 1)), 1.001 * radii

    def _bounds(self, a: FloatArray, b: FloatArray, order: int) -> FloatArray:
        """Bound derivatives of polynomials on intervals by Taylor's formula, shape (N, order + 1, dimension)."""
        if (degree := self.degree) is None or degree > self.max_order:
            return np.full((len(a), order + 1, self.dimension), np.inf)
        jets, (up, shares) = np.abs(self.jet((a + b) / 2.0, degree)), _taylor(degree, order)
        powers = ((b - a) / 2.0)[:, None] ** np.arange(degree + 1)
        return np.asarray(1.001 * (shares * powers[:, up]) @ jets)

    @abstractmethod
    def _derivatives(self, t: FloatArray, order: int) -> FloatArray:
        """Answer `jet` for checked arguments: times (N,) to derivatives (N, order+1, dimension)."""


@made_once
def _interpolation(degree: int) -> tuple[FloatArray, FloatArray]:
    """Return Chebyshev points and the matrix from values there to coefficients."""
    nodes = np.polynomial.chebyshev.chebpts1(degree + 1)
    return nodes, np.asarray(np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, degree)))


@made_once
def _taylor(degree: int, order: int) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return powers of the step and factors of the derivatives in Taylor's sums, both (order + 1, degree + 1)."""
    up = np.arange(degree + 1) - np.arange(order + 1)[:, None]
    return np.maximum(up, 0), np.array([[1.0 / factorial(n) if n >= 0 else 0.0 for n in row] for row in up.tolist()])


@made_once
def _peaks(path: Reference, order: int) -> FloatArray:
    """Bound the derivatives of a path on each of its analytic pieces, shape (pieces, order + 1, 1)."""
    fractions = np.linspace(0.0, 1.0, _PARTS + 1)
    grid = path.joints[:-1, None] + np.diff(path.joints)[:, None] * fractions
    bounds = path._bounds(grid[:, :-1].ravel(), grid[:, 1:].ravel(), order)
    return np.asarray(bounds.reshape(len(grid), _PARTS, order + 1, path.dimension).max(axis=(1, 3)))[..., None]


def numbers_of(values: npt.ArrayLike, what: str, error: type[ServocoreError] = InvalidReference) -> FloatArray:
    """Return an array of numbers, or raise `error` if something else is among them."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise error(f"{what} must be numbers in s, not {described(values)}") from None


def points(values: npt.ArrayLike | Sequence[Sequence[float]], what: str) -> FloatArray:
    """Check a table of positions, one point a row.

    Parameters
    ----------
    values : array_like, shape (n, dimension)
        Positions in m.
    what : str
        Name of one row in the error sentence, such as "waypoint".

    Returns
    -------
    ndarray, shape (n, dimension)
        A copy in double precision.

    Raises
    ------
    InvalidReference
        If the table is not rectangular, empty or not finite.
    """
    try:
        table = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidReference(f"each {what} must hold the same number of finite numbers: {error}") from None
    if table.ndim != 2 or not table.size:
        raise InvalidReference(f"a table with one {what} a row is needed, not an array of shape {table.shape}")
    bad = np.argwhere(~np.isfinite(table))
    if bad.size:
        row, column = bad[0]
        raise InvalidReference(f"{what} {row}, component {column} is {table[row, column]}, not a finite number")
    return table


def positive_time(value: float, what: str) -> float:
    """Return a time (s) called `what`, or raise `InvalidReference` unless it is positive and finite."""
    require_real(value, f"the {what} of a path", "a time in s", InvalidReference)
    if not (np.isfinite(value) and value > 0.0):
        raise InvalidReference(f"the {what} of a path must be a positive time, not {value} s")
    return float(value)


def times_of(rising: Callable[[FloatArray], FloatArray], values: FloatArray, begin: float, end: float) -> FloatArray:
    """Return the times at which a function that rises from begin to end has values (n,), by bisection."""
    early, late = np.full(len(values), begin), np.full(len(values), end)
    for _ in range(_HALVINGS):
        middle = (early + late) / 2.0
        short = rising(middle) < values
        early, late = np.where(short, middle, early), np.where(short, late, middle)
    return late


_HALVINGS = 60
_FEWEST, _MOST = 400, 20_000
_DEFAULT_STEPS = 200
_MOST_STEPS = 10**8
_EACH = 16  # on a stretch of the path


def survey(reference: Reference) -> FloatArray:
    """Return instants evenly on every stretch of the path, in all not too few and not too many."""
    ends = reference.stretches
    pieces = len(ends) - 1
    each = max(_EACH, -(-_FEWEST // pieces))
    each = max(1, min(each, _MOST // pieces))
    fractions = np.arange(each) / each
    return np.append((ends[:-1, None] + np.diff(ends)[:, None] * fractions).ravel(), ends[-1])


def subdivided(t: FloatArray, parts: int) -> FloatArray:
    """Return instants with every interval divided into so many parts."""
    return np.interp(np.arange((len(t) - 1) * parts + 1) / parts, np.arange(len(t)), t)


def time_grid(reference: Reference, step: float | None) -> FloatArray:
    """Return the instants from start to end, a whole number of equal steps.

    Raises
    ------
    InvalidSetting
        If the step is not positive, exceeds the duration or does not divide it.
    """
    duration = reference.duration
    if step is None:
        step = duration / _DEFAULT_STEPS
    require_positive(step, "the step", "a time in s")
    if step > duration * (1 + 1e-9):
        raise InvalidSetting(f"the step of {step:g} s is larger than the duration of {duration:g} s")
    count = round(duration / step)
    if count > _MOST_STEPS:
        raise InvalidSetting(
            f"the step of {step:g} s divides the duration of {duration:g} s into {count:.2g} steps, more than"
            f" {_MOST_STEPS:.0e}"
        )
    if abs(count * step - duration) > 1e-6 * step:
        below, above = duration / np.ceil(duration / step), duration / max(1, np.floor(duration / step))
        raise InvalidSetting(
            f"the step of {step:g} s does not divide the duration of {duration:g} s;"
            f" the nearest that do are {below:.10g} s and {above:.10g} s"
        )
    # k * step rather than a running sum; the last instant is the end of the path to the last bit.
    t: FloatArray = reference.start_time + np.arange(count + 1, dtype=np.float64) * (duration / count)
    t[-1] = reference.end_time
    return t


Values = Any
"""Numbers, an array of one number an instant, or an expression."""


@dataclass(frozen=True)
class Formula:
    """A path as an expression of time; formulas of one kind are equal.

    Attributes
    ----------
    kind : hashable
        Paths of one kind have the same expression.
    numbers : callable
        order -> the numbers of the path that the expression takes, up to some derivative.
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
