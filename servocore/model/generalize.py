"""`generalize`: the same system in generalized coordinates, section 3.1 of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, require_kind
from servocore.model.quantity import Quantity
from servocore.model.symbols import Coordinates
from servocore.model.system import DERIVED, MechanicalSystem
from servocore.numerics.expressions import as_expression


def generalize(
    system: MechanicalSystem,
    coordinates: Coordinates,
    mapping: ca.SX,
    *,
    guess: ca.SX = DERIVED,
    observables: Mapping[Quantity, ca.SX] | None = None,
    name: str | None = None,
) -> MechanicalSystem:
    """Return the same system in generalized coordinates mu with q = F(mu), section 3.1 of the paper.

    With P = DF and G P = 0 the constraints drop out: M~ = P^T M P, V~ = V(F(mu)), B~ = B P
    and the velocity-dependent inertia forces are P^T M P_dot nu (equations 5 to 12).

    Parameters
    ----------
    system : MechanicalSystem
        The system in redundant coordinates q.
    coordinates : Coordinates
        The generalized coordinates mu; as many as `system` has degrees of freedom.
    mapping : casadi.SX
        F(mu, p), shape (n,).
    guess : casadi.SX, optional
        A configuration mu near the one that belongs to the reference, an expression of ``system.gamma`` and p.
    observables : mapping, optional
        Observables of the new system; those of `system` that use no multipliers and inputs when not given. The others
        become its `reactions`.
    name : str, optional
        Of the new system.

    Returns
    -------
    MechanicalSystem
        Without holonomic constraints.

    Raises
    ------
    InvalidModel
        If the number of coordinates is wrong or F leaves the constraint manifold.
    """
    require_kind(system, MechanicalSystem, "the system to be generalized", "a MechanicalSystem", InvalidModel)
    require_kind(coordinates, Coordinates, f"{system.name}: coordinates", "Coordinates(...)", InvalidModel)
    mapping = as_expression(mapping, f"{system.name}: the mapping")
    mu, nu, P = coordinates.q, coordinates.v, ca.jacobian(mapping, coordinates.q)
    _require_mapping(system, coordinates, mapping)
    kept = _without_forces(system) if observables is None else {}
    mass, potential, force, gyroscopic, input_matrix, output, *seen = ca.substitute(
        [
            *(system.mass, system.potential, system.force, system.gyroscopic, system.input_matrix, system.output),
            *kept.values(),
        ],
        [system.q, system.v],
        [mapping, ca.mtimes(P, nu)],
    )
    return replace(
        system,
        name=name or f"{system.name}, generalized",
        coordinates=coordinates,
        mass=ca.mtimes([P.T, mass, P]),
        potential=potential,
        force=ca.mtimes(P.T, force),
        gyroscopic=ca.mtimes(P.T, gyroscopic + ca.mtimes(mass, ca.jtimes(ca.mtimes(P, nu), mu, nu))),
        input_matrix=ca.mtimes(input_matrix, P),
        output=output,
        constraints=ca.SX(0, 1),
        multipliers=DERIVED,
        constraint_names=(),
        guess=guess,
        observables=dict(zip(kept, seen, strict=True)) if observables is None else observables,
        reactions=_reactions(system, coordinates, mapping),
    )


def _without_forces(system: MechanicalSystem) -> dict[Quantity, ca.SX]:
    """Return the observables without multipliers and inputs: functions of the motion alone."""
    forces = ca.vertcat(system.lam, system.u)
    return {k: e for k, e in system.observables.items() if not ca.depends_on(e, forces)}


def _reactions(system: MechanicalSystem, coordinates: Coordinates, mapping: ca.SX) -> dict[Quantity, ca.Function]:
    """Return observables with multipliers as functions of (mu, nu, nu_dot, u, force on the output, p).

    The multipliers follow from motion and other forces by G^T lam = C^T d - M v_dot - bias - B^T u.
    """
    wanted = {
        quantity: expression
        for quantity, expression in system.observables.items()
        if ca.depends_on(expression, system.lam) and not ca.depends_on(expression, system.gamma)
    }
    # Forces of redundant constraints are not determined, and plants exclude equations that depend on the time.
    if not wanted or system.constraint_rank().redundant or system.time.numel():
        return {}
    mu, nu = coordinates.q, coordinates.v
    nu_dot, d, v_dot = (ca.SX.sym("", len(each)) for each in (coordinates, system.outputs, system.coordinates))
    rate, without = ca.jtimes(mapping, mu, nu), ca.SX.zeros(system.lam.numel())
    left = ca.mtimes(system.C.T, d) - ca.substitute(system.momentum_balance(v_dot), system.lam, without)
    balance, *seen = ca.substitute(
        [ca.horzcat(ca.mtimes(system.G, system.G.T), ca.mtimes(system.G, left)), *wanted.values()],
        [system.q, system.v, v_dot],
        [mapping, rate, ca.jtimes(mapping, mu, nu_dot) + ca.jtimes(rate, mu, nu)],
    )
    known = [mu, nu, nu_dot, system.u, d, system.p]
    terms = ca.Function("terms", known, [balance], {"cse": True})
    observe = ca.Function("observe", [*known, system.lam], seen, {"cse": True})
    arguments = [ca.MX.sym(f"a{k}", terms.size1_in(k)) for k in range(terms.n_in())]
    equations = terms(*arguments)
    lam = ca.solve(equations[:, :-1], equations[:, -1], "qr")
    values = observe.call([*arguments, lam])
    return {
        quantity: ca.Function("reaction", arguments, [value]) for quantity, value in zip(wanted, values, strict=True)
    }


def _require_mapping(system: MechanicalSystem, coordinates: Coordinates, mapping: ca.SX) -> None:
    """Raise `InvalidModel` if F has the wrong size or does not satisfy the constraints."""
    n = len(system.coordinates)
    if len(coordinates) != system.degrees_of_freedom:
        raise InvalidModel(
            f"{system.name} has {system.degrees_of_freedom} degrees of freedom,"
            f" not {len(coordinates)} generalized coordinates"
        )
    if mapping.shape != (n, 1):
        raise InvalidModel(f"{system.name}: the mapping has shape {mapping.shape}, expected {(n, 1)}")
    at_home = ca.substitute(system.constraints, system.time, ca.SX.zeros(system.time.shape))
    violation = ca.Function("violation", [coordinates.q, system.p], [ca.substitute(at_home, system.q, mapping)])
    # A point without symmetry: an expression that vanishes there vanishes everywhere.
    mu = 0.3 + 0.4 * np.sin(1.0 + np.arange(len(coordinates)))
    worst = np.abs(np.asarray(violation(mu, system.parameters.values()))).max(initial=0.0)
    if not worst < 1e-9:
        raise InvalidModel(f"{system.name}: the mapping leaves the constraint manifold (by {worst:.2g})")
