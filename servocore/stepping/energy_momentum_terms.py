"""Terms of a step of the energy-momentum scheme, for every choice of its unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from servocore.model.potentials import summands
from servocore.model.system import MechanicalSystem


@dataclass(frozen=True, eq=False)
class StepTerms:
    """Expressions of a step from (q0, v0) to q1 = q0 + change, given (q0, v0, u, h, p).

    Attributes
    ----------
    q0, v0, change, h : casadi.SX
        Symbols: far from the origin the change has more digits than the difference of two positions.
    givens : casadi.SX
        (q0, v0, u, h, p).
    momentum : casadi.SX
        Momentum rows times h/2 without multipliers, shape (n,).
    push : casadi.SX
        Forces that do work, of inputs and others, shape (n,).
    G, G_before : casadi.SX
        Jacobian of the constraints in the middle of the step, and at its beginning.
    constraints_after : casadi.SX
        Constraints at q1.
    mass : casadi.SX
        Constant.
    nominal : casadi.DM
        Magnitudes of the coordinates.
    """

    q0: ca.SX
    v0: ca.SX
    change: ca.SX
    h: ca.SX
    givens: ca.SX
    momentum: ca.SX
    push: ca.SX
    G: ca.SX
    G_before: ca.SX
    constraints_after: ca.SX
    mass: ca.SX
    nominal: ca.DM


def step_terms(system: MechanicalSystem) -> StepTerms:
    """Return the terms of a step of a system whose mass is constant."""
    n, q, v = len(system.coordinates), system.q, system.v
    q0, v0, change, h = (ca.SX.sym(name, size) for name, size in (("q0", n), ("v0", n), ("change", n), ("h", 1)))
    # At the middle the gradient of quadratic constraints is exact for their difference: G(q_m) (q1 - q0) = g1 - g0.
    middle, rate, q1 = q0 + change / 2, change / h, q0 + change
    G, B, force = ca.substitute([system.G, system.input_matrix, system.force], [q, v], [middle, rate])
    push = force - ca.mtimes(B.T, system.u)
    # M (v1 - v0) = h (...) with v1 = 2 change/h - v0, times h/2: nothing is divided by h.
    momentum = ca.mtimes(system.mass, change - h * v0) + h**2 / 2 * (_conservative(system, q0, q1) - push)
    return StepTerms(
        q0, v0, change, h,
        givens=ca.vertcat(q0, v0, system.u, h, system.p),
        momentum=momentum,
        push=push,
        G=G,
        G_before=ca.substitute(system.G, q, q0),
        constraints_after=ca.substitute(system.constraints, q, q1),
        mass=system.mass,
        nominal=ca.DM(system.coordinates.nominal),
    )  # fmt: skip


def _conservative(system: MechanicalSystem, q0: ca.SX, q1: ca.SX) -> ca.SX:
    """Return the discrete gradient of the potential between two configurations, shape (n,)."""
    q, middle = system.q, (q0 + q1) / 2
    quadratic, stored = summands(system.potential)
    # The gradient of a quadratic function at the middle is a discrete gradient.
    force = ca.substitute(ca.gradient(quadratic, q), q, middle)
    for energy in stored:
        before, after = (ca.substitute(energy.invariant, q, place) for place in (q0, q1))
        # Gonzalez: the difference quotient of W along its invariant makes the balance of energy exact for any step.
        force += energy.slope(before, after) * ca.substitute(ca.gradient(energy.invariant, q), q, middle)
    return force
