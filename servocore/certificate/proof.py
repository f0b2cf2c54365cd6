"""A motion proved on intervals that follow one another: answers, the interval Newton test, halving, and joints.

Every interval has one solution near its polynomial; neighbours belong to one branch where, at their joint, the solution
of one lies where that of the other is the only one. An interval before the start and one behind the end of a path show
that the motion begins and ends as the path does outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.polynomial import chebyshev

from servocore.certificate.chebyshev import UNIT, Model, arithmetic, model_of, norm
from servocore.certificate.equations import Box, Equations, equations_of, given_models, radii
from servocore.numerics.compiled_calls import Array, Mask, mapped, side_by_side
from servocore.numerics.just_in_time import JustInTime, in_machine_code
from servocore.numerics.memoization import made_once
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.structure.derivative_array import DerivativeArray, nominal
from servocore.structure.inversion import Inversion, inversion

_DEGREE = 10
_FIRST, _BOXED = 5, 8  # intervals of a path to begin with: for each order of derivatives; for a box of parameters
_ORDERS = 4  # of derivatives at least
OUTSIDE = 1e-2  # of the duration: intervals before and behind the path
REACH, _ENLARGED = 1e-5, 8.0  # D, of a peak; times a radius proved before where that is more
_SHAPED = 3.0  # D, of the radii that the test before found: near poles other radii than those of peaks
_NARROW = 0.05  # of the tolerance: radius of the inputs at which no interval is halved any more
_DEEPEST = 14  # halvings
_GUESSED = 4  # halvings while answers come from the guess of the model
_COARSE = 20.0  # last coefficients, of the tolerance, that call for halves
_TESTS = 3  # more than one where D was too small
_TINY = 1e-12
_MOST, _FINE = 1200, 600  # intervals, and those up to which they are halved for accuracy alone
_STEADY = 1e-8  # radius of what may not jump with the equations, of a peak
_TIGHT = 1e-11  # D of what they switch by
_FEW = 64  # unknowns in one block
_ON = {"one branch", "inputs jump"}  # joints at which the motion goes on
_CENTRED = 4  # steps of Newton's method to the middle of what inputs jump from and to


def grid_of(path: Reference, count: int) -> Array:
    """Return the ends of so many intervals of a path, in s: each piece of it has one at the least."""
    counts = np.maximum(np.ceil(count * np.diff(path.joints) / path.duration - 1e-9), 1).astype(int)
    grids = [np.linspace(a, b, n + 1) for (a, b), n in zip(pairwise(path.joints), counts, strict=True)]
    return np.unique(np.concatenate(grids))


def smallest_peaks(problem: Problem, variables: Sequence[tuple[int, int]]) -> Array:
    """Return the least that counts as a peak of variables, each by its number and the order of its derivative."""
    duration = problem.reference.duration
    return np.array([1e-6 * nominal(problem.system, j) / duration**order for j, order in variables])


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
    equations : Equations
        The equations.
    ring : Arithmetic
        Operations on polynomials in time and the parameters with an interval.
    joints : list of str
        How each interval meets the next: "one branch", "inputs jump", "motion jumps", "apart" or "not proved".
    begin, end : ndarray, shape (N,)
        Of the intervals in their order, in s.
    depth : ndarray of int, shape (N,)
        How often an interval was halved.
    tested, switches : ndarray of bool, shape (N,)
        Whether an interval was tested, or has no answers to be tested; equations may jump within.
    before : ndarray, shape (2, N)
        `relative` of the intervals that it is a quarter of, and a half.
    x, given : Model, shape (terms + 1, unknowns, N) and (terms + 1, givens, N)
        Polynomials of the unknowns, NaN where there are no answers, with radii; path, parameters and time.
    D : ndarray, shape (unknowns, N)
        Where solutions are the only ones.
    failed : ndarray of int, shape (N,)
        The first block of equations that was not proved; -1 for none.
    relative : ndarray, shape (N,)
        The largest radius of an input, of its peak; infinite if the motion is not proved.
    """

    relative: Array

    @np.errstate(all="ignore")  # what is not finite is not proved
    def __init__(self, problem: Problem, boxed: Box, tolerance: float, raised: bool = False) -> None:
        path = problem.reference
        first, margin = _FIRST * max(problem.array.reference_order, _ORDERS), OUTSIDE * path.duration
        grid = [path.start_time - margin, *grid_of(path, _BOXED if boxed else first), path.end_time + margin]
        self._begin(problem, boxed, equations_of(problem.resolved, raised), tolerance, np.array(grid))
        machine_code(self.equations.answering).best(1)
        self._refine()
        self.joints = self._joints()
        for step in (1, -1):
            self._follow(step)
        wide = (self.relative > tolerance) & ~self.jumping
        if self.proved.all() and wide.any() and len(self.peaks) <= _FEW and not boxed:
            self._test(wide, equations_of(problem.resolved, raised, False, True))
            self.joints = self._joints()

    def _begin(self, problem: Problem, boxed: Box, equations: Equations, tolerance: float, grid: Array) -> None:
        """Begin with intervals between instants, of which nothing is known."""
        of_parameters = {1: 4, 2: 3}.get(len(boxed), 2)
        self.boxed, self.ring = boxed, arithmetic((_DEGREE, *(of_parameters for _ in boxed)))
        self._narrow = tolerance if boxed else _NARROW * tolerance
        self._most = _MOST // 3 ** len(boxed)  # operations take the longer the more coefficients there are
        self.problem, self.equations, self.tolerance, self.joints = problem, equations, tolerance, list[str]()
        n, unknowns = len(grid) - 1, len(equations.block)
        self.begin, self.end, self.depth, self.failed = grid[:-1], grid[1:], np.zeros(n, dtype=int), np.full(n, -1)
        self.tested, self.switches = np.zeros((2, n), dtype=bool)
        self.relative, self.before = np.full(n, np.inf), np.full((2, n), np.inf)
        self.x, self.D = np.full((len(self.ring.nodes) + 1, unknowns, n), np.nan), np.zeros((unknowns, n))
        self.given = np.zeros((len(self.x), equations.symbols.numel() - unknowns, n))

    @cached_property
    def peaks(self) -> Array:
        """Largest magnitude of each unknown at the first nodes, at least what counts as small, shape (unknowns, 1).

        That is 1e-6 of its nominal magnitude within the duration of the path, and of an input 1e-6 of the largest one.
        """
        array, inputs = self.equations.array, self.equations.inputs
        least = smallest_peaks(self.problem, array.determined)
        largest = np.fmax.reduce(np.abs(self.ring.values(self.x)), axis=(0, 2))
        least = np.pad(least, (0, len(largest) - len(least)), constant_values=_TINY)  # of derivatives by states
        least[inputs] = np.fmax(least[inputs], 1e-6 * np.fmax.reduce(largest[inputs], initial=1e-300))
        return np.asarray(np.fmax(least, largest)[:, None])

    @property
    def proved(self) -> Mask:
        """Whether the motion is proved on intervals."""
        return np.asarray(self.relative < np.inf)

    @property
    def joined(self) -> Mask:
        """Whether intervals are proved and on one branch with the first."""
        lost = [time for time, joint in zip(self.end.tolist(), self.joints, strict=False) if joint not in _ON]
        return np.asarray(self.proved & (self.begin < min(lost, default=np.inf)))

    @property
    def solved(self) -> Mask:
        """Whether there are answers on intervals."""
        return np.asarray(np.isfinite(self.x[:-1]).all(axis=(0, 1)))

    @property
    def within(self) -> Mask:
        """Whether intervals are within the path, and not before or behind it."""
        path = self.problem.reference
        return np.asarray((self.begin >= path.start_time) & (self.end <= path.end_time))

    @property
    def jumping(self) -> Mask:
        """Whether inputs may jump within intervals, and the motion does not."""
        return np.asarray(self.proved & self.switches & (self.relative > self.tolerance))

    def _refine(self) -> None:
        """Answer by the guess of the model and test what is open, and halve what is not proved well enough."""
        while not self.tested.all() and len(self.begin) <= self._most:
            while (fresh := ~self.tested & ~self.solved).any():
                self._answer(fresh)
                self._halve(fresh & self._coarse())
            self._test(~self.tested, self.equations)
            self._halve(np.where(self.proved, self._too_wide(), self.depth < _GUESSED))

    def _follow(self, step: int) -> None:
        """Answer intervals that are not on the branch of the proved one beside them again, from that one.

        From the first proved interval to the end, or to the beginning. Those that are not proved then are halved.
        """
        k, tried, wide = int(self.proved.argmax()), False, self._too_wide()
        while 0 <= (n := k + step) < len(self.begin) <= self._most:
            joint, lost = self.joints[min(k, n)], np.isinf(self.relative[k])
            joined, ended = joint in _ON, joint == "motion jumps" or self.depth[n] >= _DEEPEST
            if (lost and self.tested[n]) or (joined and not wide[n]) or (tried and ended):
                k, tried = n, False
                continue
            count, one = len(self.begin), np.arange(len(self.begin)) == n
            if lost:  # later answers come from the guess
                self._refine()
            elif tried or joined:
                self._halve(one)
                tried = False
            else:
                self._answer(one, k)
                self._test(one & ~self.tested, self.equations)
                tried = True
            k += (len(self.begin) - count) * (step < 0)
            self.joints, wide = self._joints(), self._too_wide()

    def _halve(self, halved: Mask) -> None:
        """Replace intervals by their halves, of which nothing is known.

        Of intervals outside the path the halves beside it are enough.
        """
        path, middle = self.problem.reference, (self.begin + self.end) / 2.0
        parts = np.repeat(np.arange(len(halved)), 1 + halved)
        late = np.diff(parts, prepend=-1) == 0
        begin = np.where(late, middle[parts], self.begin[parts])
        end = np.where(halved[parts] & ~late, middle[parts], self.end[parts])
        beside = (path.start_time <= end) & (begin <= path.end_time)
        parts = parts[beside]
        for name in "depth", "failed", "tested", "switches", "relative", "before", "x", "D", "given":
            setattr(self, name, getattr(self, name)[..., parts])
        self.begin, self.end, new = begin[beside], end[beside], halved[parts]
        self.depth, self.before[:, new] = self.depth + new, [self.before[1, new], self.relative[new]]
        self.tested[new], self.relative[new], self.x[..., new] = False, np.inf, np.nan

    def _coarse(self) -> Mask:
        """Return whether answers from the guess have polynomials in time with large last coefficients."""
        chosen = self.equations.curved.copy()
        chosen[self.equations.inputs] = True
        last = norm(self.x[:-1][self.ring.orders[0] >= _DEGREE - 1][:, chosen])
        large = (last / self.peaks[chosen]).max(axis=0) > _COARSE * np.clip(self._narrow, 1e-12, 1e-8)
        return np.asarray(large & (self.depth < _GUESSED))

    def _too_wide(self) -> Mask:
        """Return whether intervals are proved, not well enough, and halves may help.

        They do not where a radius below the tolerance, of rounding errors, or that of a box is hardly less than that of
        what an interval is a quarter of, and a half where it is nearly small enough. There are never so many that none
        are left for what is not proved.
        """
        before = np.where(self.relative < 2.0 * self._narrow, self.before[1], self.before[0])
        wide = (self.relative <= before / 2.0) | ((self.relative > self.tolerance) & (not self.boxed))
        wide &= self._narrow < self.relative
        wide = np.where(self.jumping, self.within, wide) & self.proved & (self.depth < _DEEPEST)
        return np.asarray(wide & (len(wide) + wide.sum() <= _FINE))

    # Answers and test -----------------------------------------------------------------------------------------------

    def _answer(self, some: Mask, beside: int | None = None) -> None:
        """Answer at the nodes, by the guess of the model, or by Newton's method from the motion beside an interval."""
        array, ring = self.equations.answering, self.ring
        given = given_models(self.problem, array, ring, np.stack([self.begin, self.end])[:, some], self.boxed)
        values = np.moveaxis(ring.values(given), 2, 0).reshape(-1, given.shape[1])
        count, outputs = len(values), array.system.gamma.size1()
        size = outputs * (array.reference_order + 1)
        arguments = [side_by_side(values[:, :size].reshape(count, -1, outputs)), values[:, size:-1].T]
        function = (machine_code(array).best(count, called=False) or inversion(array)).function
        if beside is not None:
            points, function = ring.nodes[np.arange(count) % len(ring.nodes)], inversion(array).search
            begin, end = self.begin[beside], self.end[beside]
            points[:, 0] = (2.0 * values[:, -1] - begin - end) / (end - begin)
            arguments.append((ring.rows(points) @ self.x[:-1, :, beside]).T)
        x, _, residual = (each.reshape(-1, count, order="F") for each in mapped(function, count)(*arguments))
        x = np.where(np.isfinite(residual.max(axis=0)), x[self.equations.answered], np.nan)
        self.x[..., some] = self._interpolated(np.moveaxis(x.reshape(len(x), -1, len(ring.nodes)), 2, 0))
        self.given[..., some] = given
        self.tested[some], self.relative[some] = ~self.solved[some], np.inf

    def _interpolated(self, x: Array) -> Model:
        """Return polynomials from values (nodes, unknowns, intervals), NaN where there is no answer."""
        return np.where(np.isfinite(x).all(axis=0), self.ring.tried(x), np.nan)

    def _test(self, some: Mask, equations: Equations) -> None:
        """Test intervals within D, which is less where they were halved; where it is too small, in the radii's shape.

        It is least for what equations switch by: they are known wherever that is not about to pass a jump. Where they
        jump, steps of Newton's method go between what inputs jump from and to. Nothing is kept that proves less than
        was known.
        """
        for tests in range(_TESTS):
            if not some.any():
                return
            model, given, peaks = self.x[..., some], self.given[..., some], self.peaks
            x = model[:-1]
            if tests:  # more than what ends are rounded by at joints
                D = np.maximum(_SHAPED * model[-1], _TINY * np.maximum(norm(x), peaks))
            else:
                D = REACH * peaks * 0.5 ** self.depth[some]
                D[equations.switching] = _TIGHT * peaks[equations.switching]
                D = np.maximum(D, _ENLARGED * model[-1])
            for left in reversed(range(_CENTRED)):
                rho, switches, failed, shift = radii(equations, self.ring, x, given, D, peaks)
                if not left or not switches.any():
                    break
                x = x - np.where(np.isfinite(shift) & switches, shift, 0.0)
            within = np.asarray((rho <= D)[equations.curved].all(axis=0) & np.isfinite(rho).all(axis=0))
            within &= ~switches | (rho <= _STEADY * peaks)[equations.steady].all(axis=0)
            relative = np.where(within, (rho / peaks)[equations.inputs].max(axis=0, initial=0.0), np.inf)
            better = relative <= self.relative[some]
            kept = np.flatnonzero(some)[better]
            self.D[:, kept], self.failed[kept], self.switches[kept] = D[:, better], failed[better], switches[better]
            self.x[..., kept] = model_of(np.where(within, x, model[:-1]), rho)[..., better]
            self.relative[kept], self.tested[kept] = relative[better], True
            some = some & ~self.proved & np.isfinite(self.x[-1]).all(axis=0)

    @property
    def enclosures(self) -> Model:
        """Enclosures of unknowns, path, parameters and time on all intervals: any number where they are not joined."""
        joined = self.joined
        x = np.where(joined, self.x, 0.0)
        x[-1, :, ~joined] = np.inf
        return np.concatenate([x, self.given], axis=1)

    def at(self, models: Model, t: Array) -> Model:
        """Return models on all intervals at times (N,), polynomials in the parameters; infinite radii elsewhere."""
        numbers = np.searchsorted(self.end[:-1], t, side="right")
        a, b = self.begin[numbers], self.end[numbers]
        position = (2.0 * t - a - b) / (b - a)
        found = models[..., numbers]
        basis = chebyshev.chebvander(np.clip(position, -1.0, 1.0), self.ring.degrees[0])
        shaped = found[:-1].reshape(basis.shape[1], -1, *found.shape[1:])
        # A time is off by rounding in the middle of an interval: that is a share of what the polynomials vary by.
        late = 1.0 + (np.abs(a) + np.abs(b)) / (b - a)
        noise = np.tensordot(np.arange(basis.shape[1]) ** 2.0, np.abs(shaped), 1).sum(axis=0) * late
        noise = 8.0 * UNIT * (noise + 12.0 * norm(found[:-1]))
        radius = np.where(np.abs(position) > 1.0 + 1e-9, np.inf, found[-1] + noise)
        return model_of(np.einsum("nd,dpkn->pkn", basis, shaped), radius)

    # Joints ---------------------------------------------------------------------------------------------------------

    def _joints(self) -> list[str]:
        """Return how neighbours meet, by coefficients in the parameters (terms, unknowns, joints) at their ends."""
        (early, late), size, rho, D = self.ring.ends(self.x), norm(self.x[:-1]), self.x[-1], self.D
        noise = 2.0 * (_DEGREE + 2) * UNIT * (size[:, :-1] + size[:, 1:])
        apart = norm(late[..., :-1] - early[..., 1:]) + noise
        near = np.stack([apart + rho[:, 1:] <= D[:, :-1], apart + rho[:, :-1] <= D[:, 1:]])
        fits = near | self.equations.free[:, None]
        motion, inputs = self.equations.motion, self.equations.inputs
        both, one = self.proved[:-1] & self.proved[1:], fits.all(axis=1).any(axis=0)
        of_path = np.isin(self.end[:-1], self.problem.reference.joints)
        # Also of what is unique wherever it is; less is a rounding error, as is less than D where the path is smooth.
        lacking = self.problem.array.reference_order - self.problem.reference.smoothness
        rough = lacking > np.isin(np.arange(len(apart)), motion)[:, None]
        leaps = of_path & (apart > noise + rho[:, :-1] + rho[:, 1:] + _STEADY * self.peaks)
        leaps &= rough | ~near.any(axis=0)
        conditions = [~both, leaps[motion].any(axis=0), one & ~leaps[inputs].any(axis=0), ~of_path]
        conditions.append(fits[:, motion].all(axis=1).any(axis=0))
        kinds = ["not proved", "motion jumps", "one branch", "apart", "inputs jump"]
        return np.select(conditions, kinds, "apart").tolist()  # type: ignore[no-any-return]  # NumPy's stubs


class PartialProof(Proof):
    """The motion of one input, and of what it depends on, on a part of the path.

    Parameters
    ----------
    problem : Problem
        Without internal dynamics.
    unknown : int
        Number of the input among the unknowns.
    tolerance : float
        Of the input, as a share of its peak there.
    grid : ndarray
        Ends of the intervals to begin with, in s.
    """

    @np.errstate(all="ignore")  # what is not finite is not proved
    def __init__(self, problem: Problem, unknown: int, tolerance: float, grid: Array) -> None:
        self._begin(problem, {}, equations_of(problem.resolved, False, of=unknown), tolerance, grid)
        self._refine()
        self.joints = self._joints()


@made_once
def machine_code(array: DerivativeArray) -> JustInTime[Inversion]:
    """Return the inversion in machine code, once it is worth it: each proof counts as one call."""
    return in_machine_code(inversion(array), ("function",), "the exact inversion", None)
