"""Bounded inversion where the internal dynamics are unstable: a boundary value problem over the whole horizon.

Forward in time unstable internal dynamics grow without bound, backward the stable ones do. The solution that stays
bounded (stable inversion, Devasia, Chen & Paden 1996; as boundary value problem Taylor & Li 2002) starts to act before
the path begins and ends after it: at the left end of a longer horizon it lies on the unstable manifold of the
equilibrium there, at the right end on the stable one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.numerics.calls import Call
from servocore.dae import Dae
from servocore.structure.derivative_array import DerivativeArray, compile_array_solver, derivative_array, first_guess
from servocore.errors import IntegrationFailed, InvalidReference, InvalidSetting
from servocore.checks.limits import side_by_side
from servocore.formulations import Reduced
from servocore.structure.zero_dynamics import Equilibrium, internal_equilibrium
from servocore.solvers.fixed_step import Progress, Run, observe, statistics
from servocore.methods import RadauIIA
from servocore.methods.base import at, reference_symbols
from servocore.methods.collocation import tableau
from servocore.references import Reference
from servocore.solution import Solution
from servocore.stepping.stepper import compile_program
from servocore.model.symbols import Array
from servocore.model.system import MechanicalSystem

Places = npt.NDArray[np.int64]
_Triplets = tuple[Array, tuple[Places, Places]]
"""Values with their rows and columns."""

_MOST_HALVINGS = 8
_MOST_ITERATIONS = 30
_AT_REST = 1e-9


@dataclass(frozen=True)
class BoundaryValue:
    """Bounded inversion by Gauss collocation over a horizon longer than the path.

    Parameters
    ----------
    tolerance : float
        The mesh is halved until no input changes by more, relative to its peak. What is cut off before and after
        the horizon is of that size as well.
    stages : int
        Gauss nodes in every mesh interval; mesh values converge with twice that order.
    pre, post : float, optional
        Time in s by which the horizon begins before and ends after the path; chosen from the slowest unstable and the
        slowest stable eigenvalue of the internal dynamics when not given.
    """

    tolerance: float = 1e-8
    stages: int = 3
    pre: float | None = None
    post: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance < 1.0:
            raise InvalidSetting(f"the tolerance must lie between 0 and 1, not {self.tolerance}")
        for name, value in (("pre", self.pre), ("post", self.post)):
            if value is not None and not 0.0 <= value < float("inf"):
                raise InvalidSetting(f"{name} must be a time in s, zero or more, not {value}")

    @property
    def name(self) -> str:
        """Name on command lines and in tables."""
        return "boundary-value"


@dataclass(frozen=True, eq=False)
class _Problem:
    """Everything that does not change while the mesh is refined."""

    system: MechanicalSystem
    array: DerivativeArray
    dae: Dae
    reference: Reference
    p: Array
    left: Equilibrium
    right: Equilibrium
    stages: int


def solve_boundary_value(
    system: MechanicalSystem,
    reference: Reference,
    p: Array,
    route: BoundaryValue,
    step: float,
    progress: Progress | None = None,
) -> Solution:
    """Compute the bounded inputs on a grid of `step` that reaches beyond both ends of the reference.

    Raises
    ------
    InvalidReference
        If the reference does not start and end at rest, or lacks derivatives.
    IntegrationFailed
        If Newton's method fails or the mesh cannot be refined to the tolerance.
    """
    problem = _pose(system, reference, p, route)
    t = _horizon(problem, route, step)
    last: Solution | None = None
    for halvings in range(_MOST_HALVINGS):
        parts = 2**halvings
        mesh = np.interp(np.arange((len(t) - 1) * parts + 1) / parts, np.arange(len(t)), t)
        states, iterations = _solve_on(problem, mesh)
        now = _report(problem, t, states[:, ::parts], iterations, route)
        if progress is not None:
            progress(halvings + 1, _MOST_HALVINGS)
        if last is not None:
            inputs = len(system.inputs)
            change = np.abs(now.values - last.values)[:, :inputs].max(axis=0)
            relative = float((change / np.maximum(np.abs(now.values[:, :inputs]).max(axis=0), 1e-300)).max())
            if relative <= route.tolerance:
                summary = replace(now.statistics, steps=len(mesh) - 1, error_estimate=relative)
                return replace(now, statistics=summary)
        last = now
    raise IntegrationFailed(
        f"{system.name}: the inputs still change by {relative:.2g} of their peak when the mesh is halved to"
        f" {len(mesh) - 1} intervals, {route.tolerance:g} was asked for"
    )


def _pose(system: MechanicalSystem, reference: Reference, p: Array, route: BoundaryValue) -> _Problem:
    array = derivative_array(system)
    if not array.states:
        raise InvalidSetting(f"{system.name} has no internal dynamics; Reduced is exact, no boundary values are needed")
    if reference.max_order < array.reference_order:
        raise InvalidReference(
            f"the path has derivatives up to order {reference.max_order}, {system.name} needs {array.reference_order}"
        )
    ends = reference.jet(np.array([reference.start_time, reference.end_time]), array.reference_order)
    size = float(np.abs(ends[:, 0]).max()) + 1.0
    for time, jet in zip((reference.start_time, reference.end_time), ends, strict=True):
        if np.abs(jet[1]).max() > _AT_REST * size / reference.duration:
            raise InvalidReference(
                f"a bounded inversion needs a path at rest at its ends, but it moves at t = {time:g} s"
            )
    left, right = (internal_equilibrium(array, p, jet[0]) for jet in ends)
    return _Problem(system, array, Reduced().dae(system), reference, p, left, right, route.stages)


def _horizon(problem: _Problem, route: BoundaryValue, step: float) -> Array:
    """Return a grid through the start of the reference that reaches far enough beyond both ends."""
    needed = np.log(1.0 / route.tolerance) + 2.0
    rates = np.array([value.real for value in problem.left.eigenvalues])
    growing, decaying = rates[rates > 0.0], -rates[rates < 0.0]
    pre = route.pre if route.pre is not None else (needed / growing.min() if growing.size else 0.0)
    post = route.post if route.post is not None else (needed / decaying.min() if decaying.size else 0.0)
    before, inside, after = np.ceil(pre / step), round(problem.reference.duration / step), np.ceil(post / step)
    grid: Array = problem.reference.start_time + step * np.arange(-before, inside + after + 1.0)
    return grid


@lru_cache(maxsize=16)
def _interval(dae: Dae, stages: int) -> tuple[ca.Function, ca.Function, Places]:
    """Compile the collocation equations of one mesh interval.

    Returns (values, gamma, h, p) -> residual, the same -> nonzeros of its Jacobian by values, and their (row, column)
    places; values are [x at the left; stages; x at the right].
    """
    method = tableau("gauss", stages)
    size_x, size = dae.x.numel(), dae.x.numel() + dae.z.numel()
    left, right, stage = ca.SX.sym("left", size_x), ca.SX.sym("right", size_x), ca.SX.sym("stage", size, stages)
    h, (reference, at_nodes) = ca.SX.sym("h"), reference_symbols(dae, stages)
    W = np.linalg.inv(method.A)
    travel = stage[:size_x, :] - ca.repmat(left, 1, stages)
    rows = []
    for i, gamma in enumerate(at_nodes):
        x, z = stage[:size_x, i], stage[size_x:, i]
        rows.append(ca.mtimes(travel, ca.DM(W[i])) / h - at(dae, dae.f, x, z, gamma))
        rows.append(at(dae, dae.h, x, z, gamma))
    rows.append(left + ca.mtimes(travel, ca.DM(method.b @ W)) - right)
    values = ca.vertcat(left, ca.vec(stage), right)
    residual = ca.vertcat(*rows)
    jacobian = ca.jacobian(residual, values)
    arguments = [values, reference, h, dae.p]
    places = np.array(jacobian.sparsity().get_triplet(), dtype=np.int64)
    return (
        ca.Function("sc_interval", arguments, [ca.densify(residual)], {"cse": True}),
        ca.Function("sc_interval_jacobian", arguments, [ca.vertcat(*jacobian.nonzeros())], {"cse": True}),
        places,
    )


def _solve_on(problem: _Problem, mesh: Array) -> tuple[Array, int]:
    """Solve on a mesh of equal intervals; returns [x; z] at the mesh points and the Newton iterations."""
    import scipy.sparse  # noqa: PLC0415 - kept out of the run time of an FMU
    import scipy.sparse.linalg  # noqa: PLC0415

    evaluate, assemble, ends = _collocation(problem, mesh)
    y = _quasi_static(problem, mesh)
    residual = evaluate(y)
    for iteration in range(1, _MOST_ITERATIONS + 1):
        matrix = scipy.sparse.csc_array(assemble(y), shape=(len(y), len(y)))
        change = scipy.sparse.linalg.splu(matrix).solve(-residual)
        y, residual, length = _damped(evaluate, y, residual, change)
        if length == 1.0 and np.abs(change).max() <= 1e-10 * (1.0 + np.abs(y).max()):
            return _at_mesh(problem, mesh, y[ends]), iteration
        if not np.isfinite(residual).all():
            break
    raise IntegrationFailed(
        f"{problem.system.name}: Newton's method on the whole horizon failed with {len(mesh) - 1} intervals;"
        f" likely causes: a path too fast for the system, or a horizon that is too short"
    )


def _damped(evaluate: Callable[[Array], Array], y: Array, residual: Array, change: Array) -> tuple[Array, Array, float]:
    """Halve a Newton correction until the residual does not grow."""
    size, length = float(np.linalg.norm(residual)), 1.0
    while True:
        tried = y + length * change
        found = evaluate(tried)
        if np.linalg.norm(found) <= size * (1.0 + 1e-6) + 1e-9 or length < 1e-3:
            return tried, found, length
        length /= 2.0


def _collocation(
    problem: _Problem, mesh: Array
) -> tuple[Callable[[Array], Array], Callable[[Array], _Triplets], Places]:
    """Return residual and Jacobian of the whole horizon, and the places of x at the mesh points.

    Unknowns are x and stages of the first interval, of the second, ..., and x at the right end.
    """
    dae, count = problem.dae, len(mesh) - 1
    one, one_jacobian, (rows, columns) = _interval(dae, problem.stages)
    size_x, width, height = dae.x.numel(), one.numel_in(0) - dae.x.numel(), one.numel_out(0)
    h = (mesh[-1] - mesh[0]) / count
    nodes = (mesh[:-1, None] + h * tableau("gauss", problem.stages).c).ravel()
    gamma = side_by_side(problem.reference.jet(nodes, dae.reference_order))
    constant = (gamma, np.full(count, h), np.tile(problem.p[:, None], count))
    mapped, mapped_jacobian = Call(one.map(count)), Call(one_jacobian.map(count))
    starts = width * np.arange(count)
    take = starts[:, None] + np.arange(width + size_x)
    global_rows = (height * np.arange(count)[:, None] + rows).ravel() + len(problem.left.stable)
    global_columns = (starts[:, None] + columns).ravel()
    left, right = problem.left.stable, problem.right.unstable
    total = width * count + size_x
    dense = [
        (left, np.arange(size_x), 0),
        (right, np.arange(total - size_x, total), total - len(right)),
    ]

    def evaluate(y: Array) -> Array:
        (inside,) = mapped(y[take].T, *constant)
        return np.concatenate([
            left @ (y[:size_x] - problem.left.states),
            inside.ravel(order="F"),
            right @ (y[-size_x:] - problem.right.states),
        ])  # fmt: skip

    def assemble(y: Array) -> _Triplets:
        (inside,) = mapped_jacobian(y[take].T, *constant)
        data, i, j = [inside.ravel(order="F")], [global_rows], [global_columns]
        for matrix, places, first in dense:
            data.append(matrix.ravel())
            i.append(np.repeat(first + np.arange(len(matrix)), size_x))
            j.append(np.tile(places, len(matrix)))
        return np.concatenate(data), (np.concatenate(i), np.concatenate(j))

    ends = (width * np.arange(count + 1))[:, None] + np.arange(size_x)
    return evaluate, assemble, ends


def _quasi_static(problem: _Problem, mesh: Array) -> Array:
    """Return a first guess: the internal states at rest, everything else following the reference."""
    dae, stages, count = problem.dae, problem.stages, len(mesh) - 1
    h = (mesh[-1] - mesh[0]) / count
    nodes = (mesh[:-1, None] + h * tableau("gauss", stages).c).ravel()
    share = np.clip((nodes - problem.reference.start_time) / problem.reference.duration, 0.0, 1.0)
    states = problem.left.states + share[:, None] * (problem.right.states - problem.left.states)
    stage = _algebraic(problem, nodes, states).T.reshape(count, -1)
    size_x = dae.x.numel()
    inside = np.hstack([stage[:, :size_x], stage]).ravel()
    return np.concatenate([inside, problem.right.states])


def _algebraic(problem: _Problem, t: Array, states: Array) -> Array:
    """Solve for everything that the states (N, len x) and the reference determine: [x; z], shape (size, N)."""
    array = problem.array
    gamma = problem.reference.jet(t, array.reference_order)
    solver, guess = _array_functions(array, len(t))
    p = np.tile(problem.p[:, None], len(t))
    (start,) = guess(side_by_side(gamma), p)
    own = [array.unknowns.index(each) for each in array.states]
    start[own] = states.T
    found, _, _ = solver(side_by_side(gamma), p, start)
    order = [array.unknowns.index(each) for each in (*array.states, *array.determined)]
    values: Array = found[order]
    return values


@lru_cache(maxsize=64)
def _array_functions(array: DerivativeArray, count: int) -> tuple[Call, Call]:
    return Call(compile_array_solver(array).map(count)), Call(first_guess(array).map(count))


def _at_mesh(problem: _Problem, mesh: Array, states: Array) -> Array:
    return _algebraic(problem, mesh, states)


def _report(problem: _Problem, t: Array, unknowns: Array, iterations: int, route: BoundaryValue) -> Solution:
    program = compile_program(problem.system, Reduced(), RadauIIA(1))
    states = np.zeros((program.state_size, len(t)))
    states[: len(unknowns)] = unknowns
    values, violations = observe(program, problem.reference, problem.p, t, states)
    done = Run(states, iterations, iterations, 0.0)
    return Solution(
        t,
        program.channels,
        values,
        f"{problem.dae.name}, {route.name}",
        statistics(done, values[:, : len(problem.system.inputs)], violations),
        problem.reference.fit_error,
    )
