"""The derivative array of a servo constraint problem as one square system: exact inversion at an instant.

With the offsets c, d of `analyse_structure`, the equations f_i, ..., f_i^(c_i) in the unknowns
y_j, ..., y_j^(d_j) are a square system when no internal dynamics remain. Its data are the reference and its derivatives
at that instant. It yields consistent initial values for every formulation, and is the `Reduced` formulation itself.

The second-order equations (1) in the variables y = (q, lam, u) are analysed unchanged. The method uses structure, not
values: in generalized coordinates accelerations that cancel hide the true index, and the system Jacobian is then
singular everywhere. The remedy is a linear combination of equations: the momentum equations without inputs less the
accelerations that follow from the servo constraints (`combine`); and if that does not help, any combination free of the
highest derivatives (`servocore.structure.linear_combination`).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.model.system import MAX_REFERENCE_ORDER, MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.components import places_of, triangular_blocks
from servocore.numerics.constraint_ranks import pivot_columns
from servocore.numerics.expressions import highest_derivative, time_derivative
from servocore.numerics.memoization import made_once
from servocore.structure.signature import (
    Home,
    SecondOrderEquations,
    Signature,
    is_regular,
    jacobians,
    signature,
    without_vanishing,
)

_MOST_NODES = 2_000_000  # of the equations of one order: each derivative of nonlinear springs triples them


@dataclass(frozen=True, eq=False)
class DerivativeArray:
    """Equations and unknowns of the derivative array.

    Attributes
    ----------
    system : MechanicalSystem
        The differentiated system.
    signature : Signature
        With the offsets: the numbers of differentiations.
    y : casadi.SX
        Symbols of the variables (q, lam, u) and their derivatives, shape (N, max d + 1).
    unknowns : tuple of (int, int)
        Variable and order of every unknown.
    rows : tuple of (int, int)
        Equation and order of every row.
    residual : casadi.SX
        As many rows as `rows`.
    reference_order : int
        Highest derivative of the reference that enters.
    states : tuple of (int, int)
        Unknowns left free: the states of the internal dynamics. Given these, the rest is a square system.
    """

    system: MechanicalSystem
    signature: Signature
    y: ca.SX
    unknowns: tuple[tuple[int, int], ...]
    rows: tuple[tuple[int, int], ...]
    residual: ca.SX
    reference_order: int
    states: tuple[tuple[int, int], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables."""
        return self.signature.equations.names

    @property
    def determined(self) -> tuple[tuple[int, int], ...]:
        """The unknowns without the states."""
        return tuple(unknown for unknown in self.unknowns if unknown not in self.states)

    @property
    def named_states(self) -> tuple[tuple[str, int], ...]:
        """The states by name of the variable and order of the derivative."""
        return self.named(self.states)

    def named(self, entries: Iterable[tuple[int, int]]) -> tuple[tuple[str, int], ...]:
        """Return derivatives of variables by their names."""
        return tuple((self.names[j], order) for j, order in entries)

    @property
    def inputs(self) -> list[int]:
        """The indices of the inputs among the unknowns."""
        return [self.position(f"u.{quantity.name}", 0) for quantity in self.system.inputs]

    def column(self, entries: tuple[tuple[int, int], ...]) -> ca.SX:
        """Return the symbols of `entries`."""
        symbols, height = ca.vec(self.y), self.y.size1()  # indexed once for all: each takes some microseconds
        return symbols[[order * height + j for j, order in entries]] if entries else ca.SX(0, 1)

    def places(self, entries: Iterable[tuple[int, int]]) -> list[int]:
        """Return the indices of derivatives of variables among the unknowns."""
        return [self.unknowns.index(entry) for entry in entries]

    def position(self, variable: str, order: int) -> int:
        """Return the index of a derivative of a named variable among the unknowns."""
        return self.unknowns.index((self.names.index(variable), order))


@made_once  # every Dae of a system needs its array
def derivative_array(system: MechanicalSystem) -> DerivativeArray:
    """Differentiate the equations of `system` as often as their offsets require.

    Raises
    ------
    InvalidModel
        If the analysis does not apply, or an inversion needs too many derivatives or too long expressions.
    """
    structure = analyse_structure(system)
    if max(structure.equation_offsets) > MAX_REFERENCE_ORDER:
        raise InvalidModel(_too_deep(system, structure, f"a model has symbols for {MAX_REFERENCE_ORDER} only"))
    return _differentiated(system, structure)


