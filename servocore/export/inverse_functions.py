"""The functions of an exported inverse model, which CasADi writes as C that includes <math.h> only.

They are pure functions without globals or allocation, and with a bounded number of iterations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.checks.motion_limits import HIDDEN, with_watched
from servocore.dae import Dae
from servocore.errors import InvalidModel
from servocore.export.c_functions import tangent
from servocore.export.native_model import Bound
from servocore.formulations.reduced import Reduced
from servocore.methods.base import Discretization, instantaneous
from servocore.methods.collocation import RadauIIA
from servocore.model.limits import Limit
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.expressions import highest_derivative
from servocore.problem import Problem
from servocore.stepping.observation import compile_margins, compile_observation, limits_order
from servocore.stepping.program import Program, program_of
from servocore.structure.inversion import inversion

METHOD = RadauIIA(3)
"""The method that integrates the internal dynamics, on the reduced form."""

_ROUND_OFF = 1e-9  # share of a limit of the motion that may be exceeded by round-off

Matrix = TypeVar("Matrix", ca.SX, ca.MX)
"""Symbols of either kind, all of the same."""


class Mathematics(NamedTuple):
    """Functions of flat arguments; a path is (m, orders), the path itself included, column after column, parameters p.

    Attributes
    ----------
    functions : dict of str to casadi.Function
        ``begin`` (path, p, time, move of the internal states) -> (state, outputs, margins, residual), and its
        ``begin_tangent`` (..., d path, d p) -> (d state, d outputs). Without a state ``quick`` (path, p, time) ->
        (margins, outputs), NaN where ``begin`` must be called. With a state ``advance`` (state, paths at the nodes,
        h, p, time at the beginning) -> (state, outputs, margins, residual), and its ``advance_tangent`` (..., d state,
        d paths, d p) -> (d state, d outputs).
    outputs : tuple of Quantity
        Computed quantities.
    limits : tuple of Bound
        The bounds of the margins.
    nodes : tuple of float
        Fractions of a step at which the path is needed.
    depends : ndarray of bool, shape (outputs, m * orders)
        Which outputs depend on which numbers of the path.
    """

    functions: dict[str, ca.Function]
    outputs: tuple[Quantity, ...]
    limits: tuple[Bound, ...]
    nodes: tuple[float, ...]
    depends: npt.NDArray[np.bool_]


def mathematics(problem: Problem, identifier: str) -> Mathematics:
    """Compile the functions of an exported inverse model.

    Parameters
    ----------
    problem : Problem
        Resolved, and set to follow a branch where needed.
    identifier : str
        Prefix of names in C.

    Raises
    ------
    InvalidModel
        If a limit cannot be checked from step to step.
    """
    problem = with_watched(replace(problem, limits=tuple(each for each in problem.limits if not each.over_run)))
    system, limits = problem.system, bounds(problem)
    outputs = tuple(each for each in (*system.inputs, *system.observables) if not each.name.startswith(HIDDEN))
    expressions = ca.vertcat(ca.SX(0, 1), *system.observables.values())
    order = max(limits_order(system, problem.path_limits), highest_derivative(expressions, system.gamma))
    nodes = tuple[float, ...]((1.0,))
    if problem.flat and not problem.follow_branch:
        functions = _instantaneous(problem, identifier, order + 1, limits)
        depends = ca.DM(functions.get("quick", functions["begin"]).jac_sparsity(1, 0), 1).full() > 0.0
    else:
        program = program_of(problem, Reduced(), METHOD)
        functions, nodes = _stepped(problem, program, identifier, order + 1, limits), program.nodes
        depends = np.ones((len(outputs), functions["begin"].numel_in(0)), dtype=bool)  # also through the state
    return Mathematics(functions, outputs, limits, nodes, depends)


def _compile_seen(
    problem: Problem, step: Discretization, orders: int, limits: Sequence[Bound]
) -> Callable[..., tuple[Any, Any]]:
    """Return the function (state, path, p) -> outputs and margins of all limits, for symbols of either kind."""
    system, sides = problem.system, [each for each in limits if each.row >= 0]
    known = [*zip(system.inputs, ca.vertsplit(system.u), strict=True), *system.observables.items()]
    count = sum(not each.name.startswith(HIDDEN) for each, _ in known)
    read = observation(system, problem.dae(Reduced()), step, known, orders - 1)
    margins_of_path = compile_margins(system, problem.path_limits, orders - 1)

    def seen(state: Matrix, path: Matrix, p: Matrix) -> tuple[Matrix, Matrix]:
        values, margins = read(state, path, p), margins_of_path(path, p)
        kept = [each.side * (values[count + each.row] - each.bound) + _ROUND_OFF * abs(each.bound) for each in sides]
        return values[:count], ca.vertcat(margins, *kept)

    return seen


def bounds(problem: Problem) -> tuple[Bound, ...]:
    """Return the bounds of limits, those of the path first.

    Raises
    ------
    InvalidModel
        If one is of an angle that counts turns, or of the rate of a force: neither follows from a single instant.
    """
    path = [bound for limit in problem.path_limits for bound in bounds_of(limit)]
    hidden = [observable.name for observable in problem.system.observables if observable.name.startswith(HIDDEN)]
    bounds_of_limits = list[Bound]()
    for row, (limit, name) in enumerate(zip(problem.motion_limits, hidden, strict=True)):
        if name.endswith("differenced") or limit.counts_turns(problem.system):
            kind = "the rate of a force" if name.endswith("differenced") else "an angle that counts full turns"
            raise InvalidModel(
                f"{problem.name} cannot be exported with its limit of {limit.quantity}: an FMU checks limits at single"
                f" instants, and this is {kind}"
            )
        bounds_of_limits += bounds_of(limit, row)
    return (*path, *bounds_of_limits)


def bounds_of(limit: Limit, row: int = -1) -> list[Bound]:
    """Return the bounds that a limit has."""
    return [
        Bound(limit.quantity, limit.unit, limit.reason, bound, side, row, limit.rate)
        for bound, side in ((limit.bound, 1.0), (limit.upper, -1.0))
        if math.isfinite(bound)
    ]


def _instantaneous(problem: Problem, identifier: str, orders: int, limits: Sequence[Bound]) -> dict[str, ca.Function]:
    """Compile the inversion of single instants: the equations as one expression, and Newton's method where it fails."""
    system, inverse, rows = problem.system, inversion(problem.array), problem.array.reference_order + 1
    orders = max(rows, orders)
    seen = _compile_seen(problem, instantaneous(problem.dae(Reduced())), orders, limits)
    G, P, T = _symbols(system, orders)
    path = timed_path(system, G, T)
    y, _, residual = inverse.search(path[:, :rows], P, inverse.guess(path[:, :rows], P))
    outputs, kept = seen(y, path, P)
    functions, none = {}, ca.MX.sym("start", 0)
    if inverse.expression is not None:
        jet, p = timed_path(system, system.path[:, :orders], time := ca.SX.sym("time")), system.p
        results, kept_there = seen(inverse.expression(jet[:, :rows], p)[0], jet, p)
        # Margins first: their terms of the path are then evaluated in parallel with the guess.
        functions["quick"] = ca.Function(
            f"{identifier}_quick", [system.path[:, :orders], p, time], [kept_there, results], {"cse": True}
        )
    begun = [ca.MX(0, 1), outputs]
    functions["begin"] = ca.Function(f"{identifier}_begin", [G, P, T, none], [*begun, kept, residual])
    functions["begin_tangent"] = tangent(f"{identifier}_begin_tangent", [G, P, T, none], begun, [G, P])
    return functions


