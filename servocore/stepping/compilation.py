"""A model, a formulation and a method become one `Program`: compiled once for a system, whatever its path."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import casadi as ca

from servocore.dae import Dae
from servocore.formulations.base import Formulation
from servocore.formulations.reduced import Reduced
from servocore.methods.base import Discretisation, Method, errs_less_with_smaller_steps, instantaneous
from servocore.model.limits import Limit
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.just_in_time import JustInTime, in_machine_code
from servocore.numerics.memoization import made_once
from servocore.numerics.square_systems import compile_solver
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.initial_values import compile_restart, compile_start, start_instants
from servocore.stepping.observation import compile_margins, compile_observation, limit_texts, limits_order, observed
from servocore.stepping.prescribed_initial_values import prescribed_start
from servocore.stepping.program import Program
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import Inversion, inversion


def program_of(
    problem: Problem, formulation: Formulation, method: Method, native: bool | None = False, steps: int = 0
) -> Program:
    """Return the program of a problem; asked again for the same system and settings, the same program.

    Parameters
    ----------
    problem : Problem
        What is to be stepped.
    formulation, method : Formulation, Method
        How.
    native : bool or None
        Whether a C compiler shall turn it into machine code; with None it does so in the background, for a
        program that is used again or for many steps.
    steps : int
        How many are to be taken.
    """
    settings = formulation, method, tuple(limit for limit in problem.limits if limit.of_path), problem.follow_branch
    program = compile_program(problem.resolved, *settings)
    code = None if native is False else _in_machine_code(problem.resolved, program, native)
    return program if code is None else code.best(steps) or program


@made_once
def _in_machine_code(_: ResolvedSystem, program: Program, native: bool | None) -> JustInTime[Program]:
    """Return a program with start, step and observation as machine code."""
    return in_machine_code(program, ("start", "step", "observe"), program.name, native)


@made_once
def compile_program(
    resolved: ResolvedSystem,
    formulation: Formulation,
    method: Method,
    limits: tuple[Limit, ...] = (),
    follow_branch: bool = False,
) -> Program:
    """Compile a system with a formulation and a method.

    With `follow_branch` an exact inversion starts from where the instant before was heading instead of the model's
    guess.
    """
    system, dae = resolved.system, resolved.dae(formulation)
    array, inverse, reduced = _inverse(resolved, formulation)
    discretization = discretized(dae, method)
    start_order = max(array.reference_order, dae.reference_order, limits_order(system, limits), 2)
    known = observed(system)
    start: Callable[[], ca.Function] = partial(compile_start, array, inverse, dae, reduced, discretization, start_order)
    step: Callable[[], ca.Function] = partial(_compile_step, discretization)
    # Without differential states every instant stands alone: a step is a start.
    pointwise = dae.x.numel() == 0
    if pointwise:
        following = partial(_compile_following_step, array, inverse, start_order)
        step = following if follow_branch else partial(_compile_pointwise_step, start)
    return Program(
        name=f"{dae.name}, {method.name}" if not pointwise else dae.name,
        start=start,
        step=step,
        observe=compile_observation(system, dae, discretization, known, start_order),
        margins=partial(compile_margins, system, limits, start_order),
        guess_residual=partial(_compile_guess_residual, discretization),
        rescale=partial(_compile_rescale, discretization),
        between=partial(_compile_between, discretization),
        index=dae.index,
        smaller_steps_help=not pointwise and errs_less_with_smaller_steps(method, dae.index),
        order=start_order if pointwise else dae.reference_order,
        start_order=start_order,
        nodes=discretization.nodes,
        start_instants=start_instants(array, discretization),
        channels=tuple(quantity for quantity, _ in known),
        parameters=system.parameters.names,
        equations=discretization.labels,
        limits=limit_texts(limits),
    )


def _inverse(resolved: ResolvedSystem, formulation: Formulation) -> tuple[DerivativeArray, Inversion, Dae]:
    """Return the derivative array with the states that the formulation names, its inversion and its reduced form."""
    array = resolved.array
    if isinstance(formulation, Reduced):
        array = formulation.array(resolved.system)
    if array.states == resolved.array.states:
        array = resolved.array  # the usual states share one inversion with everything else that asks for it
    return array, inversion(array), resolved.dae(Reduced(states=array.named_states))


def discretized(dae: Dae, method: Method) -> Discretisation:
    """Return the equations of one step; those of an instant where nothing is left to integrate."""
    return method.discretise(dae) if dae.x.numel() else instantaneous(dae)


@made_once
def compile_restart_of(resolved: ResolvedSystem, formulation: Formulation, method: Method, order: int) -> Call:
    """Compile (unknowns of the array, gamma, h, p) -> the first state of a run of a form."""
    array, inverse, reduced = _inverse(resolved, formulation)
    dae = resolved.dae(formulation)
    return Call(compile_restart(array, inverse, dae, reduced, discretized(dae, method), order))


def prescribed_start_of(
    formulation: Formulation, method: Method
) -> Callable[[Problem, Array, float, int], tuple[Array, float]]:
    """Return what makes the first state of a run of a form from a start that its user gives; see `prescribed_start`."""
    return partial(prescribed_start, (compile_restart_of, formulation, method))


def _compile_step(step: Discretisation) -> ca.Function:
    solver = compile_solver("sc_solve", step.equations, [step.next_state])
    return _with_step_arguments("sc_step", step, lambda givens: list(solver(givens)))


def _compile_following_step(array: DerivativeArray, inverse: Inversion, order: int) -> ca.Function:
    """Invert exactly, starting from where the instant before was heading.

    Without internal dynamics its state is all unknowns, derivatives included. Where two motions meet, the one that goes
    on with the same velocity and acceleration is the nearer, by a power of h.
    """
    system = array.system
    state, h = ca.MX.sym("state", len(array.unknowns)), ca.MX.sym("h")
    gamma, p = ca.MX.sym("gamma", system.gamma.size1(), order + 1), ca.MX.sym("p", system.p.numel())
    known = dict(zip(array.unknowns, ca.vertsplit(state), strict=True))
    # By the derivatives that the array holds of an unknown; the highest ones have none and stay as they are.
    ahead = [
        value + h * known.get((j, k + 1), 0) + h**2 / 2 * known.get((j, k + 2), 0) for (j, k), value in known.items()
    ]
    results = inverse.search(gamma[:, : array.reference_order + 1], p, ca.vertcat(*ahead))
    return ca.Function("sc_step", [state, gamma, h, p], list(results))


def _compile_pointwise_step(compile_it: Callable[[], ca.Function]) -> ca.Function:
    start = compile_it()
    state, h = ca.MX.sym("state", start.numel_out(0)), ca.MX.sym("h")
    gamma, p = ca.MX.sym("gamma", *start.size_in(0)), ca.MX.sym("p", start.numel_in(2))
    return ca.Function("sc_step", [state, gamma, h, p], list(start(gamma, h, p)))


def _compile_guess_residual(step: Discretisation) -> ca.Function:
    equations = step.equations
    # At the guess, not at the last iterate: where Newton's method has blown up all equations look alike.
    residual = ca.substitute(equations.residual, equations.unknowns, equations.guess) / equations.residual_scale
    evaluate = ca.Function("sc_residual", [equations.givens], [ca.densify(residual)])
    return _with_step_arguments("sc_guess_residual", step, lambda givens: [evaluate(givens)])


def _compile_rescale(step: Discretisation) -> ca.Function:
    return ca.Function("sc_rescale", [step.state, step.ratio], [ca.densify(step.rescaled)])


def _compile_between(step: Discretisation) -> ca.Function:
    return ca.Function("sc_between", [step.state, step.fraction, step.step], [ca.densify(step.between)])


def _with_step_arguments(name: str, step: Discretisation, evaluate: Callable[[ca.MX], list[ca.MX]]) -> ca.Function:
    """Give a function of the flat givens the arguments (state, gamma, h, p)."""
    state = ca.MX.sym("state", step.state.numel())
    gamma = ca.MX.sym("gamma", *step.reference.shape)
    h = ca.MX.sym("h")
    p = ca.MX.sym("p", step.equations.givens.numel() - state.numel() - gamma.numel() - 1)
    return ca.Function(name, [state, gamma, h, p], evaluate(ca.vertcat(state, ca.vec(gamma), h, p)))
