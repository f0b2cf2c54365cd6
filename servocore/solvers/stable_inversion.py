"""Stable inversion where the internal dynamics are unstable: a boundary value problem over the whole horizon.

Forward in time unstable internal dynamics grow without bound, backward the stable ones do. The solution that stays
bounded (stable inversion, Devasia, Chen & Paden 1996; as boundary value problem Taylor & Li 2002) starts to act before
the path begins and ends after it: at the left end of a longer horizon it lies on the unstable manifold of the
equilibrium there, at the right end on the stable one. Along a path that repeats itself, the bounded solution repeats
itself as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from servocore.checks.better_solutions import NOTICED, BetterSolver, stated_branch
from servocore.checks.findings import ROUND_OFF
from servocore.dae import Dae
from servocore.errors import IntegrationFailed, InvalidModel, InvalidReference, InvalidSetting, require_real
from servocore.formulations.base import Formulation
from servocore.formulations.reduced import Reduced
from servocore.methods.collocation import Gauss
from servocore.numerics.compiled_calls import Array, Places, mapped, repeated, side_by_side
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import subdivided
from servocore.solution import Solution
from servocore.solvers.route import JudgedRoute, require_tolerance
from servocore.solvers.runs import Progress, of_states, require_derivatives, solution_of_states, step_of
from servocore.structure.zero_dynamics import Equilibrium, internal_equilibrium

_MOST_HALVINGS = 8
_MOST_STEPS = 100_000  # of the horizon
_MOST_ITERATIONS = 30
_OTHERWISE = "Reduced() with a method computes the motion that starts at rest"


@dataclass(frozen=True)
class StableInversion(JudgedRoute):
    """Stable inversion by Gauss collocation over a horizon longer than the path, or over one period of it.

    A path that comes back to where it began, with all derivatives that enter, counts as one period (or several) of a
    periodic motion; the horizon is then the path itself. Any other must be at rest at its ends.

    Parameters
    ----------
    tolerance : float
        The mesh is halved until no input changes by more, relative to its peak. The truncation before and after
        the horizon has that size as well.
    stages : int
        Gauss nodes in every mesh interval; mesh values converge with twice that order.

    Attributes
    ----------
    name : str
        Name on command lines and in tables.
    """

    name = "boundary-value"
    tolerance: float = 1e-8
    stages: int = 3

    def __post_init__(self) -> None:
        require_real(self.stages, "stages of a stable inversion", "a number", InvalidSetting)
        Gauss(self.stages)
        require_tolerance(self.tolerance, "tolerance of a stable inversion")

    def require_suits(self, problem: Problem, formulation: Formulation, *, adaptive: bool) -> None:
        """Raise `InvalidSetting` for another form than `Reduced`, for a start, or for a tolerance of steps."""
        if formulation != Reduced():
            raise InvalidSetting(f"a stable inversion works on the reduced form, not on {formulation}")
        if problem.start:
            raise InvalidSetting("a stable inversion determines the initial values itself; leave out `start`")
        if adaptive:
            raise InvalidSetting("a stable inversion controls its mesh itself; give its tolerance to StableInversion")

    def better(self, _: Problem) -> BetterSolver:
        """Return one with more stages, to a smaller tolerance, over the longer horizon that it needs."""
        return BetterSolver(self._again, True, "a stable inversion of higher order")

    def _again(self, problem: Problem, times: Array) -> Solution:
        start, end, margin = problem.reference.start_time, problem.reference.end_time, step_of(times) / 2
        inside = times[(times > start - margin) & (times < end + margin)]
        tolerance = min(max(self.tolerance / 100.0, 1e-11), 1e-6)
        return StableInversion(tolerance, min(self.stages + 2, 7)).run(problem, inside)

    def branch_statement(self, problem: Problem, solution: Solution) -> str:
        """Judge a solution whose tolerance is loose; see `JudgedRoute`."""
        better = self.better(problem) if self.tolerance > NOTICED else None
        return stated_branch(problem, solution, better, "take a smaller tolerance for StableInversion")

    def run(self, problem: Problem, times: Array, progress: Progress = lambda *_: None) -> Solution:
        """Compute the bounded inputs on the grid of `times`, continued beyond both its ends; see `Route`.

        Raises
        ------
        InvalidReference
            If the reference neither starts and ends at rest nor repeats itself, or lacks derivatives.
        InvalidModel
            If the equations depend on time, so that nothing rests.
        IntegrationFailed
            If Newton's method fails or the mesh cannot be refined to the tolerance.
        """
        bounded = _pose(problem, self)
        t = _horizon(bounded, self, step_of(times))
        last: Solution | None = None
        for halvings in range(_MOST_HALVINGS):
            parts = 2**halvings
            mesh = subdivided(t, parts)
            states, iterations = _solve_on(bounded, mesh)
            values = of_states(problem, t, states[:, ::parts])
            now = solution_of_states(problem, t, values, f"{bounded.dae.name}, {self.name}", iterations)
            progress(halvings + 1, _MOST_HALVINGS)
            if last is not None:
                inputs = len(problem.system.inputs)
                change = np.abs(now.values - last.values)[:, :inputs].max(axis=0)
                relative = float((change / np.maximum(np.abs(now.values[:, :inputs]).max(axis=0), 1e-300)).max())
                if relative <= self.tolerance:
                    summary = replace(now.statistics, steps=len(mesh) - 1, error_estimate=relative)
                    return replace(now, statistics=summary)
            last = now
        raise IntegrationFailed(
            f"{problem.system.name}: the inputs still change by {relative:.2g} of their peak when the mesh is halved to"
            f" {len(mesh) - 1} intervals, but the tolerance is {self.tolerance:g}"
        )


@dataclass(frozen=True, eq=False)
class _Bounded:
    """The data that do not change while the mesh is refined."""

    problem: Problem
    dae: Dae
    left: Equilibrium
    right: Equilibrium
    method: Gauss
    periodic: bool

    @property
    def conditions(self) -> tuple[Array, Array, Array]:
        """L, R, b of the boundary conditions L x + R x = b with the internal states x at the left and right end."""
        left, right, size = self.left.stable, self.right.unstable, self.dae.x.numel()
        if self.periodic:
            return np.eye(size), -np.eye(size), np.zeros(size)
        # On the unstable manifold at the left end, on the stable one at the right: both together are bounded.
        L, R = np.zeros((size, size)), np.zeros((size, size))
        L[: len(left)], R[len(left) :] = left, right
        return L, R, np.concatenate([left @ self.left.states, right @ self.right.states])


def _pose(problem: Problem, route: StableInversion) -> _Bounded:
    array, reference, name = problem.array, problem.reference, problem.system.name
    if problem.flat:
        raise InvalidSetting(f"{name} has no internal dynamics; Reduced is exact, no boundary values are needed")
    require_derivatives(problem, array.reference_order, f"{name} needs")
    ends = reference.jet(np.array([reference.start_time, reference.end_time]), array.reference_order)
    scaled = ends * reference.duration ** np.arange(ends.shape[1])[:, None]
    moves = np.abs(scaled[:, 1:]).max() > ROUND_OFF
    periodic = moves and np.abs(scaled[1] - scaled[0]).max() <= ROUND_OFF * (np.abs(scaled[0]).max() + 1.0)
    if problem.system.time.numel() and not periodic:
        raise InvalidModel(
            f"a stable inversion begins and ends at rest, but the equations of {name} depend on time; {_OTHERWISE}"
        )
    slow = ROUND_OFF * (float(np.abs(ends[:, 0]).max()) + 1.0) / reference.duration
    for time, jet in zip((reference.start_time, reference.end_time), ends, strict=True):
        if not periodic and np.abs(jet[1]).max() > slow:
            raise InvalidReference(
                f"a stable inversion needs a path that is at rest at its ends or periodic, but this one moves"
                f" at t = {time:g} s and does not end as it began"
            )
    left, right = (internal_equilibrium(problem.array, problem.p, jet[0]) for jet in ends)
    size, stable, unstable = len(left.states), len(left.stable), len(right.unstable)
    if not periodic and stable + unstable != size:  # stability changes along the path
        count = "no motion stays" if stable + unstable > size else "a family of motions stays"
        raise IntegrationFailed(
            f"{name}: of {size} internal states {size - stable} grow at the start of the path"
            f" and {unstable} at its end, so that {count} bounded; Reduced() with a method computes the one that starts"
            " at rest"
        )
    return _Bounded(problem, problem.dae(Reduced()), left, right, Gauss(route.stages), bool(periodic))


def _horizon(bounded: _Bounded, route: StableInversion, step: float) -> Array:
    """Return a grid through the start of the reference that reaches far enough beyond both ends."""
    if bounded.periodic:
        path = bounded.problem.reference
        return np.linspace(path.start_time, path.end_time, max(1, round(path.duration / step)) + 1)
    # A mode of rate r has decayed to exp(-r T) = tolerance / e^2 after T = needed / r; the slowest one decides.
    needed, reference = np.log(1.0 / route.tolerance) + 2.0, bounded.problem.reference
    before_it, after_it = (np.array([value.real for value in end.eigenvalues]) for end in (bounded.left, bounded.right))
    growing, decaying = before_it[before_it > 0.0], -after_it[after_it < 0.0]
    before, after = (np.ceil(needed / rates.min() / step) if rates.size else 0.0 for rates in (growing, decaying))
    inside = round(reference.duration / step)
    if before + inside + after > _MOST_STEPS:
        rate, name = np.abs([*growing, *decaying]).min(), bounded.problem.system.name
        raise IntegrationFailed(
            f"{name}: a mode of {rate:.2g}/s takes {before + after:.2g} steps beside the path to decay; {_OTHERWISE}"
        )
    return np.asarray(reference.start_time + step * np.arange(-before, inside + after + 1.0))


@made_once
def _interval(resolved: ResolvedSystem, method: Gauss) -> tuple[ca.Function, Places]:
    """Compile the collocation equations of one mesh interval.

    Returns (values, gamma, h, p) -> residual and the nonzeros of its Jacobian by values, and their (row, column)
    places; values are [x at the left; stages; x at the right].
    """
    dae = resolved.dae(Reduced())
    step = method.discretize(dae)
    right = ca.SX.sym("right", dae.x.numel())
    values = ca.vertcat(step.x, step.equations.unknowns, right)
    # Continuity of x as equations of their own keeps the Jacobian of the horizon banded.
    residual = ca.vertcat(step.equations.residual, step.next_state[: dae.x.numel()] - right)
    jacobian = ca.jacobian(residual, values)
    results = [ca.densify(residual), ca.vertcat(*jacobian.nonzeros())]
    function = ca.Function("sc_interval", [values, step.reference, step.step, dae.p], results, {"cse": True})
    return function, np.array(jacobian.sparsity().get_triplet(), dtype=np.intp)


def _solve_on(bounded: _Bounded, mesh: Array) -> tuple[Array, int]:
    """Solve on a mesh of equal intervals; returns x at the mesh points and the Newton iterations."""
    import scipy.sparse.linalg  # noqa: PLC0415 - kept out of the run time of an FMU

    h = step_of(mesh)
    nodes = (mesh[:-1, None] + h * bounded.method.tableau.c).ravel()
    linearized, ends = _collocation(bounded, h, nodes)
    y = _quasi_static(bounded, nodes)
    for iteration in range(1, _MOST_ITERATIONS + 1):
        residual, jacobian = linearized(y)
        if not np.isfinite(residual).all():
            break
        try:
            # A chain of blocks and a few boundary rows: sparse LU fills in little.
            change = scipy.sparse.linalg.splu(jacobian).solve(-residual)
        except RuntimeError:  # exactly singular
            break
        # Full steps: residuals that grow at first fall again, where damped ones get stuck.
        y = y + change
        if np.abs(change).max() <= 1e-10 * (1.0 + np.abs(y).max()):
            return y[ends].T, iteration
    resonance, short = "undamped internal dynamics in resonance with it", "a horizon that is too short"
    raise IntegrationFailed(
        f"{bounded.problem.system.name}: Newton's method on the whole horizon failed with {len(mesh) - 1} intervals;"
        f" likely causes: a path too fast for the system, or {resonance if bounded.periodic else short}"
    )


def _collocation(bounded: _Bounded, h: float, nodes: Array) -> tuple[Callable[[Array], tuple[Array, Any]], Places]:
    """Return the function from unknowns of the whole horizon to residual and Jacobian, and where x at mesh points is.

    Unknowns are x and stages of the first interval, of the second, ..., and x at the right end.
    """
    import scipy.sparse  # noqa: PLC0415 - kept out of the run time of an FMU

    problem, dae, count = bounded.problem, bounded.dae, len(nodes) // bounded.method.stages
    one, (rows, columns) = _interval(problem.resolved, bounded.method)
    size_x, width, height = dae.x.numel(), one.numel_in(0) - dae.x.numel(), one.numel_out(0)
    gamma = side_by_side(problem.reference.jet(nodes, dae.reference_order))
    constant = (gamma, np.full(count, h), repeated(problem.p, count))
    evaluate, starts = mapped(one, count), width * np.arange(count + 1)[:, None]
    take = starts[:-1] + np.arange(width + size_x)
    L, R, b = bounded.conditions
    total = width * count + size_x
    # The boundary conditions take the first len x rows.
    i, j = np.indices(L.shape).reshape(2, -1)
    inside = (size_x + height * np.arange(count)[:, None] + rows).ravel(), (starts[:-1] + columns).ravel()
    places = np.concatenate([i, i, inside[0]]), np.concatenate([j, total - size_x + j, inside[1]])

    def linearized(y: Array) -> tuple[Array, Any]:
        residual, entries = evaluate(y[take].T, *constant)
        values = np.concatenate([L.ravel(), R.ravel(), entries.ravel(order="F")])
        jacobian = scipy.sparse.csc_array((values, places), (total, total))
        return np.concatenate([L @ y[:size_x] + R @ y[-size_x:] - b, residual.ravel(order="F")]), jacobian

    return linearized, starts + np.arange(size_x)


def _quasi_static(bounded: _Bounded, nodes: Array) -> Array:
    """Return a first guess: the internal states at rest, everything else following the reference."""
    reference, size_x = bounded.problem.reference, bounded.dae.x.numel()
    # From one rest to the other along with the path: forward integration as a guess would blow up.
    share = np.clip((nodes - reference.start_time) / reference.duration, 0.0, 1.0)
    states = bounded.left.states + share[:, None] * (bounded.right.states - bounded.left.states)
    stage = of_states(bounded.problem, nodes, states.T).T.reshape(len(nodes) // bounded.method.stages, -1)
    inside = np.hstack([stage[:, :size_x], stage]).ravel()
    return np.concatenate([inside, bounded.right.states])
