"""Where along a motion the constraints lose rank: two motions meet there, and either may go on.

A parallelogram stretched out can go on as a parallelogram or cross over; a crank in its dead centre can let its
rocker go either way. At such an instant the Jacobian S = [G; C] of holonomic and servo constraints loses rank, and its
Gram determinant det(S S^T), smooth and never negative, touches zero. It is watched at the instants of a motion; where a
parabola through three of them comes down to zero, the instant is looked for by the smallest singular value.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import IntegrationFailed, ServocoreWarning
from servocore.numerics.compiled_calls import Array, Call, at_instants
from servocore.numerics.components import LARGE, Part, parts_of
from servocore.numerics.conditioning import gram_determinants
from servocore.numerics.constraint_ranks import Rows, assembled
from servocore.numerics.interpolation import lagrange
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.solution import Solution
from servocore.stepping.observation import observed

CONDITION_LIMIT = 1e5
"""Of the scaled Jacobian of all constraints: beyond it they count as dependent."""

_WATCHED = 201  # most instants of a motion that are checked
_TOUCHES = 0.1  # of the determinants beside it: a parabola's minimum below this is examined
_SUBSTEPS = 12  # before the instant, to go through it as the motion would go on
_ASTRAY = 0.1  # of how far the motion moves meanwhile: further from where it would have gone on is another branch
_JUMP = 10.0  # of the third differences beside it: one across the instant that is larger is a change of branch
_BESIDE = 4  # third differences on either side


@dataclass(frozen=True)
class RankLoss:
    """An instant at which constraints lose rank.

    Attributes
    ----------
    time : float
        In s.
    condition : float
        Condition number found there, beyond `CONDITION_LIMIT`.
    holonomic : bool
        Whether the holonomic constraints alone lose rank, and not only together with the servo constraints.
    """

    time: float
    condition: float
    holonomic: bool

    def __str__(self) -> str:
        which = "the holonomic constraints" if self.holonomic else "the holonomic and servo constraints together"
        return (
            f"at t = {self.time:.6g} s {which} lose rank (condition {self.condition:.2g}, the limit is"
            f" {CONDITION_LIMIT:.0e}) and two motions go on from there"
        )


def rank_losses(problem: Problem, t: Array, q: Array) -> list[RankLoss]:
    """Find where along a motion the constraints lose rank.

    Parameters
    ----------
    problem : Problem
        The problem that was solved.
    t : ndarray, shape (N,)
        Instants of the motion, in rising order.
    q : ndarray, shape (N, n)
        Configurations there.
    """
    if not problem.system.lam.numel() or len(t) < 3 or not np.isfinite(q).all():
        return []
    entries, magnitudes = _entries(problem, t, q), _magnitudes(problem, q)
    losses = []
    for part in constraint_entries(problem.resolved).parts:
        if len(part.rows) and len(part.columns):
            losses += _losses(problem, t, q, part, part.dense(entries) * magnitudes[part.columns])
    return sorted(losses, key=lambda loss: loss.time)


def _magnitudes(problem: Problem, q: Array) -> Array:
    """Return how large coordinates count: their nominal values, or how far they go if that is more, up to one unit.

    A nominal value that follows from how far the path goes does so where the model is at home, which may be a special
    place: there a direction that turns changes by the square of the angle.
    """
    nominal = np.array(problem.system.coordinates.nominal)
    larger: Array = np.maximum(nominal, np.minimum(1.0, np.ptp(q, axis=0)))
    return larger


def _losses(problem: Problem, t: Array, q: Array, part: Part, jacobians: Array) -> list[RankLoss]:
    """Find where constraints lose rank that have coordinates of their own; `jacobians` is S at all instants, scaled."""
    scale = np.maximum(np.linalg.norm(jacobians, axis=2).max(axis=0), 1e-300)[None, :, None]
    jacobians = jacobians / scale
    if jacobians.shape[1] < LARGE:
        signs, logarithms = np.linalg.slogdet(jacobians @ jacobians.transpose(0, 2, 1))
    else:
        signs, logarithms = gram_determinants(jacobians)
    largest = float(np.max(logarithms))
    if not np.isfinite(largest):
        return []
    determinant = np.where(signs > 0.0, np.exp(logarithms - largest), 0.0)
    touching = np.flatnonzero(_touching(t, determinant))
    if not len(touching):
        return []
    motion = _Motion.of(problem, t, q, part, scale.ravel())
    closest = [_closest(motion, int(k)) for k in touching]
    return [each for each in closest if each is not None and each.condition > CONDITION_LIMIT]


def _touching(t: Array, determinant: Array) -> npt.NDArray[np.bool_]:
    """Mark local minima at which a parabola through them and their neighbours comes down to zero, about."""
    left, here, right = determinant[:-2], determinant[1:-1], determinant[2:]
    before, after = t[1:-1] - t[:-2], t[2:] - t[1:-1]
    rise, fall = (right - here) / after, (here - left) / before
    curvature = (rise - fall) / (before + after)
    slope = (rise * before + fall * after) / (before + after)
    with np.errstate(divide="ignore", invalid="ignore"):
        minimum = here - slope**2 / (4.0 * curvature)
    touches = np.zeros(len(t), dtype=bool)
    # Of two equal neighbours one is enough.
    touches[1:-1] = (here < left) & (here <= right) & (minimum <= _TOUCHES * np.maximum(left, right))
    touches[[0, -1]] = determinant[[0, -1]] < CONDITION_LIMIT**-2
    return touches


@dataclass(frozen=True, eq=False)
class _Motion:
    """A motion between its instants: configurations that satisfy constraints, from interpolated ones.

    Of constraints with separate coordinates only these are examined; q is divided by its magnitudes.
    """

    problem: Problem
    t: Array
    q: Array
    magnitudes: Array
    row_scale: Array
    evaluate: Call
    holonomic: int  # so many of the constraints are

    @classmethod
    def of(cls, problem: Problem, t: Array, q: Array, part: Part | None, row_scale: Array) -> _Motion:
        """Compile the rank of a part of the constraints, or of all of them."""
        magnitudes, holonomic = _magnitudes(problem, q), problem.system.lam.numel()
        if part is None:
            evaluate = constraint_rows(problem.resolved)
        else:
            rows, columns = tuple(part.rows.tolist()), tuple(part.columns.tolist())
            evaluate, holonomic = constraint_rows(problem.resolved, rows, columns), int(sum(part.rows < holonomic))
            q, magnitudes = q[:, part.columns], magnitudes[part.columns]
        return cls(problem, t, q / magnitudes, magnitudes, row_scale, evaluate, holonomic)

    def configuration(self, time: float, start: Array) -> Array | None:
        """Return q near `start` where the constraints hold at a time; None if there is none."""
        return assembled(self._rows(time), start)

    def jacobian(self, time: float) -> Array | None:
        """Return the scaled Jacobian at a time; None if no configuration is found."""
        place = self.configuration(time, self.interpolated(time))
        return None if place is None else self._rows(time)(place)[1]

    def interpolated(self, time: float) -> Array:
        """Return q between the instants."""
        return np.array([np.interp(time, self.t, column) for column in self.q.T])

    def _rows(self, time: float) -> Rows:
        jet = self.problem.reference.jet(time, 0).T

        def rows(x: Array) -> tuple[Array, Array]:
            residual, jacobian = self.evaluate(x * self.magnitudes, jet, self.problem.p)
            jacobian = jacobian.reshape(len(self.row_scale), -1)
            return residual.ravel() / self.row_scale, jacobian * self.magnitudes / self.row_scale[:, None]

        return rows


def _closest(motion: _Motion, k: int) -> RankLoss | None:
    """Look for the loss of rank between the instants beside instant `k`."""
    import scipy.optimize  # noqa: PLC0415 - kept out of the run time of an FMU

    def badness(time: float) -> float:
        jacobian = motion.jacobian(time)
        return 1.0 if jacobian is None else _condition(jacobian) ** -2

    first, last = motion.t[max(0, k - 1)], motion.t[min(len(motion.t) - 1, k + 1)]
    search = scipy.optimize.minimize_scalar(
        badness, bounds=(first, last), method="bounded", options={"xatol": 1e-9 * (last - first)}
    )
    times = [float(search.x), float(motion.t[k])]
    time = min(times, key=badness)
    jacobian = motion.jacobian(time)
    if jacobian is None:
        return None
    holonomic = _condition(jacobian[: motion.holonomic]) > CONDITION_LIMIT
    return RankLoss(time, _condition(jacobian), holonomic)


def _condition(jacobian: Array) -> float:
    values = np.linalg.svd(jacobian, compute_uv=False)
    return float(values[0] / max(values[-1], 1e-300))


def _entries(problem: Problem, t: Array, q: Array) -> Array:
    """Return the entries of S at every configuration, shape (nnz, N)."""
    compiled = constraint_entries(problem.resolved)
    jets = problem.reference.jet(t, 0) if compiled.on_path else np.zeros((len(t), 1, problem.reference.dimension))
    return at_instants(compiled.function, q.T, jets=jets, p=problem.p)[0]


class _Entries(NamedTuple):
    """(q, gamma, p) -> the entries of S = [G; C], column by column; its parts; and whether it holds the path at all.

    gamma is the path at an instant, shape (m,), with the time if the system holds it.
    """

    function: ca.Function
    parts: tuple[Part, ...]
    on_path: bool


@made_once
def constraint_entries(resolved: ResolvedSystem) -> _Entries:
    """Compile the entries of all constraints' Jacobian, and find its independent parts."""
    system = resolved.system
    S, path = ca.vertcat(system.G, system.C), system.gamma[:, 0]
    function = ca.Function("sc_S", [system.q, path, system.p], [S.nz[:]])
    return _Entries(function, parts_of(S.sparsity()), bool(ca.depends_on(S, path)))


