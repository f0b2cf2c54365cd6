"""Observation: values by name and violations of the equations as functions of a program's state."""

from __future__ import annotations

import casadi as ca

from servocore.dae import Dae
from servocore.methods.base import Discretization
from servocore.model.limits import Limit
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.expressions import highest_derivative, largest


def observed(system: MechanicalSystem) -> list[tuple[Quantity, ca.SX]]:
    """List inputs, observables, servo outputs and coordinates; the first of a name is kept."""
    listed = [
        *((channel, system.u[k]) for k, channel in enumerate(system.inputs)),
        *system.observables.items(),
        *((channel, system.output[k]) for k, channel in enumerate(system.outputs)),
        *((channel, system.q[k]) for k, channel in enumerate(system.coordinates.quantities)),
    ]
    seen: dict[str, tuple[Quantity, ca.SX]] = {}
    for quantity, expression in listed:
        seen.setdefault(quantity.name, (quantity, expression))
    return list(seen.values())


def compile_observation(
    system: MechanicalSystem,
    dae: Dae,
    step: Discretization,
    known: list[tuple[Quantity, ca.SX]],
    order: int,
) -> ca.Function:
    """Compile (state, gamma (m, order + 1), p) -> (values of `known`, violations (4,)) at the instant of the state."""
    symbols = ca.vertcat(system.q, system.v, system.lam, system.u)
    physical = ca.vertcat(*[dae.physical[name] for name in ("q", "v", "lam", "u")])
    expressions = ca.vertcat(*[expression for _, expression in known])
    violations = violations_of(system)
    # Two substitutions in this order: the first introduces the unknowns of the form, which the second replaces.
    expressions, violations = ca.substitute([expressions, violations], [symbols], [physical])
    unknowns = ca.vertcat(dae.x, dae.z)
    expressions, violations = ca.substitute([expressions, violations], [unknowns], [ca.vertcat(step.x, step.z)])
    gamma = system.gamma[:, : order + 1]
    return ca.Function(
        "sc_observe", [step.state, gamma, system.p], [ca.densify(expressions), ca.densify(violations)], {"cse": True}
    )


def violations_of(system: MechanicalSystem) -> ca.SX:
    """Return |c|, |dc/dt|, |g|, |dg/dt| in the maximum norm."""
    groups = (
        system.output - system.path[:, 0],
        # Violated rates show drift first: positions integrate them.
        ca.mtimes(system.C, system.v) - system.path[:, 1],
        system.constraints,
        system.constraint_rate,
    )
    return ca.vertcat(*[largest(group) for group in groups])


def limits_order(system: MechanicalSystem, limits: tuple[Limit, ...]) -> int:
    """Return the highest derivative of the reference in the limits."""
    margins = [limit.on(system) for limit in limits]
    return highest_derivative(ca.vertcat(ca.SX(0, 1), *margins), system.gamma)


def compile_margins(system: MechanicalSystem, limits: tuple[Limit, ...], order: int) -> ca.Function:
    """Compile (gamma (m, order + 1), p) -> margin of each limit, positive where it is kept."""
    gamma = system.gamma[:, : order + 1]
    margins = [limit.on(system) - limit.bound for limit in limits]
    return ca.Function("sc_margins", [gamma, system.p], [ca.densify(ca.vertcat(ca.SX(0, 1), *margins))])
