"""The mathematics of an inverse model as CasADi functions, and as C that needs nothing but <math.h>.

Which functions there are depends on what remains to be integrated; see `Mathematics`. All are pure: no memory between
calls, no globals, no allocation, a bounded number of iterations.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.formulations.reduced import Reduced
from servocore.methods.base import instantaneous
from servocore.methods.collocation import RadauIIA
from servocore.model.quantity import Quantity
from servocore.numerics.expressions import highest_derivative
from servocore.problem import Problem
from servocore.stepping.compilation import discretised, program_of
from servocore.stepping.margins import compile_margins, limits_order
from servocore.stepping.observation import compile_observation
from servocore.structure.inversion import inversion

METHOD = RadauIIA(3)
"""What steps the internal dynamics, on the reduced form."""


@dataclass(frozen=True, eq=False)
class Mathematics:
    """Functions of flat arguments; a path is (m, orders), column after column, parameters p.

    Attributes
    ----------
    identifier : str
        What the names of the functions begin with in C.
    functions : mapping of str to casadi.Function
        ``begin`` (path, p) -> (state, outputs, margins, residual); ``begin_tangent`` (path, p, d path, d p) ->
        (d state, d outputs). Without a state ``quick`` (path, p) -> (outputs, margins), NaN where ``begin`` has to be
        asked. With a state ``advance`` (state, paths at the nodes, h, p) -> (state, outputs, margins, residual), and
        its ``advance_tangent`` (..., d state, d paths, d p) -> (d state, d outputs).
    outputs : tuple of Quantity
        What they compute.
    orders : int
        How many derivatives of the path they take, the path itself included.
    state_size : int
        Numbers that a step hands to the next; 0 where every instant stands alone.
    nodes : tuple of float
        Fractions of a step at which the path is needed.
    depends : ndarray of bool, shape (outputs, m * orders)
        Which outputs depend on which numbers of the path.
    """

    identifier: str
    functions: Mapping[str, ca.Function]
    outputs: tuple[Quantity, ...]
    orders: int
    state_size: int
    nodes: tuple[float, ...]
    depends: npt.NDArray[np.bool_]

    @property
    def operations(self) -> int:
        """Instructions of the quick function, or of a step without its iterations."""
        return int(next(iter(self.functions.values())).n_instructions())

    def source(self) -> tuple[str, str]:
        """Return header and C source ``IDENTIFIER_mathematics``; all names in them begin with the identifier."""
        name = f"{self.identifier}_mathematics"
        generator = ca.CodeGenerator(f"{name}.c", {"with_header": True, "casadi_int": "int"})
        for function in self.functions.values():
            generator.add(function)
        with tempfile.TemporaryDirectory(prefix="servocore_") as folder:
            generator.generate(f"{folder}/")
            header, source = (Path(folder, f"{name}.{ending}").read_text(encoding="utf-8") for ending in "hc")
        return header, source

    def only(self, names: Sequence[str]) -> Mathematics:
        """Return the same with those functions only that are named."""
        return replace(self, functions={name: each for name, each in self.functions.items() if name in names})

    def scratch(self) -> dict[str, int]:
        """Return how much working memory the functions take, by kind."""
        sizes = {"arguments": "sz_arg", "results": "sz_res", "integers": "sz_iw", "numbers": "sz_w"}
        return {kind: max(getattr(f, size)() for f in self.functions.values()) for kind, size in sizes.items()}


def mathematics(problem: Problem, identifier: str) -> Mathematics:
    """Compile what an exported inverse model computes."""
    return (_instantaneous if problem.flat and not problem.follow_branch else _stepped)(problem, identifier)


def _wanted(problem: Problem) -> list[tuple[Quantity, ca.SX]]:
    """List inputs and observables with their expressions."""
    system = problem.system
    return [*zip(system.inputs, ca.vertsplit(system.u), strict=True), *system.observables.items()]


def _instantaneous(problem: Problem, identifier: str) -> Mathematics:
    """Every instant by itself: the equations as one expression, and Newton's method where that does not do."""
    system, dae = problem.system, problem.dae(Reduced())
    inverse = problem.resolved.once(inversion)
    wanted, rows = _wanted(problem), problem.array.reference_order + 1
    orders = max(rows, limits_order(system, problem.limits) + 1, _highest(wanted, system.gamma) + 1)
    read = compile_observation(system, dae, instantaneous(dae), wanted, orders - 1)
    margins = compile_margins(system, problem.limits, orders - 1)
    G, P = ca.MX.sym("path", len(system.outputs), orders), ca.MX.sym("p", system.p.numel())
    y, _, residual = inverse.search(G[:, :rows], P, inverse.guess(G[:, :rows], P))
    outputs = read(y, G, P)[0]
    functions = {}
    flat = inverse.expression
    path, p = system.gamma[:, :orders], system.p
    if flat is not None:
        found = read(flat(path[:, :rows], p)[0], path, p)[0]
        functions["quick"] = ca.Function(f"{identifier}_quick", [path, p], [found, margins(path, p)], {"cse": True})
    functions["begin"] = ca.Function(f"{identifier}_begin", [G, P], [ca.MX(0, 1), outputs, margins(G, P), residual])
    functions["begin_tangent"] = _tangent(f"{identifier}_begin_tangent", [G, P], [ca.MX(0, 1), outputs], [G, P])
    depends = _dependence(functions.get("quick", functions["begin"]), 0 if flat is not None else 1)
    return Mathematics(identifier, functions, tuple(each for each, _ in wanted), orders, 0, (1.0,), depends)


