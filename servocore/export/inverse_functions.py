"""The functions of an exported inverse model, which CasADi writes as C that includes <math.h> only.

They are pure functions without globals or allocation, and with a bounded number of iterations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.checks.motion_limits import HIDDEN, with_watched
from servocore.dae import Dae
from servocore.errors import InvalidModel
from servocore.export.directional_derivatives import tangent, tangent_of_step
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
    """Functions of flat arguments; a path is (m, orders), column after column, parameters p.

    Attributes
    ----------
    functions : mapping of str to casadi.Function
        ``begin`` (path, p, time, move of the internal states) -> (state, outputs, margins, residual), and its
        ``begin_tangent`` (..., d path, d p) -> (d state, d outputs). Without a state ``quick`` (path, p, time) ->
        (margins, outputs), NaN where ``begin`` must be called. With a state ``advance`` (state, paths at the nodes,
        h, p, time at the beginning) -> (state, outputs, margins, residual), and its ``advance_tangent`` (..., d state,
        d paths, d p) -> (d state, d outputs).
    outputs : tuple of Quantity
        Computed quantities.
    limits : tuple of Bound
        The bounds of the margins.
    orders : int
        Number of derivatives of the path among the arguments, the path itself included.
    state_size : int
        Numbers kept from step to step; 0 where instants are independent.
    nodes : tuple of float
        Fractions of a step at which the path is needed.
    depends : ndarray of bool, shape (outputs, m * orders)
        Which outputs depend on which numbers of the path.
    """

    functions: Mapping[str, ca.Function]
    outputs: tuple[Quantity, ...]
    limits: tuple[Bound, ...]
    orders: int
    state_size: int
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
    watched = with_watched(replace(problem, limits=tuple(each for each in problem.limits if not each.over_run)))
    known = _Known(watched, wanted(watched), bounds(watched))
    return (_instantaneous if problem.flat and not problem.follow_branch else _stepped)(known, identifier)


@dataclass(frozen=True, eq=False)
class _Known:
    """A problem, its evaluated quantities (those of its limits last), and the bounds."""

    problem: Problem
    wanted: list[tuple[Quantity, ca.SX]]
    bounds: tuple[Bound, ...]

    @property
    def outputs(self) -> tuple[Quantity, ...]:
        """Inputs and observables of the system."""
        return tuple(each for each, _ in self.wanted if not each.name.startswith(HIDDEN))

    @property
    def of_path(self) -> tuple[Limit, ...]:
        """Limits of the path alone."""
        return tuple(limit for limit in self.problem.limits if limit.of_path)

    @property
    def orders(self) -> int:
        """Number of derivatives of the path in the evaluation, the path itself included."""
        system = self.problem.system
        expressions = ca.vertcat(ca.SX(0, 1), *[each for _, each in self.wanted])
        return 1 + max(limits_order(system, self.of_path), highest_derivative(expressions, system.gamma))

    def seen(self, dae: Dae, step: Discretization, orders: int) -> Callable[..., tuple[Any, Any]]:
        """Return the function (state, path, p) -> outputs and margins of all limits, for symbols of either kind."""
        count, sides = len(self.outputs), self.bounds[len(self.of_path) :]
        read = observation(self.problem.system, dae, step, self.wanted, orders - 1)
        of_path = compile_margins(self.problem.system, self.of_path, orders - 1)

        def seen(state: Matrix, path: Matrix, p: Matrix) -> tuple[Matrix, Matrix]:
            values, margins = read(state, path, p), of_path(path, p)
            kept = [
                each.side * (values[count + each.row] - each.bound) + _ROUND_OFF * abs(each.bound) for each in sides
            ]
            return values[:count], ca.vertcat(margins, *kept)

        return seen


def bounds(problem: Problem) -> tuple[Bound, ...]:
    """Return the bounds of limits, those of the path first.

    Raises
    ------
    InvalidModel
        If one is of an angle that counts turns, or of the rate of a force: neither follows from a single instant.
    """
    path = [bound for limit in problem.limits if limit.of_path for bound in bounds_of(limit)]
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


def _instantaneous(known: _Known, identifier: str) -> Mathematics:
    """Compile the inversion of single instants: the equations as one expression, and Newton's method where it fails."""
    problem = known.problem
    system, dae = problem.system, problem.dae(Reduced())
    inverse = inversion(problem.array)
    rows = problem.array.reference_order + 1
    orders = max(rows, known.orders)
    seen = known.seen(dae, instantaneous(dae), orders)
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
    depends = ca.DM(functions.get("quick", functions["begin"]).jac_sparsity(1, 0), 1).full() > 0.0
    return Mathematics(functions, known.outputs, known.bounds, orders, 0, (1.0,), depends)


def _stepped(known: _Known, identifier: str) -> Mathematics:
    """Compile steps: of internal dynamics, or along a branch that is followed from instant to instant."""
    problem = known.problem
    system, dae = problem.system, problem.dae(Reduced())
    program = program_of(problem, Reduced(), METHOD)
    orders = max(program.start_order + 1, known.orders)
    nodes, method_step = program.nodes, program.discretization
    seen = known.seen(dae, method_step, orders)
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
    if not dae.x.numel():  # instants are independent, except for the branch
        along = tangent(f"{identifier}_advance_tangent", step, [after, stepped], by)
    else:
        givens = ca.vertcat(S, ca.vec(used), h, P)
        along = tangent_of_step(
            f"{identifier}_advance_tangent", method_step, step, by, givens, after,
            lambda state: [seen(state, at_nodes[-1], P)[0]],
        )  # fmt: skip
    functions = {
        "advance": ca.Function(f"{identifier}_advance", step, [after, stepped, within, left]),
        "begin": ca.Function(f"{identifier}_begin", begin, [first, outputs, kept, residual]),
        "begin_tangent": tangent(f"{identifier}_begin_tangent", begin, [first, outputs], [G, P]),
        "advance_tangent": along,
    }
    depends = np.ones((len(known.outputs), G.numel()), dtype=bool)  # also through the state
    return Mathematics(functions, known.outputs, known.bounds, orders, program.state_size, nodes, depends)


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


def wanted(problem: Problem) -> list[tuple[Quantity, ca.SX]]:
    """List inputs and observables with their expressions."""
    system = problem.system
    return [*zip(system.inputs, ca.vertsplit(system.u), strict=True), *system.observables.items()]


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
