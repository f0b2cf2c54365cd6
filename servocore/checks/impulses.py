"""Where a motion jumps although its path does not: the inputs would have to strike between two instants.

A spring with two stiffnesses, a rail with a corner or a stop make the inputs of a flat system hold impulses: they are
derivatives of a force that has a kink. The equations hold at every reported instant, which hides it. Where
an output has a step, no motion may follow the path for a while; a step of a potential or a mass is an impulse itself.

Between two switches that lie close together (`sign` changes, `floor` steps, a branch of `if_else` ends) a model may
differ from its mode at all reported instants: those on both sides of every switch are added.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import IntegrationFailed
from servocore.model.quantity import Quantity
from servocore.numerics.angle_wrapping import wrapped_angle
from servocore.numerics.compiled_calls import Array, at_instants
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import JUMPS, KINKS, holds_any, switching_levels
from servocore.problem import Problem, ResolvedSystem

States = Callable[[Array], Array]
"""Times (N,) -> all unknowns of the derivative array (size, N), NaN where they are not found."""

LESS_THAN_HALF = 0.4531
"""Of an interval: in the middle of symmetric paths singular instants are to be expected."""

_ELSEWHERE = 0.25, 0.75, 0.05, 0.95, 0.01, 0.99  # of an interval: where a motion is looked for if it has none there
_MOST = 2000  # intervals at first; of more instants some are left out
_LEAST = 1e-4  # of the range of a quantity: a jump that is smaller is no more than other errors
_ROUND_OFF = 1e-12  # of a quantity: a range that is smaller is none
_HALVINGS = 60
_RESOLVED = 1e-12  # of the time: a change over less is a jump
_ASIDE = 1e-8  # of the duration: instants beside a jump, where round-off would show
_STEADY = 0.2  # of a jump: by how much values beside it may differ
_KINDS = "the model has a kink or a jump there (fabs, sign, floor, fmod, fmin, fmax, if_else)"
_FIELDS = "mass", "potential", "force", "gyroscopic", "constraints", "output", "input_matrix"


@dataclass(frozen=True)
class Jump:
    """A jump of a coordinate, of its velocity, of a mass or of the potential; or times without any motion.

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
    until : float
        In s; later than `time` where there is no motion in between.
    strikes : bool
        Whether it is of a mass or of the potential, which need no input to jump.
    """

    what: str
    unit: str
    time: float
    before: float
    after: float
    until: float = 0.0
    strikes: bool = False

    def __str__(self) -> str:
        smooth = f"{_KINDS}; a smooth form of it does, such as sqrt(x^2 + e^2) for |x|"
        if self.until > self.time:
            return (
                f"from t = {self.time:.9g} s to {self.until:.9g} s no motion is found that follows the path, with"
                f" {self.what} at {self.before:.6g} {self.unit} before and at {self.after:.6g} {self.unit} after:"
                f" {smooth}"
            )
        jumps = "jumps" if self.strikes else "would have to jump"
        and_inputs = "which is an impulse" if self.strikes else "and the inputs to strike"
        values = f"{self.before:.4g} to {self.after:.4g} {self.unit}".rstrip()
        return f"at t = {self.time:.9g} s {self.what} {jumps} from {values}, {and_inputs}: {smooth}"


@made_once
def has_kinks_or_jumps(resolved: ResolvedSystem) -> bool:
    """Whether the equations of a system hold operations with a kink or a jump; without any there are no impulses."""
    return any(holds_any(getattr(resolved.system, name), KINKS) for name in _FIELDS)


@made_once
def has_jumps(resolved: ResolvedSystem) -> bool:
    """Whether the equations of a system hold operations that jump."""
    return any(holds_any(getattr(resolved.system, name), JUMPS) for name in _FIELDS)


def first_jump(problem: Problem, t: Array, states: States) -> Jump | None:
    """Find the first jump of a motion; None where there is none.

    Parameters
    ----------
    problem : Problem
        The problem that was solved.
    t : ndarray, shape (N,)
        Instants in rising order, between which it is looked for.
    states : callable
        The motion at any times between them.
    """
    if len(t) < 2:
        return None
    every = -(-(len(t) - 1) // _MOST)
    motion, instants = _Motion.of(problem, states), np.append(t[:-1:every], t[-1])
    if (arguments := motion.arguments()) is not None:
        instants = with_switching_instants(instants, arguments)
    jumps = (motion.jump(interval, row, gap) for interval, row, gap in _steepest(motion, instants))
    return next((jump for jump in jumps if jump), None)


def require_no_jumps(problem: Problem, t: Array, states: States) -> None:
    """Raise `IntegrationFailed` if a motion jumps between some instants; see `first_jump`."""
    jump = first_jump(problem, t, states)
    if jump:
        raise IntegrationFailed(f"{problem.system.name}: {jump}")


@made_once
def _switching_arguments(resolved: ResolvedSystem) -> ca.Function | None:
    """Compile (q, v, path with the time, p) -> arguments of switches, shape (k,); see `switching_levels`."""
    system = resolved.system
    levels = switching_levels(ca.vertcat(*(ca.vec(ca.densify(getattr(system, name))) for name in _FIELDS)))
    given = [system.q, system.v, system.gamma[:, 0], system.p]
    levels = [each for each in levels if not ca.Function("sc_probe", given, [each], {"allow_free": True}).get_free()]
    return ca.Function("sc_switching", given, [ca.densify(ca.vertcat(*levels))]) if levels else None


class SteppedQuantities(NamedTuple):
    """(q, v, path with the time, p) -> quantities of the motion that must not jump, and their rates without jumps."""

    function: ca.Function
    quantities: tuple[Quantity, ...]


@made_once
def stepped_quantities(resolved: ResolvedSystem) -> SteppedQuantities | None:
    """Compile entries of the mass and the potential that hold jumps, None if there is none."""
    system = resolved.system
    found: list[tuple[Quantity, ca.SX]] = []
    names = system.coordinates.names
    for i, j in zip(*system.mass.sparsity().get_triplet(), strict=True):
        if i >= j and holds_any(system.mass[i, j], JUMPS):
            of = f"of {names[i]}" if i == j else f"between {names[j]} and {names[i]}"
            found.append((Quantity(f"the mass {of}", ""), system.mass[i, j]))
    if holds_any(system.potential, JUMPS):
        found.append((Quantity("the potential", "J"), system.potential))
    if not found:
        return None
    values, gamma = ca.vertcat(*(each for _, each in found)), system.gamma[:, :2]
    rates = ca.jtimes(values, system.q, system.v) + ca.jtimes(values, gamma[:, 0], gamma[:, 1])
    results = [ca.densify(values), ca.densify(rates)]
    return SteppedQuantities(
        ca.Function("sc_stepped", [system.q, system.v, gamma, system.p], results), tuple(each for each, _ in found)
    )


@dataclass(frozen=True, eq=False)
class _Motion:
    """Coordinates and velocities, one below the other, and quantities whose steps are impulses; with their rates.

    Accelerations that are not known count as zero.
    """

    problem: Problem
    states: States
    places: npt.NDArray[np.intp]
    rates: npt.NDArray[np.intp]
    wraps: npt.NDArray[np.bool_]
    quantities: tuple[Quantity, ...]
    stepped: SteppedQuantities | None

    @classmethod
    def of(cls, problem: Problem, states: States) -> _Motion:
        """Find the places in the derivative array."""
        array, quantities = problem.array, problem.system.coordinates.quantities
        places = [array.places((k, order) for k in range(len(quantities))) for order in (0, 1)]
        known = {unknown: k for k, unknown in enumerate(array.unknowns)}
        second = [known.get((k, 2), -1) for k in range(len(quantities))]
        stepped = stepped_quantities(problem.resolved)
        velocities = [Quantity(f"the velocity of {each.name}", f"{each.unit}/s") for each in quantities]
        watched = (*quantities, *velocities, *(stepped.quantities if stepped else ()))
        wraps = np.array([k < len(quantities) and quantities[k].wraps for k in range(len(watched))])
        rates = np.array([*places[1], *second], dtype=np.intp)
        return cls(problem, states, np.concatenate(places).astype(np.intp), rates, wraps, watched, stepped)

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return values and rates at some times, shape (rows, N) each."""
        states = self.states(t)
        values, rates = states[self.places], states[self.rates]
        rates[self.rates < 0] = 0.0
        if self.stepped is None:
            return values, rates
        others = self._stepped_at(self.stepped, values, t)
        return np.vstack([values, others[0]]), np.vstack([rates, others[1]])

    def arguments(self) -> Callable[[Array], Array] | None:
        """Return the state of the switches as a function of times; None if there are none."""
        function = _switching_arguments(self.problem.resolved)
        if function is None:
            return None
        n = len(self.problem.system.coordinates)

        def at(t: Array) -> Array:
            known, jets = self.states(t)[self.places], self.problem.reference.jet(t, 0)
            return at_instants(function, known[:n], known[n:], jets=jets, p=self.problem.p)[0]

        return at

    def _stepped_at(self, stepped: SteppedQuantities, values: Array, t: Array) -> tuple[Array, ...]:
        n, jets = len(self.problem.system.coordinates), self.problem.reference.jet(t, 1)
        return at_instants(stepped.function, values[:n], values[n : 2 * n], jets=jets, p=self.problem.p)

    def moved(self, first: Array, last: Array) -> Array:
        """Return how far values go from one instant to another."""
        way = last - first
        way[self.wraps] = wrapped_angle(way[self.wraps])
        return way

    def jump(self, interval: tuple[float, float], row: int, gap: bool) -> Jump | None:
        """Return the jump in an interval that cannot be halved any more, None if values beside it are not steady.

        In a gap there is no motion.
        """
        (left, right), path, quantity = interval, self.problem.reference, self.quantities[row]
        strikes, stepped = row >= len(self.places), self.stepped
        if gap:
            n = len(self.problem.system.coordinates)
            quantity = self.quantities[row % n]
            (before, after), until = self.at(np.array([left, right]))[0][row % n], right
            return Jump(quantity.name, quantity.unit, left, float(before), float(after), until)
        aside = _ASIDE * path.duration * np.arange(1.0, 5.0)
        times = [np.clip(t, path.start_time, path.end_time) for t in (left - aside, right + aside)]
        sides = [self.at(t)[0] for t in times]
        before, after = (side[row] for side in sides)
        way = float(self.moved(sides[0], sides[1])[row].mean())
        if strikes and stepped:  # not what depends on time alone
            here = self._stepped_at(stepped, sides[1][: len(self.places)], times[0])[0][row - len(self.places)]
            way = float((here - before).mean())
        if not max(np.ptp(before), np.ptp(after)) < _STEADY * abs(way):
            return None
        return Jump(quantity.name, quantity.unit, left, float(before[0]), float(after[0]), strikes=strikes)


