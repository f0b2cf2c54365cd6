"""Structural analysis of a servo constraint problem: the signature method, and remedies where it is misled.

The second-order equations (1) in the variables y = (q, lam, u) are analysed as they stand. The method sees structure,
not values: in generalized coordinates accelerations that cancel hide the true index, and the system Jacobian is then
singular everywhere. The remedy is a linear combination of equations: the momentum equations that no input enters, less
what the servo constraints say of the same accelerations (`combine`); and if that does not help, whatever combination is
free of the highest derivatives (`servocore.structure.linear_combination`).
"""

from __future__ import annotations

import contextlib
from dataclasses import replace

import casadi as ca

from servocore.errors import InvalidModel
from servocore.model.system import MechanicalSystem
from servocore.structure.signature import (
    Home,
    SecondOrderEquations,
    Signature,
    is_regular,
    signature,
    without_vanishing,
)


def analyse_structure(system: MechanicalSystem) -> Signature:
    """Apply the signature method at the system's home, with a remedy if the equations as they stand mislead it.

    Raises
    ------
    InvalidModel
        If some holonomic constraints are redundant, the equations are structurally singular, or the system Jacobian
        stays singular.
    """
    system.require_independent_constraints()
    equations = second_order_equations(system)
    # Cheapest first: what the equations say as they stand needs no remedy.
    for remedy in (None, leave_out_vanishing, combine):
        changed = equations if remedy is None else remedy(system, equations)
        if changed is None:
            continue
        if remedy is leave_out_vanishing:
            equations = changed  # the other remedies start from these
        with contextlib.suppress(InvalidModel):  # the last remedy will say why
            structure = signature(changed)
            if is_regular(structure):
                return structure
    from servocore.structure.linear_combination import convert  # noqa: PLC0415 - few systems need it

    return convert(equations)


def second_order_equations(system: MechanicalSystem) -> SecondOrderEquations:
    """Write equation (1) in the variables y = (q, lam, u)."""
    n, size = len(system.coordinates), system.q.numel() + system.lam.numel() + system.u.numel()
    y = ca.SX.sym("y", size, 3)
    residual = ca.vertcat(system.momentum_balance(y[:n, 2]), system.output - system.path[:, 0], system.constraints)
    return SecondOrderEquations(
        name=system.name,
        residual=_in_variables(system, residual, y),
        y=y,
        names=(
            *(f"q.{name}" for name in system.coordinates.names),
            *(f"lam.{k + 1}" for k in range(system.lam.numel())),
            *(f"u.{quantity.name}" for quantity in system.inputs),
        ),
        equations=(
            *(f"momentum of {name}" for name in system.coordinates.names),
            *(f"servo constraint on {quantity.name}" for quantity in system.outputs),
            *(f"holonomic constraint {k + 1}" for k in range(system.lam.numel())),
        ),
        embedded=(0,) * size,
        home=Home(system.gamma, system.p, *system.home_configuration(), system.home, system.coordinates.nominal),
    )


def _in_variables(system: MechanicalSystem, expression: ca.SX, y: ca.SX) -> ca.SX:
    n = len(system.coordinates)
    old = ca.vertcat(system.q, system.lam, system.u, system.v)
    return ca.substitute(expression, old, ca.vertcat(y[:, 0], y[:n, 1]))


def leave_out_vanishing(_: MechanicalSystem, equations: SecondOrderEquations) -> SecondOrderEquations | None:
    """Take derivatives out of equations where their coefficients vanish, if there are any."""
    residual, special, changed = without_vanishing(equations, [equations.residual])
    if not changed:
        return None
    return replace(equations, residual=residual, remedy="vanishing coefficients left out", special=special)


def combine(system: MechanicalSystem, equations: SecondOrderEquations) -> SecondOrderEquations | None:
    """Subtract servo accelerations from the momentum equations that no input enters.

    With C = [C_d, C_i] split into dependent and independent columns, a momentum row without inputs loses the
    accelerations of the dependent coordinates: its new form is row - M_d C_d^-1 (C a + C_dot v - gamma''). Where
    inertia couples the row to the servo constrained directions only, as the swing of a crane's load, the other
    accelerations and the velocities cancel as well. What vanishes at several points is taken out.

    Returns None if every momentum equation holds an input.
    """
    y = equations.y
    n = len(system.coordinates)
    unactuated = [k for k in range(n) if not system.input_matrix[:, k].nnz()]
    if not unactuated:
        return None
    dependent = system.dependent_coordinates()
    acceleration = y[:n, 2]
    servo = (
        ca.mtimes(system.C, acceleration)
        + ca.jtimes(ca.mtimes(system.C, system.v), system.q, system.v)
        - system.path[:, 2]
    )
    # Subtracting multiples of c'' = 0 changes no solution, only the structure that sigma sees.
    factors = ca.solve(ca.densify(system.C[:, dependent]), servo)
    taken = ca.mtimes(system.mass[unactuated, dependent], factors)
    residual = ca.SX(equations.residual)
    parts = [residual[unactuated], -_in_variables(system, taken, y)]
    residual[unactuated], special, _ = without_vanishing(equations, parts)
    names = (
        f"{name} less servo accelerations" if k in unactuated else name for k, name in enumerate(equations.equations)
    )
    return replace(
        equations,
        residual=residual,
        equations=tuple(names),
        embedded=tuple(2 if k in unactuated else order for k, order in enumerate(equations.embedded)),
        remedy="momentum equations without inputs combined with servo accelerations",
        special=equations.special or special,
    )
