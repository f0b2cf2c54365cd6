"""One branch along a path: where the equations have several solutions, an instant is to continue its neighbour.

Newton's method from a guess converges to whichever solution is near. Whether the answers at two instants belong to
one motion follows from their derivatives, which the derivative array holds: the Taylor polynomial of each must lead to
the other. Where it does not, the interval is bisected, each new instant starting from where the one before was heading,
until the polynomials agree or the interval has shrunk to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from servocore.checks.impulses import LESS_THAN_HALF, States, has_kinks_or_jumps, require_no_jumps
from servocore.errors import IntegrationFailed
from servocore.numerics.angle_wrapping import wrapped_angle
from servocore.numerics.compiled_calls import Array, at_instants, call_of, side_by_side
from servocore.numerics.components import Part, balanced
from servocore.numerics.memoization import made_once
from servocore.numerics.vectorized import Vectorized
from servocore.problem import Problem, ResolvedSystem
from servocore.solvers.taylor import SLIGHT, Taylor
from servocore.stepping.exact_evaluation import exact_unknowns, guessed_unknowns, unknowns_from
from servocore.structure.inversion import (
    determinant_signs,
    inversion,
    is_regular_throughout,
    system_jacobian,
    system_jacobian_entries,
)

CONTINUOUS = "one: every instant, solved from the guess of the model, continues its neighbours"
FOLLOWED = "one: followed from instant to instant"
CLOSED_FORM = "one: the closed form of the model at every instant, which turns too often between them to be followed"

_STILL = 1e-6  # of the nominal value: a coordinate with a smaller range may be round-off altogether
_MOST_BISECTIONS = 45
_MANY = 500  # instants from which on machine code compares neighbours
_MOST_TRIALS = 3000  # between two instants: steps shrink without end near a singularity
_MOST_CONNECTED = 4  # intervals that are bisected where the model gives its motion in closed form
_SINGULAR_CONDITION = 1e12
_MUCH_WORSE = 1e6  # than beside it: Newton's method comes no nearer to a singular answer
_WORSE = 1e3  # than on both sides, at an instant that the branch does not go through
_EXACT = 1e-8  # of a coordinate and of its range: a guess this near is the model's own closed form
_SURVEYED = 400  # instants at least, to tell whether guesses keep to one branch
_LOOKED_AT = 17  # instants, for the sign of a determinant


@dataclass(frozen=True, eq=False)
class Branch:
    """Continuation of one branch of a flat problem along its path.

    Attributes
    ----------
    problem : Problem
        Without internal dynamics.
    taylor : Taylor
        Of its derivative array.
    scale : ndarray, shape (n,)
        Ranges of the coordinates.
    """

    problem: Problem
    taylor: Taylor
    scale: Array

    @classmethod
    def along(cls, problem: Problem, states: Array) -> Branch:
        """Prepare to follow; `states` (size, N) are answers along the path, not all of which need be right."""
        taylor = _taylor(problem.array)
        q = states[taylor.q]
        ranges = q.max(axis=1) - q.min(axis=1)
        if not np.isfinite(ranges).all():
            finite = np.isfinite(q)
            lowest, highest = np.where(finite, q, np.inf).min(axis=1), np.where(finite, q, -np.inf).max(axis=1)
            ranges = np.where(finite.any(axis=1), highest - lowest, 0.0)
        still = _STILL * np.array(problem.system.coordinates.nominal)
        return cls(problem, taylor, np.maximum(ranges, still))

    def jumps(self, t: Array, states: Array, native: bool | None = False) -> npt.NDArray[np.intp]:
        """Return the intervals between the instants `t` (N,) over which the answers (size, N) seem to jump."""
        if native is not False and len(t) > _MANY:
            apart = _compiled_apart(self.problem.resolved, native)
            if apart.ready(len(t) - 1):
                (together,) = apart(states[:, :-1], states[:, 1:], np.diff(t)[None], self.scale)
                return np.flatnonzero(together[0] != 1.0)
        return self.taylor.jumps(t, states, self.scale)

    def follow(self, state: Array, begin: float, end: float) -> Array:
        """Return the answer at `end` on the branch of an answer at `begin`.

        Raises
        ------
        IntegrationFailed
            If the branch ends on the way, or cannot be distinguished from another.
        """
        waiting, trials = [end], 0
        while waiting:
            trials += 1
            reached = self._continued(state, begin, waiting[-1])
            if reached is not None:
                state, begin = reached, waiting.pop()
                continue
            middle = begin + LESS_THAN_HALF * (waiting[-1] - begin)
            exhausted = len(waiting) > _MOST_BISECTIONS or trials > _MOST_TRIALS
            if exhausted or not min(begin, waiting[-1]) < middle < max(begin, waiting[-1]):
                raise IntegrationFailed(
                    f"{self.problem.system.name}: the branch cannot be followed beyond t = {begin:.9g} s: it ends"
                    f" there, or meets another"
                )
            waiting.append(middle)
        return state

    def require_regular(self, t: Array, states: Array, instants: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Return the intervals in which the determinant of the system Jacobian changes its sign: singular, and passed.

        Raises
        ------
        IntegrationFailed
            If the equations determine no answer at one of some `instants`, or beside a sign that changes.
        """
        matrices = balanced(system_jacobians(self.problem, t, states))
        signs, _ = np.linalg.slogdet(matrices)
        passed = np.flatnonzero(signs[:-1] * signs[1:] <= 0.0)
        for k in np.unique(np.concatenate([instants, passed, passed + 1])):
            beside = k - 1 if k else k + 1
            condition, usual = np.linalg.cond(matrices[[k, beside]])
            if not condition < min(_SINGULAR_CONDITION, _MUCH_WORSE * usual):
                raise self._singular(t[k], condition)
        return passed

    def passed(self, t: Array, states: Array) -> list[int]:
        """Return intervals in which answers (size, N) that continue each other pass a singularity.

        The determinant of the system Jacobian changes its sign there. The sign is evaluated at a few instants, and the
        instant of a change is found by bisection; a sign that changes twice between two of them is missed.
        """
        looked = np.arange(_LOOKED_AT) * (len(t) - 1) // (_LOOKED_AT - 1)
        signs = self._signs(t[looked], states[:, looked])
        changes, intervals = signs[:-1] * signs[1:] < 0.0, []
        for k in np.flatnonzero(changes.any(axis=1)):
            matrices = system_jacobians(self.problem, t[looked], states[:, looked])
            if np.linalg.cond(balanced(matrices))[k : k + 2].max() < _SINGULAR_CONDITION:  # else round-off
                first, last, part = looked[k], looked[k + 1], changes[k].argmax()
                while last - first > 1:
                    middle = (first + last) // 2
                    sign = self._signs(t[[middle]], states[:, [middle]])[0, part]
                    first, last = (middle, last) if sign == signs[k, part] else (first, middle)
                intervals.append(int(first))
        return intervals

    def _signs(self, t: Array, states: Array) -> Array:
        """Return the signs of the determinants of the system Jacobian's independent parts, shape (N, parts)."""
        return determinant_signs(*_jacobian_entries(self.problem, t, states))

    def is_closed_form(self, t: Array, states: Array) -> bool:
        """Whether answers (size, N) are the guess of the model itself, and none of them is singular or seems to jump.

        A drum that unwinds kilometres of rope turns thousands of times between two instants: nothing follows that, and
        nothing has to where the model gives its motion in closed form. The sign of the determinant is the alarm for a
        guess that changes over to another branch.
        """
        problem, q = self.problem, self.taylor.q
        off = np.abs(guessed_unknowns(problem, t)[q] - states[q])
        if not (off <= _EXACT * np.maximum(np.abs(states[q]), self.scale[:, None])).all():
            return False
        parts, entries = _jacobian_entries(problem, t, states)
        signs = determinant_signs(parts, entries)
        return bool((signs == signs[0]).all()) and is_regular_throughout(parts, entries, _SINGULAR_CONDITION)

    def connects(self, t: Array, states: Array) -> bool:
        """Whether following the branch of the first of two answers (size, 2) leads to the second."""
        try:
            reached = self.follow(states[:, 0], float(t[0]), float(t[1]))
        except IntegrationFailed:
            return False
        off = reached[self.taylor.q] - states[self.taylor.q, 1]
        off[self.taylor.wraps] = wrapped_angle(off[self.taylor.wraps])
        return bool((np.abs(off) <= SLIGHT * self.scale).all())

    def require_through(self, t: Array, states: Array, seeming: npt.NDArray[np.intp]) -> None:
        """Raise `IntegrationFailed` if answers connect at an instant only because its equations are singular there.

        From a singular answer every branch can be reached that meets there. So the branch is followed past it.
        """
        for k in seeming[1:][np.diff(seeming) == 1]:
            conditions = np.linalg.cond(
                balanced(system_jacobians(self.problem, t[k - 1 : k + 2], states[:, k - 1 : k + 2]))
            )
            worse = not conditions[1] < _WORSE * max(conditions[0], conditions[2])
            if worse and not self.connects(t[[k - 1, k + 1]], states[:, [k - 1, k + 1]]):
                raise self._singular(t[k], conditions[1])

    def _singular(self, time: float, condition: float) -> IntegrationFailed:
        return IntegrationFailed(
            f"{self.problem.system.name} is singular at t = {time:.6g} s: the system Jacobian has condition"
            f" {condition:.2g}"
        )

    def along_all(self, t: Array, states: Array) -> Array:
        """Return the answers (size, N) at the instants `t` on one branch, that of the first answer which is finite.

        Raises
        ------
        IntegrationFailed
            If no instant is solved, or the branch cannot be followed.
        """
        solved = np.flatnonzero(np.isfinite(states).all(axis=0))
        if not len(solved):
            name = self.problem.system.name
            raise IntegrationFailed(f"{name}: the equations were solved at no instant, from the guess of the model")
        first, followed = int(solved[0]), states.copy()
        for k in range(first, 0, -1):
            followed[:, k - 1] = self.follow(followed[:, k], float(t[k]), float(t[k - 1]))
        for k in range(first + 1, len(t)):
            followed[:, k] = self.follow(followed[:, k - 1], float(t[k - 1]), float(t[k]))
        return followed

    def _continued(self, state: Array, begin: float, end: float) -> Array | None:
        solution = self._solved(end, self.taylor.ahead(state[:, None], end - begin)[:, 0])
        if solution is None:
            return None
        apart = self.taylor.apart(state[:, None], solution[:, None], np.array([end - begin]), self.scale)
        return None if apart[0] else solution

    def _solved(self, time: float, guess: Array) -> Array | None:
        problem = self.problem
        jet = side_by_side(problem.reference.jet(np.array([time]), problem.array.reference_order))
        unknowns, _, residual = call_of(inversion(problem.array).search)(jet, problem.p, guess)
        return unknowns if np.isfinite(unknowns).all() and np.isfinite(residual).all() else None