def _stepped(problem: Problem, identifier: str) -> Mathematics:
    """Step by step: internal dynamics, or a branch that is followed from instant to instant."""
    system, dae = problem.system, problem.dae(Reduced())
    program = program_of(problem, Reduced(), METHOD)
    wanted, orders = _wanted(problem), program.start_order + 1
    read = compile_observation(system, dae, discretised(dae, METHOD), wanted, orders - 1)
    count, nodes = len(system.outputs), program.nodes
    G, P, h = ca.MX.sym("path", count, orders), ca.MX.sym("p", system.p.numel()), ca.MX.sym("h")
    first, _, residual = program.start(ca.repmat(G, 1, len(program.start_instants)), 0, P)
    begun = [first, read(first, G, P)[0]]
    S, N = ca.MX.sym("state", program.state_size), ca.MX.sym("nodes", count, orders * len(nodes))
    at_nodes = ca.horzsplit(N, orders)
    used = ca.horzcat(*[each[:, : program.order + 1] for each in at_nodes])
    after, _, left = program.step(S, used, h, P)
    stepped = [after, read(after, at_nodes[-1], P)[0]]
    margins = program.margins
    functions = {
        "advance": ca.Function(f"{identifier}_advance", [S, N, h, P], [*stepped, margins(at_nodes[-1], P), left]),
        "begin": ca.Function(f"{identifier}_begin", [G, P], [*begun, margins(G, P), residual]),
        "begin_tangent": _tangent(f"{identifier}_begin_tangent", [G, P], begun, [G, P]),
        "advance_tangent": _tangent(f"{identifier}_advance_tangent", [S, N, h, P], stepped, [S, N, P]),
    }
    depends = np.ones((len(wanted), count * orders), dtype=bool)  # also through the state
    return Mathematics(
        identifier, functions, tuple(each for each, _ in wanted), orders, program.state_size, nodes, depends
    )


def _tangent(name: str, arguments: Sequence[ca.MX], results: Sequence[ca.MX], by: Sequence[ca.MX]) -> ca.Function:
    """Compile (arguments, directions of some of them) -> derivatives of the results along them."""
    directions = [ca.MX.sym(f"d{k}", *each.shape) for k, each in enumerate(by)]
    x, direction = ca.veccat(*by), ca.veccat(*directions)
    found = [ca.densify(ca.jtimes(each, x, direction)) if each.numel() else each for each in results]
    return ca.Function(name, [*arguments, *directions], found)


def _highest(wanted: Sequence[tuple[Quantity, ca.SX]], gamma: ca.SX) -> int:
    return highest_derivative(ca.vertcat(ca.SX(0, 1), *[each for _, each in wanted]), gamma)


def _dependence(function: ca.Function, result: int) -> npt.NDArray[np.bool_]:
    """Which rows of a result depend on which numbers of the first argument."""
    pattern = function.jac_sparsity(result, 0)
    found = np.zeros(pattern.shape, dtype=bool)
    found[tuple(np.array(pattern.get_triplet(), dtype=np.intp))] = True
    return found
