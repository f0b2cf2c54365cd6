"""The motion of a run at its instants, which every check reads."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from servocore.checks.branches import (
    CLOSED_FORM,
    FOLLOWED,
    Branch,
    Passage,
    ahead,
    coordinate_rows,
    is_closed_form,
    on_one_branch,
)
from servocore.checks.findings import FEWEST, Finding
from servocore.errors import IntegrationFailed
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array, Places
from servocore.problem import Problem
from servocore.references.base import subdivided, survey
from servocore.stepping.exact_evaluation import exact_unknowns, unknowns_from


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion at instants.

    Attributes
    ----------
    problem : Problem
        The problem it solves.
    t : ndarray, shape (N,)
        Instants in rising order.
    states : ndarray, shape (size, N)
        Unknowns of the derivative array there.
    branch : str
        How it is known to be one motion; empty where internal dynamics were integrated.
    passages : tuple of Passage
        Singularities that it passes.
    values : ndarray, shape (channels, N), or None
        Observed quantities, where they are known.
    by_guess : bool or None
        Whether the guess of the model is known to be the answer itself.
    """

    problem: Problem
    t: Array
    states: Array
    branch: str = ""
    passages: tuple[Passage, ...] = ()
    values: Array | None = None
    by_guess: bool | None = None

    @cached_property
    def direct(self) -> bool:
        """Whether the guess of the model is the answer itself, so that no instant needs its neighbours."""
        return is_closed_form(self.problem, self.t, self.states) if self.by_guess is None else self.by_guess

    @property
    def q(self) -> Array:
        """Coordinates, shape (n, N)."""
        return np.asarray(self.states[coordinate_rows(self.problem.array).values])

    def at(self, t: Array) -> Array:
        """Return the unknowns (size, M) at instants in any order, on the branch; NaN where there is no answer.

        Raises
        ------
        IntegrationFailed
            If the branch does not go on so far.
        """
        if self.direct or not len(t):
            return exact_unknowns(self.problem, t)[0] if len(t) else np.empty((len(self.states), 0))
        after = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        near = np.where(t - self.t[after - 1] < self.t[after] - t, after - 1, after)
        first, h = self.states[:, near], t - self.t[near]
        unknowns = unknowns_from(self.problem, t, ahead(self.problem.array, first, h))
        branch = Branch.of(self.problem, self.states)
        for k in np.flatnonzero(branch.apart(first, unknowns, h)):
            unknowns[:, k], _ = branch.follow_to(first[:, k], float(self.t[near[k]]), float(t[k]))
        return unknowns

    def beside(self, left: Array, states: Array, t: Array) -> Array:
        """Return the unknowns at times by Newton's method from answers (size, M) at times `left`; NaN for none."""
        if self.direct:
            return exact_unknowns(self.problem, t)[0]
        if not self.problem.flat:  # internal states between the instants are those of a straight line
            return unknowns_from(self.problem, t, np.stack([np.interp(t, self.t, row) for row in self.states]))
        # Filled up to a power of two, so that few functions are compiled.
        full = np.minimum(np.arange(1 << max(len(t) - 1, 0).bit_length()), len(t) - 1)
        guess = ahead(self.problem.array, states, t - left)
        return unknowns_from(self.problem, t[full], guess[:, full])[:, : len(t)] if len(t) else guess


def motion_of(
    problem: Problem, t: Array | None = None, states: Array | None = None, known: Array | None = None
) -> Motion:
    """Return the exact motion of a flat problem on one branch.

    Parameters
    ----------
    problem : Problem
        Without internal dynamics.
    t : ndarray, shape (N,), optional
        Instants in rising order; enough ones along the path when not given.
    states : ndarray, shape (size, N), optional
        Answers there from the guess of the model, NaN where there is none.
    known : ndarray, shape (blocks, N), optional
        Determinants there; see `block_determinants`.

    Raises
    ------
    IntegrationFailed
        If no instant is solved, or the branch cannot be followed.
    """
    t = survey(problem.reference) if t is None else t
    by_expression = False
    if states is None:
        states, by_expression = exact_unknowns(problem, t)
    if len(t) < 2 or len(states) != len(problem.array.unknowns):
        return Motion(problem, t, states, by_guess=True)
    kept, how, passages = on_one_branch(problem, t, states, known)
    by_guess = False if how == FOLLOWED else True if by_expression or how == CLOSED_FORM else None
    return Motion(problem, t, kept, how, passages, by_guess=by_guess)


def passed(motion: Motion) -> Iterator[Finding]:
    """Yield a statement on each singularity that a motion passes; where constraints lose rank, a warning as well."""
    for each in motion.passages:
        ends = min(each.time - motion.t[0], motion.t[-1] - each.time) < 1e-6 * np.ptp(motion.t)
        how = "this one begins or ends there" if ends else "this one goes on smoothly"
        if each.constraints:
            yield Finding(f"{each}; {how}", warns=True)
        yield Finding(f"{each}{';' if each.constraints else ','} {how}")


def enough(t: Array) -> tuple[Array, int]:
    """Return instants between which little is hidden, and into how many parts each interval of the given is divided.

    Into a number without small divisors: halves and thirds of a path are likely to be singular.
    """
    parts = -(-FEWEST // max(len(t) - 1, 1))
    if parts == 1 or len(t) < 2:
        return t, 1
    while math.gcd(parts, 2 * 3 * 5) > 1:
        parts += 1
    return subdivided(t, parts), parts


def poles_passed(motion: Motion, steps: Places, values: Array, channels: Sequence[Quantity]) -> Iterator[Finding]:
    """Find inputs (inputs, N) that step where a determinant changes its sign: the equations are singular in between.

    For integrated internal dynamics, whose configurations between the instants are not known.
    """
    signs = np.sign(Branch.of(motion.problem, motion.states).determinants(motion.t, motion.states))
    for k in steps:
        near = slice(max(k - 2, 0), k + 4)
        if (np.diff(signs[:, near], axis=1) != 0.0).any():
            worst = int(np.abs(np.diff(values[:, k : k + 2], axis=1)[:, 0]).argmax())
            quantity, (before, after) = channels[worst], values[worst, k : k + 2]
            yield Finding(
                f"between t = {motion.t[k]:.6g} s and {motion.t[k + 1]:.6g} s the equations are singular, the"
                f" determinant of the system Jacobian changes its sign, and {quantity.name} has a pole: it goes from"
                f" {before:.4g} to {after:.4g} {quantity.unit}", error=IntegrationFailed,
            )  # fmt: skip
