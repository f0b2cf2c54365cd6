"""Functions of a path and of parameters at many instants: with the path as part of the machine code where it can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array
from servocore.numerics.generated_code import MANY
from servocore.numerics.vectorized import Vectorized
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import Reference
from servocore.references.formula import Formula

_SECOND = 2  # call from which on machine code is worth a look
_FEW = 400  # instants: for so many the interpreter evaluates the path in less time than NumPy


@dataclass(frozen=True, eq=False)
class PathFunction:
    """A compiled function (gamma (m, order + 1), p) -> results, at instants of a path.

    Attributes
    ----------
    resolved : ResolvedSystem
        Whose function it is.
    function : casadi.Function
        With dense results; one of expressions can become machine code.
    native : bool or None
        See `GeneratedCode`.
    """

    resolved: ResolvedSystem
    function: ca.Function
    native: bool | None = None
    _last: list[tuple[Reference, Vectorized, Array]] = field(default_factory=list, repr=False)
    """The path that machine code was last called with, at most one: to choose again takes longer than to evaluate."""

    @property
    def order(self) -> int:
        """The derivatives of the path that it takes."""
        return int(self.function.size2_in(0)) - 1

    def prepare(self, reference: Reference) -> None:
        """Compile now what is wanted as machine code.

        Raises
        ------
        InvalidSetting
            If there is no C compiler.
        """
        if self.native:
            self._on_path(reference, MANY)

    def __call__(self, problem: Problem, t: Array) -> list[Array]:
        """Return the results at the instants `t` (N,), shape (rows, N) each."""
        reference = problem.reference
        finite = bool(np.isfinite(t).all())  # other times go the other way, where the path refuses them by name
        for path, machine_code, numbers in self._last:
            if finite and path is reference:
                return machine_code(t[None], numbers, problem.p)
        chosen, formula = self._on_path(reference, len(t), called=True)
        if formula is not None and finite:
            numbers = np.array(formula.numbers(self.order))
            if chosen.ready(len(t), called=True):
                self._last[:] = [(reference, chosen, numbers)]
                return chosen(t[None], numbers, problem.p)
            if len(t) <= _FEW:
                return chosen.interpreted(t[None], numbers, problem.p)
        return self.at_jets(reference.jet(t, self.order), problem.p, reference.formula is None)

    def of_cases(self, references: Sequence[Reference], t: Array, p: Array) -> list[Array]:
        """Return the results of cases, shape (cases, rows, N) each.

        There is one path a case, or one for all; `p` has shape (cases, size), or (size,) for all.
        """
        formulas = [reference.formula for reference in references]
        p = p if p.ndim == 2 or len(references) > 1 else p[None]
        count = len(t) * max(len(references), len(p) if p.ndim == 2 else 1)
        chosen, formula = self._on_path(references[0], count, called=True)
        if formula is not None and all(other == formula for other in formulas) and chosen.ready(count, called=True):
            numbers = [formula.numbers(self.order) for formula in formulas if formula is not None]
            return chosen(t[None], np.array(numbers if len(numbers) > 1 else numbers[0]), p)
        jets = np.stack([reference.jet(t, self.order).reshape(len(t), -1).T for reference in references])
        of_jets = self.resolved.once(_of_jets, self)
        return of_jets(np.ascontiguousarray(jets if len(references) > 1 else jets[0]), p)

    def ready(self, problem: Problem, count: int) -> bool:
        """Whether machine code is there for so many instants."""
        return self._on_path(problem.reference, count)[0].ready(count)

    def at_jets(self, jets: Array, p: Array, compiled: bool = True) -> list[Array]:
        """Return the same for reference jets (N, order + 1, m), by machine code if there is such for jets."""
        of_jets = self.resolved.once(_of_jets, self)
        return (of_jets if compiled else of_jets.interpreted)(jets.reshape(len(jets), -1).T, p)

    def _on_path(self, reference: Reference, count: int, called: bool = False) -> tuple[Vectorized, Formula | None]:
        """Return what evaluates on a path, with the path inside if that is a formula.

        That pays from the second call on.
        """
        formula, calls = reference.formula, self.resolved.once(_calls, self)
        calls[0] += called
        # To put a path inside means to write and to compile a function: a single call is over before.
        once = not self.native and calls[0] < _SECOND and count < MANY
        many = self.native is False and count > _FEW
        if once or many or formula is None or not self.function.is_a("SXFunction"):
            return self.resolved.once(_of_jets, self), None
        return self.resolved.once(_of_time, self, formula), formula


def _calls(_: ResolvedSystem, __: PathFunction) -> list[int]:
    return [0]


def _of_jets(resolved: ResolvedSystem, of: PathFunction) -> Vectorized:
    return Vectorized(of.function, (True, False), of.native, resolved.system.name)


def _of_time(resolved: ResolvedSystem, of: PathFunction, formula: Formula) -> Vectorized:
    return Vectorized(
        with_path_inside(of.function, formula), (True, False, False), of.native, resolved.system.name, again=True
    )


def with_path_inside(function: ca.Function, formula: Formula) -> ca.Function:
    """Return (t, numbers of the path, p) -> the results of a function of expressions (gamma, p) on that path."""
    jet, p = jet_of(formula, function.size2_in(0) - 1), ca.SX.sym("p", function.numel_in(1))
    t, numbers = ca.SX.sym("t"), ca.SX.sym("numbers", jet.numel_in(1))
    return ca.Function("sc_on_path", [t, numbers, p], function.call([jet(t, numbers), p]), {"cse": True})


def jet_of(formula: Formula, order: int) -> ca.Function:
    """Return (t, numbers of the path) -> gamma (m, order + 1)."""
    t, numbers = ca.SX.sym("t"), ca.SX.sym("numbers", len(formula.numbers(order)))
    gamma = ca.horzcat(*formula.jet(t, ca.vertsplit(numbers), order))
    return ca.Function("sc_jet", [t, numbers], [ca.densify(gamma)])
