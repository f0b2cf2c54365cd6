"""Structural analysis of a servo constraint problem: the signature method, and remedies where it is misled.

The second-order equations (1) in the variables y = (q, lam, u) are looked at as they stand. The method sees structure,
not values: in generalised coordinates accelerations that cancel hide the true index, and the system Jacobian is then
singular everywhere. The remedy is a linear combination of equations: the momentum equations that no input enters, less
what the servo constraints say of the same accelerations (`combine`).
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel
from servocore.model.system import MechanicalSystem
from servocore.numerics.calls import Array
from servocore.structure.signature import SecondOrderEquations, Signature, equilibrated, signature

_COPIES, _TREMOR = 16, 1e-7  # of each point, to tell a coefficient from the round-off of terms that cancel
_DISTANCES = (0.3, 0.03, 0.003)  # of probes from home, tried in turn: a mechanism may not reach far
_PROBES = 3  # points at which a coefficient must vanish to count as absent


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
    tried = []
    for remedy in (None, leave_out_vanishing, combine):
        changed = equations if remedy is None else remedy(system, equations)
        if changed is None:
            continue
        try:
            found = signature(changed)
        except InvalidModel as error:
            tried.append(str(error))
            continue
        if is_regular(system, found):
            return found
        tried.append(_left_over(system, found))
    raise InvalidModel(
        f"{system.name}: the system Jacobian of the signature method is singular, with every remedy; {tried[-1]}"
    )


def second_order_equations(system: MechanicalSystem) -> SecondOrderEquations:
    """Write equation (1) in the variables y = (q, lam, u)."""
    n, size = len(system.coordinates), system.q.numel() + system.lam.numel() + system.u.numel()
    y = ca.SX.sym("y", size, 3)
    residual = ca.vertcat(system.momentum_balance(y[:n, 2]), system.output - system.gamma[:, 0], system.constraints)
    return SecondOrderEquations(
        name=system.name,
        residual=_in_variables(system, residual, y),
        y=y,
        names=(
            *(f"q.{name}" for name in system.coordinates.names),
            *(f"lam.{k + 1}" for k in range(system.lam.numel())),
            *(f"u.{each.name}" for each in system.inputs),
        ),
        equations=(
            *(f"momentum of {name}" for name in system.coordinates.names),
            *(f"servo constraint on {each.name}" for each in system.outputs),
            *(f"holonomic constraint {k + 1}" for k in range(system.lam.numel())),
        ),
        embedded=(0,) * size,
    )


def _in_variables(system: MechanicalSystem, expression: ca.SX, y: ca.SX) -> ca.SX:
    n = len(system.coordinates)
    old = ca.vertcat(system.q, system.lam, system.u, system.v)
    return ca.substitute(expression, old, ca.vertcat(y[:, 0], y[:n, 1]))


def jacobian_at_probes(system: MechanicalSystem, found: Signature, p: Array | None = None) -> list[Array]:
    """Return the system Jacobian as numbers at points without symmetry near the system's home."""
    arguments = [found.equations.y, system.gamma, system.p]
    evaluate = ca.Function("sc_system_jacobian", arguments, [found.jacobian])
    return [np.asarray(evaluate(*point)) for point in _probe_points(system, found.equations, evaluate, p)]


def is_regular(system: MechanicalSystem, found: Signature, p: Array | None = None) -> bool:
    """Whether the system Jacobian is nonsingular at a point without symmetry near the system's home."""
    finite = (J for J in jacobian_at_probes(system, found, p) if np.isfinite(J).all())
    return any(np.linalg.matrix_rank(equilibrated(J)) == len(J) for J in finite)


def _left_over(system: MechanicalSystem, found: Signature) -> str:
    """Name the equations and variables between which a singular system Jacobian has lost rank."""
    J = equilibrated(jacobian_at_probes(system, found)[0])
    left, _, right = np.linalg.svd(np.nan_to_num(J))
    names = found.equations.equations, found.equations.names
    worst = [
        ", ".join(labels[k] for k in np.flatnonzero(np.abs(vector) > 0.3 * np.abs(vector).max())[:4])
        for labels, vector in zip(names, (left[:, -1], right[-1]), strict=True)
    ]
    return f"it loses rank in the equations {worst[0]} and the variables {worst[1]}"


def _probe_points(
    system: MechanicalSystem,
    equations: SecondOrderEquations,
    evaluate: ca.Function,
    p: Array | None = None,
    *,
    disturbed: bool = False,
) -> list[tuple[Array, Array, Array]]:
    """Return points (y, gamma, p) near the system's home at which `evaluate` is finite: numbers without symmetry."""
    for distance in _DISTANCES:
        points = _points(system, equations, distance, p, disturbed)
        finite = [point for point in points if np.isfinite(np.asarray(evaluate(*point))).all()]
        if finite:
            return finite
    return points


