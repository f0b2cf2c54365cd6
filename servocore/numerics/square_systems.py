"""Square systems of equations as compiled functions: ordered into blocks, each solved as simply as it allows.

`compile_solver` permutes a system to block triangular form (`casadi.Sparsity.btf`). A block that is linear in one
or two unknowns becomes an explicit expression; every other block is torn (unknowns that a row gives explicitly are
substituted) and what remains goes to CasADi's ``fast_newton`` with its sparse QR factorisation. The servo
constraint problems of this library fall apart well: one backward Euler step of the nine-coordinate crane, 25
unknowns, needs Newton's method on two blocks of three.

``fast_newton`` says nothing of how it ended, and takes NaN for convergence. So each block carries a *clock*, an
unknown of its own whose Newton correction is exactly one tick: -r/r' = tick for r = exp(-clock/tick). It counts the
iterations inside compiled loops, and convergence is judged from the count.

Where unknowns are large beside their nominal values (accelerations of stiff parts), corrections end at round-off above
`STEP_TOLERANCE`. After `QUICK_ITERATIONS` the rest is done with care: an equation counts as solved where a change of
unknowns and givens by some round-off explains what is left of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel
from servocore.numerics.expressions import largest

STEP_TOLERANCE = 1e-9
"""Newton stops when the largest scaled correction is smaller; being quadratic, it then errs by its square."""

QUICK_ITERATIONS = 12
"""After as many Newton iterations those that remain look at round-off, which takes twice as long."""

MAX_ITERATIONS = 30
"""A block that needs as many Newton iterations has failed."""

_ROUND_OFF = 64 * np.finfo(np.float64).eps  # relative change of unknowns and givens that explains a residual
_EXPLICIT_SIZE = 3  # linear blocks up to this size are solved by formula

_TICK = 1e-20  # far below every tolerance, so that the clock never decides when to stop
_MOST_UNROLLED = 16  # unknowns of a block whose solution is written out as one expression
_TEARING_FILL = 0  # a substitution must not leave more entries than it removes


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
    """

    unknowns: ca.SX
    givens: ca.SX
    residual: ca.SX
    guess: ca.SX
    unknown_scale: ca.SX
    residual_scale: ca.SX

    def __post_init__(self) -> None:
        size = self.unknowns.numel()
        for attribute in ("residual", "guess", "unknown_scale", "residual_scale"):
            found = getattr(self, attribute).numel()
            if found != size:
                raise InvalidModel(f"{size} unknowns, but {attribute} has {found} rows")


@dataclass(eq=False)
class _Assembly:
    """What is known while the blocks are worked through: symbols with their values in the compiled graph."""

    system: SquareSystem
    symbols: ca.SX
    values: ca.MX
    explicit: list[tuple[ca.SX, ca.SX]] = field(default_factory=list)  # not yet evaluated
    iterations: list[ca.MX] = field(default_factory=list)
    linear_blocks: int = 0
    flat: bool = False

    def resolved(self, *expressions: ca.SX) -> list[ca.SX]:
        """Return `expressions` in terms of evaluated symbols and of unknowns still to come."""
        return _substituted(self.explicit, *expressions)

    def flush(self) -> None:
        """Evaluate the explicit unknowns found so far, so that later iterations need not repeat them."""
        if self.explicit:
            symbols, values = (ca.vertcat(*column) for column in zip(*self.explicit, strict=True))
            evaluate = ca.Function("sc_explicit", [self.symbols], [values], {"cse": True})
            self.learn(symbols, evaluate(self.values))
            self.explicit = []

    def learn(self, symbols: ca.SX, values: ca.MX) -> None:
        self.symbols = ca.vertcat(self.symbols, symbols)
        self.values = ca.vertcat(self.values, values)


def _substituted(pairs: list[tuple[ca.SX, ca.SX]], *expressions: ca.SX) -> list[ca.SX]:
    """Return `expressions` with (symbol, expression in its place) of all pairs put in at once."""
    if not pairs:
        return list(expressions)
    symbols, values = (ca.vertcat(*column) for column in zip(*pairs, strict=True))
    found: list[ca.SX] = ca.substitute(list(expressions), [symbols], [values])
    return found


def compile_flat_solver(name: str, system: SquareSystem, outputs: list[ca.SX]) -> ca.Function | None:
    """Compile `system` like `compile_solver`, but as one expression with a single Newton iteration in every block.

    For guesses that are exact already: where the iteration corrects anything that counts, the results are NaN. An
    expression spares what the interpreter spends on calling functions, which is most of what a small block costs.

    Returns
    -------
    casadi.Function or None
        None if a block is too large to be written out.
    """
    if any(len(rows) > _MOST_UNROLLED for rows, _ in _blocks(_without_constants(system)[0])):
        return None
    function = compile_solver(name, system, outputs, flat=True).expand()
    symbols = function.sx_in()
    return ca.Function(name, symbols, function.call(symbols), {"cse": True})


