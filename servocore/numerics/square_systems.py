"""Square systems of equations as compiled functions: ordered into blocks, each solved as simply as it allows.

`compile_solver` permutes a system to block triangular form (`casadi.Sparsity.btf`). A block that is linear in one
or two unknowns becomes an explicit expression; every other block is torn (unknowns that a row gives explicitly are
substituted) and what remains goes to CasADi's ``fast_newton`` with its sparse QR factorization. The servo
constraint problems of this library fall apart well: one backward Euler step of the nine-coordinate crane, 25
unknowns, needs Newton's method on two blocks of three.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.numerics.components import Part, isomorphic_parts, places_of
from servocore.numerics.elimination import (
    CompiledValues,
    KnownValues,
    Value,
    WrittenOut,
    is_linear,
    nonlinear_rows,
    own_slopes,
    substituted,
    symbolic_solution,
    tear,
)
from servocore.numerics.expressions import largest
from servocore.numerics.newton import MAX_ITERATIONS, NEWTON_TOLERANCE, TICK, compile_newton
from servocore.numerics.step_operations import without_jumps

_EXPLICIT_SIZE = 3  # linear blocks up to this size are solved by formula

_MOST_UNROLLED = 16  # unknowns of a block whose solution is written out as one expression


class _TooLargeError(Exception):
    """A block is too large to be written out as one expression."""


@dataclass(frozen=True, eq=False)
class SquareSystem:
    """Equations residual(unknowns, givens) = 0, as many as unknowns.

    Parameters
    ----------
    unknowns, givens : casadi.SX
        Column vectors of symbols.
    residual : casadi.SX
        Column vector as long as `unknowns`.
    guess : casadi.SX
        Where Newton starts, an expression of `givens`.
    unknown_scale, residual_scale : casadi.SX
        Magnitudes by which unknowns and residuals are divided, expressions of `givens`.
    rough : frozenset of str
        Names of unknowns whose guess is rough even where that of the others is exact: forces, taken from a system at
        rest.
    tolerance : float
        Bound of the largest scaled Newton correction.
    """

    unknowns: ca.SX
    givens: ca.SX
    residual: ca.SX
    guess: ca.SX
    unknown_scale: ca.SX
    residual_scale: ca.SX
    rough: frozenset[str] = frozenset()
    tolerance: float = NEWTON_TOLERANCE

    def __post_init__(self) -> None:
        for name in ("residual", "guess", "unknown_scale", "residual_scale"):
            rows = getattr(self, name).numel()
            if rows != self.unknowns.numel():
                raise InvalidModel(f"{self.unknowns.numel()} unknowns, but {name} has {rows} rows")

    @cached_property  # a system is compiled for exact guesses and for any
    def alike(self) -> list[list[tuple[Part, list[int]]]]:
        """Groups of isomorphic independent parts, each with the indices of its givens."""
        beside = self.guess, self.unknown_scale, self.residual_scale
        return isomorphic_parts(self.residual, self.unknowns, self.givens, beside)

    @cached_property
    def rest(self) -> tuple[list[int], list[int]]:
        """Rows and columns that belong to no isomorphic part."""
        left = [np.ones(self.unknowns.numel(), dtype=bool) for _ in range(2)]
        for part, _ in (each for group in self.alike for each in group):
            left[0][part.rows] = left[1][part.columns] = False
        return np.flatnonzero(left[0]).tolist(), np.flatnonzero(left[1]).tolist()


def compile_unrolled_solver(
    name: str, system: SquareSystem, outputs: list[ca.SX], arguments: list[ca.SX], *, explicit: bool = False
) -> ca.Function | None:
    """Compile `system` like `compile_solver`, but unrolled: one expression, with one Newton iteration in every block.

    Its results hold where the guess is exact; they are NaN where the iteration corrects it by more than the tolerance.
    An expression avoids the interpreter's function calls, most of the cost of a small block. Common subexpressions are
    looked for in one of isomorphic parts, which takes seconds in a hundred of them.

    Parameters
    ----------
    name, system, outputs
        See `compile_solver`.
    arguments : list of casadi.SX
        Symbols of which the givens consist.
    explicit : bool
        Whether to write out only systems that need no iterations, whatever the guess: of linear blocks.

    Returns
    -------
    casadi.Function or None
        arguments -> the results of `compile_solver`, of an explicit one the outputs alone; None if a block is too large
        to be written out, or would need iterations.
    """
    known = WrittenOut()
    with suppress(_TooLargeError):
        _solve(known, system, system.givens)
        if explicit:
            return None if known.iterated else ca.Function(name, arguments, known.final(outputs), {"cse": True})
        *results, residual = known.final([*outputs, _worst(system, system.rest[0])])
        for others in known.residuals:
            # A sum that is NaN shows in no maximum.
            residual = ca.fmax(residual, ca.mmax(others)) + 0.0 * ca.sum2(others)
        return ca.Function(name, arguments, [*results, known.counts(), residual], {"cse": bool(system.rest[0])})
    return None


def _worst(system: SquareSystem, rows: list[int]) -> ca.SX:
    """Return the largest scaled residual of some rows."""
    return largest(system.residual[rows] / system.residual_scale[rows])


def compile_solver(name: str, system: SquareSystem, outputs: list[ca.SX], *, checked: bool = True) -> ca.Function:
    r"""Compile `system` into a function that solves it.

    Parameters
    ----------
    name : str
        Name of the function; prefixed names avoid clashes with the C library in generated code.
    system : SquareSystem
        The equations; must be structurally nonsingular.
    outputs : list of casadi.SX
        Expressions of unknowns and givens to return.
    checked : bool
        Whether to return the counts and the residual as well: to evaluate all equations once more takes a third of the
        time of a step. Outputs are NaN where Newton's method fails in any case.

    Returns
    -------
    casadi.Function
        givens -> (\*outputs, counts, residual), where counts holds the Newton iterations of the slowest block
        and the factorizations of all blocks, and residual is the largest scaled residual, NaN on failure.

    Raises
    ------
    InvalidModel
        If the equations are structurally singular.
    """
    known, givens = CompiledValues(), ca.MX.sym("givens", system.givens.numel())
    known.add_values(system.givens, givens)
    _solve(known, system, givens)
    if not checked:
        return ca.Function(name, [givens], known.final(outputs))
    *results, residual = known.final([*outputs, _worst(system, list(range(system.unknowns.numel())))])
    return ca.Function(name, [givens], [*results, known.counts(), residual])


def _solve(known: KnownValues[Value], system: SquareSystem, givens: Value) -> None:
    """Solve a system block by block for values of its givens; isomorphic parts are compiled once."""
    for group in system.alike:
        _solve_isomorphic(known, system, givens, group)
    if system.rest[0]:
        _solve_blocks(known, _part(system, *system.rest) if system.alike else system)


def _solve_blocks(known: KnownValues[Value], system: SquareSystem) -> None:
    """Solve a system block by block, whether or not it has independent parts."""
    system, constants = _without_constants(system)
    known.explicit += constants
    unrolled = isinstance(known, WrittenOut)
    for level in _levels(system, unrolled):
        single = [block for block in level if len(block[0]) == 1]
        others = [block for block in level if len(block[0]) > 1]
        if len(single) > 1:
            rows, columns = ([place for (place,) in places] for places in zip(*single, strict=True))
            single = [single[k] for k in _solve_single(known, system.residual[rows], system.unknowns[columns])]
        for block in chain(single, others):
            if unrolled and len(block[0]) > _MOST_UNROLLED:
                raise _TooLargeError
            _solve_block(known, system, *block)


def _solve_isomorphic(
    known: KnownValues[Value], system: SquareSystem, givens: Value, group: list[tuple[Part, list[int]]]
) -> None:
    """Solve isomorphic parts by one function, mapped."""
    (first, given), count, inner = group[0], len(group), type(known)()
    part = _part(system, first.rows.tolist(), first.columns.tolist())
    part = replace(part, givens=system.givens[given])
    arguments = type(givens).sym("givens", len(given))
    inner.add_values(part.givens, arguments)
    _solve_blocks(inner, part)
    outputs = [part.unknowns]
    if isinstance(known, WrittenOut):
        # The residual shares most operations with the solution, but those are looked for in parts only.
        outputs.append(_worst(part, list(range(len(first.rows)))))
    results = inner.final(outputs)
    results.append(inner.counts())
    solve = ca.Function("sc_alike", [arguments], results, {"cse": isinstance(known, WrittenOut)}).map(count)
    every = ca.reshape(givens[[k for _, places in group for k in places]], len(given), count)
    solved = solve.call([every])
    columns = [column for isomorphic, _ in group for column in isomorphic.columns.tolist()]
    known.add_values(system.unknowns[columns], ca.vec(solved[0]))
    known.residuals += solved[1:-1]
    known.iterated.append(solved[-1])


def _without_constants(system: SquareSystem) -> tuple[SquareSystem, list[tuple[ca.SX, ca.SX]]]:
    """Eliminate unknowns that a single equation fixes to a number, repeatedly: the rest decouples.

    Mechanisms have many, such as coordinates that joints to the ground keep at zero. Returns the rest and pairs
    (unknown, number).
    """
    constants: list[tuple[ca.SX, ca.SX]] = []
    while True:
        pattern = ca.jacobian_sparsity(system.residual, system.unknowns)
        rows, columns = places_of(pattern)
        alone = np.flatnonzero(np.bincount(rows, minlength=system.unknowns.numel())[rows] == 1)
        held = system.residual[rows[alone].tolist()]
        slopes = ca.vertsplit(own_slopes(without_jumps(held), system.unknowns))
        at_zero = ca.vertsplit(ca.substitute(held, system.unknowns, ca.SX.zeros(system.unknowns.numel())))
        explicit: dict[int, tuple[int, ca.SX]] = {}
        for k, (i, j) in enumerate(zip(rows[alone].tolist(), columns[alone].tolist(), strict=True)):
            if slopes[k].is_constant() and at_zero[k].is_constant():
                explicit.setdefault(j, (i, -at_zero[k] / slopes[k]))
        if not explicit:
            return system, constants
        numbers = [(system.unknowns[j], value) for j, (_, value) in explicit.items()]
        constants += numbers
        every = range(system.unknowns.numel())
        kept_rows = np.setdiff1d(every, [i for i, _ in explicit.values()]).tolist()
        system = _part(system, kept_rows, np.setdiff1d(every, list(explicit)).tolist())
        system = replace(system, residual=substituted(numbers, system.residual)[0])


def _part(system: SquareSystem, rows: list[int], columns: list[int]) -> SquareSystem:
    return replace(
        system,
        unknowns=system.unknowns[columns],
        residual=system.residual[rows],
        guess=system.guess[columns],
        unknown_scale=system.unknown_scale[columns],
        residual_scale=system.residual_scale[rows],
    )


def _levels(system: SquareSystem, unrolled: bool) -> list[list[tuple[list[int], list[int]]]]:
    """Return rows and columns of the diagonal blocks, level by level: a block depends on earlier levels alone."""
    if not system.unknowns.numel():
        return []
    pattern = ca.jacobian_sparsity(system.residual, system.unknowns)
    if ca.sprank(ca.DM(pattern, 1)) < pattern.size1():
        raise InvalidModel("the equations are structurally singular: they cannot fix all unknowns")
    count, rows, columns, row_starts, column_starts, *_ = pattern.btf()
    order = sorted if unrolled else list  # blocks of derivatives repeat: sorted, they share their minors
    of_row, level_of = pattern.T, np.full(pattern.size2(), -1)  # -1 while an unknown is not solved
    starts, held = of_row.colind(), np.array(of_row.row(), dtype=np.intp)
    levels: dict[int, list[tuple[list[int], list[int]]]] = {}
    for k in range(count):
        block = rows[row_starts[k] : row_starts[k + 1]], columns[column_starts[k] : column_starts[k + 1]]
        level = 1 + max(int(level_of[held[starts[i] : starts[i + 1]]].max()) for i in block[0])
        level_of[block[1]] = level
        levels.setdefault(level, []).append((order(block[0]), order(block[1])))
    return [levels[level] for level in sorted(levels)]


def _solve_single(known: KnownValues[Value], residual: ca.SX, unknowns: ca.SX) -> list[int]:
    """Solve rows with one unknown each that are linear in it, all at once; return the others.

    Derivatives, substitutions and tests cost as much for one row of equations as for all of them: rows of
    derivative arrays share most operations.
    """
    slopes = own_slopes(residual, unknowns)
    nonlinear = nonlinear_rows(residual, unknowns, slopes)
    linear = [k for k in range(unknowns.numel()) if k not in nonlinear]
    if linear:
        unknowns, zeros = unknowns[linear], ca.SX.zeros(len(linear))
        slopes, constant = known.resolved(slopes[linear], residual[linear], also=[(unknowns, zeros)])
        known.explicit.append((unknowns, -(constant / slopes)))
        known.linear_blocks += len(linear)
    return sorted(nonlinear)


def _solve_block(known: KnownValues[Value], system: SquareSystem, rows: list[int], columns: list[int]) -> None:
    unknowns, residual, size = system.unknowns[columns], system.residual[rows], len(rows)
    jacobian = ca.jacobian(residual, unknowns)
    if not is_linear(residual, unknowns, jacobian):
        _solve_nonlinear(known, _part(system, rows, columns))
        return
    known.linear_blocks += 1
    at_zero = (unknowns, ca.SX.zeros(size))
    if size > _EXPLICIT_SIZE:
        (constant,) = substituted([at_zero], residual)
        known.add_values(unknowns, known.linear_solution(jacobian, -constant))
    else:
        jacobian, constant = known.resolved(jacobian, residual, also=[at_zero])
        known.explicit.append((unknowns, -symbolic_solution(jacobian, constant)))


def _solve_nonlinear(known: KnownValues[Value], block: SquareSystem) -> None:
    core, kept_rows, torn = tear(block.unknowns, block.residual)
    block = _part(block, kept_rows, core)
    block = replace(block, residual=substituted(torn, block.residual)[0])
    if isinstance(known, WrittenOut):
        known.add_values(block.unknowns, _iterated_once(known, block))
    elif isinstance(known, CompiledValues):
        known.add_values(block.unknowns, _iterated(known, block))
    resolved = known.resolved(*(expression for _, expression in torn))
    known.explicit += [(symbol, value) for (symbol, _), value in zip(torn, resolved, strict=True)]


def _iterated(known: CompiledValues, block: SquareSystem) -> ca.MX:
    """Return the solution by Newton's method, NaN if it does not converge."""
    known.evaluate_explicit()
    unknown_scale, residual_scale = block.unknown_scale, block.residual_scale
    start, scale = known.evaluated("sc_prepare", block.guess / unknown_scale, unknown_scale)
    size = block.unknowns.numel()
    scaled, clock = ca.SX.sym("scaled", size), ca.SX.sym("clock")
    symbols, values = known.needed(block.residual, unknown_scale, residual_scale)
    equations = ca.substitute(block.residual, block.unknowns, scaled * unknown_scale) / residual_scale
    x, data = ca.vertcat(scaled, clock), known.needed(block.residual)[0]
    newton = compile_newton(x, symbols, ca.vertcat(equations, ca.exp(-clock / TICK)), data, block.tolerance)
    root = newton(ca.vertcat(start, 0), values)
    ticks = root[size] / TICK
    known.iterated.append(ca.vertcat(ticks, ticks))
    # A count at the limit is a failure: NaN instead of the last iterate.
    verdict = ca.if_else(ticks > MAX_ITERATIONS - 0.5, np.nan, 1.0)
    return root[:size] * scale * verdict


