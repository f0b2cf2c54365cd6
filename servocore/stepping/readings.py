"""Quantities of a system, and their rates, as functions of the unknowns of its derivative array."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.model.limits import Expression, Limit
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import highest_derivative, time_derivative
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.exact_evaluation import ExactEvaluation, along_path, exact_evaluation
from servocore.stepping.observation import observed
from servocore.structure.derivative_array import DerivativeArray, in_variables


def reading(resolved: ResolvedSystem, expressions: Sequence[ca.SX]) -> ca.Function:
    """Compile (unknowns of the derivative array, gamma (m, reference_order + 1), p) -> expressions of the system."""
    array = resolved.array
    values = in_variables(resolved.system, ca.vertcat(*expressions), array.y)
    return _compiled(array, array.y, values, [], array.reference_order)


@made_once
def exact_quantities(resolved: ResolvedSystem, names: tuple[str, ...], native: bool | None) -> ExactEvaluation:
    """Compile the evaluation of named quantities by exact inversion.

    Names are those that `solve` reports, and those of `ResolvedSystem.must_be_positive`.
    """
    known = {quantity.name: each for quantity, each in (*observed(resolved.system), *resolved.must_be_positive)}
    return exact_evaluation(resolved, reading(resolved, [known[name] for name in names]), native)


@dataclass(frozen=True, eq=False)
class Watched:
    """The quantities of limits, as one function of an exact inversion.

    Attributes
    ----------
    function : casadi.Function
        (unknowns of the derivative array, gamma (m, order + 1), p) -> values (limits,).
    order : int
        Of the path's derivatives in gamma.
    needs : tuple of int
        Highest derivative of the path that each value depends on.
    """

    function: ca.Function
    order: int
    needs: tuple[int, ...]

    def values(self, problem: Problem, t: Array, states: Array) -> Array:
        """Return the values (limits, N) at instants (N,) where the unknowns of the derivative array are (size, N)."""
        return along_path(problem, self.function, t, states)[0]


@made_once
def compile_watched(resolved: ResolvedSystem, wanted: tuple[tuple[Expression, bool], ...]) -> Watched:
    """Compile expressions, and rates of those marked, for an exact inversion.

    The rate of the highest derivative in the array follows from the array differentiated once more, which is
    linear in it.
    """
    array, system = resolved.array, resolved.system
    limits = [(Limit("", "", -np.inf, "", expression), rate) for expression, rate in wanted]
    values, y = with_rates(array, [(each.on(system), rate) for each, rate in limits])
    rows = array.y.size1()
    needs, used = [], set[tuple[int, int]]()
    top = dict(array.unknowns)  # the highest of each comes last
    for value in values:
        entries = {(c % rows, c // rows) for c in ca.jacobian_sparsity(value, ca.vec(y)).get_col()}
        orders = [array.reference_order - (top[j] - k) for j, k in entries]
        needs.append(max([*orders, highest_derivative(value, system.gamma)]))
        used |= entries
    beyond = sorted(each for each in used if each not in array.unknowns)
    if any(k > top[j] + 1 for j, k in beyond):
        raise InvalidModel(f"{system.name}: a limit is on the rate of something that is differentiated already")
    order = max([*needs, array.reference_order + bool(beyond)])
    return Watched(_compiled(array, y, ca.vertcat(*values), beyond, order), order, tuple(needs))


def with_rates(array: DerivativeArray, expressions: Sequence[tuple[ca.SX, bool]]) -> tuple[list[ca.SX], ca.SX]:
    """Return expressions of a system, and rates of those marked, by the symbols y of a derivative array, and these.

    y has one column more than the array: the derivatives of one order more are there.
    """
    y = ca.horzcat(array.y, ca.SX.sym("next", array.y.size1()))
    known = [(in_variables(array.system, each, y), rate) for each, rate in expressions]
    return [time_derivative(each, y, array.system.gamma) if rate else each for each, rate in known], y


def next_derivatives(array: DerivativeArray, y: ca.SX, gamma: ca.SX) -> tuple[ca.SX, ca.SX, ca.Function]:
    """Differentiate a derivative array; `y` are its symbols and those that follow, gamma goes as far as the result.

    Returns
    -------
    unknowns : casadi.SX, shape (variables,)
        The derivative of every variable that follows its last in the array.
    rows : casadi.SX, shape (variables,)
        Equations that hold them, linear in them: the last ones of the array, differentiated. Derivatives of others are
        in the array already.
    function : casadi.Function
        (unknowns of the array, gamma, p) -> the new ones.
    """
    column, p = array.column(array.unknowns), array.system.p
    unknowns = ca.vertcat(*[y[j, k + 1] for j, k in dict(array.unknowns).items()])  # of each the highest comes last
    last = {i: row for row, (i, _) in enumerate(array.rows)}
    rows = time_derivative(array.residual[list(last.values())], y, array.system.gamma)
    linear = [ca.jacobian(rows, unknowns), -ca.substitute(rows, unknowns, ca.SX.zeros(unknowns.shape))]
    matrix = ca.Function("sc_next", [column, gamma, p], linear, {"cse": True})
    given = [ca.MX.sym("given", *each.shape) for each in (column, gamma, p)]
    J, right = matrix(*given)
    return unknowns, rows, ca.Function("sc_next", given, [ca.solve(J, right, "qr")])


def _compiled(
    array: DerivativeArray, y: ca.SX, values: ca.SX, beyond: list[tuple[int, int]], order: int
) -> ca.Function:
    """Compile (unknowns, gamma, p) -> expressions of the symbols `y`, of which `beyond` are not in the array."""
    system, column = array.system, array.column(array.unknowns)
    gamma = system.gamma[:, : order + 1]
    further = ca.vertcat(ca.SX(0, 1), *[y[j, k] for j, k in beyond])
    arguments = [column, further, gamma, system.p]
    if foreign := ca.Function("sc_probe", arguments, [values], {"allow_free": True}).get_free():
        raise InvalidModel(f"{system.name}: a limit holds symbols that are none of this model: {foreign}")
    if not beyond:
        return ca.Function("sc_reading", [column, gamma, system.p], [ca.densify(values)], {"cse": True})
    read = ca.Function("sc_read", arguments, [ca.densify(values)], {"cse": True})
    state, G, p = (ca.MX.sym("x", *each.shape) for each in (column, gamma, system.p))
    *_, following = next_derivatives(array, y, gamma)
    known = following(state, G, p)[[j for j, _ in beyond]]
    return ca.Function("sc_watched", [state, G, p], [read(state, known, G, p)])