def _stepped(
    problem: Problem, program: Program, identifier: str, orders: int, limits: Sequence[Bound]
) -> dict[str, ca.Function]:
    """Compile steps: of internal dynamics, or along a branch that is followed from instant to instant."""
    system, nodes, method_step = problem.system, program.nodes, program.discretization
    orders = max(program.start_order + 1, orders)
    seen = _compile_seen(problem, method_step, orders, limits)
    G, P, T = _symbols(system, orders)
    D, h = ca.MX.sym("start", len(problem.array.states)), ca.MX.sym("h")
    path = timed_path(system, G, T)
    first, residual = _first(problem, program, path, P, D)
    outputs, kept = seen(first, path, P)
    S, N = ca.MX.sym("state", program.state_size), ca.MX.sym("nodes", G.shape[0], orders * len(nodes))
    at_nodes = [
        timed_path(system, column, T + node * h) for column, node in zip(ca.horzsplit(N, orders), nodes, strict=True)
    ]
    used = ca.horzcat(*[each[:, : program.order + 1] for each in at_nodes])
    after, _, left = program.step(S, used, h, P)
    stepped, within = seen(after, at_nodes[-1], P)
    step, by, begin = [S, N, h, P, T], [S, N, P], [G, P, T, D]
    name = f"{identifier}_advance_tangent"

    def results(state: ca.MX) -> list[ca.MX]:
        return [state, seen(state, at_nodes[-1], P)[0]]

    if program.dae.x.numel():
        along = _tangent_of_step(name, step, by, method_step, ca.vertcat(S, ca.vec(used), h, P), after, results)
    else:  # instants are independent, except for the branch
        along = tangent(name, step, results(after), by)
    return {
        "advance": ca.Function(f"{identifier}_advance", step, [after, stepped, within, left]),
        "begin": ca.Function(f"{identifier}_begin", begin, [first, outputs, kept, residual]),
        "begin_tangent": tangent(f"{identifier}_begin_tangent", begin, [first, outputs], [G, P]),
        "advance_tangent": along,
    }