def _iterated_once(known: WrittenOut, block: SquareSystem) -> ca.SX:
    """Return a guess after one Newton iteration; `WrittenOut.final` compares the correction with the tolerance."""
    unknowns = block.unknowns
    better = _with_forces(block)
    jacobian = ca.jacobian(block.residual, unknowns)
    residual, jacobian = ca.substitute([block.residual, jacobian], [unknowns], [better])
    correction = symbolic_solution(jacobian, residual)
    moved = ca.sumsqr(correction / block.unknown_scale)
    (start,) = known.resolved(block.guess)
    solution, squared = known.resolved(better - correction, moved, also=[(unknowns, start)])
    known.iterated.append(ca.SX([1, 1]))
    known.corrections.append(squared)
    return solution


def _with_forces(block: SquareSystem) -> ca.SX:
    """Return the unknowns of a block; those of a rough guess follow from the others by linear least squares."""
    unknowns, residual = block.unknowns, block.residual
    rough = [k for k in range(unknowns.numel()) if unknowns[k].name() in block.rough]
    matrix = ca.jacobian(residual, unknowns[rough])
    if not rough or len(rough) > _EXPLICIT_SIZE or not is_linear(residual, unknowns[rough], matrix):
        return unknowns
    # Linearized at zero: the result does not depend on their guess, which then need not be computed.
    rest = ca.substitute(residual, unknowns[rough], ca.SX.zeros(len(rough)))
    estimate = ca.SX(unknowns)
    estimate[rough] = -symbolic_solution(ca.mtimes(matrix.T, matrix), ca.mtimes(matrix.T, rest))
    return estimate
