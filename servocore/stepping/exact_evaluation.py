"""Exact inversions evaluated along paths; no other module assembles them.

The unknowns follow from an expression where the guess of the model is exact, elsewhere from Newton's method. Results
are read from them by one function, at one instant or many, of one case or many, interpreted or as machine code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array, at_instants, mapped, repeated, side_by_side
from servocore.numerics.just_in_time import MANY, Use
from servocore.numerics.memoization import made_once
from servocore.numerics.vectorized import Vectorized
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import Formula, Reference
from servocore.solution import Solution
from servocore.structure.inversion import LARGEST_RESIDUAL, inversion

_SPLINE = 5  # degree of the spline through coordinates of a solution
_FEW = 400  # instants: for so many the interpreter evaluates the path in less time than NumPy


class PathFunction:
    """A compiled function (gamma (m, order + 1), p) -> results, at instants of a path.

    Parameters
    ----------
    function : casadi.Function
        With dense results; one of expressions can become machine code.
    native : bool or None
        See `JustInTime`.
    of_what : str
        Name in messages.
    """

    def __init__(self, function: ca.Function, native: bool | None, of_what: str) -> None:
        self.function, self._native, self._of_what = function, native, of_what
        self.order = int(function.size2_in(0)) - 1
        self._use = Use()
        # The last path evaluated by machine code, at most one: to choose a function takes longer than to evaluate it.
        self._last: list[tuple[Reference, Vectorized, Array]] = []

    def prepare(self, reference: Reference) -> None:
        """Compile machine code for a path now, if `native` is true.

        Raises
        ------
        InvalidSetting
            If there is no C compiler.
        """
        if self._native and not self._made_for(reference):
            self._on_path(reference, MANY)

    def __call__(self, problem: Problem, t: Array) -> list[Array]:
        """Return the results at the instants `t` (N,), shape (rows, N) each."""
        reference = problem.reference
        finite = bool(np.isfinite(t).all())  # other times are refused by the path itself
        for path, machine_code, numbers in self._last:
            if finite and path is reference:
                return machine_code(t[None], numbers, problem.p)
        chosen, formula = self._on_path(reference, len(t), called=True)
        if formula is not None and finite:
            numbers = np.array(formula.numbers(self.order))
            if chosen.ready(len(t)):
                self._last[:] = [(reference, chosen, numbers)]
                return chosen(t[None], numbers, problem.p)
            if len(t) <= _FEW:
                return chosen.interpreted(t[None], numbers, problem.p)
        jets = reference.jet(t, self.order)
        evaluate = self._of_jets if reference.formula is None else self._of_jets.interpreted
        return evaluate(jets.reshape(len(jets), -1).T, problem.p)

    def of_cases(self, references: Sequence[Reference], t: Array, p: Array) -> list[Array]:
        """Return the results of cases, shape (cases, rows, N) each.

        There is one path a case, or one for all; `p` has shape (cases, size), or (size,) for all.
        """
        formulas = [reference.formula for reference in references]
        p = p if p.ndim == 2 or len(references) > 1 else p[None]
        count = len(t) * max(len(references), len(p) if p.ndim == 2 else 1)
        chosen, formula = self._on_path(references[0], count, called=True)
        if formula is not None and all(other == formula for other in formulas) and chosen.ready(count):
            numbers = [formula.numbers(self.order) for formula in formulas if formula is not None]
            return chosen(t[None], np.array(numbers if len(numbers) > 1 else numbers[0]), p)
        jets = np.stack([reference.jet(t, self.order).reshape(len(t), -1).T for reference in references])
        return self._of_jets(np.ascontiguousarray(jets if len(references) > 1 else jets[0]), p)

    def ready(self, problem: Problem, count: int) -> bool:
        """Whether machine code for so many instants is compiled."""
        path = problem.reference
        return self._made_for(path) or self._on_path(path, count)[0].ready(count, called=False)

    def _made_for(self, reference: Reference) -> bool:
        """Whether machine code of this path was the last to be run."""
        return any(path is reference for path, *_ in self._last)

    @cached_property  # not needed where all paths are formulas in machine code
    def _of_jets(self) -> Vectorized:
        return Vectorized(self.function, (True, False), self._native, self._of_what)

    def _on_path(self, reference: Reference, count: int, called: bool = False) -> tuple[Vectorized, Formula | None]:
        """Return the function for a path, and its formula if the path is compiled into the function.

        This is worth it from the second call on.
        """
        formula = reference.formula
        # To compile the path into a function takes longer than a single call.
        pays = self._use.pays(count, called) and (self._native is None or count <= _FEW)
        if not (self._native or pays) or formula is None or not self.function.is_a("SXFunction"):
            return self._of_jets, None
        return _inside(self.function, formula, self._native, self._of_what), formula


@made_once
def _inside(function: ca.Function, formula: Formula, native: bool | None, of_what: str) -> Vectorized:
    """Return a function of expressions (gamma, p) as one of (t, numbers of the path, p)."""
    order, t, p = function.size2_in(0) - 1, ca.SX.sym("t"), ca.SX.sym("p", function.numel_in(1))
    numbers = ca.SX.sym("numbers", len(formula.numbers(order)))
    gamma = ca.horzcat(*formula.jet(t, ca.vertsplit(numbers), order))
    on_path = ca.Function("sc_on_path", [t, numbers, p], function.call([gamma, p]), {"cse": True})
    return Vectorized(on_path, (True, False, False), native, of_what, again=True)


_Symbol = TypeVar("_Symbol", ca.SX, ca.MX)


@dataclass(frozen=True, eq=False)
class ExactEvaluation:
    """Results of exact inversions at instants of paths.

    Attributes
    ----------
    resolved : ResolvedSystem
        The inverted system.
    read : casadi.Function
        (unknowns of the derivative array, gamma (m, order + 1), p) -> results.
    whole : bool
        Whether unknowns, counts and residual of the inversion precede the results.
    by_expression : PathFunction
        (gamma, p) -> all results, NaN where the guess of the model is not exact. By Newton's method if the inversion is
        not a single expression.
    is_expression : bool
        Whether the inversion is a single expression.
    """

    resolved: ResolvedSystem
    read: ca.Function
    whole: bool
    by_expression: PathFunction
    is_expression: bool

    @property
    def by_newton(self) -> ca.Function:
        """Return (gamma, p) -> the results by Newton's method.

        It is compiled at its first use, since its compilation takes longest.
        """
        return _by_newton(self.resolved, self.read, self.whole)

    def __call__(self, problem: Problem, t: Array) -> list[Array]:
        """Return the results at instants (N,), shape (rows, N) each; NaN where they are not solved."""
        return self.completed(problem, t, self.by_expression(problem, t))

    def completed(self, problem: Problem, t: Array, results: list[Array]) -> list[Array]:
        """Return results of `by_expression` with Newton's method in the place of NaN."""
        left = self._left(results)
        if len(left):
            for result, solved in zip(results, along_path(problem, self.by_newton, t[left]), strict=True):
                result[:, left] = solved
        return results

    def of_cases(self, references: Sequence[Reference], t: Array, p: Array) -> list[Array]:
        """Return the results of cases, shape (cases, rows, N) each; see `PathFunction.of_cases`."""
        results = self.by_expression.of_cases(references, t, p)
        for case in range(len(results[0])) if not np.isfinite(results[0]).all() else ():
            left = self._left([result[case] for result in results])
            if len(left):
                jets = references[case % len(references)].jet(t[left], self.by_expression.order)
                solved = at_instants(self.by_newton, jets=jets, p=p[case % len(p)] if p.ndim == 2 else p)
                for result, values in zip(results, solved, strict=True):
                    result[case][:, left] = values
        return results

    def _left(self, results: Sequence[Array]) -> Sequence[int]:
        """Return the indices of the instants that need Newton's method."""
        if not self.is_expression:
            return ()
        good = results[2] < LARGEST_RESIDUAL if self.whole else np.isfinite(results[0])
        left: list[int] = [] if good.all() else np.flatnonzero(~good.all(axis=0)).tolist()
        return left


