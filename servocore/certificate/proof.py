"""A motion proved on intervals that follow one another: answers, the interval Newton test, halving, and joints.

Every interval has one solution near its polynomial; neighbours belong to one branch where, at their joint, the solution
of one lies where that of the other is the only one. An interval before the start and one behind the end of a path show
that the motion begins and ends as the path does outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import UNIT, Arithmetic, Model, arithmetic, norm
from servocore.certificate.equations import Answers, Equations, equations_of, parameter_models, path_models
from servocore.certificate.krawczyk import radii
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem

Joint = Literal["one branch", "inputs jump", "motion jumps", "apart", "not proved"]

_DEGREE = 10
_FIRST = 8  # intervals of a path to begin with, each piece of it one at the least
_OUTSIDE = 1e-2  # of the duration: intervals before and behind the path
_REACH, _ENLARGED = 1e-5, 8.0  # D, of a peak; times the radius where that is more
_DEEPEST = 14  # halvings
_GUESSED = 4  # halvings while answers come from the guess of the model
_AHEAD = 6  # intervals that are followed before they are proved
_MOST = 1200  # intervals
_AT_ONCE = 48


@dataclass(eq=False)
class Interval:
    """A time interval with what is known of the motion on it.

    Attributes
    ----------
    begin, end : float
        In s.
    depth : int
        How often it was halved.
    outside : bool
        Whether it lies before or behind the path.
    guessed : bool
        Whether answers come from the guess of the model, or from an interval beside it.
    backwards : bool
        Whether from the one behind it.
    c : ndarray, shape (terms, unknowns)
        Polynomials.
    rho, D : ndarray, shape (unknowns,)
        Radii, and where the solution is the only one.
    failed : int
        The first unknown that was not proved; -1 for none.
    tested : bool
        Whether the test was done.
    before : float
        Relative radius of the interval that it is a half of.
    """

    begin: float
    end: float
    depth: int = 0
    outside: bool = False
    guessed: bool = True
    backwards: bool = False
    c: Array | None = None
    rho: Array = field(default_factory=lambda: np.zeros(0))
    D: Array = field(default_factory=lambda: np.zeros(0))
    failed: int = -1
    tested: bool = False
    proved: bool = False
    final: bool = False
    before: float = np.inf

    def halves(self, relative: float = np.inf) -> list[Interval]:
        """Return both halves, of which nothing is known."""
        middle = (self.begin + self.end) / 2.0
        ends = ((self.begin, middle), (middle, self.end))
        return [
            Interval(a, b, self.depth + 1, self.outside, self.guessed, self.backwards, before=relative) for a, b in ends
        ]


@dataclass(eq=False)
class Proof:
    """The motion of a flat problem on intervals, for all parameters of a box.

    Parameters
    ----------
    problem : Problem
        Without internal dynamics.
    boxed : dict of int to (float, float)
        Intervals of parameters by number.
    tolerance : float
        Radius of the inputs at which no interval is halved any more, of their peaks.
    raised : bool
        Whether rates are enclosed too.
    """

    problem: Problem
    boxed: dict[int, tuple[float, float]]
    tolerance: float
    raised: bool = False
    intervals: list[Interval] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)

    @cached_property
    def equations(self) -> Equations:
        """The equations."""
        return equations_of(self.problem.resolved, self.raised)

    @cached_property
    def ring(self) -> Arithmetic:
        """Operations on polynomials in time and the parameters with an interval."""
        of_parameters = {1: 4, 2: 3}.get(len(self.boxed), 2)
        return arithmetic((_DEGREE, *(of_parameters for _ in self.boxed)))

    @cached_property
    def answers(self) -> Answers:
        """The source of approximate solutions."""
        return Answers(self.problem, self.equations)

    @cached_property
    def peaks(self) -> Array:
        """Largest magnitude of each unknown at the first nodes, at least what counts as small, shape (unknowns,)."""
        seen: Array = self.answers.magnitudes
        for each in self.intervals:
            if each.c is not None:
                seen = np.fmax(seen, np.abs(self.ring.values(each.c[:, :, None])[:, :, 0]).max(axis=0))
        return seen

    @np.errstate(all="ignore")  # what is not finite is not proved
    def run(self) -> Proof:
        """Prove what can be proved."""
        self.intervals = self._first_intervals()
        while len(self.intervals) <= _MOST and self._round():
            pass
        self.joints = [self._joint(a, b) for a, b in zip(self.intervals, self.intervals[1:], strict=False)]
        return self

    def _first_intervals(self) -> list[Interval]:
        path = self.problem.reference
        ends = path.joints
        each = np.maximum(np.ceil(_FIRST * np.diff(ends) / path.duration - 1e-9), 1).astype(int)
        grid = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(ends[:-1], ends[1:], each, strict=True)]
        times = np.array([*np.concatenate(grid), path.end_time])
        margin = _OUTSIDE * path.duration
        inner = [Interval(a, b) for a, b in zip(times[:-1].tolist(), times[1:].tolist(), strict=True)]
        first = Interval(path.start_time - margin, path.start_time, outside=True)
        return [first, *inner, Interval(path.end_time, path.end_time + margin, outside=True)]

    def _round(self) -> bool:
        """Answer and test what is open, and see what to do next; return whether something is left to do."""
        fresh = [each for each in self.intervals if not each.tested]
        if fresh:
            pairs = list(zip(self.intervals, self.intervals[1:], strict=False))
            for a, b in pairs:
                if b.c is None and not b.guessed and not b.backwards:
                    self._answer_from(a, [b])
            for a, b in reversed(pairs):
                if a.c is None and a.backwards:
                    self._answer_from(b, [a], late=False)
            for k in range(0, len(fresh), _AT_ONCE):
                self._prove(fresh[k : k + _AT_ONCE])
            self.intervals = [part for each in self.intervals for part in self._refined(each)]
            return True
        return self._follow()

    def _refined(self, each: Interval) -> list[Interval]:
        """Return an interval, or its halves where it is not proved well enough and that may help."""
        if each.final:
            return [each]
        relative = self.relative_radius(each)
        enough = each.proved and (relative <= self.tolerance or relative > each.before / 2.0)
        deepest = _DEEPEST if each.proved or not each.guessed else _GUESSED
        if enough or each.depth >= deepest:
            each.final = True
            return [each]
        return each.halves(relative if each.proved else np.inf)

    def relative_radius(self, each: Interval) -> float:
        """Return the largest radius of an input, of its peak."""
        places = self.equations.inputs
        return float((each.rho[places] / self.input_peaks).max(initial=0.0)) if each.proved else np.inf

    @cached_property
    def input_peaks(self) -> Array:
        """Peaks of the inputs; one that is next to nothing counts as a millionth of the largest."""
        peaks = self.peaks[self.equations.inputs]
        return np.asarray(np.maximum(peaks, 1e-6 * peaks.max(initial=1e-300)))

    # Answers and test -----------------------------------------------------------------------------------------------

    @cached_property
    def _parameters(self) -> Array:
        """Parameter values (n_p, points) at the nodes of the box."""
        nodes = self.ring.nodes[: len(self.ring.nodes) // (_DEGREE + 1), 1:]
        p = np.tile(self.problem.p[:, None], len(nodes))
        for axis, (k, (low, high)) in enumerate(self.boxed.items()):
            p[k] = (low + high) / 2.0 + (high - low) / 2.0 * nodes[:, axis]
        return p

    def _times(self, each: Interval) -> Array:
        """Return the nodes in time, shape (degree + 1,), falling."""
        nodes = self.ring.nodes[:: self._parameters.shape[1], 0]
        return np.asarray((each.begin + each.end) / 2.0 + (each.end - each.begin) / 2.0 * nodes)

    def _prove(self, fresh: Sequence[Interval]) -> None:
        unanswered = [each for each in fresh if each.c is None]
        if unanswered:
            points = self._parameters.shape[1]
            t = np.concatenate([np.repeat(self._times(each), points) for each in unanswered])
            x = self.answers.from_guess(t, np.tile(self._parameters, len(t) // points))
            for each, own in zip(unanswered, np.split(x, len(unanswered), axis=1), strict=True):
                each.c = self._interpolated(own)
        self._test(fresh, self.first_reach(fresh))
        again = [each for each in fresh if not each.proved and np.isfinite(each.rho).all()]
        if again:
            D = np.stack([_ENLARGED * each.rho for each in again], axis=1)
            self._test(again, np.maximum(D, self.first_reach(again)))

    def _interpolated(self, x: Array) -> Array:
        c = self.ring.interpolated(x.T[:, :, None])[:, :, 0]
        return np.where(np.isfinite(c), c, np.nan)

    def first_reach(self, fresh: Sequence[Interval]) -> Array:
        """Return D (unknowns, intervals) to begin with: the effect of curvature falls with the square of the width."""
        widths = np.array([0.25 ** max(each.depth, 0) for each in fresh])
        return np.asarray(_REACH * self.peaks[:, None] * np.maximum(widths, 1e-6))

    def given(self, some: Sequence[Interval]) -> Model:
        """Return models of path and parameters on intervals."""
        begin, end = (np.array([getattr(each, name) for each in some]) for name in ("begin", "end"))
        path = path_models(self.problem, self.ring, begin, end, self.equations.path_order)
        p = parameter_models(self.ring, self.problem.p, self.boxed, len(some))
        return np.concatenate([path[0], p[0]], axis=1), np.concatenate([path[1], p[1]])

    def _test(self, some: Sequence[Interval], D: Array) -> None:
        x = np.stack([each.c for each in some if each.c is not None], axis=2)
        solved: npt.NDArray[np.bool_] = np.asarray(np.isfinite(x).all(axis=(0, 1)))
        rho, failed = radii(self.equations, self.ring, np.where(solved, x, 0.0), self.given(some), D, self.peaks)
        curved = self.equations.curved
        within = np.asarray(solved & (rho <= D)[curved].all(axis=0) & np.isfinite(rho).all(axis=0))
        for k, each in enumerate(some):
            each.rho, each.D, each.proved = rho[:, k], D[:, k], bool(within[k])
            each.failed, each.tested = int(failed[k]), True
            each.rho = each.rho if solved[k] else np.full_like(each.rho, np.inf)

    def models(self, some: Sequence[Interval]) -> Model:
        """Return enclosures of unknowns, path and parameters, the arguments of walks; infinite where not proved."""
        (c, r), none = self.given(some), np.zeros((len(self.ring.nodes), len(self.peaks)))
        x = np.stack([none if each.c is None or not each.proved else each.c for each in some], axis=2)
        rho = np.stack([each.rho if each.proved else np.full(len(self.peaks), np.inf) for each in some], axis=1)
        return np.concatenate([x, c], axis=1), np.concatenate([rho, r])

    # Joints ---------------------------------------------------------------------------------------------------------

    def _end_values(self, each: Interval, late: bool) -> Array:
        """Return coefficients in the parameters (terms, unknowns) at an end of an interval."""
        assert each.c is not None
        shaped = each.c.reshape(_DEGREE + 1, -1, each.c.shape[1])
        signs = np.ones(_DEGREE + 1) if late else (-1.0) ** np.arange(_DEGREE + 1)
        return np.asarray(np.einsum("i,ijk->jk", signs, shaped))

    def _joint(self, a: Interval, b: Interval) -> Joint:
        """Return how two neighbours meet."""
        if not (a.proved and b.proved):
            return "not proved"
        assert a.c is not None
        assert b.c is not None
        noise = 2.0 * (_DEGREE + 2) * UNIT * (norm(a.c) + norm(b.c))
        apart = norm(self._end_values(a, True) - self._end_values(b, False)) + noise
        free = self.answers.rates | ~self.equations.curved  # rates may jump, and others are unique wherever they are
        fits = (apart + b.rho <= a.D) | free, (apart + a.rho <= b.D) | free
        if any(side.all() for side in fits):
            return "one branch"
        motion = self.equations.motion
        off = apart[motion] > 2.0 * noise[motion] + a.rho[motion] + b.rho[motion]
        if not np.isclose(self.problem.reference.joints, a.end, rtol=0.0, atol=0.0).any():
            return "apart"
        if off.any():
            return "motion jumps"
        return "inputs jump" if any(side[motion].all() for side in fits) else "apart"

    # Following the branch -------------------------------------------------------------------------------------------

    def _follow(self) -> bool:
        """Answer again, from the proved interval beside it, the first that is not on its branch.

        From the beginning on; before the first interval that is proved at all, backwards from that.
        """
        pairs = list(zip(self.intervals, self.intervals[1:], strict=False))
        for k, (a, b) in enumerate(pairs, 1):
            if not a.proved or (not b.guessed and not b.proved):
                continue  # the branch is lost: later answers come from the guess
            if b.proved and self._joint(a, b) in {"one branch", "inputs jump"}:
                continue
            if b.proved and not b.guessed:
                if b.depth >= _DEEPEST or self._joint(a, b) == "motion jumps":
                    continue
                self.intervals[k : k + 1] = b.halves()
            self._answer_from(a, self.intervals[k : k + _AHEAD])
            return True
        first = next((k for k, each in enumerate(self.intervals) if each.proved), 0)
        if first and self.intervals[first - 1].guessed:
            self._answer_from(self.intervals[first], self.intervals[first - 1 :: -1][:_AHEAD], late=False)
            return True
        return False

    def _answer_from(self, a: Interval, following: Sequence[Interval], late: bool = True) -> None:
        """Follow the motion by Newton's method from node to node, from an end of an interval that was answered."""
        of_box = self.ring.nodes[: self._parameters.shape[1]].copy()
        of_box[:, 0] = 1.0 if late else -1.0
        assert a.c is not None
        x, t, before = (self.ring.rows(of_box) @ a.c).T, a.end if late else a.begin, None
        for each in following:
            found = []
            for at in self._times(each)[:: -1 if late else 1]:
                guess = self.answers.predicted(x, before, at - t)
                new = self.answers.from_near(np.full(x.shape[1], at), self._parameters, guess)
                before, x, t = (x, at - t), new, at
                found.append(new)
            own = np.stack(found[:: -1 if late else 1], axis=1).reshape(len(x), -1)
            each.c, each.guessed, each.backwards = self._interpolated(own), False, not late
            each.tested, each.final, each.proved = False, False, False