@made_once
def constraint_rows(
    resolved: ResolvedSystem, rows: tuple[int, ...] | None = None, columns: tuple[int, ...] | None = None
) -> Call:
    """Compile (q, gamma, p) -> residual of the constraints, S = [G; C]; of some rows, which hold some columns only."""
    system = resolved.system
    residual, S = ca.vertcat(system.constraints, system.output - system.path[:, 0]), ca.vertcat(system.G, system.C)
    taken = [
        list(range(size)) if some is None else list(some) for some, size in zip((rows, columns), S.shape, strict=True)
    ]
    results = [ca.densify(residual[taken[0]]), ca.densify(S[taken[0], taken[1]])]
    return Call(ca.Function("sc_S_rows", [system.q[taken[1]], system.gamma[:, 0], system.p], results))


def require_one_branch(problem: Problem, solution: Solution) -> str:
    """Warn where the constraints of a solution lose rank, and refuse a solution that changes branch there.

    Returns the warning, to be added to the statement on the branch.

    Raises
    ------
    IntegrationFailed
        If the configurations do not go on as they came.
    """
    places = _columns(problem.resolved, solution.names) if problem.system.lam.numel() else None
    if places is None:
        return ""
    passed, count = "", len(solution.t)
    every = -(-count // _WATCHED)
    watched = np.append(np.arange(0, count - 1, every), count - 1)
    for loss in rank_losses(problem, solution.t[watched], solution.values[watched[:, None], places]):
        if changes_branch(problem, solution.t, solution.values[:, places], loss.time):
            raise IntegrationFailed(
                f"{solution.route}: {loss}; this one changes over from one to the other: a scene with follow_branch and"
                " a smaller step goes on smoothly in the form Reduced()"
            )
        ends = min(loss.time - solution.t[0], solution.t[-1] - loss.time) < 1e-6 * np.ptp(solution.t)
        how = "this one begins or ends there" if ends else "this one goes on smoothly"
        passed += f"; {loss}; {how}"
        warnings.warn(f"{solution.route}: {loss}; {how}", ServocoreWarning, stacklevel=3)
    return passed


def configurations(problem: Problem, solution: Solution) -> Array | None:
    """Return the coordinates of a solution, shape (N, n); None where it does not report them by their names."""
    places = _columns(problem.resolved, solution.names)
    return None if places is None else solution.values[:, places]


@made_once
def _columns(resolved: ResolvedSystem, names: tuple[str, ...]) -> list[int] | None:
    """Places of the coordinates among reported names; None if one is missing or its name is that of something else."""
    reported = {quantity.name: expression for quantity, expression in observed(resolved.system)}
    coordinates = resolved.system.coordinates
    if not set(coordinates.names) <= set(names):
        return None
    if not all(ca.is_equal(reported[name], coordinates[name]) for name in coordinates.names):
        return None
    return [names.index(name) for name in coordinates.names]


def changes_branch(problem: Problem, t: Array, q: Array, time: float) -> bool:
    """Whether a motion q, shape (N, n), at the instants `t` does not go on smoothly at a time when rank is lost.

    Where the constraints determine the configuration, the smooth motion is followed through that time in small steps
    and compared. Elsewhere a third difference across it must not stand out, which needs small steps.
    """
    apart = np.abs(t - time) > 0.25 * np.diff(t).max()
    before, after = np.flatnonzero(apart & (t < time)), np.flatnonzero(apart & (t > time))
    if not len(before) or not len(after):
        return False  # it starts or ends there
    system = problem.system
    if len(system.coordinates) == system.lam.numel() + len(system.outputs):
        motion = _Motion.of(problem, t, q, None, np.ones(len(system.coordinates)))
        first, last = (motion.q[k] for k in (before[-1], after[0]))
        smooth = _followed(motion, float(t[before[-1]]), time, float(t[after[0]]), first)
        if smooth is not None:
            return bool(np.abs(last - smooth).max() > _ASTRAY * np.abs(smooth - first).max())
    return _has_kink(t, q / _magnitudes(problem, q), time)


def _followed(motion: _Motion, begin: float, through: float, end: float, first: Array) -> Array | None:
    """Follow a motion from `begin` to `end` in small steps, of which one has the time `through` in its middle."""
    step = (through - begin) / (_SUBSTEPS + 0.5)
    times = [begin, *np.arange(begin + step, end - 0.25 * step, step), end]
    places = [first]
    for k in range(1, len(times)):
        known = slice(max(0, k - 3), k)
        ahead = np.column_stack(places[known]) @ np.asarray(lagrange(times[known], [times[k]])).ravel()
        x = motion.configuration(times[k], ahead)
        if x is None:
            return None
        places.append(x)
    return places[-1]


def _has_kink(t: Array, x: Array, time: float) -> bool:
    steps = np.diff(t)
    if len(t) < 2 * _BESIDE or np.ptp(steps) > 1e-6 * steps.max():
        return False
    third = np.abs(np.diff(x, 3, axis=0)).max(axis=1)
    after = int(np.searchsorted(t, time))
    first = max(0, after - 3)  # differences over t[k] to t[k + 3] from here on hold the time inside
    beside = [*third[max(0, first - _BESIDE) : first], *third[after : after + _BESIDE]]
    across = third[first:after]
    return bool(len(across) and beside and across.max() > _JUMP * max(*beside, 1e-9))
