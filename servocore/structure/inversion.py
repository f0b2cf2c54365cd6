"""Exact inversion: every unknown of the derivative array from the reference at one instant."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.numerics.compiled_calls import Array
from servocore.numerics.components import Part, parts_of, triangular_blocks
from servocore.numerics.memoization import made_once
from servocore.numerics.square_systems import SquareSystem, compile_solver, compile_unrolled_solver
from servocore.structure.derivative_array import DerivativeArray, nominal

LARGEST_RESIDUAL = 1e-9
"""Residual of the derivative array below which its guess counts as exact."""

_MOST_OPERATIONS = 6000  # of equations that do not decouple; beyond, to compile takes longer than many solves
_FEW_OPERATIONS = 2500  # to be differentiated
_MOST_LOGARITHM = 650.0  # of a determinant: beyond, its sign counts alone
_MOST_TERMS = 128.0  # of a determinant that is written out
_MOST_EXPLICIT = 10_000  # of equations that need no iterations, whatever the guess
_REGULARIZATION = 1e-9  # of the normal equations that give a first guess of multipliers and inputs


@dataclass(frozen=True, eq=False)
class Inversion:
    """A compiled derivative array: functions that return its unknowns at an instant.

    gamma has shape (m, reference_order + 1). Every function returns the unknowns of the array, the counts of Newton's
    method and the residual; states of the internal dynamics keep their guess.

    Attributes
    ----------
    guess : casadi.Function
        (gamma, p) -> a guess of the unknowns: the system's own configuration, with the forces that hold it at rest
        (with no force in the rope the equations would be singular), and zero for the rest.
    search : casadi.Function
        (gamma, p, guess) -> the results by Newton's method from a guess.
    expression : casadi.Function or None
        (gamma, p) -> the results where the guess is exact, and NaN elsewhere, as one expression: a quarter of the cost
        of calling Newton's method block by block. None if the expression would be too long.
    search_from_guess : casadi.Function
        (gamma, p) -> the results of `search` from `guess`.
    function : casadi.Function
        (gamma, p) -> the results: those of `expression` if they satisfy all equations, and else of `search_from_guess`.
    """

    guess: ca.Function
    expression: ca.Function | None
    _array: DerivativeArray

    @property
    def differentiable(self) -> ca.Function | None:
        """The expression if it is short enough to be differentiated; that of longer equations is to be evaluated."""
        long = self.expression is not None and self.expression.n_instructions() > _FEW_OPERATIONS
        return None if long else self.expression

    @property
    def search(self) -> ca.Function:
        """See above; compiled at the first use, since `analyse` seldom needs it."""
        return _compile_search(self._array)

    @cached_property
    def search_from_guess(self) -> ca.Function:
        """See above."""
        gamma, p = self._arguments()
        return ca.Function("sc_search", [gamma, p], list(self.search(gamma, p, self.guess(gamma, p))))

    @cached_property
    def function(self) -> ca.Function:
        """See above."""
        gamma, p = self._arguments()
        if self.expression is None:
            results = self.search_from_guess(gamma, p)
        else:
            candidate = self.expression(gamma, p)
            symbols = [ca.MX.sym("given", *argument.shape) for argument in (*candidate, gamma, p)]
            accept = ca.Function("sc_accept", symbols, symbols[:3])
            reject = ca.Function("sc_reject", symbols, list(self.search_from_guess(*symbols[3:])))
            choose = ca.Function.if_else("sc_choose", accept, reject)
            results = choose(candidate[2] < LARGEST_RESIDUAL, *candidate, gamma, p)
        return ca.Function("sc_inversion", [gamma, p], list(results), ["gamma", "p"], ["y", "counts", "residual"])

    def by_search(self) -> Inversion:
        """Return the inversion without the expression: half of the code, where speed does not matter."""
        return replace(self, expression=None)

    def _arguments(self) -> list[ca.MX]:
        return [ca.MX.sym(name, *self.guess.size_in(k)) for k, name in enumerate(("gamma", "p"))]


@made_once
def inversion(array: DerivativeArray) -> Inversion:
    """Compile the exact inversion of a derivative array.

    Raises
    ------
    InvalidModel
        If the equations call a function without the derivatives that are needed.
    """
    if _differentiates_linear_tables(array):
        raise InvalidModel(
            f"{array.system.name}: its equations call a function that cannot be differentiated as often as the"
            " inputs require, such as a table with linear interpolation; use a table of the kind bspline"
        )
    guess = _compile_guess(array)
    return Inversion(guess, _compile_expression(array, guess), array)


def _differentiates_linear_tables(array: DerivativeArray) -> bool:
    """Whether rows that are differentiated twice or more call tables with linear interpolation.

    CasADi takes the slopes of such tables for constants.
    """
    rows = [k for k, (_, order) in enumerate(array.rows) if order > 1]
    calls = ca.Function("sc_calls", [], [array.residual[rows]], {"allow_free": True}).find_functions()
    return any(each.class_name().startswith("LinearInterpolant") for each in calls)


@made_once
def system_jacobian(array: DerivativeArray) -> ca.Function:
    """Compile (unknowns of the array, gamma, p) -> system Jacobian."""
    arguments, J = _system_jacobian(array)
    return ca.Function("sc_J", arguments, [ca.densify(J)])


@made_once
def system_jacobian_entries(array: DerivativeArray) -> tuple[ca.Function, tuple[Part, ...]]:
    """Compile (unknowns, gamma, p) -> entries of the system Jacobian, column by column, and find independent parts."""
    arguments, J = _system_jacobian(array)
    return ca.Function("sc_J_entries", arguments, [J.nz[:]]), parts_of(J.sparsity())


@made_once
def diagonal_blocks(array: DerivativeArray) -> tuple[Part, ...]:
    """Return the diagonal blocks of the system Jacobian in block triangular form: all are regular where it is.

    Those that depend on neither unknowns nor path are regular everywhere, as at home, and left out.
    """
    (unknowns, reference, _), J = _system_jacobian(array)
    varying = set(ca.jacobian_sparsity(ca.vertcat(J.nz[:]), ca.veccat(unknowns, reference)).row())
    return tuple(each for each in triangular_blocks(J.sparsity()) if varying & set(each.entries.ravel().tolist()))


def block_determinants(array: DerivativeArray, found: Array, entries: Array | None = None) -> Array:
    """Return the determinants of the diagonal blocks at N instants, shape (blocks, N).

    `found` and `entries` are the results of `determinants` at the instants. The determinant of the whole would hide a
    singular block of which there are two, as there are of constraints: one holds the motion, the other the forces.
    """
    for k, block in enumerate(diagonal_blocks(array) if entries is not None else ()):
        if not _by_formula(block):
            with np.errstate(invalid="ignore"):  # where there is no answer
                signs, logarithms = np.linalg.slogdet(block.dense(np.asarray(entries)))
            found[k] = signs * np.exp(np.clip(logarithms, -_MOST_LOGARITHM, _MOST_LOGARITHM))
    return found


def _by_formula(block: Part) -> bool:
    """Whether a determinant has few terms: at most the product of all (n!)^(1/n), with n entries in a row (Bregman)."""
    terms = sum(math.lgamma(n + 1.0) / n for n in np.bincount(block.places[0]).tolist())
    return len(block.rows) != len(block.columns) or terms <= math.log(_MOST_TERMS)


@made_once
def determinants(array: DerivativeArray) -> ca.Function:
    """Compile (unknowns of the array, gamma, p) -> determinants of small blocks, and all entries if some are large."""
    (arguments, J), blocks = _system_jacobian(array), diagonal_blocks(array)
    small, entries = [ca.SX(0)] * len(blocks), ca.vertsplit(J.nz[:]) if blocks else []
    for k, block in enumerate(blocks):
        if _by_formula(block) and len(block.rows) == len(block.columns):
            # To take a block of one entry out of a matrix takes as long as a determinant.
            single = len(block.rows) == len(block.entries) == 1
            small[k] = entries[block.entries[0]] if single else ca.det(J[block.rows.tolist(), block.columns.tolist()])
    others = [] if all(map(_by_formula, blocks)) else [ca.vertcat(J.nz[:])]
    return ca.Function("sc_blocks", arguments, [ca.vertcat(*small), *others], {"cse": True})


@made_once
def _system_jacobian(array: DerivativeArray) -> tuple[list[ca.SX], ca.SX]:
    reference = array.system.gamma[:, : array.reference_order + 1]
    equations = array.signature.equations
    J = ca.substitute(array.signature.jacobian, equations.y, array.y[:, : equations.y.size2()])
    return [array.column(array.unknowns), reference, array.system.p], J


def _compile_expression(array: DerivativeArray, guess: ca.Function) -> ca.Function | None:
    """Compile the inversion as one expression, with NaN where the guess is not exact; None if too long.

    Such an expression costs a quarter of calling Newton's method block by block.
    """
    if array.states:  # they are integrated from step to step
        return None
    most = _MOST_OPERATIONS
    length = ca.Function("sc_length", [], [array.residual], {"allow_free": True}).n_instructions()
    # Common parts of an expression are found once it is complete, which takes most of an analysis of long equations.
    if _too_long(array, length, 2 * most):
        most = _MOST_EXPLICIT
        if _too_long(array, length, 2 * most) or compile_explicit(array) is None:
            return None
    gamma, p = array.system.gamma[:, : array.reference_order + 1], array.system.p
    givens, (equations, unknowns) = ca.vertcat(ca.vec(gamma), p), _equations(array)
    equations = replace(equations, givens=givens, guess=guess(gamma, p))
    function = compile_unrolled_solver("sc_flat_inversion", equations, unknowns, [gamma, p])
    return None if function is None or _too_long(array, function.n_instructions(), most) else function


def _too_long(array: DerivativeArray, length: int, most: int) -> bool:
    """Whether the largest independent part has more operations than `most`, by its share in the entries of all."""
    if length <= most:
        return False
    parts = parts_of(ca.jacobian_sparsity(array.residual, array.column(array.unknowns)))
    # One test of exactness joins all parts, so that operations cannot be counted by part.
    entries = [len(part.entries) for part in parts]
    return max(entries) / sum(entries) * length > most


@made_once
def compile_explicit(array: DerivativeArray) -> ca.Function | None:
    """Compile (gamma, p, states) -> unknowns of the array, as one expression; None where that needs iterations.

    The states are those of the internal dynamics, in their order.
    """
    system, (equations, unknowns) = array.system, _equations(array)
    states = equations.givens[-len(array.unknowns) :][array.places(array.states)]
    arguments = [system.gamma[:, : array.reference_order + 1], system.p, states]
    return compile_unrolled_solver("sc_explicit", equations, unknowns, arguments, explicit=True)


@made_once
def _compile_search(array: DerivativeArray) -> ca.Function:
    """Compile (gamma, p, guess) -> (unknowns of the array, counts, residual); states keep their guess."""
    solver = compile_solver("sc_array", *_equations(array))
    gamma = ca.MX.sym("gamma", array.system.gamma.size1(), array.reference_order + 1)
    p, guess = ca.MX.sym("p", array.system.p.numel()), ca.MX.sym("guess", len(array.unknowns))
    results = solver(ca.vertcat(ca.vec(gamma), p, guess))
    return ca.Function("sc_array_solver", [gamma, p, guess], list(results))


@made_once
def _equations(array: DerivativeArray) -> tuple[SquareSystem, list[ca.SX]]:
    """Return the equations of the array with givens (gamma, p, guess), and all its unknowns as outputs."""
    system = array.system
    guess_symbols = ca.SX.sym("guess", len(array.unknowns))
    guessed = dict(zip(array.unknowns, ca.vertsplit(guess_symbols), strict=True))
    scale = np.array([nominal(system, j) for j, _ in array.determined])
    forces = tuple(force for force in array.determined if force[0] >= len(system.coordinates))
    # States keep the value of their guess: they are integrated, not solved for.
    pinned = ca.vertcat(ca.SX(0, 1), *[guessed[state] for state in array.states])
    equations = SquareSystem(
        unknowns=array.column(array.determined),
        givens=ca.vertcat(ca.vec(system.gamma[:, : array.reference_order + 1]), system.p, guess_symbols),
        residual=ca.substitute(array.residual, array.column(array.states), pinned),
        guess=ca.vertcat(*[guessed[unknown] for unknown in array.determined]),
        unknown_scale=ca.SX(scale),
        residual_scale=ca.SX.ones(len(array.rows)),
        rough=frozenset(entry.name() for entry in ca.vertsplit(array.column(forces))),
    )
    return equations, [ca.substitute(array.column(array.unknowns), array.column(array.states), pinned)]


def _compile_guess(array: DerivativeArray) -> ca.Function:
    """Return (gamma, p) -> guess of the unknowns: configuration at rest, with the forces that hold it.

    The forces are those of least squares, from normal equations. A guess need not be exact, and as plain expressions
    with a sparse LDL' factorization they cost a fifth of a compiled QR factorization.
    """
    system = array.system
    n, gamma = len(system.coordinates), system.gamma[:, : array.reference_order + 1]
    # At rest momentum reads G^T lam + B^T u = -bias: linear in the forces, with at least as many rows.
    balance = [ca.horzcat(system.G.T, system.input_matrix.T), -system.bias]
    matrix, load = ca.substitute(balance, [system.q, system.v], [system.guess, ca.SX.zeros(n)])
    normal = ca.mtimes(matrix.T, matrix) + _REGULARIZATION * ca.SX.eye(matrix.size2())
    forces = ca.ldl_solve(ca.mtimes(matrix.T, load), *ca.ldl(normal))
    guess = ca.SX.zeros(len(array.unknowns))
    guess[[k for k, (_, order) in enumerate(array.unknowns) if order == 0]] = ca.vertcat(system.guess, forces)
    return ca.Function("sc_first_guess", [gamma, system.p], [guess], {"cse": True})
