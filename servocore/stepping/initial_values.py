"""Consistent initial values, and the history that a multistep method needs, from the reference alone."""

from __future__ import annotations

import casadi as ca

from servocore.dae import Dae
from servocore.methods.base import Discretisation
from servocore.methods.collocation import RadauIIA
from servocore.numerics.square_systems import compile_solver
from servocore.structure.derivative_array import DerivativeArray
from servocore.structure.inversion import Inversion

_BACKWARDS = RadauIIA(4)
"""Carries internal dynamics back before the initial time, at order seven."""


def start_instants(array: DerivativeArray, step: Discretisation) -> tuple[float, ...]:
    """Instants, in steps from the initial time, at which `compile_start` needs the reference."""
    if not array.states:
        return step.start.instants
    past = len(step.start.instants) - 1
    return (0.0, *(-(k + float(c)) for k in range(past) for c in _BACKWARDS.tableau.c))


def compile_start(
    array: DerivativeArray, inversion: Inversion, dae: Dae, reduced: Dae, step: Discretisation, order: int
) -> ca.Function:
    """Compile (gamma (m, (order + 1) * instants), h, p) -> (first state, counts, residual).

    Values at the initial time come from the exact inversion. Values before it come from the exact inversion there;
    with internal dynamics, from integrating the reduced form backwards with small steps of high order.
    """
    restart = compile_restart(array, inversion, dae, reduced, step, order)
    _, gamma, h, p = (ca.MX.sym("argument", *restart.size_in(k)) for k in range(4))
    first, counts, residual = inversion.function(gamma[:, : array.reference_order + 1], p)
    return ca.Function("sc_start", [gamma, h, p], [restart(first, gamma, h, p), counts, residual])


def compile_restart(
    array: DerivativeArray, inversion: Inversion, dae: Dae, reduced: Dae, step: Discretisation, order: int
) -> ca.Function:
    """Compile (unknowns of the array now, gamma as for `compile_start`, h, p) -> first state.

    `dae` is what is stepped, `reduced` the reduced form of the same array.
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
        columns += [inversion.function(jet, p)[0] for jet in jets[1:]]
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
    step = _BACKWARDS.discretise(dae)
    solve = compile_solver("sc_backwards", step.equations, [step.next_state])
    entries = (*array.states, *array.determined)
    to_dae = [array.unknowns.index(entry) for entry in entries]
    from_dae = [entries.index(unknown) for unknown in array.unknowns]
    begin = ca.Function("sc_begin", [step.start.values, step.start.rates], [step.first_state])
    state: ca.MX = begin(first[to_dae], ca.MX(dae.x.numel(), 1))
    history = []
    stages = _BACKWARDS.stages
    for k in range(0, len(jets), stages):
        gamma = [jet[:, : dae.reference_order + 1] for jet in jets[k : k + stages]]
        state = solve(ca.vertcat(state, ca.vec(ca.horzcat(*gamma)), -h, p))[0]
        # A start whose step is not known yet (h = 0) takes the present for the past.
        history.append(ca.if_else(h == 0, first, state[: len(entries)][from_dae]))
    return history
