"""One branch along a path: where the equations have several solutions, an instant is to continue its neighbour.

Newton's method from a guess converges to whichever solution is near. Whether the answers at two instants belong to one
motion is seen by their velocities and accelerations, and by the signs of the determinants of the system Jacobian's
diagonal blocks: a branch keeps them as long as it is regular. Where neighbours disagree, the branch is followed by
Taylor prediction and Newton's method, in steps that are halved until the answers agree or the interval has shrunk to
nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.checks.findings import ROUND_OFF
from servocore.errors import IntegrationFailed
from servocore.numerics.angle_wrapping import wrapped_angle
from servocore.numerics.compiled_calls import Array, Call, Mask, Places, call_of, side_by_side
from servocore.numerics.components import condition_number, singular_values
from servocore.numerics.constraint_ranks import unit_rows
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.exact_evaluation import along_path, guessed_unknowns
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import (
    block_determinants,
    determinants,
    diagonal_blocks,
    inversion,
    system_jacobian,
)

CONTINUOUS = (
    "one: every instant, solved from the guess of the model, continues its neighbours; `certify` proves the rest"
)
FOLLOWED = "one: followed from instant to instant; `certify` proves the rest"
CLOSED_FORM = "one: the closed form of the model at every instant, which turns too often between them to be followed"

_SLIGHT = 1e-3  # of the range of a coordinate: a miss that says nothing; of its nominal value: a range that may be none
_MOST_FOLLOWED = 4  # intervals where the model gives its motion in closed form: to follow hundreds takes seconds
_ON_IT = 1e-4  # of the determinants on both sides: an instant with less is singular itself
LOST = 1e-6
"""Of a determinant at instants beside: one with less is singular, and what lies behind another branch."""

DISAGREEMENT = 0.05
"""Of a movement, or of the range of a derivative: neighbours whose rates explain it but for less belong together."""

_LESS = 0.1  # of the least singular value at the instants beside: with less, constraints lose rank

MANY = 500
"""Intervals that are compared, of more some are left out, though of no instant the determinants; and steps from one
instant to the next, which shrink without end near a singularity."""

LESS_THAN_HALF = 0.4531
"""Of an interval: in the middle of symmetric paths singular instants are to be expected."""


@dataclass(frozen=True)
class Passage:
    """A singularity between two instants that a motion passes.

    Attributes
    ----------
    before, after, time : float
        The instants, and the time itself, in s.
    constraints : str
        The constraints that lose rank there; empty if none do.
    """

    before: float
    after: float
    time: float
    constraints: str

    def __str__(self) -> str:
        if self.constraints:
            return f"at t = {self.time:.6g} s {self.constraints} lose rank and two motions go on from there"
        return f"between t = {self.before:.6g} s and {self.after:.6g} s the equations are singular"


@made_once
def _powers(array: DerivativeArray) -> list[tuple[Places, Places]]:
    """Return for every power of time the places of unknowns, and those of the derivatives that are coefficients."""
    place, powers = {unknown: k for k, unknown in enumerate(array.unknowns)}, []
    for power in range(max(order for _, order in array.unknowns) + 1):
        known = [(k, place[j, i + power]) for (j, i), k in place.items() if (j, i + power) in place]
        powers.append((np.array([to for to, _ in known], dtype=np.intp), np.array([of for _, of in known], np.intp)))
    return powers


def ahead(array: DerivativeArray, states: Array, h: Array) -> Array:
    """Return unknowns (size, N) by their Taylor polynomials `h` later."""
    total = np.zeros_like(states)
    for power, (to, of) in enumerate(_powers(array)):
        total[to] += states[of] * (h**power / math.factorial(power))
    return total


@dataclass(frozen=True, eq=False)
class Rows:
    """Unknowns that are watched, the places of their rates (-1 where unknown), and which of them wrap.

    Each belongs to a coordinate at a place of its own, which rests if its range is less than `still`.
    """

    values: Places
    rates: Places
    wraps: Mask
    coordinates: Places
    still: Array

    @classmethod
    def of(cls, array: DerivativeArray, watched: Sequence[tuple[int, int]]) -> Rows:
        """Return the rows of derivatives (coordinate, order) of an array."""
        place, system = {unknown: k for k, unknown in enumerate(array.unknowns)}, array.system.coordinates
        at = [(place[j, k], place.get((j, k + 1), -1), place[j, 0]) for j, k in watched]
        values, rates, coordinates = np.array(at, dtype=np.intp).reshape(-1, 3).T
        wraps = np.array([system.quantities[j].wraps and k == 0 for j, k in watched], dtype=bool)
        still = ROUND_OFF * np.array(system.nominal)[[j for j, _ in watched]]
        return cls(values, rates, wraps, coordinates, still)

    def ranges(self, states: Array) -> Array:
        """Return the ranges of the values of unknowns (size, N), infinite where a coordinate rests."""
        if not states.size:
            return np.full(len(self.values), np.inf)
        moves = np.ptp(states[self.coordinates], axis=1) > self.still
        return np.where(moves, np.ptp(states[self.values], axis=1), np.inf)

    def missed(self, first: Array, last: Array, h: Array) -> Array:
        """Return how much more values change from `first` to `last` (size, N), `h` later, than their mean rates say."""
        way, rates = last[self.values] - first[self.values], first[self.rates] + last[self.rates]
        rates[self.rates < 0] = 0.0
        rates *= h / 2.0
        way -= rates
        if self.wraps.any():
            way[self.wraps] = wrapped_angle(way[self.wraps])
        return np.asarray(np.abs(way, out=way))


@made_once
def coordinate_rows(array: DerivativeArray) -> Rows:
    """Return the coordinates of an array."""
    return Rows.of(array, [(j, 0) for j in range(len(array.system.coordinates))])


@made_once
def _motion_rows(array: DerivativeArray) -> tuple[Places, Rows]:
    """Return the coordinates whose accelerations are known; and all coordinates with the velocities of these."""
    every = range(len(array.system.coordinates))
    known = [j for j in every if (j, 2) in array.unknowns]
    return np.array(known, dtype=np.intp), Rows.of(array, [*((j, 0) for j in every), *((j, 1) for j in known)])


@dataclass(frozen=True, eq=False)
class Branch:
    """Continuation of one branch of a problem along its path.

    `rows` are the coordinates, `scale` (n,) their ranges.
    """

    problem: Problem
    rows: Rows
    scale: Array

    @classmethod
    def of(cls, problem: Problem, states: Array) -> Branch:
        """Prepare to follow; `states` (size, N) are answers along the path, not all of which need be right."""
        rows, still = coordinate_rows(problem.array), np.array(problem.system.coordinates.nominal)
        known = states[rows.values]
        ranges = np.fmax.reduce(known, axis=1) - np.fmin.reduce(known, axis=1)
        return cls(problem, rows, np.fmax(ranges, _SLIGHT * still))

    def apart(self, first: Array, last: Array, h: Array, slight: float = _SLIGHT) -> Mask:
        """Whether neighbours (size, N), `h` apart, belong to two motions; misses of `slight` of a range are none."""
        rows, (known, watched) = self.rows, _motion_rows(self.problem.array)
        missed = watched.missed(first, last, h)
        missed, velocities = missed[: len(self.scale)], missed[len(self.scale) :]
        # A velocity that changes over in the middle of an interval leaves the mean rate.
        missed[known] += np.abs(h) / 2.0 * velocities
        allowed = slight * self.scale[:, None]
        within = (missed <= allowed).all(axis=0)
        if not within.all():
            lengths = np.abs(h) * (np.abs(first[rows.rates]) + np.abs(last[rows.rates]))
            lengths += np.where(rows.wraps[:, None], 0.0, np.abs(last[rows.values] - first[rows.values]))
            within = (missed <= np.maximum(DISAGREEMENT * lengths, allowed)).all(axis=0)
        return ~np.asarray(within)  # so that NaN counts

    def determinants(self, t: Array, states: Array) -> Array:
        """Return the determinants of the system Jacobian's diagonal blocks, shape (blocks, N)."""
        array = self.problem.array
        return block_determinants(array, *along_path(self.problem, determinants(array), t, states))

    def follow(self, state: Array, begin: float, end: float, across: bool = False) -> tuple[Array, float]:
        """Follow the branch of an answer at `begin`; return the last answer and its time, `end` if it goes so far.

        With `across` it may pass a singularity on which it is smooth.
        """
        own = None if across else self.determinants(np.array([begin]), state[:, None])
        waiting, trials = [end], 0
        while waiting and trials < MANY:
            trials += 1
            reached = self._continued(state, begin, waiting[-1], own)
            if reached is not None:
                state, begin = reached, waiting.pop()
                continue
            middle = begin + LESS_THAN_HALF * (waiting[-1] - begin)
            if not min(begin, waiting[-1]) < middle < max(begin, waiting[-1]):
                break
            waiting.append(middle)
        return state, begin

    def follow_to(self, state: Array, begin: float, end: float) -> tuple[Array, float]:
        """Return the answer at `end`, and the time of the first singularity that it passes, or `end`.

        Raises
        ------
        IntegrationFailed
            If the branch ends before.
        """
        reached, time = self.follow(state, begin, end)
        regular = time
        if time != end:
            reached, time = self.follow(state, begin, end, across=True)
        if time != end:
            raise IntegrationFailed(
                f"{self.problem.system.name}: the branch cannot be followed beyond t = {time:.9g} s: it ends there, or"
                " meets another"
            )
        return reached, regular

    def _continued(self, state: Array, begin: float, end: float, own: Array | None) -> Array | None:
        """Return the answer at `end`, None if it is not seen to be on the branch, with determinants like `own`."""
        problem, h, t = self.problem, np.array([end - begin]), np.array([end])
        guess = ahead(problem.array, state[:, None], h)[:, 0]
        jet = side_by_side(problem.reference.jet(t, problem.array.reference_order))
        found, _, residual = call_of(inversion(problem.array).search)(jet, problem.p, guess)
        good = bool(np.isfinite(found).all() and np.isfinite(residual).all())
        # With more room where branches meet, short steps would turn into the other one.
        slight = _SLIGHT if own is None else ROUND_OFF
        good = good and not self.apart(state[:, None], found[:, None], h, slight)[0]
        if good and own is not None:
            good = bool((self.determinants(t, found[:, None]) * np.sign(own) > LOST * np.abs(own)).all())
        return found if good else None