def system_jacobians(problem: Problem, t: Array, states: Array) -> Array:
    """Return the system Jacobians at instants, shape (N, size, size), zeros for what is not finite.

    Parameters
    ----------
    problem : Problem
        Whose derivative array they belong to.
    t : ndarray, shape (N,)
        Instants.
    states : ndarray, shape (unknowns of the array, N)
        Its unknowns there.
    """
    jets = problem.reference.jet(t, problem.array.reference_order)
    (rows,) = at_instants(system_jacobian(problem.array), states, jets=jets, p=problem.p)
    matrices: Array = np.nan_to_num(rows).reshape(len(rows), len(t), -1).transpose(1, 0, 2)
    return matrices


def _jacobian_entries(problem: Problem, t: Array, states: Array) -> tuple[tuple[Part, ...], Array]:
    """Return the independent parts of the system Jacobian, and its entries (nnz, N), zeros for what is not finite."""
    function, parts = system_jacobian_entries(problem.array)
    jets = problem.reference.jet(t, problem.array.reference_order)
    return parts, np.nan_to_num(at_instants(function, states, jets=jets, p=problem.p)[0])


_taylor = made_once(Taylor.of)


@made_once
def _compiled_apart(resolved: ResolvedSystem, native: bool | None) -> Vectorized:
    function = _taylor(resolved.array).compile_together(len(resolved.array.unknowns))
    return Vectorized(function, (True, True, True, False), native, resolved.system.name)


