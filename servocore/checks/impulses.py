"""Where a motion jumps although its path does not: the inputs would have to strike between two instants.

A spring with two stiffnesses, a rail with a corner or a stop make the inputs of a flat system hold impulses: they are
derivatives of a force that has a kink. The equations hold at every instant that is asked for, and nothing shows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from servocore.errors import IntegrationFailed
from servocore.model.system import MechanicalSystem
from servocore.numerics.angle_wrapping import wrapped_angle
from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference
from servocore.structure.derivative_array import DerivativeArray

States = Callable[[Array], Array]
"""Times (N,) -> all unknowns of the derivative array (size, N), NaN where they are not found."""

LESS_THAN_HALF = 0.4531
"""Of an interval: in the middle of symmetric paths singular instants are to be expected."""

_MOST = 2000  # intervals at first; of more instants some are left out
_LEAST = 1e-4  # of the range of a quantity: a jump that is smaller is no more than other errors
_HALVINGS = 60
_RESOLVED = 1e-12  # of the time: what changes over less jumps
_ASIDE = 1e-8  # of the duration: instants beside a jump, where round-off would show
_STEADY = 0.2  # of a jump: by how much values beside it may differ
_FIELDS = "mass", "potential", "force", "gyroscopic", "constraints", "output", "input_matrix"
_SWITCHES = {
    getattr(ca, f"OP_{name}")
    for name in (
        "LT", "LE", "EQ", "NE", "NOT", "AND", "OR", "IF_ELSE_ZERO", "FLOOR", "CEIL", "FABS", "SIGN", "FMIN", "FMAX",
        "FMOD", "COPYSIGN", "CALL",
    )
}  # fmt: skip


class Modelled(Protocol):
    """Whatever has a system, as `servocore.problem.ResolvedSystem` has."""

    @property
    def system(self) -> MechanicalSystem:
        """The system."""


class Posed(Modelled, Protocol):
    """A system with its derivative array and a path, as `servocore.problem.Problem` has them."""

    @property
    def array(self) -> DerivativeArray:
        """The derivative array."""

    @property
    def reference(self) -> Reference:
        """The path."""


@dataclass(frozen=True)
class Jump:
    """A jump of a coordinate, or of its velocity.

    Attributes
    ----------
    what : str
        "the velocity of x".
    unit : str
        Of the values.
    time : float
        In s.
    before, after : float
        Values on both sides of it.
    """

    what: str
    unit: str
    time: float
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"at t = {self.time:.9g} s {self.what} would have to jump from {self.before:.4g} to {self.after:.4g}"
            f" {self.unit}, and the inputs to strike: the model has a kink or a jump there (fabs, sign, fmin, fmax,"
            " if_else); a smooth form of it does, such as sqrt(x^2 + e^2) for |x|"
        )


def has_switches(resolved: Modelled) -> bool:
    """Whether the equations of a system hold operations with a kink or a jump; what has none, has no impulses."""
    system = resolved.system
    expressions = [getattr(system, name) for name in _FIELDS]
    symbols = ca.symvar(ca.vertcat(*(ca.vec(expression) for expression in expressions)))
    function = ca.Function("sc_switches", [ca.vertcat(ca.SX(0, 1), *symbols)], expressions)
    return any(function.instruction_id(k) in _SWITCHES for k in range(function.n_instructions()))


def first_jump(problem: Posed, t: Array, states: States) -> Jump | None:
    """Find the first jump of a motion; None where there is none.

    Parameters
    ----------
    problem : Posed
        What was solved.
    t : ndarray, shape (N,)
        Instants in rising order, between which it is looked for.
    states : callable
        The motion at any times between them.
    """
    if len(t) < 2:
        return None
    every = -(-(len(t) - 1) // _MOST)
    motion, instants = _Motion.of(problem, states), np.append(t[:-1:every], t[-1])
    jumps = (motion.jump(time, part) for time, part in _steepest(motion, instants))
    return next((jump for jump in jumps if jump), None)


def require_no_strikes(problem: Posed, t: Array, states: States) -> None:
    """Raise `IntegrationFailed` if a motion jumps between some instants; see `first_jump`."""
    jump = first_jump(problem, t, states)
    if jump:
        raise IntegrationFailed(f"{problem.system.name}: {jump}")


@dataclass(frozen=True, eq=False)
class _Motion:
    """Coordinates and velocities, one below the other, with their rates; zero for accelerations that are not known."""

    problem: Posed
    states: States
    places: Array
    rates: Array
    wraps: Array

    @classmethod
    def of(cls, problem: Posed, states: States) -> _Motion:
        """Find the places in the derivative array."""
        array, quantities = problem.array, problem.system.coordinates.quantities
        places = [array.places((k, order) for k in range(len(quantities))) for order in (0, 1)]
        known = {unknown: k for k, unknown in enumerate(array.unknowns)}
        second = [known.get((k, 2), -1) for k in range(len(quantities))]
        wraps = [quantity.wraps for quantity in quantities] + [False] * len(quantities)
        return cls(
            problem, states, np.concatenate(places), np.array([*places[1], *second], dtype=np.intp), np.array(wraps)
        )

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return values and rates at some times, shape (2 n, N) each."""
        states = self.states(t)
        rates = states[self.rates]
        rates[self.rates < 0] = 0.0
        return states[self.places], rates

    def moved(self, first: Array, last: Array) -> Array:
        """Return how far values go from one instant to another."""
        way = last - first
        way[self.wraps] = wrapped_angle(way[self.wraps])
        return way

    def jump(self, interval: tuple[float, float], part: int) -> Jump | None:
        """Return the jump in an interval that cannot be halved any more, None if values beside it are not steady."""
        (left, right), path = interval, self.problem.reference
        aside = _ASIDE * path.duration * np.arange(1.0, 5.0)
        sides = [self.at(np.clip(t, path.start_time, path.end_time))[0] for t in (left - aside, right + aside)]
        before, after = (side[part] for side in sides)
        way = float(self.moved(sides[0], sides[1])[part].mean())
        if not max(np.ptp(before), np.ptp(after)) < _STEADY * abs(way):
            return None
        n = len(self.problem.system.coordinates)
        quantity = self.problem.system.coordinates.quantities[part % n]
        what, unit = (f"the velocity of {quantity.name}", f"{quantity.unit}/s") if part >= n else (
            quantity.name, quantity.unit)  # fmt: skip
        return Jump(what, unit, left, float(before[0]), float(after[0]))


