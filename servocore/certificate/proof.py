"""A motion proved on intervals that follow one another: answers, the interval Newton test, halving, and joints.

Every interval has one solution near its polynomial; neighbours belong to one branch where, at their joint, the solution
of one lies where that of the other is the only one. An interval before the start and one behind the end of a path show
that the motion begins and ends as the path does outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import UNIT, Arithmetic, Model, arithmetic, norm
from servocore.certificate.equations import (
    Equations,
    answers,
    equations_of,
    machine_code,
    parameter_models,
    path_models,
    predicted,
)
from servocore.certificate.krawczyk import joined, radii
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.structure.derivative_array import nominal

Joint = Literal["one branch", "inputs jump", "motion jumps", "apart", "not proved"]

_DEGREE = 10
_FIRST = 8  # intervals of a path to begin with, each piece of it one at the least
_OUTSIDE = 1e-2  # of the duration: intervals before and behind the path
_REACH, _ENLARGED = 1e-5, 8.0  # D, of a peak; times the radius where that is more
_NARROW = 0.05  # of the tolerance
_DEEPEST = 14  # halvings
_GUESSED = 4  # halvings while answers come from the guess of the model
_COARSE, _LESS = 20.0, 1e-3  # last coefficients, of the tolerance, that call for halves, and their share in a half
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
    source : int
        0 if answers come from the guess of the model, 1 from the interval before it, -1 from the one behind it.
    c : ndarray, shape (terms, unknowns)
        Polynomials.
    given : Model
        Of path and parameters.
    rho, D : ndarray, shape (unknowns,)
        Radii, and where the solution is the only one.
    failed : int
        The first unknown that was not proved; -1 for none.
    tested, proved : bool
        Whether the test was done, and what it said.
    before : tuple of (float, float)
        Relative radii of the intervals that it is a quarter of, and a half.
    """

    begin: float
    end: float
    depth: int = 0
    outside: bool = False
    source: int = 0
    c: Array | None = None
    given: Model | None = None
    rho: Array = field(default_factory=lambda: np.zeros(0))
    D: Array = field(default_factory=lambda: np.zeros(0))
    failed: int = -1
    tested: bool = False
    proved: bool = False
    before: tuple[float, float] = (np.inf, np.inf)

    def parts(self, halvings: int = 1, relative: float = np.inf) -> list[Interval]:
        """Return its halves, or quarters and so on, of which nothing is known."""
        if not halvings:
            return [self]
        ends, depth = np.linspace(self.begin, self.end, 2**halvings + 1).tolist(), self.depth + halvings
        before = self.before[1], relative
        return [Interval(*each, depth, self.outside, self.source, before=before) for each in pairwise(ends)]


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
        Of the inputs, of their peaks: their enclosures are narrower.
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
    def _negligible(self) -> Array:
        """Negligible size of each unknown: 1e-6 of its nominal magnitude within the duration of the path."""
        array, duration = self.equations.array, self.problem.reference.duration
        return np.array([1e-6 * nominal(array.system, j) / duration**order for j, order in array.unknowns])

    @cached_property
    def peaks(self) -> Array:
        """Largest magnitude of each unknown at the first nodes, at least what counts as small, shape (unknowns,)."""
        values = self.ring.values(np.stack([each.c for each in self.intervals if each.c is not None], axis=2))
        return np.asarray(np.fmax(self._negligible, np.fmax.reduce(np.abs(values), axis=(0, 2))))

    @np.errstate(all="ignore")  # what is not finite is not proved
    def run(self) -> Proof:
        """Prove what can be proved."""
        machine_code(self.equations.array).best(1)
        self.intervals = self._first_intervals()
        while self._tested() or self._followed():
            if len(self.intervals) > _MOST:
                self.joints = self._joints()
                break
        return self

    def _first_intervals(self) -> list[Interval]:
        path = self.problem.reference
        ends = path.joints
        each = np.maximum(np.ceil(_FIRST * np.diff(ends) / path.duration - 1e-9), 1).astype(int)
        grid = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(ends[:-1], ends[1:], each, strict=True)]
        margin = _OUTSIDE * path.duration
        inner = [Interval(a, b) for a, b in pairwise([*np.concatenate(grid).tolist(), path.end_time])]
        first = Interval(path.start_time - margin, path.start_time, outside=True)
        return [first, *inner, Interval(path.end_time, path.end_time + margin, outside=True)]

    def _tested(self) -> bool:
        """Answer and test what is open, and halve what is not proved well enough; return whether there was any."""
        while fresh := [each for each in self.intervals if each.c is None and not each.source]:
            self._answer_guessed(fresh)
            self._replace(fresh, [each.parts(k) for each, k in zip(fresh, self._coarse(fresh), strict=True)])
        for beside, own in (*pairwise(self.intervals), *pairwise(reversed(self.intervals))):
            if own.c is None and own.source == (1 if beside.begin < own.begin else -1):
                self._answer_from(beside, [own])
        fresh = [each for each in self.intervals if not each.tested]
        for k in range(0, len(fresh), _AT_ONCE):
            self._prove(fresh[k : k + _AT_ONCE])
        halved = [each for k, each in enumerate(self.intervals) if self._too_wide(k)]
        self._replace(halved, [each.parts(relative=self.relative_radius(each)) for each in halved])
        return bool(halved)

    def _replace(self, old: Sequence[Interval], new: Sequence[list[Interval]]) -> None:
        """Put intervals in the places of others."""
        parts = dict(zip(map(id, old), new, strict=True))
        self.intervals = [part for each in self.intervals for part in parts.get(id(each), [each])]

    def _coarse(self, fresh: Sequence[Interval]) -> list[int]:
        """Return how many halvings answers need, as the last coefficients of their polynomials in time fall."""
        c = np.stack([each.c for each in fresh if each.c is not None], axis=2)
        last = norm(c.reshape(_DEGREE + 1, -1, *c.shape[1:])[-2:].reshape(-1, *c.shape[1:]))
        most = (last / self.peaks[:, None])[self._curved_or_input].max(axis=0)
        depth = np.array([each.depth for each in fresh])
        halvings = np.ceil(np.log(most / (_COARSE * np.clip(self.narrow, 1e-12, 1e-8))) / -np.log(_LESS))
        known = np.where(np.isfinite(halvings), halvings, 0.0)
        return [int(each) for each in np.clip(known, 0.0, np.maximum(_GUESSED - depth, 0))]

    @property
    def narrow(self) -> float:
        """Radius of the inputs, of their peaks, at which no interval is halved any more."""
        return self.tolerance if self.boxed else _NARROW * self.tolerance

    @cached_property
    def _curved_or_input(self) -> npt.NDArray[np.bool_]:
        """Unknowns that the test depends on, and those that it is for."""
        chosen = self.equations.curved & (self.peaks > self._negligible)
        chosen[self.equations.inputs] = True
        return chosen

    def _too_wide(self, k: int) -> bool:
        """Whether an interval is not proved well enough, and halves may help.

        They do not where its radius, of rounding errors, is hardly less than that of the interval of which it is a
        quarter, nor where those beside it are lost.
        """
        each, relative = self.intervals[k], self.relative_radius(self.intervals[k])
        if each.proved:
            return self.narrow < relative <= each.before[0] / 2.0 and each.depth < _DEEPEST
        if each.source:
            return each.depth < _DEEPEST and self.intervals[k - each.source].proved
        return each.depth < _GUESSED

    def relative_radius(self, each: Interval) -> float:
        """Return the largest radius of an input, of its peak; infinite if it is not proved."""
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

    def _answer_guessed(self, fresh: Sequence[Interval]) -> None:
        points = self._parameters.shape[1]
        t = np.concatenate([np.repeat(self._times(each), points) for each in fresh])
        x = answers(self.problem, self.equations.array, t, np.tile(self._parameters, len(t) // points))
        for each, own in zip(fresh, np.split(x, len(fresh), axis=1), strict=True):
            each.c = self._interpolated(own)

    def _prove(self, fresh: Sequence[Interval]) -> None:
        self._test(fresh, self.first_reach(fresh))
        again = [each for each in fresh if not each.proved and np.isfinite(each.rho).all()]
        if again:
            D = np.stack([_ENLARGED * each.rho for each in again], axis=1)
            self._test(again, np.maximum(D, self.first_reach(again)))

    def _interpolated(self, x: Array) -> Array:
        c = self.ring.interpolated(x.T[:, :, None])[:, :, 0]
        return np.where(np.isfinite(c), c, np.nan)

    def first_reach(self, fresh: Sequence[Interval]) -> Array:
        """Return D (unknowns, intervals) to begin with: less on intervals that were halved, where it did not help."""
        widths = np.array([0.5**each.depth for each in fresh])
        return np.asarray(_REACH * self.peaks[:, None] * widths)

    def given(self, some: Sequence[Interval]) -> Model:
        """Return models of path and parameters on intervals."""
        if new := [each for each in some if each.given is None]:
            begin, end = (np.array([getattr(each, name) for each in new]) for name in ("begin", "end"))
            path = path_models(self.problem, self.ring, begin, end, self.equations.path_order)
            c, r = joined(path, parameter_models(self.ring, self.problem.p, self.boxed, len(new)))
            for k, each in enumerate(new):
                each.given = c[:, :, k], r[:, k]
        models = [each.given for each in some if each.given is not None]
        return np.stack([c for c, _ in models], axis=2), np.stack([r for _, r in models], axis=1)

    def _test(self, some: Sequence[Interval], D: Array) -> None:
        x = np.stack([each.c for each in some if each.c is not None], axis=2)
        solved: npt.NDArray[np.bool_] = np.asarray(np.isfinite(x).all(axis=(0, 1)))
        rho, failed = radii(self.equations, self.ring, np.where(solved, x, 0.0), self.given(some), D, self.peaks)
        rho = np.where(solved, rho, np.inf)
        within = np.asarray((rho <= D)[self.equations.curved].all(axis=0) & np.isfinite(rho).all(axis=0))
        for k, each in enumerate(some):
            each.rho, each.D, each.proved = rho[:, k], D[:, k], bool(within[k])
            each.failed, each.tested = int(failed[k]), True

    def models(self, some: Sequence[Interval]) -> Model:
        """Return enclosures of unknowns, path and parameters, the arguments of walks; infinite where not proved."""
        none, unbounded = np.zeros((len(self.ring.nodes), len(self.peaks))), np.full(len(self.peaks), np.inf)
        x = np.stack([each.c if each.c is not None and each.proved else none for each in some], axis=2)
        rho = np.stack([each.rho if each.proved else unbounded for each in some], axis=1)
        return joined((x, rho), self.given(some))

    @cached_property
    def enclosures(self) -> Model:
        """The same on all intervals, once they are final."""
        return self.models(self.intervals)

    @property
    def unproved(self) -> list[Interval]:
        """The intervals without a proof."""
        return [each for each in self.intervals if not each.proved]

    # Joints ---------------------------------------------------------------------------------------------------------

    def _joints(self) -> list[Joint]:
        """Return how neighbours meet, by coefficients in the parameters (terms, unknowns, joints) at their ends."""
        count, none = len(self.peaks), np.zeros(len(self.peaks))
        no_polynomial, proved = np.zeros((len(self.ring.nodes), count)), np.array([k.proved for k in self.intervals])
        c = np.stack([k.c if k.c is not None and k.proved else no_polynomial for k in self.intervals], axis=2)
        rho, D = (
            np.stack([getattr(each, name) if each.proved else none for each in self.intervals], axis=1)
            for name in ("rho", "D")
        )
        shaped = c.reshape(_DEGREE + 1, -1, count, len(self.intervals))
        early, late = np.tensordot((-1.0) ** np.arange(_DEGREE + 1), shaped, 1), shaped.sum(axis=0)
        noise = 2.0 * (_DEGREE + 2) * UNIT * (norm(c)[:, :-1] + norm(c)[:, 1:])
        apart = norm(late[..., :-1] - early[..., 1:]) + noise
        rates = [unknown not in self.problem.array.unknowns for unknown in self.equations.array.unknowns]
        free = np.array(rates) | ~self.equations.curved  # rates may jump, and others are unique wherever they are
        fits = np.stack([apart + rho[:, 1:] <= D[:, :-1], apart + rho[:, :-1] <= D[:, 1:]]) | free[:, None]
        motion = self.equations.motion
        jumped = (apart > 2.0 * noise + rho[:, :-1] + rho[:, 1:])[motion].any(axis=0)
        of_path = np.isin([each.end for each in self.intervals[:-1]], self.problem.reference.joints)
        both = proved[:-1] & proved[1:]
        kinds: list[tuple[npt.NDArray[np.bool_], Joint]] = [
            (both & fits.all(axis=1).any(axis=0), "one branch"), (~both, "not proved"), (~of_path, "apart"),
            (jumped, "motion jumps"), (fits[:, motion].all(axis=1).max(axis=0), "inputs jump"),
            (np.ones_like(both), "apart"),
        ]  # fmt: skip
        chosen = np.stack([holds for holds, _ in kinds]).argmax(axis=0)
        return [kinds[k][1] for k in chosen.tolist()]

    # Following the branch -------------------------------------------------------------------------------------------

    def _followed(self) -> bool:
        """Answer again, from the proved interval beside it, the first that is not on its branch.

        From the beginning on; before the first interval that is proved at all, backwards from that.
        """
        self.joints = self._joints()
        for k, (a, b) in enumerate(pairwise(self.intervals), 1):
            joint = self.joints[k - 1]
            if not a.proved or (b.source and not b.proved):
                continue  # the branch is lost: later answers come from the guess
            if joint in {"one branch", "inputs jump"}:
                continue
            if b.proved and b.source:
                if b.depth >= _DEEPEST or joint == "motion jumps":
                    continue
                self.intervals[k : k + 1] = b.parts()
            self._answer_from(a, self.intervals[k : k + _AHEAD])
            return True
        first = next((k for k, each in enumerate(self.intervals) if each.proved), 0)
        if first and not self.intervals[first - 1].source:
            self._answer_from(self.intervals[first], self.intervals[first - 1 :: -1][:_AHEAD])
            return True
        return False

    def _answer_from(self, a: Interval, following: Sequence[Interval]) -> None:
        """Follow the motion by Newton's method from node to node, from an end of an interval that was answered."""
        array, source = self.equations.array, 1 if following[0].begin >= a.end else -1
        of_box = self.ring.nodes[: self._parameters.shape[1]].copy()
        of_box[:, 0] = source
        assert a.c is not None
        x, t, before = (self.ring.rows(of_box) @ a.c).T, a.end if source > 0 else a.begin, None
        for each in following:
            found = []
            for at in self._times(each)[::-source]:
                guess, same = predicted(array, x, before, at - t), np.full(x.shape[1], at)
                new = answers(self.problem, array, same, self._parameters, guess)
                before, x, t = (x, at - t), new, at
                found.append(new)
            each.c = self._interpolated(np.stack(found[::-source], axis=1).reshape(len(x), -1))
            each.source, each.tested, each.proved = source, False, False