def _too_deep(system: MechanicalSystem, structure: Signature, why: str) -> str:
    return (
        f"{system.name}: an inversion needs derivatives of the path up to order {max(structure.equation_offsets)}, but"
        f" {why}: divide elastic bodies less finely; as a plant it can be simulated"
    )


@made_once
def differentiated_once_more(array: DerivativeArray) -> DerivativeArray:
    """Return the array with all offsets one higher: with the rates of all unknowns."""
    structure = array.signature
    c, d = (tuple(each + 1 for each in some) for some in (structure.equation_offsets, structure.variable_offsets))
    return _differentiated(array.system, replace(structure, equation_offsets=c, variable_offsets=d))


def determining(array: DerivativeArray, unknown: int) -> DerivativeArray:
    """Return the equations that determine an unknown, by its number, with all their unknowns: square as well."""
    pattern = ca.jacobian_sparsity(array.residual, array.column(array.unknowns))
    rows, columns = places_of(pattern)
    needed, kept = {unknown}, np.zeros(len(array.rows), dtype=bool)
    for part in reversed(triangular_blocks(pattern)):
        if needed.intersection(part.columns.tolist()):
            kept[part.rows] = True
            needed.update(columns[np.isin(rows, part.rows)].tolist())
    places = np.flatnonzero(kept).tolist()
    unknowns, own = (tuple(of[k] for k in at) for of, at in ((array.unknowns, sorted(needed)), (array.rows, places)))
    return replace(array, unknowns=unknowns, rows=own, residual=array.residual[places])


def _differentiated(system: MechanicalSystem, structure: Signature) -> DerivativeArray:
    equations = structure.equations
    c, d = structure.equation_offsets, structure.variable_offsets
    orders = max(equations.y.size2(), max(d) + 1)
    # One symbol each, named with primes, so that printed expressions are readable.
    symbols = [ca.SX.sym(name + "'" * order) for order in range(orders) for name in equations.names]
    y = ca.reshape(ca.vertcat(*symbols), len(d), orders)
    first = ca.substitute(equations.residual, equations.y, y[:, : equations.y.size2()])
    rows: list[tuple[int, int]] = []
    residual: list[ca.SX] = []
    gamma = system.gamma
    for order, (active, current) in enumerate(_rates(system, c, y, first)):
        rows += [(i, order) for i in active]
        residual.append(current)
        if ca.n_nodes(current) > _MOST_NODES:
            raise InvalidModel(_too_deep(system, structure, f"those of order {order} are too long expressions"))
    equations_of_all_orders = ca.vertcat(*residual)
    return DerivativeArray(
        system=system,
        signature=structure,
        y=y,
        unknowns=tuple((j, order) for j in range(len(d)) for order in range(d[j] + 1)),
        rows=tuple(rows),
        residual=equations_of_all_orders,
        reference_order=highest_derivative(equations_of_all_orders, gamma),
        states=choose_states(structure, jacobians(structure)[0]) if structure.degrees_of_freedom else (),
    )


def _rates(system: MechanicalSystem, c: tuple[int, ...], y: ca.SX, current: ca.SX) -> Iterator[tuple[list[int], ca.SX]]:
    """Yield derivatives by time of a matrix of one row for each equation: the equations left, and their rows."""
    active = list(range(len(c)))
    for order in range(max(c) + 1):
        keep = [k for k, i in enumerate(active) if c[i] >= order]
        active, current = [active[k] for k in keep], current[keep, :]
        if order:
            current = time_derivative(current, y, system.gamma)
            if system.time.numel():  # the rate of the time is constant: no higher derivatives of the path are needed
                later = system.gamma[-1, 2:]
                current = ca.substitute(current, later, ca.SX.zeros(later.shape))
        yield active, current


def jacobian(array: DerivativeArray, unknowns: tuple[tuple[int, int], ...]) -> ca.SX:
    """Return the Jacobian of the residual in `unknowns`, by Leibniz' rule: its entries share their expressions.

    With D the derivative by time, df^(r)/dy^(m) is the sum of binomial(r, k) D^(r-k) df/dy^(m-k) over k.
    """
    c, y, height = array.signature.equation_offsets, ca.vec(array.y), array.y.size1()
    first, place = ca.jacobian(array.residual[: len(c)], y), {row: k for k, row in enumerate(array.rows)}
    slopes = ca.sparsify(ca.vertcat(*(each for _, each in _rates(array.system, c, array.y, first))))
    found = ca.SX(len(place), y.numel())
    for k in range(max(c) + 1):
        later = [(i, order) for i, order in array.rows if order >= k]
        part = slopes[[place[i, order - k] for i, order in later], : y.numel() - height * k]
        binomials = ca.diag(ca.DM([math.comb(order, k) for _, order in later]))
        found += ca.diagcat(ca.SX(len(place) - len(later), height * k), ca.mtimes(binomials, part))
    return found[:, [order * height + j for j, order in unknowns]]