def _points(
    system: MechanicalSystem, equations: SecondOrderEquations, distance: float, p: Array | None, disturbed: bool
) -> list[tuple[Array, Array, Array]]:
    """Return fixed points (y, gamma, p), with coordinates and their derivatives near those of the system's home.

    They are up to `distance` of their nominal values away, or of one unit if that is less. With `disturbed` the
    parameters leave their home as well, by a few per cent of themselves and of one.
    """
    q, home = system.home_configuration()
    generator = np.random.default_rng(20090601)
    points = []
    for _ in range(_PROBES):
        y = distance * generator.uniform(0.5, 1.0, equations.y.shape) * generator.choice([-1.0, 1.0], equations.y.shape)
        y[: len(q)] *= np.minimum(1.0, system.coordinates.nominal)[:, None]
        y[: len(q), 0] += q
        gamma = generator.uniform(-0.3, 0.3, system.gamma.shape)
        gamma[:, 0] = system.home
        values = home if p is None else p
        if disturbed:
            values = values * generator.uniform(1.01, 1.05, len(values)) + generator.uniform(0.01, 0.05, len(values))
        points.append((y, gamma, values))
    return points


def leave_out_vanishing(system: MechanicalSystem, equations: SecondOrderEquations) -> SecondOrderEquations | None:
    """Take derivatives out of equations where their coefficients vanish, if there are any."""
    residual, special, changed = _without_vanishing(system, equations, equations.residual)
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
        - system.gamma[:, 2]
    )
    factors = ca.solve(ca.densify(system.C[:, dependent]), servo)
    rows = system.momentum_balance(acceleration)[unactuated] - ca.mtimes(system.mass[unactuated, dependent], factors)
    residual = ca.SX(equations.residual)
    residual[unactuated] = _in_variables(system, rows, y)
    residual, special, _ = _without_vanishing(system, equations, residual)
    names = (
        f"{name} less servo accelerations" if k in unactuated else name for k, name in enumerate(equations.equations)
    )
    return replace(
        equations,
        residual=residual,
        equations=tuple(names),
        embedded=tuple(2 if k in unactuated else order for k, order in enumerate(equations.embedded)),
        remedy="momentum equations without inputs combined with servo accelerations",
        special=special,
    )


def _is_not_noise(evaluate: ca.Function, point: tuple[Array, Array, Array]) -> npt.NDArray[np.bool_]:
    """Tell which results are numbers of their own, however small, and which the round-off of terms that cancel.

    The arguments tremble by a relative 1e-7: a true number trembles as little, round-off changes altogether.
    """
    generator = np.random.default_rng(31)
    y, gamma, p = point
    copies = []
    for _ in range(_COPIES):
        factors = (1.0 + _TREMOR * generator.uniform(-1.0, 1.0, each.shape) for each in (y, p))
        trembling_y, trembling_p = (each * factor for each, factor in zip((y, p), factors, strict=True))
        copies.append(np.asarray(evaluate(trembling_y, gamma, trembling_p)))
    values = np.stack(copies)
    found: npt.NDArray[np.bool_] = np.abs(values.mean(axis=0)) > 3.0 * values.std(axis=0)
    return found


def _without_vanishing(
    system: MechanicalSystem, equations: SecondOrderEquations, rows: ca.SX
) -> tuple[ca.SX, bool, bool]:
    """Set variables and their derivatives to constants in the rows whose derivatives by them vanish at all probes.

    Returns the rows, whether something vanishes for the home parameters only, and whether anything changed.
    """
    y = equations.y
    derivatives, rest = ca.vec(y), np.zeros(y.numel())
    q, _ = system.home_configuration()
    rest[: len(q)] = q
    by_derivatives = ca.jacobian(rows, derivatives)
    evaluate = ca.Function("by", [y, system.gamma, system.p], [by_derivatives])

    def present(disturbed: bool) -> npt.NDArray[np.bool_]:
        points = _probe_points(system, equations, evaluate, disturbed=disturbed)
        found: npt.NDArray[np.bool_] = np.any([_is_not_noise(evaluate, point) for point in points], axis=0)
        return found

    structural = np.zeros(by_derivatives.shape, dtype=bool)
    structural[tuple(np.array(by_derivatives.sparsity().get_triplet()))] = True
    here = present(disturbed=False)
    cleaned = []
    for k in range(rows.numel()):
        absent = [int(j) for j in np.flatnonzero(structural[k] & ~here[k])]
        cleaned.append(ca.substitute(rows[k], derivatives[absent], ca.SX(rest[absent])) if absent else rows[k])
    special = bool((present(disturbed=True) & structural & ~here).any())
    return ca.vertcat(*cleaned), special, bool((structural & ~here).any())