@made_once
def exact_evaluation(
    resolved: ResolvedSystem, read: ca.Function, native: bool | None = None, whole: bool = False
) -> ExactEvaluation:
    """Compile the evaluation of results of exact inversions.

    Parameters
    ----------
    resolved : ResolvedSystem
        Without internal dynamics.
    read, whole
        See `ExactEvaluation`; `read` is one of expressions.
    native : bool or None
        See `JustInTime`.

    Raises
    ------
    InvalidSetting
        If there is no C compiler for `native`.
    """
    expression = inversion(resolved.array).expression
    if expression is not None:
        function = _composed("sc_by_expression", expression, read, whole, ca.SX)
    else:
        function = _by_newton(resolved, read, whole)
        if native:
            from servocore.numerics.machine_code import compiled  # noqa: PLC0415 - few compile

            function = compiled(function, resolved.system.name)
    path_function = PathFunction(function, native, resolved.system.name)
    return ExactEvaluation(resolved, read, whole, path_function, expression is not None)


def along_path(problem: Problem, function: ca.Function, t: Array, *columns: Array) -> tuple[Array, ...]:
    """Return the results (rows, N) of a function of (*columns, gamma, p) at instants (N,), with columns (size, N)."""
    outputs, orders = function.size_in(len(columns))
    jets = problem.reference.jet(t, orders - 1) if _reads_path(function) else np.zeros((len(t), orders, outputs))
    return at_instants(function, *columns, jets=jets, p=problem.p)


