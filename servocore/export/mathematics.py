"""What an exported inverse model computes, as a handful of CasADi functions, with the bounds that it keeps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.checks.motion_limits import HIDDEN, counts_turns, with_watched
from servocore.errors import InvalidModel
from servocore.export.inverse_model import Bound, Mathematics
from servocore.formulations.reduced import Reduced
from servocore.methods.base import instantaneous
from servocore.methods.collocation import RadauIIA
from servocore.model.limits import Limit
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.expressions import highest_derivative
from servocore.problem import Problem
from servocore.stepping.compilation import discretised, program_of
from servocore.stepping.initial_values import compile_restart
from servocore.stepping.margins import compile_margins, limits_order
from servocore.stepping.observation import compile_observation
from servocore.structure.inversion import inversion

METHOD = RadauIIA(3)
"""What steps the internal dynamics, on the reduced form."""

_ROUND_OFF = 1e-9  # of a limit on what moves: beyond it by less is on it


def mathematics(problem: Problem, identifier: str) -> Mathematics:
    """Compile what an exported inverse model computes.

    Parameters
    ----------
    problem : Problem
        Resolved; set to follow a branch where it has to.
    identifier : str
        What names in C begin with.

    Raises
    ------
    InvalidModel
        If a limit cannot be kept from step to step.
    """
    watched = with_watched(problem)
    known = _Known(watched, _wanted(watched), bounds(watched))
    return (_instantaneous if problem.flat and not problem.follow_branch else _stepped)(known, identifier)


@dataclass(frozen=True, eq=False)
class _Known:
    """A problem, all that is evaluated of it (what its limits compare comes last), and the bounds."""

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
        return tuple(each for each in self.problem.limits if each.of_path)

    @property
    def orders(self) -> int:
        """Derivatives of the path that evaluating takes, the path itself included."""
        system = self.problem.system
        expressions = ca.vertcat(ca.SX(0, 1), *[each for _, each in self.wanted])
        return 1 + max(limits_order(system, self.of_path), highest_derivative(expressions, system.gamma))

    def split(self, values: ca.SX | ca.MX, margins: ca.SX | ca.MX) -> tuple[ca.SX | ca.MX, ca.SX | ca.MX]:
        """Return outputs, and margins of all limits, of all values and the margins of the path."""
        count, sides = len(self.outputs), self.bounds[len(self.of_path) :]
        kept = [each.side * (values[count + each.row] - each.bound) + _ROUND_OFF * abs(each.bound) for each in sides]
        return values[:count], ca.vertcat(margins, *kept)


def _wanted(problem: Problem) -> list[tuple[Quantity, ca.SX]]:
    """List inputs and observables with their expressions."""
    system = problem.system
    return [*zip(system.inputs, ca.vertsplit(system.u), strict=True), *system.observables.items()]


def bounds(problem: Problem) -> tuple[Bound, ...]:
    """Return the bounds that limits set, those of the path first.

    Raises
    ------
    InvalidModel
        If one is of an angle that counts turns, or of the rate of a force, which no instant tells.
    """
    path = [Bound(e.quantity, e.unit, e.reason, e.bound, 1.0, -1) for e in problem.limits if e.of_path]
    hidden = [each.name for each in problem.system.observables if each.name.startswith(HIDDEN)]
    found = []
    for row, (limit, name) in enumerate(zip((e for e in problem.limits if not e.of_path), hidden, strict=True)):
        if name.endswith("differenced") or counts_turns(limit.expression, limit.rate, problem.system):
            why = "the rate of a force" if name.endswith("differenced") else "an angle that counts full turns"
            raise InvalidModel(
                f"{problem.name} cannot be exported with its limit of {limit.quantity}: an FMU keeps limits instant by"
                f" instant, and that is {why}"
            )
        sides = [(limit.bound, 1.0), (limit.upper, -1.0)]
        found += [
            Bound(limit.quantity, limit.unit, limit.reason, bound, side, row, limit.rate)
            for bound, side in sides
            if math.isfinite(bound)
        ]
    return (*path, *found)


def _timed(system: MechanicalSystem, path: ca.SX | ca.MX, time: ca.SX | ca.MX) -> ca.SX | ca.MX:
    """Return a path with the time as its last row, where the system holds it."""
    if not system.time.numel():
        return path
    row = ca.horzcat(time, 1.0, ca.DM.zeros(1, max(path.shape[1] - 2, 0)))[:, : path.shape[1]]
    return ca.vertcat(path, row)


def _instantaneous(known: _Known, identifier: str) -> Mathematics:
    """Every instant by itself: the equations as one expression, and Newton's method where that does not do."""
    problem = known.problem
    system, dae = problem.system, problem.dae(Reduced())
    inverse = problem.resolved.once(inversion)
    rows = problem.array.reference_order + 1
    orders = max(rows, known.orders)
    read = compile_observation(system, dae, instantaneous(dae), known.wanted, orders - 1)
    margins = compile_margins(system, known.of_path, orders - 1)

    def seen(state: ca.SX | ca.MX, path: ca.SX | ca.MX, p: ca.SX | ca.MX) -> tuple[ca.SX | ca.MX, ca.SX | ca.MX]:
        return known.split(read(state, path, p)[0], margins(path, p))

    G, P, T = _symbols(system, orders)
    path = _timed(system, G, T)
    y, _, residual = inverse.search(path[:, :rows], P, inverse.guess(path[:, :rows], P))
    outputs, kept = seen(y, path, P)
    functions, none = {}, ca.MX.sym("start", 0)
    if inverse.expression is not None:
        own, p = _timed(system, system.path[:, :orders], time := ca.SX.sym("time")), system.p
        found = seen(inverse.expression(own[:, :rows], p)[0], own, p)
        functions["quick"] = ca.Function(
            f"{identifier}_quick", [system.path[:, :orders], p, time], list(found), {"cse": True}
        )
    begun = [ca.MX(0, 1), outputs]
    functions["begin"] = ca.Function(f"{identifier}_begin", [G, P, T, none], [*begun, kept, residual])
    functions["begin_tangent"] = _tangent(f"{identifier}_begin_tangent", [G, P, T, none], begun, [G, P])
    depends = _dependence(functions.get("quick", functions["begin"]), 0 if "quick" in functions else 1)
    return Mathematics(identifier, functions, known.outputs, known.bounds, orders, 0, (1.0,), depends)


