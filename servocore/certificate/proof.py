"""A motion proved on intervals that follow one another: answers, the interval Newton test, halving, and joints.

Every interval has one solution near its polynomial; neighbours belong to one branch where, at their joint, the solution
of one lies where that of the other is the only one. An interval before the start and one behind the end of a path show
that the motion begins and ends as the path does outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby, pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import UNIT, Arithmetic, Model, arithmetic, model_of, norm
from servocore.certificate.equations import Equations, answers, equations_of, given_models, machine_code
from servocore.certificate.krawczyk import radii
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
_MOST, _SWITCHING = 1200, 64  # intervals, and those with jumps of equations that are halved
_STEADY = 1e-8  # radius of what may not jump with the equations, of a peak
_TIGHT = 1e-11  # D of what they switch by
_CENTRED = 4  # steps of Newton's method to the middle of what inputs jump from and to


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
    followed : bool
        Whether answers continue the motion beside it; else they come from the guess of the model.
    before : tuple of (float, float)
        `relative` of the intervals that it is a quarter of, and a half.
    x : Model, shape (terms + 1, unknowns)
        Polynomials and radii; empty before there are answers.
    given : Model
        Of path, parameters and time; empty before it is asked for.
    D : ndarray, shape (unknowns,)
        Where solutions are the only ones; empty before the test.
    failed : int
        The first unknown that was not proved; -1 for none.
    switches : bool
        Whether equations may jump within.
    relative : float
        The largest radius of an input, of its peak; infinite if the motion is not proved.
    """

    begin: float
    end: float
    depth: int = 0
    outside: bool = False
    followed: bool = False
    before: tuple[float, float] = (np.inf, np.inf)
    x: Model = field(default_factory=lambda: np.zeros((0, 0)))
    given: Model = field(default_factory=lambda: np.zeros((0, 0)))
    D: Array = field(default_factory=lambda: np.zeros(0))
    failed: int = -1
    switches: bool = False
    relative: float = np.inf

    @property
    def proved(self) -> bool:
        """Whether the motion is proved."""
        return self.relative < np.inf

    @property
    def solved(self) -> bool:
        """Whether there are answers."""
        return bool(self.x.size and np.isfinite(self.x[:-1]).all())

    def parts(self, halvings: int = 1) -> list[Interval]:
        """Return its halves, or quarters and so on, of which nothing is known."""
        if not halvings:
            return [self]
        ends, depth = np.linspace(self.begin, self.end, 2**halvings + 1).tolist(), self.depth + halvings
        before = self.before[1], self.relative
        return [Interval(*each, depth, self.outside, self.followed, before) for each in pairwise(ends)]


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
        Of the inputs, as a share of their peaks: intervals are halved to a radius below it.
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
    def peaks(self) -> Array:
        """Largest magnitude of each unknown at the first nodes, at least what counts as small, shape (unknowns,).

        That is 1e-6 of its nominal magnitude within the duration of the path.
        """
        array, duration = self.equations.array, self.problem.reference.duration
        least = np.array([1e-6 * nominal(array.system, j) / duration**order for j, order in array.unknowns])
        values = self.ring.values(np.stack([each.x for each in self.intervals if each.x.size], axis=2))
        return np.asarray(np.fmax(least, np.fmax.reduce(np.abs(values), axis=(0, 2))))

    @cached_property
    def input_peaks(self) -> Array:
        """Peaks of the inputs; one that is next to nothing counts as a millionth of the largest."""
        peaks = self.peaks[self.equations.inputs]
        return np.asarray(np.maximum(peaks, 1e-6 * peaks.max(initial=1e-300)))

    @property
    def unproved(self) -> list[Interval]:
        """The intervals without a proof."""
        return [each for each in self.intervals if not each.proved]

    def jumps_within(self, each: Interval) -> bool:
        """Whether inputs may jump within an interval, and the motion does not."""
        return each.proved and each.switches and each.relative > self.tolerance

    @property
    def jumps(self) -> list[float]:
        """Times in s at which inputs alone jump: at joints of the path, and where equations switch."""
        path = self.problem.reference
        times = [each.end for each, joint in zip(self.intervals, self.joints, strict=False) if joint == "inputs jump"]
        for switching, run in groupby(self.intervals, self.jumps_within):
            first, *_, last = 2 * list(run)
            middle = path.start_time if first.outside else (first.begin + last.end) / 2.0
            times += [path.end_time if last.outside else middle] if switching else []
        return times

    @np.errstate(all="ignore")  # what is not finite is not proved
    def run(self) -> Proof:
        """Prove what can be proved."""
        machine_code(self.equations.array).best(1)
        path = self.problem.reference
        count = np.maximum(np.ceil(_FIRST * np.diff(path.joints) / path.duration - 1e-9), 1).astype(int)
        grids = [np.linspace(a, b, n + 1).tolist() for (a, b), n in zip(pairwise(path.joints), count, strict=True)]
        inner = [Interval(a, b) for grid in grids for a, b in pairwise(grid)]
        margin = _OUTSIDE * path.duration
        first = Interval(path.start_time - margin, path.start_time, outside=True)
        self.intervals = [first, *inner, Interval(path.end_time, path.end_time + margin, outside=True)]
        while self._refined() or self._followed():
            if len(self.intervals) > _MOST:
                self.joints = self._joints()
                break
        return self

    def _refined(self) -> bool:
        """Answer and test what is open, and halve what is not proved well enough; return whether there was any."""
        while fresh := [each for each in self.intervals if not each.x.size and not each.followed]:
            self._answer(fresh)
            self._replace(fresh, [each.parts(k) for each, k in zip(fresh, self._coarse(fresh), strict=True)])
        if fresh := [each for each in self.intervals if each.x.size and not each.D.size]:
            self._test(fresh, self._reach(fresh))
            again = [each for each in fresh if not each.proved and np.isfinite(each.x[-1]).all()]
            if again:
                D = np.stack([_ENLARGED * each.x[-1] for each in again], axis=1)
                self._test(again, np.maximum(D, self._reach(again)))
        many = sum(each.switches for each in self.intervals) > _SWITCHING
        halved = [each for each in self.intervals if self._too_wide(each) and not (many and each.switches)]
        self._replace(halved, [each.parts() for each in halved])
        return bool(halved)

    def _replace(self, old: Sequence[Interval], new: Sequence[list[Interval]]) -> None:
        """Put intervals in the places of others."""
        parts = dict(zip(map(id, old), new, strict=True))
        self.intervals = [part for each in self.intervals for part in parts.get(id(each), [each])]

    def _coarse(self, fresh: Sequence[Interval]) -> list[int]:
        """Return how many halvings answers need, as the last coefficients of their polynomials in time fall."""
        chosen = self.equations.curved.copy()
        chosen[self.equations.inputs] = True
        c = np.stack([each.x[:-1, chosen] for each in fresh], axis=2)
        last = norm(c[self.ring.orders[0] >= _DEGREE - 1])
        share = (last / self.peaks[chosen, None]).max(axis=0) / (_COARSE * np.clip(self._narrow, 1e-12, 1e-8))
        halvings = np.ceil(np.log(share) / -np.log(_LESS))
        depth = np.array([each.depth for each in fresh])
        known = np.where(np.isfinite(halvings), halvings, 0.0)
        return [int(each) for each in np.clip(known, 0.0, np.maximum(_GUESSED - depth, 0))]

    @property
    def _narrow(self) -> float:
        """Radius of the inputs, of their peaks, at which no interval is halved any more."""
        return self.tolerance if self.boxed else _NARROW * self.tolerance

    def _too_wide(self, each: Interval) -> bool:
        """Whether an interval is not proved well enough, and halves may help.

        They do not where its radius, of rounding errors, is hardly less than that of the interval of which it is a
        quarter.
        """
        if self.jumps_within(each):
            return not each.outside and each.depth < _DEEPEST
        if each.proved:
            return self._narrow < each.relative <= each.before[0] / 2.0 and each.depth < _DEEPEST
        return not each.followed and each.depth < _GUESSED

    # Answers and test -----------------------------------------------------------------------------------------------

    def _answer(self, some: Sequence[Interval], beside: Interval | None = None) -> None:
        """Answer at the nodes, by the guess of the model, or by Newton's method from the motion beside an interval."""
        nodes, guess = self.ring.nodes, None
        p = np.tile(self.problem.p[:, None], len(nodes))
        for axis, (k, (low, high)) in enumerate(self.boxed.items(), 1):
            p[k] = (low + high) / 2.0 + (high - low) / 2.0 * nodes[:, axis]
        t = np.concatenate([(k.begin + k.end) / 2.0 + (k.end - k.begin) / 2.0 * nodes[:, 0] for k in some])
        if beside is not None:
            points = nodes.copy()
            points[:, 0] = (2.0 * t - beside.begin - beside.end) / (beside.end - beside.begin)
            guess = (self.ring.rows(points) @ beside.x[:-1]).T
        x = answers(self.problem, self.equations.array, t, np.tile(p, len(some)), guess)
        found = self._interpolated(x.reshape(len(x), len(some), -1).transpose(2, 0, 1))
        for k, each in enumerate(some):
            each.x, each.D, each.relative = found[:, :, k], np.zeros(0), np.inf

    def _interpolated(self, x: Array) -> Model:
        """Return polynomials from values (nodes, unknowns, intervals), NaN where there is no answer."""
        found = self.ring.tried(x)
        found[:, ~np.isfinite(x).all(axis=0)] = np.nan
        return found

    def _reach(self, fresh: Sequence[Interval]) -> Array:
        """Return D (unknowns, intervals) to begin with: less on intervals that were halved, where it did not help.

        It is least for what equations switch by: they are known wherever that is not about to pass a jump.
        """
        D = _REACH * self.peaks[:, None] * np.array([0.5**each.depth for each in fresh])
        D[self.equations.switching] = _TIGHT * self.peaks[self.equations.switching, None]
        return np.asarray(D)

    @cached_property
    def _steady(self) -> npt.NDArray[np.bool_]:
        """Unknowns that may not jump with the equations: coordinates, velocities, and what those switch by."""
        places = [*self.equations.motion, *self.equations.switching]
        return np.isin(np.arange(len(self.peaks)), places)

    def given(self, some: Sequence[Interval]) -> Model:
        """Return models of path, parameters and time on intervals."""
        if new := [each for each in some if not each.given.size]:
            ends, order = ([each.begin for each in new], [each.end for each in new]), self.equations.array.reference_order
            found = given_models(self.problem, self.ring, *map(np.array, ends), order, self.boxed)
            for k, each in enumerate(new):
                each.given = found[:, :, k]
        return np.stack([each.given for each in some], axis=2)

    def _test(self, some: Sequence[Interval], D: Array) -> None:
        x, given = np.stack([each.x[:-1] for each in some], axis=2), self.given(some)
        solved: npt.NDArray[np.bool_] = np.asarray(np.isfinite(x).all(axis=(0, 1)))
        x = np.where(solved, x, 0.0)
        for left in reversed(range(_CENTRED)):
            rho, switches, failed, shift = radii(self.equations, self.ring, x, given, D, self.peaks)
            if not left or not switches.any():
                break
            x = x - np.where(np.isfinite(shift) & switches, shift, 0.0)  # between what inputs jump from and to
        rho = np.where(solved, rho, np.inf)
        within = np.asarray((rho <= D)[self.equations.curved].all(axis=0) & np.isfinite(rho).all(axis=0))
        within &= ~switches | (rho <= _STEADY * self.peaks[:, None])[self._steady].all(axis=0)
        relative = (rho[self.equations.inputs] / self.input_peaks[:, None]).max(axis=0, initial=0.0)
        for k, each in enumerate(some):
            each.D, each.failed, each.switches = D[:, k], int(failed[k]), bool(switches[k])
            each.relative = float(relative[k]) if within[k] else np.inf
            each.x = model_of(x[..., k] if within[k] else each.x[:-1], rho[:, k])

    def _found(self) -> Model:
        """Return enclosures of the unknowns on all intervals: any number where they are not proved."""
        nothing = self.ring.constant(np.zeros(len(self.peaks)))
        nothing[-1] = np.inf
        return np.stack([each.x if each.proved else nothing for each in self.intervals], axis=2)

    @cached_property
    def enclosures(self) -> Model:
        """Enclosures of unknowns, path, parameters and time on all intervals, arguments of walks, once they are final."""
        return np.concatenate([self._found(), self.given(self.intervals)], axis=1)

    # Joints ---------------------------------------------------------------------------------------------------------

    def _joints(self) -> list[Joint]:
        """Return how neighbours meet, by coefficients in the parameters (terms, unknowns, joints) at their ends."""
        found = self._found()
        D = np.stack([each.D if each.proved else np.zeros(len(self.peaks)) for each in self.intervals], axis=1)
        c, rho = found[:-1], found[-1]
        shaped = c.reshape(_DEGREE + 1, -1, *c.shape[1:])
        early, late = np.tensordot((-1.0) ** np.arange(_DEGREE + 1), shaped, 1), shaped.sum(axis=0)
        noise = 2.0 * (_DEGREE + 2) * UNIT * (norm(c)[:, :-1] + norm(c)[:, 1:])
        apart = norm(late[..., :-1] - early[..., 1:]) + noise
        rates = [unknown not in self.problem.array.unknowns for unknown in self.equations.array.unknowns]
        free = np.array(rates) | ~self.equations.curved  # rates may jump, and others are unique wherever they are
        fits = np.stack([apart + rho[:, 1:] <= D[:, :-1], apart + rho[:, :-1] <= D[:, 1:]]) | free[:, None]
        motion = self.equations.motion
        of_path = np.isin([each.end for each in self.intervals[:-1]], self.problem.reference.joints)
        proved = np.array([each.proved for each in self.intervals])
        both = proved[:-1] & proved[1:]
        kinds: list[tuple[npt.ArrayLike, Joint]] = [
            (~both, "not proved"), (fits.all(axis=1).any(axis=0), "one branch"), (~of_path, "apart"),
            ((apart > 2.0 * noise + rho[:, :-1] + rho[:, 1:])[motion].any(axis=0), "motion jumps"),
            (fits[:, motion].all(axis=1).max(axis=0), "inputs jump"), (np.ones_like(both), "apart"),
        ]  # fmt: skip
        return [kinds[k][1] for k in np.stack([holds for holds, _ in kinds]).argmax(axis=0).tolist()]

    def _followed(self) -> bool:
        """Answer the first interval that is not on the branch of a proved one beside it again, from that one.

        From the first proved interval to the end, and to the beginning. What was followed in vain is halved.
        """
        self.joints = self._joints()
        first = next((k for k, each in enumerate(self.intervals) if each.proved), 0)
        for order in (range(first, len(self.intervals)), range(first, -1, -1)):
            for k, n in pairwise(order):
                a, b, joint = self.intervals[k], self.intervals[n], self.joints[min(k, n)]
                if not a.proved and not b.x.size:  # the branch is lost: later answers come from the guess
                    b.followed = False
                    return True
                if not a.proved or joint in {"one branch", "inputs jump"}:
                    continue
                if b.followed and b.x.size:
                    if b.depth >= _DEEPEST or joint == "motion jumps":
                        continue
                    self.intervals[n : n + 1] = b.parts()
                    b = self.intervals[n + (n < k)]
                b.followed = True
                self._answer([b], a)
                return True
        return False
