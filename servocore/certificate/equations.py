"""The equations of a flat problem, prepared for proofs: residual, Jacobian, its blocks, and answers at instants.

The unknowns are those of the derivative array. For rates of inputs the array is differentiated once more: the same
structure with all offsets one higher.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import Arithmetic, Model
from servocore.certificate.walk import CONSTANT, Walk, lowered, walk_of
from servocore.numerics.compiled_calls import Array, mapped, side_by_side
from servocore.numerics.just_in_time import JustInTime, in_machine_code
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import KINKS, computed, holds_any, rebuilt
from servocore.problem import Problem, ResolvedSystem
from servocore.structure.derivative_array import DerivativeArray, differentiated_once_more
from servocore.structure.inversion import Inversion, inversion

Places = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Equations:
    """A derivative array for proofs.

    Operations that are constant between jumps, such as signs, are arguments of residual and Jacobian: where a value is
    not known, all of them are tried.

    Attributes
    ----------
    array : DerivativeArray
        Differentiated once more for rates.
    symbols : casadi.SX
        Unknowns, path with its derivatives, parameters, time, states of the internal dynamics: arguments of the walks.
    steps : Walk
        Of operations that are constant between jumps.
    residual, jacobian : Walk
        Of the equations, and of the entries of their Jacobian; arguments are the symbols and the steps.
    transposed : casadi.Sparsity
        Of the transposed Jacobian: CasADi counts entries by columns.
    curved : ndarray of bool
        Unknowns that the Jacobian or the steps depend on.
    motion, switching : list of int
        Unknowns that are coordinates and velocities: they cannot jump; and those that the steps depend on.
    """

    array: DerivativeArray
    symbols: ca.SX
    steps: Walk
    residual: Walk
    jacobian: Walk
    transposed: ca.Sparsity
    curved: npt.NDArray[np.bool_]
    motion: list[int]
    switching: list[int]

    @cached_property
    def inputs(self) -> list[int]:
        """Places of the inputs among the unknowns."""
        first = len(self.array.names) - len(self.array.system.inputs)
        return [self.array.determined.index((j, 0)) for j in range(first, len(self.array.names))]


@made_once
def equations_of(resolved: ResolvedSystem, raised: bool) -> Equations:
    """Prepare the equations of a system; `raised` with the rates."""
    array = differentiated_once_more(resolved.array) if raised else resolved.array
    x, gamma = array.column(array.determined), ca.vec(array.system.gamma[:, : array.reference_order + 1])
    residual, names, steps = _without_steps(array.residual)
    symbols = ca.vertcat(x, gamma, array.system.p, ca.SX.sym("t"), array.column(array.states))
    every, J = ca.vertcat(symbols, names), ca.jacobian(residual, x).T
    switching = ca.jacobian_sparsity(steps, x).get_col()
    curved = np.zeros(x.numel(), dtype=bool)
    curved[[*switching, *ca.jacobian_sparsity(J.nz[:], x).get_col()]] = True
    n = len(array.system.coordinates)
    motion = [k for k, (j, order) in enumerate(array.determined) if j < n and order < 2]
    walks = walk_of(steps, symbols), walk_of(residual, every), walk_of(J.nz[:], every)
    return Equations(array, symbols, *walks, J.sparsity(), curved, motion, switching)


def _without_steps(expression: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return an expression of names for operations that are constant between jumps, these names, and the operations."""
    names, steps, compared = ca.SX(0, 1), ca.SX(0, 1), dict[int, tuple[int, ...]]()

    def named(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
        nonlocal names, steps
        # Kinks are written by signs, which have a derivative that is bounded where they switch.
        result = (lowered if operation in {ca.OP_FMAX, ca.OP_FMIN} else computed)(operation, taken)
        if operation == ca.OP_DIV and _is_share(taken[0], taken[1], compared):
            return taken[0]
        if operation not in CONSTANT:
            return result
        name = ca.SX.sym("s")
        if operation == ca.OP_LE:
            compared[name.element_hash()] = tuple(each.element_hash() for each in taken)
        names, steps = ca.vertcat(names, name), ca.vertcat(steps, *ca.substitute([result], [names], [steps]))
        return name

    if holds_any(expression, KINKS):
        expression = rebuilt(ca.cse(expression), named)
    return expression, names, steps


def _is_share(a: ca.SX, b: ca.SX, compared: Mapping[int, tuple[int, ...]]) -> bool:
    """Whether a/b is s/(s + z) with s = (y <= x), z = (x <= y), as in derivatives of fmax(x, y): s but where x = y."""
    parts = {each.element_hash(): each for each in ca.symvar(b)}
    if len(parts) != 2 or a.element_hash() not in parts or not parts.keys() <= compared.keys():
        return False
    (s, z), (first, second) = parts.values(), (compared[each] for each in parts)
    return first == second[::-1] and ca.is_equal(b, s + z, 1)


# Answers at instants --------------------------------------------------------------------------------------------------


def answers(problem: Problem, array: DerivativeArray, t: Array, p: Array, guess: Array | None = None) -> Array:
    """Return unknowns (size, N) at instants with parameters (n_p, N), in plain floating point; NaN for none.

    They are centres of enclosures, from the guess of the model or by Newton's method from guesses (size, N).
    """
    jets = problem.reference.jet(t, array.reference_order)
    if guess is None:
        inverse = machine_code(array).best(len(t), called=False) or inversion(array)
        found, _, residual = _at_points(inverse.function, jets, p)
    else:
        found, _, residual = _at_points(inversion(array).search, jets, p, guess)
    return np.where(np.isfinite(residual.max(axis=0)), found, np.nan)


def guessed(problem: Problem, array: DerivativeArray, t: Array, p: Array) -> Array:
    """Return the guess of the model (size, N) at instants."""
    (guess,) = _at_points(inversion(array).guess, problem.reference.jet(t, array.reference_order), p)
    return guess


@made_once
def machine_code(array: DerivativeArray) -> JustInTime[Inversion]:
    """Return the inversion in machine code, once it is worth it: each proof counts as one call."""
    return in_machine_code(inversion(array), ("function",), "the exact inversion", None)


def _at_points(function: ca.Function, jets: Array, p: Array, *columns: Array) -> list[Array]:
    """Evaluate a function of (gamma, p, *columns) at N points, filled up to a power of two: few maps are compiled."""
    count = len(jets)
    full = np.minimum(np.arange(1 << (count - 1).bit_length()), count - 1)
    results = mapped(function, len(full))(side_by_side(jets[full]), *(each[:, full] for each in (p, *columns)))
    return [each.reshape(-1, len(full), order="F")[:, :count].copy() for each in results]


def given_models(
    problem: Problem, ring: Arithmetic, begin: Array, end: Array, order: int, boxed: Mapping[int, tuple[float, float]]
) -> Model:
    """Return models of the path and its derivatives, the parameters and the time on intervals, as the walks take them.

    Parameters with an interval are variables of the arithmetic, in their order.
    """
    count, first = len(begin), ring.degrees[0] + 1
    coefficients, radii = problem.reference.enclosure(begin, end, order, first - 1)
    path = np.zeros((len(ring.nodes) + 1, radii[0].size, count))
    path[:-1].reshape(first, -1, radii[0].size, count)[:, 0] = coefficients.reshape(count, -1, first).T
    path[-1] = radii.reshape(count, -1).T
    rest = ring.constant(np.tile([[each] for each in (*problem.p, 0.0)], count))
    for axis, (k, (low, high)) in enumerate([(-1, (begin, end)), *boxed.items()]):
        rest[0, k] = (low + high) / 2.0
        if ring.degrees[axis]:
            rest[np.flatnonzero(ring.orders.sum(axis=0) * (ring.orders[axis] == 1) == 1), k] = (high - low) / 2.0
        rest[-1, k] = 4e-16 * np.maximum(np.abs(low), np.abs(high))
    return np.concatenate([path, rest], axis=1)