def on_one_branch(problem: Problem, t: Array, states: Array, native: bool | None = False) -> tuple[Array, str]:
    """Return answers (size, N) at the instants `t` that belong to one branch, and how that is known.

    Parameters
    ----------
    problem : Problem
        Without internal dynamics.
    t : ndarray, shape (N,)
        Instants in rising order.
    states : ndarray, shape (size, N)
        Answers from the guess of the model; NaN where there is none.
    native : bool or None
        Whether machine code compares them; see `Vectorized`.

    Raises
    ------
    IntegrationFailed
        If they jump and no branch can be followed.
    """
    if len(t) < 2 or states.shape[0] != len(problem.array.unknowns):
        return states, ""
    branch = Branch.along(problem, states)
    seeming = branch.jumps(t, states, native)
    for count, k in enumerate(seeming):  # instants far apart seem to jump: look in between
        if count == _MOST_CONNECTED and branch.is_closed_form(t, states):
            return states, CLOSED_FORM
        if not np.isfinite(states[:, k : k + 2]).all() or not branch.connects(t[k : k + 2], states[:, k : k + 2]):
            try:
                followed = branch.along_all(t, states)
            except IntegrationFailed:
                if branch.is_closed_form(t, states):
                    return states, CLOSED_FORM
                raise
            passed = branch.require_regular(t, followed, np.flatnonzero(~np.isfinite(states).all(axis=0)))
            return followed, FOLLOWED + _passages(t, passed)
    branch.require_through(t, states, seeming)
    return states, CONTINUOUS + _passages(t, branch.passed(t, states))