def on_one_branch(
    problem: Problem, t: Array, states: Array, known: Array | None = None
) -> tuple[Array, str, tuple[Passage, ...]]:
    """Return answers on the branch of the first, how that is known, and the singularities passed.

    `known` are the determinants of the answers that are given, where they are known.
    """
    branch = Branch.of(problem, some_of(states))
    kept = _with_a_beginning(branch, t, states)
    incomplete, far = kept is not states, _far(branch, t, some_of(kept))
    known = branch.determinants(t, kept) if known is None or incomplete else known
    changes, passages = _sign_changes(branch, t, kept, known)
    waiting, replaced = sorted({*far, *changes}, reverse=True), False
    if len(waiting) > _MOST_FOLLOWED and is_closed_form(problem, t, states):
        return states, CLOSED_FORM, ()
    while waiting:
        k = waiting.pop()
        begin, end = float(t[k]), float(t[k + 1])
        try:
            reached, time = branch.follow_to(kept[:, k], begin, end)
        except IntegrationFailed:
            if replaced or not is_closed_form(problem, t, states):
                raise
            return states, CLOSED_FORM, ()
        if time != end:
            passages.append(_passage(branch, kept[:, k], reached, begin, end, time))
        off = branch.rows.missed(reached[:, None], kept[:, k + 1, None], np.zeros(1))
        if (off[:, 0] <= _SLIGHT * branch.scale).all():
            continue
        kept = kept if replaced else kept.copy()
        kept[:, k + 1], replaced = reached, True
        if k + 2 < len(t) and (not waiting or waiting[-1] != k + 1):
            waiting.append(k + 1)
    return kept, FOLLOWED if replaced or incomplete else CONTINUOUS, tuple(passages)