_Sides = tuple[Array, Array, Array]
"""Times (N,), values and rates (rows, N)."""


def _steepest(motion: _Motion, t: Array) -> Iterator[tuple[tuple[float, float], int, bool]]:
    """Yield intervals over which values change by more than their rates say, in rising order.

    They are too short to be halved, or nothing is known between their ends, as the last entry says. The entry between
    is the row that changes most.
    """
    values, rates = motion.at(t)
    known = _known(values, rates)  # not where the equations are singular
    if known.sum() < 2:
        return
    t, values, rates = t[known], values[:, known], rates[:, known]
    size = np.ptp(values, axis=1)
    least = np.where(size > _ROUND_OFF * np.abs(values).max(axis=1), _LEAST * size, np.inf)[:, None]
    left: _Sides = t[:-1], values[:, :-1], rates[:, :-1]
    right: _Sides = t[1:], values[:, 1:], rates[:, 1:]
    gaps: list[tuple[_Sides, _Sides]] = []
    for _ in range(_HALVINGS):
        missed = np.abs(motion.moved(left[1], right[1]) - (right[0] - left[0]) / 2.0 * (left[2] + right[2])) / least
        worst = np.nan_to_num(missed).max(axis=0)
        kept = np.argsort(-worst, kind="stable")[: min(_MOST, int((worst > 1.0).sum()))]
        left, right = _some(left, kept), _some(right, kept)
        if not len(kept) or (right[0] - left[0]).max() <= _RESOLVED * max(np.ptp(t), float(np.abs(t).max())):
            break
        middle = _between(motion, left[0], right[0])
        found = _known(middle[1], middle[2])
        if not found.all():
            gaps.append((_some(left, ~found), _some(right, ~found)))
            left, middle, right = (_some(each, found) for each in (left, middle, right))
        left, right = _joined(left, middle), _joined(middle, right)
    marked = [(left, right, False), *((*gap, True) for gap in gaps)]
    intervals = []
    for begin, end, gap in marked:
        way = np.abs(motion.moved(begin[1], end[1]) - gap * (end[0] - begin[0]) / 2.0 * (begin[2] + end[2])) / least
        rows = way.argmax(axis=0)
        intervals += [((float(a), float(b)), int(row), gap) for a, b, row in zip(begin[0], end[0], rows, strict=True)]
    yield from sorted(intervals)