def require_followed(problem: Problem, t: Array, states: Array) -> None:
    """Raise `IntegrationFailed` if answers (size, N), each found from where the one before was heading, jump."""
    if states.shape[0] != len(problem.array.unknowns):
        return
    branch = Branch.along(problem, states)
    for k in branch.jumps(t, states):
        if not branch.connects(t[k : k + 2], states[:, k : k + 2]):
            raise IntegrationFailed(
                f"{problem.system.name}: the branch cannot be followed from t = {t[k]:.6g} s to {t[k + 1]:.6g} s: it"
                f" ends there, or meets another"
            )


def _passages(t: Array, passed: Iterable[int]) -> str:
    """Return the text of `statistics.branch` on the singular intervals that a motion passes."""
    return "".join(
        f"; between t = {t[k]:.6g} s and {t[k + 1]:.6g} s the equations are singular, this one goes on smoothly"
        for k in passed
    )


@dataclass(frozen=True, eq=False)
class BranchTable:
    """Answers along a path, all on one branch, from which the answer at any instant is found.

    Attributes
    ----------
    branch : Branch
        The continuation of their branch.
    t : ndarray, shape (N,)
        Instants in rising order.
    states : ndarray, shape (size, N)
        The answers.
    """

    branch: Branch
    t: Array
    states: Array

    def states_at(self, t: Array) -> Array:
        """Return the answers (size, M) at instants in any order."""
        if not len(t):
            return np.empty((len(self.states), 0))
        after = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        near = np.where(t - self.t[after - 1] < self.t[after] - t, after - 1, after)
        first, h = self.states[:, near], t - self.t[near]
        taylor = self.branch.taylor
        unknowns = unknowns_from(self.branch.problem, t, taylor.ahead(first, h))
        for k in np.flatnonzero(taylor.apart(first, unknowns, h, self.branch.scale)):
            unknowns[:, k] = self.branch.follow(first[:, k], float(self.t[near[k]]), float(t[k]))
        return unknowns


def prepared_table(problem: Problem) -> BranchTable | None:
    """Return answers along the path of a problem on one branch; None if the guess of the model is the answer itself."""
    ends = problem.reference.stretches
    each = max(1, -(-_SURVEYED // (len(ends) - 1)))
    t = np.unique(np.concatenate([np.linspace(a, b, each + 1) for a, b in pairwise(ends)]))
    states, by_expression = exact_unknowns(problem, t)
    kept, how = on_one_branch(problem, t, states)
    branch = Branch.along(problem, kept)
    closed = not how.startswith(FOLLOWED) and (by_expression or branch.is_closed_form(t, kept))
    table = None if closed else BranchTable(branch, t, kept)
    if has_kinks_or_jumps(problem.resolved):
        require_no_jumps(problem, t, exact_states(problem, table))
    return table


def exact_states(problem: Problem, table: BranchTable | None) -> States:
    """Return the exact inversion of a problem as a function of times; `table` is its `prepared_table`."""
    return table.states_at if table is not None else lambda t: exact_unknowns(problem, t)[0]
