"""The functions of a `Program`, compiled: consistent initial values, with the history of a multistep method, and steps.

A start depends on the reference alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import casadi as ca

from servocore.dae import Dae
from servocore.methods.base import Discretization
from servocore.numerics.square_systems import compile_solver
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import Inversion, inversion

if TYPE_CHECKING:
    from servocore.methods.collocation import RadauIIA


def _backwards_method() -> RadauIIA:
    """Return the method that integrates internal dynamics backwards from the initial time, of order seven."""
    from servocore.methods.collocation import RadauIIA  # noqa: PLC0415 - a flat scene has no history

    return RadauIIA(4)


def compile_step(step: Discretization) -> ca.Function:
    """Compile (state, gamma, h, p) -> (state, counts, residual)."""
    solver = compile_solver("sc_solve", step.equations, [step.next_state])
    return _with_step_arguments("sc_step", step, lambda givens: list(solver(givens)))


def compile_bare_step(step: Discretization, tolerance: float) -> ca.Function:
    """Compile (state, gamma, h, p) -> state, NaN where the step is not solved; `tolerance` is Newton's."""
    equations = replace(step.equations, tolerance=tolerance)
    solver = compile_solver("sc_bare", equations, [step.next_state], checked=False)
    return _with_step_arguments("sc_bare_step", step, lambda givens: [solver(givens)])


def compile_following_step(array: DerivativeArray, order: int) -> ca.Function:
    """Compile an exact inversion that starts from the extrapolated previous instant.

    Its state is all unknowns, derivatives included. Where two motions meet, the one of continuous velocity and
    acceleration is closer to the extrapolation, by a power of h.
    """
    system = array.system
    state, h = ca.MX.sym("state", len(array.unknowns)), ca.MX.sym("h")
    gamma, p = ca.MX.sym("gamma", system.gamma.size1(), order + 1), ca.MX.sym("p", system.p.numel())
    known = dict(zip(array.unknowns, ca.vertsplit(state), strict=True))
    # By the derivatives of an unknown in the array; the highest ones have none and stay constant.
    ahead = [
        value + h * known.get((j, k + 1), 0) + h**2 / 2 * known.get((j, k + 2), 0) for (j, k), value in known.items()
    ]
    results = inversion(array).search(gamma[:, : array.reference_order + 1], p, ca.vertcat(*ahead))
    return ca.Function("sc_step", [state, gamma, h, p], list(results))


def compile_pointwise_step(start: ca.Function) -> ca.Function:
    """Return a step that is a start, whatever the state."""
    state, h = ca.MX.sym("state", start.numel_out(0)), ca.MX.sym("h")
    gamma, p = ca.MX.sym("gamma", *start.size_in(0)), ca.MX.sym("p", start.numel_in(2))
    return ca.Function("sc_step", [state, gamma, h, p], list(start(gamma, h, p)))


def compile_guess_residual(step: Discretization) -> ca.Function:
    """Compile (state, gamma, h, p) -> residual of every equation at the first guess."""
    equations = step.equations
    # At the guess, not at the last iterate: where Newton's method diverged, all residuals are large.
    residual = ca.substitute(equations.residual, equations.unknowns, equations.guess) / equations.residual_scale
    evaluate = ca.Function("sc_residual", [equations.givens], [ca.densify(residual)])
    return _with_step_arguments("sc_guess_residual", step, lambda givens: [evaluate(givens)])


def _with_step_arguments(name: str, step: Discretization, evaluate: Callable[[ca.MX], list[ca.MX]]) -> ca.Function:
    """Return a function of (state, gamma, h, p) from one of the flat givens."""
    state = ca.MX.sym("state", step.state.numel())
    gamma = ca.MX.sym("gamma", *step.reference.shape)
    h = ca.MX.sym("h")
    p = ca.MX.sym("p", step.equations.givens.numel() - state.numel() - gamma.numel() - 1)
    return ca.Function(name, [state, gamma, h, p], evaluate(ca.vertcat(state, ca.vec(gamma), h, p)))