def _known(values: Array, rates: Array) -> npt.NDArray[np.bool_]:
    known: npt.NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(np.vstack([values, rates])), axis=0)
    return known


def _some(side: _Sides, kept: npt.NDArray[np.intp] | npt.NDArray[np.bool_]) -> _Sides:
    return side[0][kept], side[1][:, kept], side[2][:, kept]


def _joined(first: _Sides, second: _Sides) -> _Sides:
    return np.concatenate([first[0], second[0]]), np.hstack([first[1], second[1]]), np.hstack([first[2], second[2]])


def _between(motion: _Motion, left: Array, right: Array) -> _Sides:
    """Return a time between others, about the middle where a motion is known there, with values and rates."""
    t = left + LESS_THAN_HALF * (right - left)
    values, rates = motion.at(t)
    for share in _ELSEWHERE:
        unknown = ~_known(values, rates)
        if not unknown.any():
            break
        t[unknown] = left[unknown] + share * (right - left)[unknown]
        values[:, unknown], rates[:, unknown] = motion.at(t[unknown])
    return t, values, rates


_MOST_SWITCHES = 500  # switches that are looked for: of a model that rattles, not all
_BISECTIONS = 40
_NARROWINGS = 12
_APEX = 0.1  # of an argument beside it: an extremum nearer to zero is examined


