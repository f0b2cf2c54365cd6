"""`InverseModel`: what is exported of a scene, as one value. Everything else here writes it down in some language."""

from __future__ import annotations

import hashlib
import keyword
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from servocore.checks.internal_dynamics import NON_MINIMUM_PHASE, SINGULAR, internal_dynamics
from servocore.checks.limits import require_feasible
from servocore.errors import InvalidModel, InvalidReference
from servocore.export import variables
from servocore.export.mathematics import METHOD, Mathematics, mathematics
from servocore.export.variables import Causality, Variable
from servocore.model.scene import Scene
from servocore.numerics.calls import Array
from servocore.problem import Problem
from servocore.solvers.following import BranchTable, prepared_table
from servocore.stepping.margins import limit_texts
from servocore.stepping.program import LimitText

_LONGEST_IDENTIFIER = 40


@dataclass(frozen=True, eq=False)
class InverseModel:
    """The inverse model of a scene, ready to be written down.

    Attributes
    ----------
    identifier : str
        The scene's name as an identifier of C.
    title, model : str
        Names of scene and model.
    description : str
        One line.
    mathematics : Mathematics
        What it computes.
    variables : tuple of Variable
        Inputs, outputs, parameters and internal states, in the order of their numbers; without input_time.
    components : int
        Of the path.
    limits : tuple of LimitText
        Where the scene ends.
    method : str
        What steps internal dynamics; empty where there are none.
    duration : float
        Of the scene's own path, for a default experiment, in s.
    """

    identifier: str
    title: str
    model: str
    description: str
    mathematics: Mathematics
    variables: tuple[Variable, ...]
    components: int
    limits: tuple[LimitText, ...]
    method: str
    duration: float

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality."""
        return tuple(each for each in self.variables if each.causality == causality)

    def token(self, *more: str) -> str:
        """Return an identifier that changes when, and only when, variables, mathematics or `more` do."""
        digest = hashlib.sha256(repr(self.variables).encode())
        for text in (*self.mathematics.source(), repr(self.limits), *more):
            digest.update(text.encode())
        code = digest.hexdigest()
        return f"{{{code[:8]}-{code[8:12]}-{code[12:16]}-{code[16:20]}-{code[20:32]}}}"


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
        If the inputs do not follow from past and present of the path: internal dynamics that are unstable.
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
    if not problem.flat:
        found.append(variables.internal_step(place))
        units = dict(
            zip((f"q.{each}" for each in system.coordinates.names), system.coordinates.quantities, strict=True)
        )
        named = array.named_states
        found += variables.state_variables(
            named, [units[name].unit if name in units else "1" for name, _ in named], place + 1
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
