"""One step of the energy-momentum scheme, compiled: energy, momentum and constraints to round-off at any step size.

With q_h = (q0 + q1)/2, constant M, constraints at most quadratic and V = V2 + sum W_a(pi_a), V2 and pi_a at most
quadratic (Gonzalez 1996, Betsch and Steinmann 2001):

    q1 - q0     = (h/2) (v0 + v1)
    M (v1 - v0) = -h [grad V2(q_h) + sum W_a'(pi_a0, pi_a1) grad pi_a(q_h)] - h G(q_h)^T lam + h f - h B(q_h)^T u
    g(q1)       = 0

where W'(x0, x1) is the difference quotient. The unknowns are q1 and L = h^2 lam, the momentum rows are multiplied by
h/2: so the condition of Newton's matrix does not depend on h.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.model.potentials import summands
from servocore.model.symbols import Coordinates
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array, Call, Mask
from servocore.numerics.constraint_ranks import assembled, scaled_rows
from servocore.numerics.square_systems import SquareSystem, compile_solver
from servocore.stepping.energy_momentum_terms import step_terms
from servocore.stepping.rotation_update import RotationUpdate, compile_rotation_step

_AXES = "xyz"
_ROUND_OFF = 1e-9  # relative moment of a constraint that counts as zero


@dataclass(frozen=True, eq=False)
class ConservingStep:
    """Compiled functions of the scheme for one system.

    Attributes
    ----------
    step : casadi.Function
        (state (q, v, L), u, h, p) -> (state, counts (2,), residual, work): the work of inputs and forces in J.
    energy : casadi.Function
        (q, v, p) -> kinetic plus potential energy, J, and the angular momentum about the origin (3,), N m s.
    """

    step: ca.Function
    energy: ca.Function


def compile_conserving_step(system: MechanicalSystem, update: RotationUpdate | None = None) -> ConservingStep:
    """Compile the scheme for a system; its unknowns are positions and multipliers, or those of an update.

    Raises
    ------
    InvalidModel
        If M depends on q, the equations hold the time, or a constraint, V2 or an invariant is more than quadratic; or
        if the update cannot be used.
    """
    _require_conservable(system)
    q, v = system.q, system.v
    energy = ca.dot(v, ca.mtimes(system.mass, v)) / 2 + ca.SX(system.potential)
    conserved = ca.Function("sc_energy", [q, v, system.p], [energy, angular_momentum(system)], {"cse": True})
    return ConservingStep(_compile_step(system) if update is None else compile_rotation_step(system), conserved)


def _compile_step(system: MechanicalSystem) -> ca.Function:
    """Compile a step in positions and multipliers."""
    n, m_h = len(system.coordinates), system.lam.numel()
    equations, push = conserving_equations(system)
    q0, v0, h = equations.givens[:n], equations.givens[n : 2 * n], equations.givens[-1 - system.p.numel()]
    q1, L1 = equations.unknowns[:n], equations.unknowns[n:]
    # The midpoint rule for positions, solved for v1: (v0 + v1)/2 = (q1 - q0)/h.
    after = ca.vertcat(q1, 2 * (q1 - q0) / h - v0, L1)
    solver = compile_solver("sc_conserving", equations, [after, ca.dot(push, q1 - q0)])
    sizes = (2 * n + m_h, len(system.inputs), 1, system.p.numel())
    arguments = [ca.MX.sym(name, size) for name, size in zip(("state", "u", "h", "p"), sizes, strict=True)]
    state, work, counts, residual = solver(ca.vertcat(*arguments))
    return ca.Function("sc_conserving_step", arguments, [state, counts, residual, work])


def conserving_equations(system: MechanicalSystem) -> tuple[SquareSystem, ca.SX]:
    """Return the equations of a step for (q1, L), given (q0, v0, L0, u, h, p), and the forces that do work, (n,)."""
    terms, m_h, n = step_terms(system), system.lam.numel(), len(system.coordinates)
    q0, v0, h, nominal = terms.q0, terms.v0, terms.h, terms.nominal
    q1, L0, L1 = ca.SX.sym("q1", n), ca.SX.sym("L0", m_h), ca.SX.sym("L1", m_h)
    momentum, G, push = ca.substitute([terms.momentum, terms.G, terms.push], [terms.change], [q1 - q0])
    # Momentum rows are M dq: their size is inertia times coordinate, whatever the step.
    inertia = ca.fabs(ca.diag(system.mass)) * nominal
    heaviest = ca.mmax(inertia)
    equations = SquareSystem(
        unknowns=ca.vertcat(q1, L1),
        givens=ca.vertcat(q0, v0, L0, system.u, h, system.p),
        residual=ca.vertcat(momentum + ca.mtimes(G.T, L1) / 2, ca.substitute(system.constraints, system.q, q1)),
        guess=ca.vertcat(q0 + h * v0, L0),
        unknown_scale=ca.vertcat(ca.SX(nominal), heaviest * ca.SX.ones(m_h)),
        # Massless coordinates have no inertia to measure by; the heaviest keeps their rows finite.
        residual_scale=ca.vertcat(ca.if_else(inertia > 0, inertia, heaviest), ca.SX.ones(m_h)),
    )
    return equations, push


def _require_conservable(system: MechanicalSystem) -> None:
    """Raise `InvalidModel`, with the reason, if the scheme cannot conserve the energy of a system."""
    name, q = system.name, system.q
    if system.time.numel():
        raise InvalidModel(f"{name}: its equations depend on the time, so that its energy is not conserved")
    if ca.depends_on(system.mass, q):
        raise InvalidModel(f"{name}: its mass depends on the configuration, energy-momentum needs a constant one")
    crooked = [k for k in range(system.lam.numel()) if not _at_most_quadratic(system.constraints[k], q)]
    if crooked:
        raise InvalidModel(
            f"{name}: energy-momentum needs constraints that are at most quadratic, but these are not:"
            f" {system.listed_constraints(crooked)}"
        )
    quadratic, stored = summands(system.potential)
    if not _at_most_quadratic(quadratic, q):
        raise InvalidModel(
            f"{name}: its potential is more than quadratic; energy-momentum needs it as a Potential of a quadratic part"
            " and of energies of quadratic invariants"
        )
    for k, energy in enumerate(stored):
        if not _at_most_quadratic(energy.invariant, q):
            raise InvalidModel(f"{name}: the invariant of its stored energy {k + 1} is more than quadratic")


def _at_most_quadratic(expression: ca.SX, q: ca.SX) -> bool:
    # A constant Hessian is the exact test: without numbers no entry vanishes by chance.
    return not ca.depends_on(ca.jacobian(ca.gradient(expression, q), q), q)


# Rotations ------------------------------------------------------------------------------------------------------------


def vectors(coordinates: Coordinates) -> tuple[tuple[int | None, ...], ...]:
    """Return the indices of the components along x, y and z of the vectors in a configuration.

    Coordinates whose names differ in a last x, y, z only are the components of one vector, as ``load.x``, ``load.y``,
    ``load.z``. Without a z the vector is planar.
    """
    places: dict[str, dict[str, int]] = {}
    for k, name in enumerate(coordinates.names):
        stem, axis = name[:-1], name[-1:]
        if axis in _AXES and stem[-1:] in ("", "_", "."):
            places.setdefault(stem, {})[axis] = k
    triples = [tuple(place.get(axis) for axis in _AXES) for place in places.values()]
    return tuple(triple for triple in triples if triple[0] is not None and triple[1] is not None)


def angular_momentum(system: MechanicalSystem) -> ca.SX:
    """Return the angular momentum about the origin of the vectors among the coordinates, shape (3,)."""
    momentum, total = ca.mtimes(system.mass, system.v), ca.SX.zeros(3)
    for places in vectors(system.coordinates):
        arm, share = (
            ca.vertcat(*[ca.SX(0) if k is None else vector[k] for k in places]) for vector in (system.q, momentum)
        )
        total += ca.cross(arm, share)
    return total


def _turned(coordinates: Coordinates, axis: int, q: Array) -> Array:
    """Return the rate of a configuration that rotates about an axis through the origin at 1 rad/s."""
    rate, one, two = np.zeros(len(q)), (axis + 1) % 3, (axis + 2) % 3
    for places in vectors(coordinates):
        first, second = places[one], places[two]
        if first is not None and second is not None:
            rate[first], rate[second] = -q[second], q[first]
    return rate


def require_invariant_constraints(system: MechanicalSystem, q: Array, p: Array) -> None:
    """Raise `InvalidModel` for constraints that rotations leave invariant only where they vanish.

    Such a constraint, as p - s d = 0, holds after every rotation, but not at the middle of a step, where its force has
    a moment: the angular momentum would drift. Written as d . p = s and d x p = 0 it has none.

    Parameters
    ----------
    system : MechanicalSystem
        With constraints that are at most quadratic.
    q : ndarray, shape (n,)
        A configuration in which they hold.
    p : ndarray
        Parameters.
    """
    gradient = ca.gradient(ca.SX(system.potential), system.q)
    look = Call(ca.Function("sc_rows", [system.q, system.p], [ca.densify(system.G), ca.densify(gradient)]))
    other = _assembled_elsewhere(system, q, p)
    if other is None:
        return
    flat = any(None in vector for vector in vectors(system.coordinates))
    for axis in (2,) if flat else range(3):
        ends = [_moments(look, system.coordinates, axis, place, p) for place in (q, other)]
        if any(end.any() for end in ends):
            continue  # rotations about this axis are not a symmetry
        guilty = np.flatnonzero(_moments(look, system.coordinates, axis, (q + other) / 2, p)[:-1])
        if len(guilty):
            raise InvalidModel(
                f"{system.name}: rotations about the {_AXES[axis]} axis leave these constraints invariant only where"
                f" they vanish, so that the angular momentum would drift: {system.listed_constraints(guilty.tolist())};"
                " for p = s d write d . p = s and d x p = 0"
            )


def _moments(look: Call, coordinates: Coordinates, axis: int, q: Array, p: Array) -> Mask:
    """Return which constraints, and as last entry whether the potential, change in a rotation about an axis."""
    rate = _turned(coordinates, axis, q)
    G, slope = look(q, p)
    rows = np.vstack([G, slope.reshape(1, -1)])
    changes: Mask = np.abs(rows @ rate) > _ROUND_OFF * (np.abs(rows) @ np.abs(rate) + np.finfo(np.float64).tiny)
    return changes


def _assembled_elsewhere(system: MechanicalSystem, q: Array, p: Array) -> Array | None:
    """Return another configuration in which the constraints hold, away from `q`; None if none is found."""
    nominal = np.array(system.coordinates.nominal)
    # Incommensurate displacements, so that no symmetry of the model hides a change under rotations.
    start = q / nominal + 0.3 * np.sin(1.0 + 7.0 * np.arange(len(q)))
    found = assembled(scaled_rows(system.constraints, system.q, system.p, p, nominal), start)
    return None if found is None else found * nominal