def choose_states(structure: Signature, J: Array) -> tuple[tuple[int, int], ...]:
    """Choose the states of the internal dynamics: dummy derivatives (Mattsson & Soederlind 1993) by pivoting.

    At level k the equations with c_i >= k determine as many of the derivatives y_j^(d_j - k), chosen by QR with
    column pivoting on the system Jacobian `J` and nested from level to level; the others are states. Columns are scaled
    by nominal values: a small strain, computed as the difference of large coordinates, would be a poor choice.
    """
    c, d, nominal_values = structure.equation_offsets, structure.variable_offsets, structure.equations.home.nominal
    J = J * np.array([*nominal_values, *[1.0] * (len(d) - len(nominal_values))])
    chosen = list(range(len(d)))
    states: list[tuple[int, int]] = []
    for level in range(1, max(d) + 1):
        rows = [i for i in range(len(c)) if c[i] >= level]
        candidates = [j for j in chosen if d[j] >= level]
        # Nested: below a derivative that is a state all lower ones are states as well, each the integral of the next.
        picked = pivot_columns(J[np.ix_(rows, candidates)])
        chosen = sorted(candidates[k] for k in picked)
        states += [(j, d[j] - level) for j in range(len(d)) if d[j] >= level and j not in chosen]
    return tuple(sorted(states))


def nominal(system: MechanicalSystem, variable: int) -> float:
    """Typical magnitude of a variable (q, lam, u) in SI units."""
    n, m_h = len(system.coordinates), system.lam.numel()
    if variable < n:
        return system.coordinates.quantities[variable].magnitude
    return 1.0 if variable < n + m_h else system.inputs[variable - n - m_h].magnitude


# Structural analysis --------------------------------------------------------------------------------------------------


def analyse_structure(system: MechanicalSystem) -> Signature:
    """Apply the signature method at the system's home, with a remedy where their structure is misleading.

    Raises
    ------
    InvalidModel
        If some holonomic constraints are redundant, the equations are structurally singular, or the system Jacobian
        stays singular.
    """
    system.require_independent_constraints()
    equations = second_order_equations(system)
    # Cheapest first: most equations need no remedy.
    for remedy in (None, leave_out_vanishing, combine):
        changed = equations if remedy is None else remedy(system, equations)
        if changed is None:
            continue
        if remedy is leave_out_vanishing:
            equations = changed  # the other remedies start from these
        with contextlib.suppress(InvalidModel):  # the last remedy reports the reason
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
        residual=in_variables(system, residual, y),
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


def in_variables(system: MechanicalSystem, expression: ca.SX, y: ca.SX) -> ca.SX:
    """Return an expression of q, v, lam and u in the variables y = (q, lam, u), derivatives in columns."""
    n = len(system.coordinates)
    old = ca.vertcat(system.q, system.lam, system.u, system.v)
    return ca.substitute(expression, old, ca.vertcat(y[:, 0], y[:n, 1]))


def leave_out_vanishing(_: MechanicalSystem, equations: SecondOrderEquations) -> SecondOrderEquations | None:
    """Remove derivatives with vanishing coefficients from equations, None if there are none."""
    residual, special, changed = without_vanishing(equations, [equations.residual])
    if not changed:
        return None
    return replace(equations, residual=residual, remedy="vanishing coefficients left out", special=special)


def combine(system: MechanicalSystem, equations: SecondOrderEquations) -> SecondOrderEquations | None:
    """Subtract servo accelerations from the momentum equations without inputs.

    With C = [C_d, C_i] split into dependent and independent columns, a momentum row without inputs loses the
    accelerations of the dependent coordinates: its new form is row - M_d C_d^-1 (C a + C_dot v - gamma''). Where
    inertia couples the row to the servo constrained directions only, as the swing of a crane's load, the other
    accelerations and the velocities cancel as well. Entries that vanish at several points are removed.

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
    # Subtracting multiples of c'' = 0 changes no solution, only the structure.
    factors = ca.solve(ca.densify(system.C[:, dependent]), servo)
    taken = ca.mtimes(system.mass[unactuated, dependent], factors)
    residual = ca.SX(equations.residual)
    parts = [residual[unactuated], -in_variables(system, taken, y)]
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
