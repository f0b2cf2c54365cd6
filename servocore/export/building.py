"""From a scene to its `InverseModel`: analysed, compiled, with all variables named."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.checks.along_motion import (
    require_redundant_constraints,
    with_redundant_constraints_as_limits,
)
from servocore.checks.before_run import NON_MINIMUM_PHASE, SINGULAR, internal_dynamics, require_feasible
from servocore.checks.failure_causes import causes_explained
from servocore.checks.motion_limits import HIDDEN, counts_turns, with_watched
from servocore.errors import InvalidModel, InvalidReference
from servocore.export import variables as rows
from servocore.export.c_functions import named_in_c
from servocore.export.directional_derivatives import tangent, tangent_of_step
from servocore.export.estimates import SampledEstimates
from servocore.export.exported_quantities import Matrix, observation, timed_path, wanted
from servocore.export.feedback import SampledFeedback
from servocore.export.identifiers import identifier_of, require_different
from servocore.export.inverse_model import InverseModel, Mathematics
from servocore.export.native_model import Bound
from servocore.export.variables import INPUT_TIME, Variable
from servocore.formulations.reduced import Reduced
from servocore.methods.base import instantaneous
from servocore.methods.collocation import RadauIIA
from servocore.model.drives import motors
from servocore.model.limits import Limit
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import highest_derivative
from servocore.problem import Problem
from servocore.solvers.exact_inversion import prepared_motion
from servocore.stepping.observation import compile_margins, limits_order
from servocore.stepping.program import Program, program_of
from servocore.structure.inversion import inversion

METHOD = RadauIIA(3)
"""The method that integrates the internal dynamics, on the reduced form."""

TERMINALS = {
    "path": ("input", "the path to follow with its derivatives"),
    "result": ("output", "inputs of the drives, and the resulting motion"),
}
"""Groups of variables that a host connects together."""

_ROUND_OFF = 1e-9  # share of a limit of the motion that may be exceeded by round-off


def inverse_model(
    scene: Scene,
    model: str | None = None,
    feedback: SampledFeedback | None = None,
    estimates: SampledEstimates | None = None,
) -> InverseModel:
    """Analyse and compile a scene for export.

    Parameters
    ----------
    scene : Scene
        With its parameter values; its own path gives start values and default experiment only.
    model : str, optional
        Model of the scene; its smallest when not given.
    feedback : SampledFeedback, optional
        For scenes without internal dynamics.
    estimates : SampledEstimates, optional
        Of derivatives of the path that are not connected; for the same scenes.

    Raises
    ------
    InvalidModel
        If the inputs depend on the future of the path, as with unstable internal dynamics; or a limit cannot be
        checked from step to step.
    InvalidReference
        If the scene's own path breaks its limits.
    """
    problem = with_redundant_constraints_as_limits(followed(Problem.of(scene, model)))
    kind = internal_dynamics(problem)
    if kind.kind in (NON_MINIMUM_PHASE, SINGULAR):
        grows = f"grow at {kind.growth:.4g} 1/s" if kind.kind == NON_MINIMUM_PHASE else "are singular at rest"
        raise InvalidModel(
            f"{scene.name} cannot be exported: its internal dynamics {grows} ({kind.kind}), so that bounded inputs"
            f" depend on the whole path, its future included; solve computes them"
        )
    if not problem.flat or problem.follow_branch:  # `followed` has checked the others
        require_feasible(problem)
    identifier = identifier_of(scene.name)
    compiled, system = mathematics(problem, identifier), problem.system
    home = scene.reference.jet([scene.reference.start_time], 0)[0, 0]
    variables = rows.placed(_variables(problem, compiled, scene.tracked, home, feedback))
    moved = bool(feedback and scene.drives)  # motors, by inputs that are not those of the path alone
    if (feedback or estimates) and compiled.state_size:
        option = "a feedback" if feedback else "estimated derivatives"
        raise InvalidModel(f"{scene.name} cannot have {option}: its inputs are stepped, not found at every instant")
    return InverseModel(
        identifier=identifier,
        title=scene.name,
        model=model or scene.default_model,
        description=f"Inverse dynamics of {scene.name.replace('_', ' ')}: the inputs"
        f" {', '.join(quantity.name for quantity in system.inputs)} that make"
        f" {', '.join(quantity.name for quantity in system.outputs)}"
        " follow a path",
        kernel="inverse",
        own=_own(compiled, len(system.outputs), scene.tracked, feedback)
        | {"estimates": estimates.own() if estimates else None, "has_motors": int(moved)},
        functions={
            **compiled.functions,
            **(named_in_c({**feedback.laws, "judge": feedback.judge}, identifier) if feedback else {}),
            **(named_in_c(estimates.functions, identifier) if estimates else {}),
            **(named_in_c({"motors": motors(system, scene.drives, compiled.outputs)}, identifier) if moved else {}),
        },
        variables=variables,
        choices=(INPUT_TIME, *((estimates.choice,) if estimates else ())),
        outputs=compiled.outputs,
        limits=compiled.limits,
        depends=_with_measured(compiled, feedback),
        differentiable=not (feedback or estimates),
        terminals=TERMINALS,
        mathematics=compiled,
        components=len(system.outputs),
        method="" if problem.flat else METHOD.name,
        timed=bool(system.time.numel()),
        start_time=scene.reference.start_time if system.time.numel() else 0.0,
        duration=scene.reference.duration,
    )


def followed(problem: Problem) -> Problem:
    """Return the problem, set to follow a branch if the guess of the model leaves its branch along the path."""
    if not problem.flat or problem.follow_branch:
        return problem
    if problem.reference.max_order < problem.array.reference_order:
        raise InvalidReference(
            f"the path has derivatives up to order {problem.reference.max_order}, the inputs of {problem.name} need"
            f" order {problem.array.reference_order}"
        )
    require_feasible(problem)  # first: a limit says more than a singular matrix
    with causes_explained(problem):
        motion = prepared_motion(problem)
    require_redundant_constraints(problem, motion)
    return replace(problem, follow_branch=not motion.direct)


def _variables(
    problem: Problem, compiled: Mathematics, tracked: str, home: Array, feedback: SampledFeedback | None
) -> Sequence[Variable]:
    system, array = problem.system, problem.array
    variables = rows.path_variables(system.outputs, tracked, compiled.orders, home)
    if feedback is not None:
        variables += rows.measured_variables(feedback.measured)
    variables += rows.output_variables(compiled.outputs)
    variables += rows.parameter_variables(system.parameters.declared, problem.p)
    if feedback is not None:
        variables += rows.feedback_settings(system.inputs, feedback.distance)
    if compiled.state_size:
        variables.append(rows.internal_step())
    if not problem.flat:
        quantities = {f"q.{quantity.name}": quantity for quantity in system.coordinates.quantities}
        units = [quantities[name].unit if name in quantities else "1" for name, _ in array.named_states]
        variables += rows.state_variables(array.named_states, units)
    require_different(problem, variables, ("input_time", "time", *(() if compiled.state_size else ("internal_step",))))
    return variables


def _own(compiled: Mathematics, components: int, tracked: str, feedback: SampledFeedback | None) -> dict[str, Any]:
    """Return values for the templates of the sources, by name."""
    return {
        "components": components,
        "orders": compiled.orders,
        "order_names": [rows.order_name(order) for order in range(compiled.orders)],
        "follower": tracked or "path",
        "state_size": compiled.state_size,
        "routes": None,
        "nodes": compiled.nodes,
        "has_quick": int("quick" in compiled.functions),
        "end_conditions": end_conditions(compiled.orders),
        "feedback": feedback.own() if feedback else None,
    }


def _with_measured(compiled: Mathematics, feedback: SampledFeedback | None) -> npt.NDArray[np.bool_]:
    """Return which outputs depend on which inputs; inputs of the system and their motors also on measured values."""
    if feedback is None:
        return compiled.depends
    drives, measured = feedback.laws["feedback_start"].numel_out(1), feedback.numbers
    inputs = [each.name for each in compiled.outputs[:drives]]
    rows = np.array([each.name.partition(".")[0] in inputs for each in compiled.outputs])
    return np.hstack([compiled.depends, np.repeat(rows[:, None], measured, axis=1)])


def end_conditions(orders: int) -> list[list[float]]:
    """Return the inverse of the conditions at the end of a step on the upper half of a polynomial's coefficients.

    The polynomial of degree 2 orders - 1 joins two instants at which a path and its derivatives are known.
    """
    falling = [[math.factorial(j) / math.factorial(j - k) for j in range(orders, 2 * orders)] for k in range(orders)]
    inverse: list[list[float]] = np.linalg.inv(np.array(falling)).tolist()
    return inverse


# The mathematics --------------------------------------------------------------------------------------------------


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
    watched = with_watched(problem)
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

    def split(self, values: Matrix, margins: Matrix) -> tuple[Matrix, Matrix]:
        """Return outputs and margins of all limits, from all values and the margins of the path."""
        count, sides = len(self.outputs), self.bounds[len(self.of_path) :]
        kept = [side.side * (values[count + side.row] - side.bound) + _ROUND_OFF * abs(side.bound) for side in sides]
        return values[:count], ca.vertcat(margins, *kept)


def bounds(problem: Problem) -> tuple[Bound, ...]:
    """Return the bounds of limits, those of the path first.

    Raises
    ------
    InvalidModel
        If one is of an angle that counts turns, or of the rate of a force: neither follows from a single instant.
    """
    path = [Bound(e.quantity, e.unit, e.reason, e.bound, 1.0, -1) for e in problem.limits if e.of_path]
    hidden = [observable.name for observable in problem.system.observables if observable.name.startswith(HIDDEN)]
    bounds_of_limits = []
    for row, (limit, name) in enumerate(zip((e for e in problem.limits if not e.of_path), hidden, strict=True)):
        if name.endswith("differenced") or counts_turns(limit.expression, limit.rate, problem.system):
            kind = "the rate of a force" if name.endswith("differenced") else "an angle that counts full turns"
            raise InvalidModel(
                f"{problem.name} cannot be exported with its limit of {limit.quantity}: an FMU checks limits at single"
                f" instants, and this is {kind}"
            )
        sides = [(limit.bound, 1.0), (limit.upper, -1.0)]
        bounds_of_limits += [
            Bound(limit.quantity, limit.unit, limit.reason, bound, side, row, limit.rate)
            for bound, side in sides
            if math.isfinite(bound)
        ]
    return (*path, *bounds_of_limits)


def _instantaneous(known: _Known, identifier: str) -> Mathematics:
    """Compile the inversion of single instants: the equations as one expression, and Newton's method where it fails."""
    problem = known.problem
    system, dae = problem.system, problem.dae(Reduced())
    inverse = inversion(problem.array)
    rows = problem.array.reference_order + 1
    orders = max(rows, known.orders)
    read = observation(system, dae, instantaneous(dae), known.wanted, orders - 1)
    margins = compile_margins(system, known.of_path, orders - 1)

    def seen(state: Matrix, path: Matrix, p: Matrix) -> tuple[Matrix, Matrix]:
        return known.split(read(state, path, p), margins(path, p))

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
    depends = _dependence(functions.get("quick", functions["begin"]), 1)
    return Mathematics(functions, known.outputs, known.bounds, orders, 0, (1.0,), depends)