def _steepest(motion: _Motion, t: Array) -> Iterator[tuple[tuple[float, float], int]]:
    """Yield intervals too short to be halved over which values change by more than their rates say, in rising order.

    With each comes the row that changes most, a velocity before a coordinate.
    """
    values, rates = motion.at(t)
    known = np.isfinite(values).all(axis=0) & np.isfinite(rates).all(axis=0)  # not where the equations are singular
    if known.sum() < 2:
        return
    t, values, rates = t[known], values[:, known], rates[:, known]
    size = np.ptp(values, axis=1)
    least = np.where(size > 0.0, _LEAST * size, np.inf)[:, None]
    left, right = (t[:-1], values[:, :-1], rates[:, :-1]), (t[1:], values[:, 1:], rates[:, 1:])
    for _ in range(_HALVINGS):
        missed = np.abs(motion.moved(left[1], right[1]) - (right[0] - left[0]) / 2.0 * (left[2] + right[2])) / least
        worst = np.nan_to_num(missed).max(axis=0)
        kept = np.argsort(-worst, kind="stable")[: min(_MOST, int((worst > 1.0).sum()))]
        if not len(kept):
            return
        left, right = ((side[0][kept], side[1][:, kept], side[2][:, kept]) for side in (left, right))
        if (right[0] - left[0]).max() <= _RESOLVED * max(np.ptp(t), float(np.abs(t).max())):
            break
        middle = left[0] + LESS_THAN_HALF * (right[0] - left[0])
        halves = (middle, *motion.at(middle))
        left, right = (
            (np.concatenate([a[0], b[0]]), np.hstack([a[1], b[1]]), np.hstack([a[2], b[2]]))
            for a, b in ((left, halves), (halves, right))
        )
    for k in np.argsort(left[0], kind="stable"):
        way = np.abs(motion.moved(left[1][:, [k]], right[1][:, [k]]))[:, 0] / least[:, 0]
        yield (float(left[0][k]), float(right[0][k])), int(way.argmax())