def compile_solver(name: str, system: SquareSystem, outputs: list[ca.SX], *, flat: bool = False) -> ca.Function:
    r"""Compile `system` into a function that solves it.

    Parameters
    ----------
    name : str
        Name of the function; prefixed names avoid clashes with the C library in generated code.
    system : SquareSystem
        The equations; must be structurally nonsingular.
    outputs : list of casadi.SX
        Expressions of unknowns and givens to return.
    flat : bool
        See `compile_flat_solver`.

    Returns
    -------
    casadi.Function
        givens -> (\*outputs, counts, residual), where counts holds the Newton iterations of the slowest block
        and the factorisations of all blocks, and residual is the largest scaled residual. NaN says that it failed.

    Raises
    ------
    InvalidModel
        If the equations are structurally singular.
    """
    givens = ca.MX.sym("givens", system.givens.numel())
    full, (system, constants) = system, _without_constants(system)
    assembly = _Assembly(system, system.givens, givens, explicit=constants, flat=flat)
    for rows, columns in _blocks(system):
        _solve_block(assembly, rows, columns)
    worst = largest(full.residual / full.residual_scale)
    finish = ca.Function(
        "sc_finish",
        [assembly.symbols],
        [ca.densify(each) for each in assembly.resolved(*outputs, worst)],
        {"cse": True},
    )
    *found, residual = finish.call([assembly.values])
    most = ca.MX(0)
    total = ca.MX(assembly.linear_blocks)
    for count in assembly.iterations:
        most, total = ca.fmax(most, count), total + count
    return ca.Function(name, [givens], [*found, ca.vertcat(most, total), residual])


def _without_constants(system: SquareSystem) -> tuple[SquareSystem, list[tuple[ca.SX, ca.SX]]]:
    """Take out unknowns that a single equation fixes to a number, again and again: what they held together falls apart.

    Mechanisms have many: coordinates that joints to the ground keep at zero. Returns the rest and (unknown, number)
    pairs.
    """
    constants: list[tuple[ca.SX, ca.SX]] = []
    while system.unknowns.numel():
        jacobian = ca.jacobian(system.residual, system.unknowns)
        pattern = _dependence(jacobian)
        found: dict[int, tuple[int, ca.SX]] = {}
        for i in np.flatnonzero(pattern.sum(axis=1) == 1).tolist():
            j = int(pattern[i].argmax())
            value = -ca.substitute(system.residual[i], system.unknowns[j], ca.SX(0)) / jacobian[i, j]
            if jacobian[i, j].is_constant() and value.is_constant():
                found.setdefault(j, (i, value))
        if not found:
            break
        numbers = [(system.unknowns[j], value) for j, (_, value) in found.items()]
        constants += numbers
        kept_rows = np.setdiff1d(range(len(pattern)), [i for i, _ in found.values()]).tolist()
        kept = np.setdiff1d(range(len(pattern)), list(found)).tolist()
        system = replace(
            system,
            unknowns=system.unknowns[kept],
            residual=_substituted(numbers, system.residual[kept_rows])[0],
            guess=system.guess[kept],
            unknown_scale=system.unknown_scale[kept],
            residual_scale=system.residual_scale[kept_rows],
        )
    return system, constants


def _blocks(system: SquareSystem) -> list[tuple[list[int], list[int]]]:
    """Rows and columns of the diagonal blocks, in the order in which they can be solved."""
    if not system.unknowns.numel():
        return []
    pattern = ca.jacobian_sparsity(system.residual, system.unknowns)
    if ca.sprank(ca.DM(pattern, 1)) < pattern.size1():
        raise InvalidModel("the equations are structurally singular: they cannot fix all unknowns")
    count, rows, columns, row_starts, column_starts, *_ = pattern.btf()
    return [
        (rows[row_starts[k] : row_starts[k + 1]], columns[column_starts[k] : column_starts[k + 1]])
        for k in range(count)
    ]


def _solve_block(assembly: _Assembly, rows: list[int], columns: list[int]) -> None:
    unknowns = assembly.system.unknowns[columns]
    residual = assembly.system.residual[rows]
    jacobian = ca.jacobian(residual, unknowns)
    linear = not ca.depends_on(jacobian, unknowns)
    if linear and len(rows) <= _EXPLICIT_SIZE:
        jacobian, constant = assembly.resolved(jacobian, ca.substitute(residual, unknowns, ca.SX.zeros(len(rows))))
        solution = -_small_inverse_times(jacobian, constant)
        assembly.explicit += [(unknowns[k], solution[k]) for k in range(len(rows))]
        assembly.linear_blocks += 1
        return
    assembly.flush()
    if linear:
        _solve_linear(assembly, unknowns, residual, jacobian)
    else:
        _solve_nonlinear(assembly, rows, columns)


