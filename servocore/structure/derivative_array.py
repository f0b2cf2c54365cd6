"""The derivative array of a servo constraint problem as one square system: exact inversion at an instant.

With the offsets c, d of `servocore.structure.structural_analysis`, the equations f_i, ..., f_i^(c_i) in the unknowns y_j, ..., y_j^(d_j)
are a square system when no internal dynamics remain. Its data are the reference and its derivatives at that instant.
It gives consistent initial values to every formulation, and is itself the `Reduced` one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from servocore.numerics.square_systems import SquareSystem, compile_solver
from servocore.structure.projection import pivot_columns
from servocore.structure.structural_analysis import Signature, analyse_structure, system_jacobian_at_home
from servocore.model.symbols import Array
from servocore.model.system import MechanicalSystem

_REGULARISATION = 1e-9  # of the normal equations that give a first guess of multipliers and inputs


@dataclass(frozen=True, eq=False)
class DerivativeArray:
    """Equations and unknowns of the derivative array.

    Attributes
    ----------
    y : casadi.SX
        Symbols of the variables (q, lam, u) and their derivatives, shape (N, max d + 1).
    unknowns : tuple of (int, int)
        Variable and order of every unknown.
    rows : tuple of (int, int)
        Equation and order of every row.
    residual : casadi.SX
        As many rows as `rows`.
    states : tuple of (int, int)
        Unknowns left free: the states of the internal dynamics. Given these, the rest is a square system.
    """

    signature: Signature
    y: ca.SX
    unknowns: tuple[tuple[int, int], ...]
    rows: tuple[tuple[int, int], ...]
    residual: ca.SX
    states: tuple[tuple[int, int], ...]

    @property
    def system(self) -> MechanicalSystem:
        """The system that was differentiated."""
        return self.signature.equations.system

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables."""
        return self.signature.equations.names

    @cached_property
    def reference_order(self) -> int:
        """Highest derivative of the reference that enters."""
        gamma = self.system.gamma
        columns = ca.jacobian_sparsity(self.residual, ca.vec(gamma)).get_col()
        return max((column // gamma.size1() for column in columns), default=0)

    @property
    def determined(self) -> tuple[tuple[int, int], ...]:
        """The unknowns without the states."""
        return tuple(each for each in self.unknowns if each not in self.states)

    def column(self, entries: tuple[tuple[int, int], ...]) -> ca.SX:
        """Return the symbols of `entries`."""
        return ca.vertcat(ca.SX(0, 1), *[self.y[j, order] for j, order in entries])

    def position(self, variable: str, order: int) -> int:
        """Place of a derivative of a named variable among the unknowns."""
        return self.unknowns.index((self.names.index(variable), order))


@lru_cache(maxsize=64)
def derivative_array(system: MechanicalSystem) -> DerivativeArray:
    """Differentiate the equations of `system` as often as their offsets ask."""
    found = analyse_structure(system)
    equations = found.equations
    c, d = found.equation_offsets, found.variable_offsets
    orders = max(2, *d) + 1
    y = ca.SX.sym("y", len(d), orders)
    for j, name in enumerate(equations.names):
        for order in range(orders):
            y[j, order] = ca.SX.sym(name + "'" * order)
    current = ca.substitute(equations.residual, equations.y, y[:, :3])
    rows: list[tuple[int, int]] = []
    residual: list[ca.SX] = []
    gamma = system.gamma
    active = list(range(len(c)))
    for order in range(max(c) + 1):
        keep = [k for k, i in enumerate(active) if c[i] >= order]
        active, current = [active[k] for k in keep], current[keep]
        rows += [(i, order) for i in active]
        residual.append(current)
        current = ca.jtimes(current, ca.vec(y[:, :-1]), ca.vec(y[:, 1:])) + ca.jtimes(
            current, ca.vec(gamma[:, :-1]), ca.vec(gamma[:, 1:])
        )
    return DerivativeArray(
        signature=found,
        y=y,
        unknowns=tuple((j, order) for j in range(len(d)) for order in range(d[j] + 1)),
        rows=tuple(rows),
        residual=ca.vertcat(*residual),
        states=choose_states(found) if found.degrees_of_freedom else (),
    )


def choose_states(found: Signature, J: Array | None = None) -> tuple[tuple[int, int], ...]:
    """Choose the states of the internal dynamics: dummy derivatives (Mattsson & Soederlind 1993) by pivoting.

    At level k the equations with c_i >= k determine as many of the derivatives y_j^(d_j - k), chosen by QR with
    column pivoting on the system Jacobian and nested from level to level; the others are states. The Jacobian is
    taken at the system's home unless `J` is given.
    """
    J = system_jacobian_at_home(found) if J is None else J
    c, d = found.equation_offsets, found.variable_offsets
    chosen = list(range(len(d)))
    states: list[tuple[int, int]] = []
    for level in range(1, max(d) + 1):
        rows = [i for i in range(len(c)) if c[i] >= level]
        candidates = [j for j in chosen if d[j] >= level]
        picked = pivot_columns(J[np.ix_(rows, candidates)])
        chosen = sorted(candidates[k] for k in picked)
        states += [(j, d[j] - level) for j in range(len(d)) if d[j] >= level and j not in chosen]
    return tuple(sorted(states))


def compile_array_solver(array: DerivativeArray) -> ca.Function:
    """Compile (gamma, p, guess) -> (unknowns of the array, counts, residual); states keep their guess."""
    solver = compile_solver("sc_array", *array_system(array))
    gamma = ca.MX.sym("gamma", array.system.gamma.size1(), array.reference_order + 1)
    p, guess = ca.MX.sym("p", array.system.p.numel()), ca.MX.sym("guess", len(array.unknowns))
    found = solver(ca.vertcat(ca.vec(gamma), p, guess))
    return ca.Function("sc_array_solver", [gamma, p, guess], list(found))


def array_system(array: DerivativeArray) -> tuple[SquareSystem, list[ca.SX]]:
    """Return the equations of the array with givens (gamma, p, guess), and all its unknowns as what is wanted."""
    system = array.system
    guess_symbols = ca.SX.sym("guess", len(array.unknowns))
    guessed = dict(zip(array.unknowns, ca.vertsplit(guess_symbols), strict=True))
    scale = np.array([nominal(system, j) for j, _ in array.determined])
    pinned = ca.vertcat(ca.SX(0, 1), *[guessed[each] for each in array.states])
    equations = SquareSystem(
        unknowns=array.column(array.determined),
        givens=ca.vertcat(ca.vec(system.gamma[:, : array.reference_order + 1]), system.p, guess_symbols),
        residual=ca.substitute(array.residual, array.column(array.states), pinned),
        guess=ca.vertcat(*[guessed[each] for each in array.determined]),
        unknown_scale=ca.SX(scale),
        residual_scale=ca.SX.ones(len(array.rows)),
    )
    return equations, [ca.substitute(array.column(array.unknowns), array.column(array.states), pinned)]


def nominal(system: MechanicalSystem, variable: int) -> float:
    """Typical magnitude of a variable (q, lam, u) in SI units."""
    n, m_h = len(system.coordinates), system.lam.numel()
    if variable < n:
        return system.coordinates.nominal[variable]
    return 1.0 if variable < n + m_h else system.inputs[variable - n - m_h].nominal


def first_guess(array: DerivativeArray) -> ca.Function:
    """Return (gamma, p) -> guess of the unknowns: configuration at rest, with the forces that hold it.

    The forces are those of least squares, from normal equations. A guess need not be exact, and as plain expressions
    with a sparse LDL' factorisation they cost a fifth of a compiled QR factorisation.
    """
    system = array.system
    n, gamma = len(system.coordinates), system.gamma[:, : array.reference_order + 1]
    at_rest = [ca.substitute(each, system.v, ca.SX.zeros(n)) for each in (
        ca.horzcat(system.G.T, system.input_matrix.T), -system.bias)]  # fmt: skip
    configuration = ca.SX.sym("q", n)
    matrix, load = ca.substitute(at_rest, [system.q], [configuration])
    normal = ca.mtimes(matrix.T, matrix) + _REGULARISATION * ca.SX.eye(matrix.size2())
    forces = ca.ldl_solve(ca.mtimes(matrix.T, load), *ca.ldl(normal))
    held = ca.Function("sc_statics", [configuration, system.p], [forces], {"cse": True})
    values = ca.vertcat(system.guess, held(system.guess, system.p))
    entries = [values[j] if order == 0 else ca.SX(0) for j, order in array.unknowns]
    return ca.Function("sc_first_guess", [gamma, system.p], [ca.densify(ca.vertcat(*entries))], {"cse": True})
