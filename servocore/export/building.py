"""From a scene to its `InverseModel`: analysed, compiled, with all variables named."""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence
from dataclasses import replace

from servocore.checks.internal_dynamics import NON_MINIMUM_PHASE, SINGULAR, internal_dynamics
from servocore.checks.limits import require_feasible
from servocore.errors import InvalidModel, InvalidReference
from servocore.export import variables
from servocore.export.inverse_model import InverseModel, Mathematics
from servocore.export.mathematics import METHOD, mathematics
from servocore.export.variables import Variable
from servocore.model.scene import Scene
from servocore.numerics.calls import Array
from servocore.problem import Problem
from servocore.solvers.following import BranchTable, prepared_table

_LONGEST_IDENTIFIER = 40
_NAMES_TAKEN = ("main", "all", "clean", "help", "install", "package", "test")  # files, and CMake's own targets


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
        If the inputs do not follow from past and present of the path, as with internal dynamics that are unstable; or
        a limit cannot be kept from step to step.
    InvalidReference
        If the scene's own path breaks its limits.
    """
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
        method="" if problem.flat else METHOD.name,
        timed=bool(system.time.numel()),
        start_time=scene.reference.start_time if system.time.numel() else 0.0,
        duration=scene.reference.duration,
    )


def identifier_of(name: str) -> str:
    """Return a name as an identifier of C, as short as functions' names have to be."""
    # CasADi takes no two underscores in a row.
    found = re.sub(r"[\W_]+", "_", name, flags=re.ASCII)[:_LONGEST_IDENTIFIER].strip("_")
    if not found:
        return "model"
    taken = not found[0].isalpha() or keyword.iskeyword(found) or found.lower() in _NAMES_TAKEN
    return f"model_{found}" if taken else found


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
        quantities = {f"q.{each.name}": each for each in system.coordinates.quantities}
        units = [quantities[name].unit if name in quantities else "1" for name, _ in array.named_states]
        found += variables.start_variables(array.named_states, units, place)
        found += variables.state_variables(array.named_states, units, place + len(units))
    _require_different(problem, found, ("input_time", "time", *(() if compiled.state_size else ("internal_step",))))
    return found


def _require_different(problem: Problem, found: Sequence[Variable], taken: Sequence[str]) -> None:
    names = [name for each in found for name in each.scalar_names]
    every = [*names, *taken]
    repeated = sorted({name for name in every if every.count(name) > 1})
    if repeated:
        raise InvalidModel(f"{problem.name} cannot be exported: variables named twice: {', '.join(repeated)}")
    broken = [name for name in names if not re.fullmatch(r"[a-zA-Z_]\w*(\.\w+)*(\[\d+\])?", name, flags=re.ASCII)]
    if broken:
        raise InvalidModel(
            f"{problem.name} cannot be exported: FMI has no variable called {broken[0]!r}; names are the letters a to z"
            f" and A to Z, digits and underscores"
        )