def _stepped(known: _Known, identifier: str) -> Mathematics:
    """Step by step: internal dynamics, or a branch that is followed from instant to instant."""
    problem = known.problem
    system, dae = problem.system, problem.dae(Reduced())
    program = program_of(problem, Reduced(), METHOD)
    orders = max(program.start_order + 1, known.orders)
    read = compile_observation(system, dae, discretised(dae, METHOD), known.wanted, orders - 1)
    margins, nodes = compile_margins(system, known.of_path, orders - 1), program.nodes
    G, P, T = _symbols(system, orders)
    D, h = ca.MX.sym("start", len(problem.array.states)), ca.MX.sym("h")
    path = _timed(system, G, T)
    first, residual = _first(problem, program.start_order, path, P, D)
    outputs, kept = known.split(read(first, path, P)[0], margins(path, P))
    S, N = ca.MX.sym("state", program.state_size), ca.MX.sym("nodes", G.shape[0], orders * len(nodes))
    at_nodes = [_timed(system, each, T + node * h) for each, node in zip(ca.horzsplit(N, orders), nodes, strict=True)]
    used = ca.horzcat(*[each[:, : program.order + 1] for each in at_nodes])
    after, _, left = program.step(S, used, h, P)
    stepped, within = known.split(read(after, at_nodes[-1], P)[0], margins(at_nodes[-1], P))
    step, begin = [S, N, h, P, T], [G, P, T, D]
    functions = {
        "advance": ca.Function(f"{identifier}_advance", step, [after, stepped, within, left]),
        "begin": ca.Function(f"{identifier}_begin", begin, [first, outputs, kept, residual]),
        "begin_tangent": _tangent(f"{identifier}_begin_tangent", begin, [first, outputs], [G, P]),
        "advance_tangent": _tangent(f"{identifier}_advance_tangent", step, [after, stepped], [S, N, P]),
    }
    depends = np.ones((len(known.outputs), G.numel()), dtype=bool)  # also through the state
    return Mathematics(identifier, functions, known.outputs, known.bounds, orders, program.state_size, nodes, depends)


def _symbols(system: MechanicalSystem, orders: int) -> tuple[ca.MX, ca.MX, ca.MX]:
    return ca.MX.sym("path", len(system.outputs), orders), ca.MX.sym("p", system.p.numel()), ca.MX.sym("time")


def _first(problem: Problem, order: int, path: ca.MX, p: ca.MX, moved: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return the first state, its internal states moved from where they rest, and the residual of the equations."""
    array, inverse, dae = problem.array, problem.resolved.once(inversion), problem.dae(Reduced())
    path = path[:, : order + 1]
    used = path[:, : array.reference_order + 1]
    if array.states:
        guess = inverse.guess(used, p)
        guess[array.places(array.states)] += moved
        found, _, residual = inverse.search(used, p, guess)
    else:
        found, _, residual = inverse.function(used, p)
    restart = compile_restart(array, inverse, dae, dae, discretised(dae, METHOD), order)
    return restart(found, path, 0, p), residual


def _tangent(name: str, arguments: Sequence[ca.MX], results: Sequence[ca.MX], by: Sequence[ca.MX]) -> ca.Function:
    """Compile (arguments, directions of some of them) -> derivatives of the results along them."""
    directions = [ca.MX.sym(f"d{k}", *each.shape) for k, each in enumerate(by)]
    x, direction = ca.veccat(*by), ca.veccat(*directions)
    found = [ca.densify(ca.jtimes(each, x, direction)) if each.numel() else each for each in results]
    return ca.Function(name, [*arguments, *directions], found)


def _dependence(function: ca.Function, result: int) -> npt.NDArray[np.bool_]:
    """Which rows of a result depend on which numbers of the first argument."""
    pattern = function.jac_sparsity(result, 0)
    found = np.zeros(pattern.shape, dtype=bool)
    found[tuple(np.array(pattern.get_triplet(), dtype=np.intp))] = True
    return found