def _tangent_of_step(
    name: str, arguments: Sequence[ca.MX], by: Sequence[ca.MX], step: Discretization, givens: ca.MX, after: ca.MX,
    results: Callable[[ca.MX], Sequence[ca.MX]],
) -> ca.Function:  # fmt: skip
    """Compile (arguments, directions of some of them) -> derivatives of results of the next state along them.

    Those of the unknowns follow from the implicit function theorem, refined once: a change of the path at one end of a
    step h causes accelerations of order 1/h^2 at the stages, which cancel in the result. A factorization spreads their
    round-off to all rows; one refinement in the same precision removes it (Skeel, 1980), which gains two to four digits
    at steps of 0.01 s.

    Parameters
    ----------
    name : str
        Name of the function.
    arguments, by : sequence of casadi.MX
        Symbols, and those among them with directions.
    step : Discretization
        The step; its next state contains its unknowns.
    givens, after : casadi.MX
        Givens of the step's equations and its next state, as expressions of the arguments.
    results : callable
        Next state -> differentiated results, expressions of it and the arguments.
    """
    equations, free = step.equations, ca.MX.sym("unknowns", step.equations.unknowns.numel())
    residual, scale, rows = equations.residual, equations.unknown_scale, equations.residual_scale
    matrix = ca.mtimes(ca.mtimes(ca.diag(1 / rows), ca.jacobian(residual, equations.unknowns)), ca.diag(scale))
    along = ca.SX.sym("along", equations.givens.numel())
    right = -ca.jtimes(residual, equations.givens, along) / rows
    given, parts = [equations.unknowns, equations.givens, along], [matrix, ca.densify(right), ca.densify(scale)]
    linear = ca.Function("sc_linearized", given, parts, {"cse": True})
    places = {each.element_hash(): k for k, each in enumerate(ca.vertsplit(step.next_state))}
    unknowns = after[[places[each.element_hash()] for each in ca.vertsplit(equations.unknowns)]]
    of_givens = tangent("sc_givens_tangent", arguments, [givens], by)
    directions = of_givens.mx_in()[len(arguments) :]
    J, b, unit = linear(unknowns, givens, of_givens(*arguments, *directions))
    found = ca.solve(J, b, "qr")
    found += ca.solve(J, b - ca.mtimes(J, found), "qr")
    state = ca.Function("sc_next_state", given[:2], [step.next_state])(free, givens)
    explicit = tangent("sc_results_tangent", [*arguments, free], results(state), [*by, free])
    return ca.Function(name, [*arguments, *directions], list(explicit(*arguments, unknowns, *directions, found * unit)))


def _symbols(system: MechanicalSystem, orders: int) -> tuple[ca.MX, ca.MX, ca.MX]:
    return ca.MX.sym("path", len(system.outputs), orders), ca.MX.sym("p", system.p.numel()), ca.MX.sym("time")


def _first(problem: Problem, program: Program, path: ca.MX, p: ca.MX, offset: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return the first state, its internal states offset from rest, and the residual of the equations."""
    array, inverse = problem.array, inversion(problem.array)
    path = path[:, : program.start_order + 1]
    used = path[:, : array.reference_order + 1]
    if array.states:
        guess = inverse.guess(used, p)
        guess[array.places(array.states)] += offset
        unknowns, _, residual = inverse.search(used, p, guess)
    else:
        unknowns, _, residual = inverse.function(used, p)
    return program.restart(unknowns, path, 0, p), residual


def observation(
    system: MechanicalSystem, dae: Dae, step: Discretization, known: list[tuple[Quantity, ca.SX]], order: int
) -> ca.Function:
    """Compile (state, gamma (m, order + 1), p) -> values of `known`, without constraint violations."""
    read = compile_observation(system, dae, step, known, order)
    arguments = read.sx_in()
    return ca.Function(read.name(), arguments, [read(*arguments)[0]], {"cse": True})


def timed_path(system: MechanicalSystem, path: Matrix, time: Matrix) -> Matrix:
    """Return a path with the time as its last row, if the system depends on time."""
    if not system.time.numel():
        return path
    row = ca.horzcat(time, 1.0, ca.DM.zeros(1, max(path.shape[1] - 2, 0)))[:, : path.shape[1]]
    return ca.vertcat(path, row)