@made_once
def _reads_path(function: ca.Function) -> bool:
    """Whether results of a function of (..., gamma, p) depend on gamma, which costs more than most functions.

    Solutions and functions that call others do; the pattern of their Jacobians takes longer than their compilation.
    """
    if function.n_in() == 2 or not function.is_a("SXFunction"):
        return True
    symbols = function.sx_in()
    return bool(ca.depends_on(ca.veccat(*function.call(symbols)), symbols[-2]))


def exact_unknowns(problem: Problem, t: Array) -> tuple[Array, bool]:
    """Return the unknowns of the derivative array (size, N) at instants, NaN where they are not found.

    The second value is whether they follow from the expression, without Newton's method.
    """
    inverse = inversion(problem.array)
    if inverse.expression is not None:
        states, _, residual = along_path(problem, inverse.expression, t)
        if (residual < LARGEST_RESIDUAL).all():
            return states, True
    states, _, residual = along_path(problem, inverse.function, t)  # compiled on use
    return np.where(np.isfinite(residual), states, np.nan), False


def unknowns_from(problem: Problem, t: Array, guess: Array) -> Array:
    """Return the unknowns of the derivative array (size, N) at instants by Newton's method from guesses (size, N)."""
    jets, count = side_by_side(problem.reference.jet(t, problem.array.reference_order)), len(t)
    search = mapped(inversion(problem.array).search, count)
    return search(jets, repeated(problem.p, count), guess)[0].reshape(-1, count, order="F")


def guessed_unknowns(problem: Problem, t: Array) -> Array:
    """Return the guess of the unknowns of the derivative array (size, N) at instants."""
    return along_path(problem, inversion(problem.array).guess, t)[0].copy()


def unknowns_near(problem: Problem, solution: Solution, t: Array) -> Array:
    """Return unknowns of the derivative array (size, N) at times by Newton's method from a solution near them.

    It starts from a spline through the coordinates, and from the guess of the model for the others.
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - kept out of the run time of an FMU

    array, degree, guess = problem.array, min(_SPLINE, len(solution.t) - 1), guessed_unknowns(problem, t)
    for k, (j, order) in enumerate(array.unknowns):
        if j < len(problem.system.coordinates) and order <= degree:
            curve = make_interp_spline(solution.t, solution[array.names[j].removeprefix("q.")], k=degree)
            guess[k] = curve.derivative(order)(t)
    return unknowns_from(problem, t, guess)


@made_once
def _by_newton(resolved: ResolvedSystem, read: ca.Function, whole: bool) -> ca.Function:
    return _composed("sc_by_newton", inversion(resolved.array).search_from_guess, read, whole, ca.MX)


def _composed(name: str, inverted: ca.Function, read: ca.Function, whole: bool, kind: type[_Symbol]) -> ca.Function:
    """Return (gamma, p) -> results read from an inversion, preceded by its own results if `whole`."""
    gamma, p = kind.sym("gamma", *read.size_in(1)), kind.sym("p", read.numel_in(2))
    found = inverted.call([gamma[:, : inverted.size2_in(0)], p])
    results = read.call([found[0], gamma, p])
    return ca.Function(name, [gamma, p], found + results if whole else results, {"cse": kind is ca.SX})
