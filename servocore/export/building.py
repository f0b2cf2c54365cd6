"""From a scene to its `InverseModel`: analysed, compiled, with all variables named."""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.checks.internal_dynamics import NON_MINIMUM_PHASE, SINGULAR, internal_dynamics
from servocore.checks.limits import require_feasible
from servocore.errors import InvalidModel, InvalidReference
from servocore.export import variables
from servocore.export.inverse_model import InverseModel, Mathematics
from servocore.export.variables import Variable
from servocore.formulations.reduced import Reduced
from servocore.methods.base import instantaneous
from servocore.methods.collocation import RadauIIA
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.numerics.calls import Array
from servocore.numerics.expressions import highest_derivative
from servocore.problem import Problem
from servocore.solvers.following import BranchTable, prepared_table
from servocore.stepping.compilation import discretised, program_of
from servocore.stepping.margins import compile_margins, limit_texts, limits_order
from servocore.stepping.observation import compile_observation
from servocore.structure.inversion import inversion

METHOD = RadauIIA(3)
"""What steps the internal dynamics, on the reduced form."""

_LONGEST_IDENTIFIER = 40


def inverse_model(scene: Scene, model: str | None = None) -> InverseModel:
    """Analyse and compile a scene for export.

    Parameters
    ----------
    scene : Scene
        With its parameter values; its own path gives start values and default experiment only.
    model : str, optional
        Model of the scene; its smallest when not given.

    Raises
    ------
    InvalidModel
        If the inputs do not follow from past and present of the path: internal dynamics that are unstable, equations
        that hold the time.
    InvalidReference
        If the scene's own path breaks its limits.
    """
    if scene.model(model).time.numel():
        raise InvalidModel(
            f"{scene.name} cannot be exported: its equations hold the time, which an FMU would have to be told with the"
            f" path; make what moves by itself a part of the path, or a parameter"
        )
    problem = _followed(Problem.of(scene, model))
    kind = internal_dynamics(problem)
    if kind.kind in (NON_MINIMUM_PHASE, SINGULAR):
        grows = f"grow at {kind.growth:.4g} 1/s" if kind.kind == NON_MINIMUM_PHASE else "are singular at rest"
        raise InvalidModel(
            f"{scene.name} cannot be exported: its internal dynamics {grows} ({kind.kind}), so that bounded inputs"
            f" depend on the whole path, its future included; solve computes them"
        )
    require_feasible(problem)
    identifier = identifier_of(scene.name)
    compiled, system = mathematics(problem, identifier), problem.system
    home = scene.reference.jet([scene.reference.start_time], 0)[0, 0]
    return InverseModel(
        identifier=identifier,
        title=scene.name,
        model=model or scene.default_model,
        description=f"Inverse dynamics of {scene.name.replace('_', ' ')}: the inputs"
        f" {', '.join(each.name for each in system.inputs)} that make {', '.join(each.name for each in system.outputs)}"
        " follow a path",
        mathematics=compiled,
        variables=tuple(_variables(problem, compiled, scene.tracked, home)),
        components=len(system.outputs),
        limits=limit_texts(problem.limits),
        method="" if problem.flat else METHOD.name,
        duration=scene.reference.duration,
    )


def identifier_of(name: str) -> str:
    """Return a name as an identifier of C, as short as functions' names have to be."""
    found = re.sub(r"\W", "_", name, flags=re.ASCII)[:_LONGEST_IDENTIFIER]
    return f"model_{found}" if not found[:1].isalpha() or keyword.iskeyword(found) else found


def _followed(problem: Problem) -> Problem:
    """Return the problem, set to follow a branch where the guess of the model does not keep to one along its path."""
    if not problem.flat or problem.follow_branch:
        return problem
    if problem.reference.max_order < problem.array.reference_order:
        raise InvalidReference(
            f"the path has derivatives up to order {problem.reference.max_order}, the inputs of {problem.name} need"
            f" order {problem.array.reference_order}"
        )
    return replace(problem, follow_branch=isinstance(prepared_table(problem), BranchTable))


def _variables(problem: Problem, compiled: Mathematics, tracked: str, home: Array) -> Sequence[Variable]:
    system, array = problem.system, problem.array
    found = variables.path_variables(system.outputs, tracked, compiled.orders, home)
    place = len(system.outputs) * compiled.orders
    found += variables.output_variables(compiled.outputs, place)
    place += len(compiled.outputs)
    found += variables.parameter_variables(system.parameters.declared, problem.p, place)
    place += len(system.parameters)
    if compiled.state_size:
        found.append(variables.internal_step(place))
        place += 1
    if not problem.flat:
        units = dict(
            zip((f"q.{each}" for each in system.coordinates.names), system.coordinates.quantities, strict=True)
        )
        named = array.named_states
        found += variables.state_variables(
            named, [units[name].unit if name in units else "1" for name, _ in named], place
        )
    _require_different(problem, found)
    return found


def _require_different(problem: Problem, found: Sequence[Variable]) -> None:
    names = [name for each in found for name in each.scalar_names] + ["input_time", "time"]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InvalidModel(f"{problem.name} cannot be exported: variables named twice: {', '.join(repeated)}")
    broken = [name for name in names if not re.fullmatch(r"[^\W\d]\w*(\.\w+)*(\[\d+\])?", name)]
    if broken:
        raise InvalidModel(
            f"{problem.name} cannot be exported: FMI has no variable called {broken[0]!r}; names are letters, digits"
            f" and underscores"
        )


# The mathematics --------------------------------------------------------------------------------------------------


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