def with_switching_instants(t: Array, arguments: Callable[[Array], Array]) -> Array:
    """Return instants with those on both sides of every switch between them.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Instants in rising order.
    arguments : callable
        Times (N,) -> arguments (k, N), each of which switches where it passes a whole number; NaN where not known.
    """
    t, values = _with_extrema(t, arguments(t), arguments)
    which, interval = np.nonzero(_levels(values[:, 1:]) != _levels(values[:, :-1]))
    which, interval = which[:_MOST_SWITCHES], interval[:_MOST_SWITCHES]
    if not len(which):
        return t
    rows, before = np.arange(len(which)), _levels(values[which, interval])
    left, right = t[interval], t[interval + 1]
    for _ in range(_BISECTIONS):
        middle = (left + right) / 2.0
        same = _levels(arguments(middle)[which, rows]) == before
        left, right = np.where(same, middle, left), np.where(same, right, middle)
    return np.unique(np.concatenate([t, left, right]))


def _levels(arguments: Array) -> Array:
    """Return the steps that the arguments are on; NaN is on none."""
    levels: Array = np.nan_to_num(np.floor(arguments), nan=-np.inf)
    return levels


def _with_extrema(t: Array, values: Array, at: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Add instants at which an argument turns back close to where it would switch."""
    if len(t) < 3:
        return t, values
    steps = np.abs(np.diff(values, axis=1))
    reach = np.maximum(steps[:, :-1], steps[:, 1:])
    turning = np.diff(values[:, :-1], axis=1) * np.diff(values[:, 1:], axis=1) <= 0.0
    here = values[:, 1:-1]
    near = np.abs(here - np.round(here)) <= (1.0 + _APEX) * reach
    which, k = np.nonzero(turning & near & (reach > 0.0))
    which, k = which[:_MOST_SWITCHES], k[:_MOST_SWITCHES] + 1
    if not len(which):
        return t, values
    rows, side = np.arange(len(which)), np.sign(values[which, k] - values[which, k - 1])
    left, middle, right = t[k - 1], t[k], t[k + 1]
    best = side * values[which, k]
    for _ in range(_NARROWINGS):
        for other in ((left + middle) / 2.0, (middle + right) / 2.0):
            found = side * at(other)[which, rows]
            better, later = found > best, other > middle
            left = np.where(better & later, middle, np.where(~better & ~later, other, left))
            right = np.where(better & ~later, middle, np.where(~better & later, other, right))
            middle, best = np.where(better, other, middle), np.where(better, found, best)
    t = np.unique(np.concatenate([t, middle]))
    return t, at(t)
