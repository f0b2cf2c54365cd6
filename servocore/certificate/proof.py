"""A motion proved on intervals that follow one another: answers, the interval Newton test, halving, and joints.

Every interval has one solution near its polynomial; neighbours belong to one branch where, at their joint, the solution
of one lies where that of the other is the only one. An interval before the start and one behind the end of a path show
that the motion begins and ends as the path does outside.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from servocore.certificate.chebyshev import UNIT, Model, arithmetic, model_of, norm
from servocore.certificate.equations import Box, equations_of, given_models, radii
from servocore.numerics.compiled_calls import Array, mapped, side_by_side
from servocore.numerics.just_in_time import JustInTime, in_machine_code
from servocore.numerics.memoization import made_once
from servocore.problem import Problem
from servocore.structure.derivative_array import DerivativeArray, nominal
from servocore.structure.inversion import Inversion, inversion

_DEGREE = 10
_FIRST = 8  # intervals of a path to begin with, each piece of it one at the least
_OUTSIDE = 1e-2  # of the duration: intervals before and behind the path
_REACH, _ENLARGED = 1e-5, 8.0  # D, of a peak; times the radius where that is more
_NARROW = 0.05  # of the tolerance
_DEEPEST = 14  # halvings
_GUESSED = 4  # halvings while answers come from the guess of the model
_COARSE = 20.0  # last coefficients, of the tolerance, that call for halves
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

    def halves(self) -> list[Interval]:
        """Return its halves, of which nothing is known."""
        middle, depth = (self.begin + self.end) / 2.0, self.depth + 1
        ends, before = ((self.begin, middle), (middle, self.end)), (self.before[1], self.relative)
        return [Interval(a, b, depth, self.outside, self.followed, before) for a, b in ends]


class Proof:
    """The motion of a flat problem on intervals, for all parameters of a box.

    Parameters
    ----------
    problem : Problem
        Without internal dynamics.
    boxed : Box
        Intervals of parameters.
    tolerance : float
        Of the inputs, as a share of their peaks: intervals are halved to a radius below it.
    raised : bool
        Whether rates are enclosed too.

    Attributes
    ----------
    narrow : float
        Radius of the inputs, of their peaks, at which no interval is halved any more.
    equations : Equations
        The equations.
    ring : Arithmetic
        Operations on polynomials in time and the parameters with an interval.
    intervals : list of Interval
        In their order.
    joints : list of str
        How each meets the next: "one branch", "inputs jump", "motion jumps", "apart" or "not proved".
    """

    @np.errstate(all="ignore")  # what is not finite is not proved
    def __init__(self, problem: Problem, boxed: Box, tolerance: float, raised: bool = False) -> None:
        p = problem.p.copy()
        p[list(boxed)] = [sum(interval) / 2.0 for interval in boxed.values()]
        self.problem, self.boxed, self.tolerance = replace(problem, p=p), boxed, tolerance
        self.narrow = tolerance if boxed else _NARROW * tolerance
        self.equations = equations_of(problem.resolved, raised)
        of_parameters = {1: 4, 2: 3}.get(len(boxed), 2)
        self.ring = arithmetic((_DEGREE, *(of_parameters for _ in boxed)))
        machine_code(self.equations.array).best(1)
        path = problem.reference
        count = np.maximum(np.ceil(_FIRST * np.diff(path.joints) / path.duration - 1e-9), 1).astype(int)
        grids = [np.linspace(a, b, n + 1).tolist() for (a, b), n in zip(pairwise(path.joints), count, strict=True)]
        margin = _OUTSIDE * path.duration
        self.intervals = [Interval(a, b) for grid in grids for a, b in pairwise(grid)]
        self.intervals.insert(0, Interval(path.start_time - margin, path.start_time, outside=True))
        self.intervals.append(Interval(path.end_time, path.end_time + margin, outside=True))
        while self._refined() or self._followed():
            if len(self.intervals) > _MOST:
                self.joints = self._joints()
                break

    @cached_property
    def peaks(self) -> Array:
        """Largest magnitude of each unknown at the first nodes, at least what counts as small, shape (unknowns,).

        That is 1e-6 of its nominal magnitude within the duration of the path, and of an input 1e-6 of the largest one.
        """
        array, duration, inputs = self.equations.array, self.problem.reference.duration, self.equations.inputs
        least = np.array([1e-6 * nominal(array.system, j) / duration**order for j, order in array.unknowns])
        values = self.ring.values(np.stack([each.x for each in self.intervals if each.x.size], axis=2))
        largest = np.fmax.reduce(np.abs(values), axis=(0, 2))
        least[inputs] = np.fmax(least[inputs], 1e-6 * np.fmax.reduce(largest[inputs], initial=1e-300))
        return np.asarray(np.fmax(least, largest))

    @property
    def unproved(self) -> list[Interval]:
        """The intervals without a proof."""
        return [each for each in self.intervals if not each.proved]

    def jumps_within(self, each: Interval) -> bool:
        """Whether inputs may jump within an interval, and the motion does not."""
        return each.proved and each.switches and each.relative > self.tolerance

    def _refined(self) -> bool:
        """Answer and test what is open, and halve what is not proved well enough; return whether there was any."""
        while fresh := [each for each in self.intervals if not each.x.size and not each.followed]:
            self._answer(fresh)
            self._halve(self._coarse(fresh))
        if fresh := [each for each in self.intervals if not each.D.size and each.solved]:
            self._test(fresh)
            self._test([each for each in fresh if not each.proved and np.isfinite(each.x[-1]).all()])
        many = sum(each.switches for each in self.intervals) > _SWITCHING
        halved = {each for each in self.intervals if self._too_wide(each) and not (many and each.switches)}
        self._halve(halved)
        return bool(halved)

    def _halve(self, halved: Collection[Interval]) -> None:
        parts = (each.halves() if each in halved else [each] for each in self.intervals)
        self.intervals = [part for some in parts for part in some]

    def _coarse(self, fresh: Sequence[Interval]) -> set[Interval]:
        """Return the intervals whose answers have polynomials in time with large last coefficients."""
        chosen = self.equations.curved.copy()
        chosen[self.equations.inputs] = True
        c = np.stack([each.x[:-1, chosen] for each in fresh], axis=2)
        share = (norm(c[self.ring.orders[0] >= _DEGREE - 1]) / self.peaks[chosen, None]).max(axis=0)
        large = (share > _COARSE * np.clip(self.narrow, 1e-12, 1e-8)).tolist()
        return {each for each, coarse in zip(fresh, large, strict=True) if coarse and each.depth < _GUESSED}

    def _too_wide(self, each: Interval) -> bool:
        """Whether an interval is not proved well enough, and halves may help.

        They do not where its radius, of rounding errors, is hardly less than that of what it is a quarter of.
        """
        if self.jumps_within(each):
            return not each.outside and each.depth < _DEEPEST
        if each.proved:
            return self.narrow < each.relative <= each.before[0] / 2.0 and each.depth < _DEEPEST
        return not each.followed and each.depth < _GUESSED

    # Answers and test -----------------------------------------------------------------------------------------------

    def _answer(self, some: Sequence[Interval], beside: Interval | None = None) -> None:
        """Answer at the nodes, by the guess of the model, or by Newton's method from the motion beside an interval."""
        nodes, array = self.ring.nodes, self.equations.array
        p = np.tile(self.problem.p[:, None], len(nodes))
        for axis, (k, (low, high)) in enumerate(self.boxed.items(), 1):
            p[k] = (low + high) / 2.0 + (high - low) / 2.0 * nodes[:, axis]
        t = np.concatenate([(k.begin + k.end) / 2.0 + (k.end - k.begin) / 2.0 * nodes[:, 0] for k in some])
        # Filled up to a power of two: few maps are compiled.
        full = np.minimum(np.arange(1 << (len(t) - 1).bit_length()), len(t) - 1)
        function = (machine_code(array).best(len(t), called=False) or inversion(array)).function
        arguments = [side_by_side(self.problem.reference.jet(t, array.reference_order)[full])]
        arguments.append(np.tile(p, len(some))[:, full])
        if beside is not None:
            points, function = nodes.copy(), inversion(array).search
            points[:, 0] = (2.0 * t - beside.begin - beside.end) / (beside.end - beside.begin)
            arguments.append((self.ring.rows(points) @ beside.x[:-1]).T[:, full])
        results = mapped(function, len(full))(*arguments)
        x, _, residual = (each.reshape(-1, len(full), order="F")[:, : len(t)] for each in results)
        x = np.where(np.isfinite(residual.max(axis=0)), x, np.nan)
        found = self._interpolated(x.reshape(len(x), len(some), -1).transpose(2, 0, 1))
        for k, each in enumerate(some):
            each.x, each.D, each.relative = found[:, :, k], np.zeros(0), np.inf

    def _interpolated(self, x: Array) -> Model:
        """Return polynomials from values (nodes, unknowns, intervals), NaN where there is no answer."""
        return np.where(np.isfinite(x).all(axis=0), self.ring.tried(x), np.nan)

    def given(self, some: Sequence[Interval]) -> Model:
        """Return models of path, parameters and time on intervals."""
        if new := [each for each in some if not each.given.size]:
            ends = np.array([(each.begin, each.end) for each in new]).T
            found = given_models(self.problem, self.equations.array, self.ring, ends, self.boxed)
            for k, each in enumerate(new):
                each.given = found[:, :, k]
        return np.stack([each.given for each in some], axis=2)

    def _test(self, some: Sequence[Interval]) -> None:
        """Test intervals within D, which is less where they were halved; more where that was tried and is too small.

        It is least for what equations switch by: they are known wherever that is not about to pass a jump.
        """
        if not some:
            return
        model, given, peaks = np.stack([each.x for each in some], axis=2), self.given(some), self.peaks[:, None]
        D = _REACH * peaks * np.array([0.5**each.depth for each in some])
        D[self.equations.switching] = _TIGHT * peaks[self.equations.switching]
        x, D = model[:-1], np.maximum(D, _ENLARGED * model[-1])
        for left in reversed(range(_CENTRED)):
            rho, switches, failed, shift = radii(self.equations, self.ring, x, given, D, self.peaks)
            if not left or not switches.any():
                break
            x = x - np.where(np.isfinite(shift) & switches, shift, 0.0)  # between what inputs jump from and to
        within = np.asarray((rho <= D)[self.equations.curved].all(axis=0) & np.isfinite(rho).all(axis=0))
        within &= ~switches | (rho <= _STEADY * peaks)[self.equations.steady].all(axis=0)
        relative = (rho / peaks)[self.equations.inputs].max(axis=0, initial=0.0)
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
        """Enclosures of unknowns, path, parameters and time on all intervals, once these are final."""
        return np.concatenate([self._found(), self.given(self.intervals)], axis=1)

    # Joints ---------------------------------------------------------------------------------------------------------

    def _joints(self) -> list[str]:
        """Return how neighbours meet, by coefficients in the parameters (terms, unknowns, joints) at their ends."""
        found = self._found()
        D = np.stack([each.D if each.proved else np.zeros(len(self.peaks)) for each in self.intervals], axis=1)
        c, rho = found[:-1], found[-1]
        shaped = c.reshape(_DEGREE + 1, -1, *c.shape[1:])
        early, late = np.tensordot((-1.0) ** np.arange(_DEGREE + 1), shaped, 1), shaped.sum(axis=0)
        noise = 2.0 * (_DEGREE + 2) * UNIT * (norm(c)[:, :-1] + norm(c)[:, 1:])
        apart = norm(late[..., :-1] - early[..., 1:]) + noise
        fits = np.stack([apart + rho[:, 1:] <= D[:, :-1], apart + rho[:, :-1] <= D[:, 1:]])
        fits |= self.equations.free[:, None]
        motion = self.equations.motion
        of_path = np.isin([each.end for each in self.intervals[:-1]], self.problem.reference.joints)
        proved = np.array([each.proved for each in self.intervals])
        both = proved[:-1] & proved[1:]
        jumps = (apart > 2.0 * noise + rho[:, :-1] + rho[:, 1:])[motion].any(axis=0)
        conditions = [~both, fits.all(axis=1).any(axis=0), ~of_path, jumps, fits[:, motion].all(axis=1).any(axis=0)]
        kinds = ["not proved", "one branch", "apart", "motion jumps", "inputs jump"]
        return np.select(conditions, kinds, "apart").tolist()  # type: ignore[no-any-return]  # NumPy's stubs

    def _followed(self) -> bool:
        """Answer the first interval that is not on the branch of a proved one beside it again, from that one.

        From the first proved interval to the end, and to the beginning. Intervals that following did not prove are
        halved.
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
                    self.intervals[n : n + 1] = b.halves()
                    b = self.intervals[n + (n < k)]
                b.followed = True
                self._answer([b], a)
                return True
        return False


@made_once
def machine_code(array: DerivativeArray) -> JustInTime[Inversion]:
    """Return the inversion in machine code, once it is worth it: each proof counts as one call."""
    return in_machine_code(inversion(array), ("function",), "the exact inversion", None)
