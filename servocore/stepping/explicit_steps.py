"""Compiled explicit Runge-Kutta steps of internal dynamics whose rates need no iterations.

The states of the internal dynamics are stepped with the path's jets at the nodes of every step, and inputs follow from
the states and the path at the same instant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.numerics.stepped_runs import Instants, Run, SteppedRuns
from servocore.problem import ResolvedSystem
from servocore.references.base import Formula, Reference
from servocore.stepping.observation import observed
from servocore.stepping.readings import reading
from servocore.structure.inversion import compile_explicit


@dataclass(frozen=True, eq=False)
class ExplicitSteps:
    """Steps and readings of a system on paths of one kind.

    Attributes
    ----------
    runs : SteppedRuns
        Of (states, path at the nodes, numbers, [h; p]) -> (states after a step, rates before it), read by
        (states, path, numbers, p) -> inputs, quantities that must be positive, further quantities.
    order : int
        Highest derivative of the path in the equations.
    formula : Formula or None
        The path as a formula; times and numbers then replace jets.
    nodes : ndarray
        Nodes of the method.
    """

    runs: SteppedRuns
    order: int
    formula: Formula | None
    nodes: Array

    def run(self, references: Sequence[Reference], count: int, p: Array, start: Array) -> Run:
        """Prepare steps from start to end of a path, or of paths of one kind with the same start and end.

        `start` has shape (states,), `p` (size,); with cases, (cases, states) and (cases, size).
        """
        reference = references[0]
        h = reference.duration / count
        times: Array = reference.start_time + h * np.arange(count + 1.0)
        settings = np.concatenate([np.full((*p.shape[:-1], 1), h), p], axis=-1)
        if self.formula is not None:
            formulas = (path.formula for path in references)
            numbers = np.array([formula.numbers(self.order) for formula in formulas if formula is not None])
            path = times[None]
        else:
            nodes = (times[:, None] + h * self.nodes).ravel()
            numbers, path = np.zeros((len(references), 1)), _of_all(references, nodes, self.order, count + 1)
        if len(references) == 1:
            numbers = numbers[0]
        return Run(reference.start_time, reference.end_time, count, path, numbers, settings, start)

    def instants(self, references: Sequence[Reference], t: Array) -> Instants:
        """Prepare instants (N,) of a path, or of several."""
        return Instants(t, t[None] if self.formula is not None else _of_all(references, t, self.order, len(t)))


def _of_all(references: Sequence[Reference], t: Array, order: int, count: int) -> Array:
    """Return the jets of paths, one column per step or instant: (rows, count), or (cases, rows, count) if many."""
    jets = [reference.jet(t, order) for reference in references]
    tables = [jet.reshape(count, jet.size // max(count, 1)).T for jet in jets]
    return np.stack(tables) if len(tables) > 1 else np.ascontiguousarray(tables[0])


@made_once
def compile_explicit_steps(
    resolved: ResolvedSystem, formula: Formula | None, native: bool | None, names: tuple[str, ...] = ()
) -> ExplicitSteps:
    """Compile steps, inputs and named quantities by the method of Dormand and Prince of order eight.

    Raises
    ------
    InvalidModel
        If the rates of the states need iterations.
    """
    from scipy.integrate import DOP853  # noqa: PLC0415 - the library is imported where SciPy is not

    explicit, array, system = compile_explicit(resolved.array), resolved.array, resolved.system
    if explicit is None:
        raise InvalidModel(f"{system.name}: the rates of its internal dynamics take iterations; sc.solve steps them")
    order, count = array.reference_order, len(array.states)
    x, hp = ca.SX.sym("x", count), ca.SX.sym("hp", 1 + system.p.numel())
    p, time, numbers = hp[1:], ca.SX.sym("t"), ca.SX.sym("n", len(formula.numbers(order)) if formula else 1)
    size = system.gamma.size1()
    stages = range(len(DOP853.C))
    tables = [ca.SX.sym("gamma", size, order + 1) for _ in stages]

    def jet(k: int) -> ca.SX:
        if formula is None:
            return tables[k]
        return ca.horzcat(*formula.jet(time + float(DOP853.C[k]) * hp[0], ca.vertsplit(numbers), order))

    rates, highest = list[ca.SX](), array.places((j, degree + 1) for j, degree in array.states)
    for k in stages:
        inner = sum((float(a) * rate for a, rate in zip(DOP853.A[k], rates, strict=False) if a), ca.SX.zeros(count))
        rates.append(explicit(jet(k), p, x + hp[0] * inner)[highest])
    after = x + hp[0] * sum((float(b) * rate for b, rate in zip(DOP853.B, rates, strict=True)), ca.SX.zeros(count))
    path = time if formula else ca.vertcat(*map(ca.vec, tables))
    step = ca.Function("sc_explicit_step", [x, path, numbers, hp], [after, rates[0]], {"cse": True})
    q = ca.SX.sym("p", system.p.numel())
    now = jet(0)  # the first node is the beginning of a step
    known = {quantity.name: expression for quantity, expression in observed(system)}
    wanted = [system.u, *(each for _, each in resolved.must_be_positive), *(known[name] for name in names)]
    results = reading(resolved, wanted)(explicit(now, q, x), now, q)
    read = ca.Function(
        "sc_inputs", [x, time if formula else ca.vec(now), numbers, q], [ca.densify(results)], {"cse": True}
    )
    signs = range(system.u.numel(), system.u.numel() + len(resolved.must_be_positive))
    runs = SteppedRuns(step, read, signs, native, system.name)
    return ExplicitSteps(runs, order, formula, DOP853.C)