def _small_inverse_times(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Return matrix^-1 right for up to three rows, by Cramer's rule."""
    if matrix.size1() == 1:
        return right / matrix
    if matrix.size1() == 2:
        (a, b), (c, d) = ((matrix[i, 0], matrix[i, 1]) for i in range(2))
        return ca.vertcat(d * right[0] - b * right[1], a * right[1] - c * right[0]) / (a * d - b * c)
    rows = [matrix[i, :].T for i in range(3)]
    # The columns of the adjugate are the cross products of the rows.
    adjugate = ca.horzcat(*[ca.cross(rows[(i + 1) % 3], rows[(i + 2) % 3]) for i in range(3)])
    return ca.mtimes(adjugate, right) / ca.dot(rows[0], adjugate[:, 0])


def _solve_linear(assembly: _Assembly, unknowns: ca.SX, residual: ca.SX, jacobian: ca.SX) -> None:
    constant = ca.substitute(residual, unknowns, ca.SX.zeros(unknowns.numel()))
    assembly.linear_blocks += 1
    if assembly.flat:
        solve = ca.Function("sc_linear", [assembly.symbols], [ca.solve(jacobian, -constant)], {"cse": True})
        assembly.learn(unknowns, solve(assembly.values))
        return
    evaluate = ca.Function("sc_linear", [assembly.symbols], [jacobian, -constant], {"cse": True})
    matrix, right = evaluate(assembly.values)
    assembly.learn(unknowns, ca.solve(matrix, right, "qr"))


def _solve_nonlinear(assembly: _Assembly, rows: list[int], columns: list[int]) -> None:
    system = assembly.system
    core, kept_rows, torn = _tear(system, rows, columns)
    (residual,) = _substituted(torn, system.residual[kept_rows])
    find = _iterated_once if assembly.flat else _iterated
    unknowns, guess, scale = (each[core] for each in (system.unknowns, system.guess, system.unknown_scale))
    assembly.learn(unknowns, find(assembly, residual, unknowns, guess, scale, system.residual_scale[kept_rows]))
    for symbol, expression in torn:
        assembly.explicit.append((symbol, assembly.resolved(expression)[0]))


def _iterated(
    assembly: _Assembly, residual: ca.SX, unknowns: ca.SX, guess: ca.SX, scale: ca.SX, row_scale: ca.SX
) -> ca.MX:
    """Return where Newton's method ends, or NaN if it does not."""
    system = assembly.system
    prepare = ca.Function("sc_prepare", [system.givens], [guess / scale, scale, row_scale], {"cse": True})
    start, scale_value, row_scale_value = prepare(assembly.values[: system.givens.numel()])

    size = unknowns.numel()
    scaled, clock = ca.SX.sym("scaled", size), ca.SX.sym("clock")
    scale_symbol, row_scale_symbol = ca.SX.sym("scale", size), ca.SX.sym("row_scale", size)
    equations = ca.substitute(residual, unknowns, scaled * scale_symbol) / row_scale_symbol
    x, p = ca.vertcat(scaled, clock), ca.vertcat(assembly.symbols, scale_symbol, row_scale_symbol)
    root = _newton(x, p, ca.vertcat(equations, ca.exp(-clock / _TICK)), assembly.symbols)(
        ca.vertcat(start, 0), ca.vertcat(assembly.values, scale_value, row_scale_value)
    )
    ticks = root[size] / _TICK
    assembly.iterations.append(ticks)
    # A count at the limit is a failure: let it spread instead of the last iterate.
    verdict = ca.if_else(ticks > MAX_ITERATIONS - 0.5, np.nan, 1.0)
    return root[:size] * scale_value * verdict


def _newton(x: ca.SX, p: ca.SX, equations: ca.SX, data: ca.SX) -> ca.Function:
    """Compile (start, p) -> root of `equations`; the last unknown is the clock, `data` what round-off changes in p."""
    options = {"abstol": 0.0, "abstolStep": STEP_TOLERANCE, "error_on_fail": False, "common_options": {"cse": True}}
    problem = {"x": x, "p": p, "g": equations}
    quick = ca.rootfinder("sc_newton", "fast_newton", problem, {**options, "max_iter": QUICK_ITERATIONS})
    J = ca.jacobian(equations, x)
    # Componentwise backward error (Oettli and Prager, 1964).
    floor = ca.mtimes(ca.fabs(J), ca.fabs(x)) + ca.mtimes(ca.fabs(ca.jacobian(equations, data)), ca.fabs(data))
    beyond = ca.if_else(ca.fabs(equations) <= _ROUND_OFF * floor, 0.0, equations)
    beyond[-1] = equations[-1]
    careful = ca.rootfinder("sc_careful_newton", "fast_newton", problem, {
        **options, "max_iter": MAX_ITERATIONS - QUICK_ITERATIONS,
        "jacobian_function": ca.Function("sc_beyond", [x, p], [J, beyond], ["x", "p"], ["J", "g"], {"cse": True}),
    })  # fmt: skip
    start, given = ca.MX.sym("start", x.numel()), ca.MX.sym("p", p.numel())
    enough = ca.Function("sc_enough", [start, given], [start])
    more = ca.Function("sc_more", [start, given], [careful(start, given)])
    root = quick(start, given)
    root = ca.Function.if_else("sc_rest", more, enough)(root[-1] > (QUICK_ITERATIONS - 0.5) * _TICK, root, given)
    return ca.Function("sc_root", [start, given], [root])


def _iterated_once(
    assembly: _Assembly, residual: ca.SX, unknowns: ca.SX, guess: ca.SX, scale: ca.SX, _: ca.SX
) -> ca.MX:
    """Return a guess after one Newton iteration, or NaN if that moved it by more than `STEP_TOLERANCE`."""
    jacobian, size = ca.jacobian(residual, unknowns), unknowns.numel()
    correction = _small_inverse_times(jacobian, residual) if size <= _EXPLICIT_SIZE else ca.solve(jacobian, residual)
    verdict = ca.if_else(largest(correction / scale) < STEP_TOLERANCE, 1.0, np.nan)
    start = ca.Function("sc_prepare", [assembly.system.givens], [guess])
    iterate = ca.Function(
        "sc_iterate", [assembly.symbols, unknowns], [(unknowns - correction) * verdict], {"cse": True}
    )
    assembly.iterations.append(ca.MX(1))
    found: ca.MX = iterate(assembly.values, start(assembly.values[: assembly.system.givens.numel()]))
    return found


def _tear(
    system: SquareSystem, rows: list[int], columns: list[int]
) -> tuple[list[int], list[int], list[tuple[ca.SX, ca.SX]]]:
    """Take unknowns out of a block that one of its rows gives explicitly with a constant coefficient.

    Returns the remaining columns and rows of the system, and the substitutions in an order in which each
    holds unknowns that remain or come later in the list; they are returned already resolved among themselves.
    """
    unknowns, residual = system.unknowns[columns], system.residual[rows]
    jacobian = ca.jacobian(residual, unknowns)
    pattern = _dependence(jacobian)
    constant = {(int(i), int(j)) for i, j in zip(*np.nonzero(pattern), strict=True) if jacobian[i, j].is_constant()}
    active_rows, active_columns = set(range(len(rows))), set(range(len(columns)))
    pivots: list[tuple[int, int]] = []
    while len(active_rows) > 1:
        best = _cheapest_pivot(pattern, constant, active_rows)
        if best is None:
            break
        i, j = best
        touched = [k for k in active_rows if pattern[k, j] and k != i]
        pattern[touched] |= pattern[i]
        constant = {(r, c) for r, c in constant if c != j and not (r in touched and pattern[i, c])}
        active_rows.remove(i)
        active_columns.remove(j)
        pivots.append(best)
    torn: list[tuple[ca.SX, ca.SX]] = []
    for i, j in pivots:
        (row,), unknown = _substituted(torn, residual[i]), unknowns[j]
        coefficient = ca.jacobian(row, unknown)
        value = -ca.substitute(row, unknown, ca.SX(0)) / coefficient
        torn = [(s, ca.substitute(e, unknown, value)) for s, e in torn]
        torn.append((unknown, value))
    core = [columns[j] for j in sorted(active_columns)]
    kept = [rows[i] for i in sorted(active_rows)]
    return core, kept, torn


def _dependence(jacobian: ca.SX) -> npt.NDArray[np.bool_]:
    pattern = np.zeros(jacobian.shape, dtype=bool)
    pattern[tuple(np.array(jacobian.sparsity().get_triplet(), dtype=np.intp))] = True
    return pattern


def _cheapest_pivot(
    pattern: npt.NDArray[np.bool_],
    constant: set[tuple[int, int]],
    active_rows: set[int],
) -> tuple[int, int] | None:
    """Return the constant entry whose elimination creates the fewest new entries, if those are few enough."""

    def fill(i: int, j: int) -> int:
        touched = [k for k in active_rows if pattern[k, j] and k != i]
        return int((pattern[i] & ~pattern[touched]).sum()) - len(touched)

    best = min(((fill(i, j), i, j) for i, j in constant if i in active_rows), default=None)
    return best[1:] if best is not None and best[0] <= _TEARING_FILL else None
