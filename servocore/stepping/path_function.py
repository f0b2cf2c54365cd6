"""Functions of a path and of parameters at many instants, with paths that are formulas compiled in."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array
from servocore.numerics.just_in_time import MANY, Use
from servocore.numerics.memoization import made_once
from servocore.numerics.vectorized import Vectorized
from servocore.problem import Problem
from servocore.references.base import Formula, Reference

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
        if self._native:
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
        return self._on_path(problem.reference, count)[0].ready(count, called=False)

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
    jet, p = jet_of(formula, function.size2_in(0) - 1), ca.SX.sym("p", function.numel_in(1))
    t, numbers = ca.SX.sym("t"), ca.SX.sym("numbers", jet.numel_in(1))
    on_path = ca.Function("sc_on_path", [t, numbers, p], function.call([jet(t, numbers), p]), {"cse": True})
    return Vectorized(on_path, (True, False, False), native, of_what, again=True)


def jet_of(formula: Formula, order: int) -> ca.Function:
    """Return (t, numbers of the path) -> gamma (m, order + 1)."""
    t, numbers = ca.SX.sym("t"), ca.SX.sym("numbers", len(formula.numbers(order)))
    gamma = ca.horzcat(*formula.jet(t, ca.vertsplit(numbers), order))
    return ca.Function("sc_jet", [t, numbers], [ca.densify(gamma)])
