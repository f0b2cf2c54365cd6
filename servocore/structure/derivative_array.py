"""The derivative array of a servo constraint problem as one square system: exact inversion at an instant.

With the offsets c, d of `servocore.structure.structural_analysis`, the equations f_i, ..., f_i^(c_i) in the unknowns
y_j, ..., y_j^(d_j) are a square system when no internal dynamics remain. Its data are the reference and its derivatives
at that instant. It gives consistent initial values to every formulation, and is itself the `Reduced` one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.constraint_ranks import pivot_columns
from servocore.numerics.expressions import highest_derivative, time_derivative
from servocore.numerics.memoization import made_once
from servocore.structure.signature import Signature, jacobian_at_probes
from servocore.structure.structural_analysis import analyse_structure


@dataclass(frozen=True, eq=False)
class DerivativeArray:
    """Equations and unknowns of the derivative array.

    Attributes
    ----------
    system : MechanicalSystem
        What was differentiated.
    signature : Signature
        With the offsets that say how often.
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
        return tuple((self.names[j], order) for j, order in self.states)

    def column(self, entries: tuple[tuple[int, int], ...]) -> ca.SX:
        """Return the symbols of `entries`."""
        symbols, height = ca.vec(self.y), self.y.size1()  # one look for all: each takes some microseconds
        return symbols[[order * height + j for j, order in entries]] if entries else ca.SX(0, 1)

    def places(self, entries: Iterable[tuple[int, int]]) -> list[int]:
        """Places of derivatives of variables among the unknowns."""
        return [self.unknowns.index(entry) for entry in entries]

    def position(self, variable: str, order: int) -> int:
        """Place of a derivative of a named variable among the unknowns."""
        return self.unknowns.index((self.names.index(variable), order))


@made_once  # a formulation knows the system alone, and asks for its array whenever it makes a Dae
def derivative_array(system: MechanicalSystem) -> DerivativeArray:
    """Differentiate the equations of `system` as often as their offsets ask."""
    structure = analyse_structure(system)
    equations = structure.equations
    c, d = structure.equation_offsets, structure.variable_offsets
    orders = max(equations.y.size2(), max(d) + 1)
    y = ca.SX.sym("y", len(d), orders)
    for j, name in enumerate(equations.names):
        for order in range(orders):
            # A symbol each, named as derivatives are on paper: what is printed can be read.
            y[j, order] = ca.SX.sym(name + "'" * order)
    current = ca.substitute(equations.residual, equations.y, y[:, : equations.y.size2()])
    rows: list[tuple[int, int]] = []
    residual: list[ca.SX] = []
    gamma = system.gamma
    active = list(range(len(c)))
    for order in range(max(c) + 1):
        keep = [k for k, i in enumerate(active) if c[i] >= order]
        active, current = [active[k] for k in keep], current[keep]
        rows += [(i, order) for i in active]
        residual.append(current)
        current = time_derivative(current, y, gamma)
        if system.time.numel():  # it goes on evenly: a path needs no more derivatives because of it
            later = gamma[-1, 2:]
            current = ca.substitute(current, later, ca.SX.zeros(later.shape))
    equations_of_all_orders = ca.vertcat(*residual)
    return DerivativeArray(
        system=system,
        signature=structure,
        y=y,
        unknowns=tuple((j, order) for j in range(len(d)) for order in range(d[j] + 1)),
        rows=tuple(rows),
        residual=equations_of_all_orders,
        reference_order=highest_derivative(equations_of_all_orders, gamma),
        states=choose_states(structure, jacobian_at_probes(structure)[0]) if structure.degrees_of_freedom else (),
    )


def choose_states(structure: Signature, J: Array) -> tuple[tuple[int, int], ...]:
    """Choose the states of the internal dynamics: dummy derivatives (Mattsson & Soederlind 1993) by pivoting.

    At level k the equations with c_i >= k determine as many of the derivatives y_j^(d_j - k), chosen by QR with
    column pivoting on the system Jacobian `J` and nested from level to level; the others are states.
    """
    c, d = structure.equation_offsets, structure.variable_offsets
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
