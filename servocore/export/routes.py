"""`SteppedRoutes`: formulations and methods of an exported inverse model besides the exact inversion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from servocore.errors import InvalidModel
from servocore.export.c_functions import c_source
from servocore.export.inverse_functions import observation, timed_path
from servocore.export.native_model import NativeModel
from servocore.export.variables import Choice, internal_step, placed
from servocore.formulations.base import Formulation
from servocore.methods.base import Method
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.numerics.machine_code import renamed
from servocore.problem import Problem
from servocore.stepping.observation import compile_margins, observed
from servocore.stepping.program import Program, program_of
from servocore.stepping.step_functions import compile_start
from servocore.structure.inversion import inversion


@dataclass(frozen=True)
class SteppedRoutes:
    """Models and formulations for a host to choose; the first model with the first formulation is inverted exactly.

    Attributes
    ----------
    models : tuple of str
        Models of the scene; its smallest comes first.
    formulations : mapping of str to Formulation
        By name; the reduced one comes first.
    method : Method
        The method of their steps; it has one node, the end of the step.
    """

    models: tuple[str, ...]
    formulations: Mapping[str, Formulation]
    method: Method


def with_routes(made: NativeModel, scene: Scene, options: SteppedRoutes) -> NativeModel:
    """Return an inverse model with a choice of routes.

    Parameters
    ----------
    made : NativeModel
        Of a scene whose inputs do not depend on the past.
    scene : Scene
        That scene.
    options : SteppedRoutes
        The routes.

    Raises
    ------
    InvalidModel
        If the inputs are stepped, there are limits of the motion, or a step of a route has other nodes than its end.
    """
    if made.own["state_size"] or any(not limit.row < 0 for limit in made.limits):
        raise InvalidModel(f"{scene.name} cannot have routes to choose from: its inputs are stepped, or limited")
    outputs, orders = made.outputs, made.own["orders"]
    programs, functions, sources = list[Program](), list[ca.Function](), dict[str, str]()
    for model in options.models:
        of_model = list[ca.Function]()
        for formulation in options.formulations.values():
            program = program_of(Problem.of(scene, model), formulation, options.method)
            if program.nodes != (1.0,):
                raise InvalidModel(f"{program.name} cannot be exported: its steps have other nodes than their end")
            if route := len(programs):
                name = f"{made.identifier}_route_{route}"
                of_model += step_functions(program, name, outputs, orders, guess=True).values()
            programs.append(program)
        # Routes are large: those of a model share a file, and in it the functions of the model's exact inversion.
        name = f"{made.identifier}_{model}"
        sources[f"{name}.h"], sources[f"{name}.c"] = c_source(name, of_model)
        functions += of_model
    problem = Problem.of(scene, options.models[0])
    margins = compile_margins(problem.system, problem.path_limits, orders - 1)
    models = tuple((name, f"the model {name}") for name in options.models)
    formulations = tuple((name, f"the {name} equations") for name in options.formulations)
    choices = (
        Choice("model", "model that is solved", models),
        Choice("formulation", "how the servo constraints enter the equations", formulations),
    )
    return replace(
        made,
        variables=placed([*made.variables, internal_step()]),
        choices=(*choices, *made.choices),
        own={**made.own, "routes": programs, "formulations": len(options.formulations)},
        functions={**made.functions, "margins": renamed(margins, f"{made.identifier}_margins")},
        elsewhere=tuple(functions),
        more_sources=sources,
        differentiable=False,
    )


def step_functions(
    program: Program, name: str, outputs: Sequence[Quantity], orders: int, guess: bool = False
) -> dict[str, ca.Function]:
    """Compile start and step of a program; a path is (m, orders), column after column, parameters p.

    Parameters
    ----------
    program : Program
        Model, formulation and method.
    name : str
        Prefix of names in C.
    outputs : sequence of Quantity
        Results, by their names.
    orders : int
        Number of derivatives of the path among the arguments, the path itself included; of missing ones, which no
        result depends on, the program gets zeros.
    guess : bool
        Whether also residuals of all equations at the first guess of a step are wanted.

    Returns
    -------
    dict of str to casadi.Function
        ``begin``, (nothing, paths at the instants of a start, h, p, time of the start) -> (state, outputs, residual);
        ``step``, (state, path after the step, h, p, time before it) -> the same; and ``guess``, of the same arguments.
    """
    array, dae, order, instants = program.array, program.dae, program.start_order, program.start_instants
    system, every = array.system, {quantity.name: (quantity, each) for quantity, each in observed(array.system)}
    read = observation(system, dae, program.discretization, [every[each.name] for each in outputs], order)
    past, path = (ca.MX.sym("path", len(system.outputs), orders * count) for count in (len(instants), 1))
    none, state, p = ca.MX.sym("none", 0), ca.MX.sym("state", program.state_size), ca.MX.sym("p", system.p.numel())
    h, time, zeros = ca.MX.sym("h"), ca.MX.sym("time"), ca.MX.zeros(len(system.outputs), max(0, order + 1 - orders))

    def known(column: ca.MX, instant: ca.MX) -> ca.MX:
        return timed_path(system, ca.horzcat(column[:, : order + 1], zeros), instant)

    jets = [known(each, time + k * h) for each, k in zip(ca.horzsplit(past, orders), instants, strict=True)]
    by_search = inversion(array).by_search()
    start = compile_start(array, by_search, dae, program.reduced, program.discretization, order)
    first, _, residual = start(ca.horzcat(*jets), h, p)
    then, arguments = known(path, time + h), [state, path, h, p, time]
    after, _, left = program.step(state, then[:, : program.order + 1], h, p)
    found = {
        "begin": ([none, past, h, p, time], [first, read(first, jets[0], p), residual]),
        "step": (arguments, [after, read(after, then, p), left]),
    }
    if guess:
        used = then[:, : program.guess_residual.size2_in(1)]
        found["guess"] = arguments, [program.guess_residual(state, used, h, p)]
    return {
        key: ca.Function(f"{name}_{key}", given, [ca.densify(each) for each in results])
        for key, (given, results) in found.items()
    }
