"""The functions of a `Program` that step it, compiled: its equations solved, and what is made of its state."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from servocore.methods.base import Discretisation
from servocore.numerics.square_systems import compile_solver
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import inversion


def compile_step(step: Discretisation) -> ca.Function:
    """Compile (state, gamma, h, p) -> (state, counts, residual)."""
    solver = compile_solver("sc_solve", step.equations, [step.next_state])
    return _with_step_arguments("sc_step", step, lambda givens: list(solver(givens)))


def compile_following_step(array: DerivativeArray, order: int) -> ca.Function:
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
    results = inversion(array).search(gamma[:, : array.reference_order + 1], p, ca.vertcat(*ahead))
    return ca.Function("sc_step", [state, gamma, h, p], list(results))


def compile_pointwise_step(start: ca.Function) -> ca.Function:
    """Return a step that forgets its state and starts again."""
    state, h = ca.MX.sym("state", start.numel_out(0)), ca.MX.sym("h")
    gamma, p = ca.MX.sym("gamma", *start.size_in(0)), ca.MX.sym("p", start.numel_in(2))
    return ca.Function("sc_step", [state, gamma, h, p], list(start(gamma, h, p)))


def compile_guess_residual(step: Discretisation) -> ca.Function:
    """Compile (state, gamma, h, p) -> residual of every equation at the first guess."""
    equations = step.equations
    # At the guess, not at the last iterate: where Newton's method has blown up all equations look alike.
    residual = ca.substitute(equations.residual, equations.unknowns, equations.guess) / equations.residual_scale
    evaluate = ca.Function("sc_residual", [equations.givens], [ca.densify(residual)])
    return _with_step_arguments("sc_guess_residual", step, lambda givens: [evaluate(givens)])


def compile_rescale(step: Discretisation) -> ca.Function:
    """Compile (state, ratio) -> state for steps of another size."""
    return ca.Function("sc_rescale", [step.state, step.ratio], [ca.densify(step.rescaled)])


def compile_between(step: Discretisation) -> ca.Function:
    """Compile (state, fraction, h) -> state within its last step."""
    return ca.Function("sc_between", [step.state, step.fraction, step.step], [ca.densify(step.between)])


def _with_step_arguments(name: str, step: Discretisation, evaluate: Callable[[ca.MX], list[ca.MX]]) -> ca.Function:
    """Give a function of the flat givens the arguments (state, gamma, h, p)."""
    state = ca.MX.sym("state", step.state.numel())
    gamma = ca.MX.sym("gamma", *step.reference.shape)
    h = ca.MX.sym("h")
    p = ca.MX.sym("p", step.equations.givens.numel() - state.numel() - gamma.numel() - 1)
    return ca.Function(name, [state, gamma, h, p], evaluate(ca.vertcat(state, ca.vec(gamma), h, p)))