def start_instants(array: DerivativeArray, step: Discretization) -> tuple[float, ...]:
    """Return the instants of the reference in `compile_start`, in steps from the initial time."""
    if not array.states:
        return step.start.instants
    past = len(step.start.instants) - 1
    return (0.0, *(-(k + float(c)) for k in range(past) for c in _backwards_method().tableau.c))


def compile_start(
    array: DerivativeArray, inverse: Inversion, dae: Dae, reduced: Dae, step: Discretization, order: int
) -> ca.Function:
    """Compile (gamma (m, (order + 1) * instants), h, p) -> (first state, counts, residual).

    Values at the initial time come from the exact inversion. Values before it come from the exact inversion there;
    with internal dynamics, from integrating the reduced form backwards with small steps of high order.
    """
    restart = compile_restart(array, inverse, dae, reduced, step, order)
    _, gamma, h, p = (ca.MX.sym("argument", *restart.size_in(k)) for k in range(4))
    first, counts, residual = inverse.function(gamma[:, : array.reference_order + 1], p)
    return ca.Function("sc_start", [gamma, h, p], [restart(first, gamma, h, p), counts, residual])


def compile_restart(
    array: DerivativeArray, inverse: Inversion, dae: Dae, reduced: Dae, step: Discretization, order: int
) -> ca.Function:
    """Compile (unknowns of the array now, gamma as for `compile_start`, h, p) -> first state.

    `dae` is the form that is stepped, `reduced` the reduced form of the same array.
    """
    system = array.system
    first = ca.MX.sym("now", len(array.unknowns))
    gamma = ca.MX.sym("gamma", system.gamma.size1(), (order + 1) * len(start_instants(array, step)))
    h, p = ca.MX.sym("h"), ca.MX.sym("p", system.p.numel())
    jets = [block[:, : array.reference_order + 1] for block in ca.horzsplit(gamma, order + 1)]
    columns = [first]
    if array.states:
        columns += _backwards(array, reduced, first, jets[1:], h, p)
    else:
        columns += [inverse.function(jet, p)[0] for jet in jets[1:]]
    places = [array.position(unknown.variable, unknown.order) for unknown in dae.unknowns]
    values = ca.horzcat(*[column[places] for column in columns])
    rates = ca.vertcat(
        ca.MX(0, 1),
        *[_rate(array, unknown.variable, unknown.order + 1, first) for unknown in dae.unknowns[: dae.x.numel()]],
    )
    assemble = ca.Function("sc_first", [step.start.values, step.start.rates, step.step], [ca.densify(step.first_state)])
    return ca.Function("sc_restart", [first, gamma, h, p], [assemble(values, rates, h)])


def _rate(array: DerivativeArray, variable: str, order: int, values: ca.MX) -> ca.MX:
    """Return a derivative from the array, or zero if the equations do not determine it."""
    entry = (array.names.index(variable), order)
    return values[array.unknowns.index(entry)] if entry in array.unknowns else ca.MX(0)


def _backwards(array: DerivativeArray, dae: Dae, first: ca.MX, jets: list[ca.MX], h: ca.MX, p: ca.MX) -> list[ca.MX]:
    """Integrate the reduced form from the initial time backwards, one step of the method at a time."""
    if not jets:
        return []
    method = _backwards_method()
    step = method.discretize(dae)
    solve = compile_solver("sc_backwards", step.equations, [step.next_state])
    entries = (*array.states, *array.determined)
    to_dae = [array.unknowns.index(entry) for entry in entries]
    from_dae = [entries.index(unknown) for unknown in array.unknowns]
    begin = ca.Function("sc_begin", [step.start.values, step.start.rates], [step.first_state])
    state: ca.MX = begin(first[to_dae], ca.MX(dae.x.numel(), 1))
    history = []
    stages = method.stages
    for k in range(0, len(jets), stages):
        gamma = [jet[:, : dae.reference_order + 1] for jet in jets[k : k + stages]]
        state = solve(ca.vertcat(state, ca.vec(ca.horzcat(*gamma)), -h, p))[0]
        # A start whose step is not known yet (h = 0) uses present values as past ones.
        history.append(ca.if_else(h == 0, first, state[: len(entries)][from_dae]))
    return history
