"""`SteppedRoutes`: formulations and methods of an exported inverse model besides the exact inversion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import casadi as ca

from servocore.errors import InvalidModel
from servocore.export.c_functions import c_source
from servocore.export.native_model import NativeModel
from servocore.export.variables import Choice, internal_step, placed
from servocore.formulations.base import Formulation
from servocore.methods.base import Method
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.numerics.machine_code import renamed
from servocore.problem import Problem
from servocore.stepping.observation import compile_margins
from servocore.stepping.program import Program, program_of

_FULL_DERIVATIVES = 3  # of the path: steps that use these need no history of it


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

    @property
    def choices(self) -> tuple[Choice, Choice]:
        """The parameters of the choice."""
        models = tuple((name, f"the model {name}") for name in self.models)
        formulations = tuple((name, f"the {name} equations") for name in self.formulations)
        return (
            Choice("model", "model that is solved", models),
            Choice("formulation", "how the servo constraints enter the equations", formulations),
        )


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
    programs, functions, sources = list[Program](), list[dict[str, ca.Function]](), dict[str, str]()
    for k, (model, formulation) in enumerate(product(options.models, options.formulations.values())):
        program = program_of(Problem.of(scene, model), formulation, options.method)
        if program.nodes != (1.0,):
            raise InvalidModel(f"{program.name} cannot be exported: its steps have other nodes than their end")
        programs.append(program)
        functions.append(_functions(program, f"{made.identifier}_route_{k}", outputs, orders) if k else {})
    # Routes are large: those of a model share a file, and in it the functions of the model's exact inversion.
    count = len(options.formulations)
    for k, model in enumerate(options.models):
        name, of_model = f"{made.identifier}_{model}", functions[k * count : (k + 1) * count]
        sources[f"{name}.h"], sources[f"{name}.c"] = c_source(name, [f for each in of_model for f in each.values()])
    problem = Problem.of(scene, options.models[0])
    of_path = tuple(limit for limit in problem.limits if limit.of_path)
    margins = renamed(compile_margins(problem.system, of_path, orders - 1), f"{made.identifier}_margins")
    table = _table(programs, functions, outputs) | {"formulations": count}
    return replace(
        made,
        variables=placed([*made.variables, internal_step()]),
        choices=(*options.choices, *made.choices),
        own={**made.own, "routes": table},
        functions={**made.functions, "margins": margins},
        elsewhere=tuple(function for each in functions for function in each.values()),
        more_sources=sources,
        differentiable=False,
    )


def _table(
    programs: Sequence[Program], functions: Sequence[Mapping[str, ca.Function]], outputs: Sequence[Quantity]
) -> dict[str, Any]:
    """Return values for the templates of the sources, by name."""
    return {
        "size": max(program.state_size for program in programs),
        "instants": max(len(program.start_instants) for program in programs),
        "equations": max(len(program.equations) for program in programs),
        "wrong_signs": [each.wrong_sign for each in outputs],
        "forces": [each.unit == "N" for each in outputs],
        "each": [
            {
                "name": program.name,
                "exact": not of_route,
                "size": program.state_size,
                "at": program.start_instants,
                "settle": max(0, _FULL_DERIVATIVES - program.order),
                "equations": program.equations,
                "smaller_steps_help": program.smaller_steps_help,
            }
            for program, of_route in zip(programs, functions, strict=True)
        ],
    }


def _padded(program: Program, path: ca.MX) -> ca.MX:
    """Return a path padded with zeros to the derivatives of the program; no result depends on the zeros."""
    missing = program.start_order + 1 - path.shape[1]
    return path[:, : program.start_order + 1] if missing <= 0 else ca.horzcat(path, ca.MX.zeros(path.shape[0], missing))


def _functions(program: Program, name: str, outputs: Sequence[Quantity], orders: int) -> dict[str, ca.Function]:
    """Return the functions of a route by name.

    They are ``begin``, (path, p) -> (state, outputs, residual), ``past``, (paths at its start's instants, h, p) ->
    (state, residual), ``step``, (state, path, h, p) -> (state, outputs, residual), and ``guess``, (state, path, h, p)
    -> residuals of all equations at the first guess.
    """
    names, count = [channel.name for channel in program.channels], len(program.start_instants)
    places = [names.index(each.name) for each in outputs]
    path, past = (ca.MX.sym(name, program.start.size1_in(0), orders * k) for name, k in (("path", 1), ("past", count)))
    p, h, state = (
        ca.MX.sym(*each) for each in (("p", program.start.numel_in(2)), ("h",), ("state", program.state_size))
    )
    used = _padded(program, path)

    def seen(of: ca.MX) -> ca.MX:
        return ca.densify(program.observe(of, used, p)[0][places])

    first, _, residual = program.start(ca.repmat(used, 1, count), 0, p)
    earlier, _, unsolved = program.start(ca.horzcat(*(_padded(program, e) for e in ca.horzsplit(past, orders))), h, p)
    after, _, left = program.step(state, used[:, : program.order + 1], h, p)
    guess = program.guess_residual(state, used[:, : program.guess_residual.size2_in(1)], h, p)
    results: dict[str, tuple[list[ca.MX], list[ca.MX]]] = {
        "begin": ([path, p], [first, seen(first), residual]),
        "past": ([past, h, p], [earlier, unsolved]),
        "step": ([state, path, h, p], [after, seen(after), left]),
        "guess": ([state, path, h, p], [guess]),
    }
    return {
        key: ca.Function(f"{name}_{key}", arguments, [ca.densify(each) for each in found])
        for key, (arguments, found) in results.items()
    }