def _with_a_beginning(branch: Branch, t: Array, states: Array) -> Array:
    """Return answers with those before the first that was found, followed backwards; a copy if any is missing."""
    found, name = np.isfinite(states[0]), branch.problem.system.name
    if found.all():
        return states
    if not found.any():
        raise IntegrationFailed(f"{name}: the equations were solved at no instant, from the guess of the model")
    kept = states.copy()
    for k in range(int(found.argmax()), 0, -1):
        kept[:, k - 1], time = branch.follow(kept[:, k], float(t[k]), float(t[k - 1]))
        if time != t[k - 1]:
            raise IntegrationFailed(f"{name}: no answer was found at t = {t[k - 1]:.6g} s, nor from the instants after")
    return kept


def some_of(values: Array) -> Array:
    """Return values (..., N) at the ends of `MANY` intervals at most, the first and the last among them."""
    every = -(-(values.shape[-1] - 1) // MANY)
    # Rows stay contiguous, which they do not where columns are chosen by an index.
    return values if every <= 1 else np.concatenate([values[..., :-1:every], values[..., -1:]], axis=-1)


def _far(branch: Branch, t: Array, some: Array) -> list[int]:
    """Return the intervals over which derivatives disagree, of very many instants those between `some_of` them."""
    last = len(t) - 1
    far, every = np.flatnonzero(branch.apart(some[:, :-1], some[:, 1:], np.diff(some_of(t)))), -(-last // MANY)
    return [k for first in (every * far).tolist() for k in range(first, min(first + every, last))]


def _constraints_of(problem: Problem, blocks: Places) -> str:
    """Name the constraints of the first of some diagonal blocks that holds nothing else; empty if there is none."""
    names, every = problem.signature.equations.equations, diagonal_blocks(problem.array)
    for k in blocks:
        kinds = {names[row].partition(" ")[0] for row in every[k].rows}
        if "holonomic" in kinds and kinds <= {"holonomic", "servo"}:
            together = "the holonomic and servo constraints together"
            return together if "servo" in kinds else "the holonomic constraints"
    return ""


def _passage(branch: Branch, first: Array, last: Array, begin: float, end: float, time: float) -> Passage:
    problem, ends = branch.problem, branch.determinants(np.array([begin, end]), np.stack([first, last], axis=1))
    moments = ((begin, first), (time, ahead(problem.array, first[:, None], np.array(time - begin))[:, 0]), (end, last))
    least = [_least_singular_value(problem, t, states[branch.rows.values]) for t, states in moments]
    # The forces of constraints are in a block of their own, which is singular with them.
    at_once = least[1] < _LESS * max(least[0], least[2])
    changed = np.flatnonzero(np.sign(ends[:, 0]) * np.sign(ends[:, 1]) < 0.0)
    return Passage(begin, end, time, _constraints_of(problem, changed) if at_once else "")


@made_once
def constraint_rows(resolved: ResolvedSystem) -> Call:
    """Compile (q, gamma, p) -> residual and Jacobian S = [G; C] of the holonomic and servo constraints."""
    system = resolved.system
    residual, S = ca.vertcat(system.constraints, system.output - system.path[:, 0]), ca.vertcat(system.G, system.C)
    results = [ca.densify(residual), ca.densify(S)]
    return Call(ca.Function("sc_S_rows", [system.q, system.gamma[:, 0], system.p], results))


def _least_singular_value(problem: Problem, t: float, q: Array) -> float:
    """Return the least singular value of the Jacobian of all constraints, with rows of unit length."""
    residual, S = constraint_rows(problem.resolved)(q, problem.reference.jet(t, 0)[0], problem.p)
    rows = S.reshape(len(residual), -1) * np.array(problem.system.coordinates.nominal)
    return float(singular_values(unit_rows(rows))[-1])


def _sign_changes(branch: Branch, t: Array, states: Array, known: Array) -> tuple[list[int], list[Passage]]:
    """Return intervals over which a determinant changes its sign, and ends of a motion at which it is that of none.

    Raises
    ------
    IntegrationFailed
        For an instant that is singular itself.
    """
    ends = zip(known.min(axis=1).tolist(), known.max(axis=1).tolist(), strict=True)
    # Of one sign and one size, they neither change it nor vanish.
    if all(low > _ON_IT * high > 0.0 or high < _ON_IT * low < 0.0 for low, high in ends):
        return [], []
    problem, passages, sizes = branch.problem, list[Passage](), np.abs(known)
    for k, time in ((0, float(t[0])), (-1, float(t[-1]))):
        lost = np.flatnonzero(sizes[:, k] < ROUND_OFF * np.fmax.reduce(sizes, axis=1))
        if constraints := _constraints_of(problem, lost):
            passages.append(Passage(time, time, time, constraints))
    small = sizes[:, 1:-1] < _ON_IT * np.minimum(sizes[:, :-2], sizes[:, 2:])
    if small.any():
        k = int(small.any(axis=0).argmax()) + 1
        jet = problem.reference.jet(float(t[k]), problem.array.reference_order)
        matrix = call_of(system_jacobian(problem.array))(states[:, k], jet.T, problem.p)[0]
        raise IntegrationFailed(
            f"{problem.system.name} is singular at t = {t[k]:.6g} s: the system Jacobian has condition"
            f" {condition_number(matrix):.2g}"
        )
    signs = np.sign(known)
    return np.flatnonzero((~(signs[:, :-1] * signs[:, 1:] > 0.0)).any(axis=0)).tolist(), passages


def is_closed_form(problem: Problem, t: Array, states: Array) -> bool:
    """Whether answers (size, N) are the guess of the model itself, all of one sign and none of them singular.

    A drum that unwinds kilometres of rope turns thousands of times between two instants: nothing follows that, and
    nothing has to where the model gives its motion in closed form. The signs of the determinants are the alarm for a
    guess that changes over to another branch.
    """
    branch = Branch.of(problem, states)
    off = np.abs(guessed_unknowns(problem, t)[branch.rows.values] - states[branch.rows.values])
    if not (off <= ROUND_OFF * np.maximum(np.abs(states[branch.rows.values]), branch.scale[:, None])).all():
        return False
    found = branch.determinants(t, states)
    return bool((found * np.sign(found[:, :1]) > 0.0).all())
