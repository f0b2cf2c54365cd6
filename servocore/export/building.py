"""`inverse_model`: the inverse dynamics of a scene, ready to become an FMU: analysed, compiled, with all variables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from servocore.checks.along_motion import with_redundant_constraints_as_limits
from servocore.checks.before_run import NON_MINIMUM_PHASE, SINGULAR, internal_dynamics, require_feasible
from servocore.errors import InvalidModel
from servocore.export import variables as rows
from servocore.export.inverse_functions import Mathematics, bounds_of, mathematics
from servocore.export.native_model import NativeModel, identifier_of
from servocore.export.sampled_laws import SampledEstimates, SampledFeedback
from servocore.export.variables import INPUT_TIME, Variable
from servocore.model.drives import motors
from servocore.model.scene import Scene
from servocore.numerics.machine_code import renamed
from servocore.problem import Problem
from servocore.solvers.exact_inversion import prepared_motion
from servocore.solvers.runs import require_derivatives
from servocore.solvers.solve import solve


def inverse_model(
    scene: Scene,
    model: str | None = None,
    feedback: SampledFeedback | None = None,
    estimates: SampledEstimates | None = None,
) -> NativeModel:
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
        If the scene's own path breaks its limits, of instants or of the run as a whole.
    """
    problem = _analysed(scene, model)
    identifier = identifier_of(scene.name)
    compiled, system = mathematics(problem, identifier), problem.system
    orders, state_size = compiled.functions["begin"].size2_in(0), compiled.functions["begin"].numel_out(0)
    require_limits_kept(scene, model)
    if (feedback or estimates) and state_size:
        option = "a feedback" if feedback else "estimated derivatives"
        raise InvalidModel(f"{scene.name} cannot have {option}: its inputs are stepped, not found at every instant")
    more = dict(estimates.functions) if estimates else {}
    if feedback:
        more |= {**feedback.laws, "judge": feedback.judge}
    if feedback and scene.drives:  # motors, by inputs that are not those of the path alone
        more["motors"] = motors(system, scene.drives, compiled.outputs)
    return NativeModel(
        identifier=identifier,
        title=scene.name,
        model=model or scene.default_model,
        description=f"Inverse dynamics of {scene.name.replace('_', ' ')}: the inputs"
        f" {', '.join(quantity.name for quantity in system.inputs)} that make"
        f" {', '.join(quantity.name for quantity in system.outputs)} follow a path",
        kernel="inverse",
        own={
            "components": len(system.outputs),
            "orders": orders,
            "order_names": [rows.order_name(order) for order in range(orders)],
            "follower": scene.tracked or "path",
            "state_size": state_size,
            "routes": (),
            "nodes": compiled.nodes,
            "has_quick": int("quick" in compiled.functions),
            "end_conditions": end_conditions(orders),
            "feedback": feedback,
            "estimates": estimates,
        },
        functions=compiled.functions | {name: renamed(each, f"{identifier}_{name}") for name, each in more.items()},
        variables=rows.placed(_variables(problem, compiled, scene, feedback)),
        choices=(INPUT_TIME, *((estimates.choice,) if estimates else ())),
        outputs=compiled.outputs,
        limits=compiled.limits,
        run_limits=tuple(bound for limit in problem.limits if limit.over_run for bound in bounds_of(limit)),
        depends=_with_measured(compiled, feedback),
        differentiable=not (feedback or estimates),
        timed=bool(system.time.numel()),
        start_time=scene.reference.start_time if system.time.numel() else 0.0,
        duration=scene.reference.duration,
    )


def require_limits_kept(scene: Scene, model: str | None) -> None:
    """Raise `InvalidReference` if the scene's own path breaks a limit of an instant or of the whole run."""
    require_feasible(problem := Problem.of(scene, model))
    if problem.motion_limits:
        solve(scene, model=model)


def _analysed(scene: Scene, model: str | None) -> Problem:
    """Return a scene's problem; raises `InvalidModel` if its inputs depend on the future of the path."""
    problem = with_redundant_constraints_as_limits(followed(Problem.of(scene, model)))
    kind = internal_dynamics(problem)
    if kind.kind in (NON_MINIMUM_PHASE, SINGULAR):
        grows = f"grow at {kind.growth:.4g} 1/s" if kind.kind == NON_MINIMUM_PHASE else "are singular at rest"
        raise InvalidModel(
            f"{scene.name} cannot be exported: its internal dynamics {grows} ({kind.kind}), so that bounded inputs"
            f" depend on the whole path, its future included; solve computes them"
        )
    return problem


def followed(problem: Problem) -> Problem:
    """Return the problem, set to follow a branch if the guess of the model leaves its branch along the path."""
    if not problem.flat or problem.follow_branch:
        return problem
    require_derivatives(problem, problem.array.reference_order, f"the inputs of {problem.name} need")
    require_feasible(problem)  # first: a limit says more than a singular matrix
    return replace(problem, follow_branch=not prepared_motion(problem).direct)


def _variables(
    problem: Problem, compiled: Mathematics, scene: Scene, feedback: SampledFeedback | None
) -> Sequence[Variable]:
    system, array = problem.system, problem.array
    home = scene.reference.jet([scene.reference.start_time], 0)[0, 0]
    variables = rows.path_variables(system.outputs, scene.tracked, compiled.functions["begin"].size2_in(0), home)
    if feedback is not None:
        variables += [rows.measured_variable(*each) for each in feedback.measured]
        variables += rows.feedback_settings(system.inputs, feedback.distance)
    variables += [rows.of_quantity(each, "output") for each in compiled.outputs]
    variables += rows.parameter_variables(system.parameters.declared, problem.p)
    if "advance" in compiled.functions:
        variables.append(rows.internal_step())
    if not problem.flat:
        quantities = {f"q.{quantity.name}": quantity for quantity in system.coordinates.quantities}
        units = [quantities[name].unit if name in quantities else "1" for name, _ in array.named_states]
        variables += rows.state_variables(array.named_states, units)
    return variables


def _with_measured(compiled: Mathematics, feedback: SampledFeedback | None) -> npt.NDArray[np.bool_]:
    """Return which outputs depend on which inputs; inputs of the system and their motors also on measured values."""
    if feedback is None:
        return compiled.depends
    inputs = [each.name for each in compiled.outputs[: feedback.drives]]
    chosen = np.array([each.name.partition(".")[0] in inputs for each in compiled.outputs])
    return np.hstack([compiled.depends, np.repeat(chosen[:, None], feedback.numbers, axis=1)])


def end_conditions(orders: int) -> list[list[float]]:
    """Return the inverse of the conditions at the end of a step on the upper half of a polynomial's coefficients.

    The polynomial of degree 2 orders - 1 joins two instants at which a path and its derivatives are known.
    """
    falling = [[math.factorial(j) / math.factorial(j - k) for j in range(orders, 2 * orders)] for k in range(orders)]
    inverse: list[list[float]] = np.linalg.inv(np.array(falling)).tolist()
    return inverse