def _stepped(known: _Known, identifier: str) -> Mathematics:
    """Compile steps: of internal dynamics, or along a branch that is followed from instant to instant."""
    problem = known.problem
    system, dae = problem.system, problem.dae(Reduced())
    program = program_of(problem, Reduced(), METHOD)
    orders = max(program.start_order + 1, known.orders)
    method_step = program.discretization
    read = observation(system, dae, method_step, known.wanted, orders - 1)
    margins, nodes = compile_margins(system, known.of_path, orders - 1), program.nodes
    G, P, T = _symbols(system, orders)
    D, h = ca.MX.sym("start", len(problem.array.states)), ca.MX.sym("h")
    path = timed_path(system, G, T)
    first, residual = _first(problem, program, path, P, D)
    outputs, kept = known.split(read(first, path, P), margins(path, P))
    S, N = ca.MX.sym("state", program.state_size), ca.MX.sym("nodes", G.shape[0], orders * len(nodes))
    at_nodes = [
        timed_path(system, column, T + node * h) for column, node in zip(ca.horzsplit(N, orders), nodes, strict=True)
    ]
    used = ca.horzcat(*[each[:, : program.order + 1] for each in at_nodes])
    after, _, left = program.step(S, used, h, P)

    def seen(state: ca.MX) -> tuple[ca.MX, ca.MX]:
        return known.split(read(state, at_nodes[-1], P), margins(at_nodes[-1], P))

    stepped, within = seen(after)
    step, by, begin = [S, N, h, P, T], [S, N, P], [G, P, T, D]
    if not dae.x.numel():  # instants are independent, except for the branch
        along = tangent(f"{identifier}_advance_tangent", step, [after, stepped], by)
    else:
        givens = ca.vertcat(S, ca.vec(used), h, P)
        along = tangent_of_step(
            f"{identifier}_advance_tangent", method_step, step, by, givens, after, lambda state: [seen(state)[0]]
        )
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


def _dependence(function: ca.Function, result: int) -> npt.NDArray[np.bool_]:
    """Return which rows of a result depend on which numbers of the first argument."""
    pattern = function.jac_sparsity(result, 0)
    depends = np.zeros(pattern.shape, dtype=bool)
    depends[tuple(np.array(pattern.get_triplet(), dtype=np.intp))] = True
    return depends
