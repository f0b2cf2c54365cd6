"""The equations of a flat problem, prepared for proofs: residual, Jacobian, its blocks, and answers at instants.

The unknowns are those of the derivative array. For rates of inputs the array is differentiated once more: the same
structure with all offsets one higher.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import Arithmetic, Model
from servocore.certificate.walk import CONSTANT, Walk, lowered, walk_of
from servocore.numerics.compiled_calls import Array, mapped, side_by_side
from servocore.numerics.expressions import time_derivative
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
        Unknowns, path with its derivatives, parameters, and states of the internal dynamics: arguments of the walks.
    steps : Walk
        Of operations that are constant between jumps.
    residual, jacobian : Walk
        Of the equations, and of the entries of their Jacobian; arguments are the symbols and the steps.
    pattern : casadi.Sparsity
        Of the Jacobian.
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
    pattern: ca.Sparsity
    curved: npt.NDArray[np.bool_]
    motion: list[int]
    switching: list[int]

    @property
    def path_order(self) -> int:
        """Highest derivative of the path that enters."""
        return self.array.reference_order

    @cached_property
    def inputs(self) -> list[int]:
        """Places of the inputs among the unknowns."""
        first = len(self.array.names) - len(self.array.system.inputs)
        return [self.array.determined.index((j, 0)) for j in range(first, len(self.array.names))]

    def walk(self, quantities: Iterable[tuple[ca.SX, bool]]) -> Walk:
        """Return expressions of q, v, lam, u, gamma and p, of some the rates, as a walk of the same arguments."""
        system, y = self.array.system, self.array.y
        n = len(system.coordinates)
        old, new = ca.vertcat(system.q, system.v, system.lam, system.u), ca.vertcat(y[:n, 0], y[:n, 1], y[n:, 0])
        expressions, rates = zip(*quantities, strict=True)
        values = ca.substitute(list(expressions), [old], [new])
        wanted = (time_derivative(e, y, system.gamma) if rate else e for e, rate in zip(values, rates, strict=True))
        return walk_of(ca.vertcat(*wanted), self.symbols)


@made_once
def equations_of(resolved: ResolvedSystem, raised: bool) -> Equations:
    """Prepare the equations of a system; `raised` with the rates."""
    array = differentiated_once_more(resolved.array) if raised else resolved.array
    x, gamma = array.column(array.determined), ca.vec(array.system.gamma[:, : array.reference_order + 1])
    residual, names, steps = _without_steps(array.residual)
    symbols, J = ca.vertcat(x, gamma, array.system.p, array.column(array.states)), ca.jacobian(residual, x)
    switching = ca.jacobian_sparsity(steps, x).get_col()
    curved = np.zeros(x.numel(), dtype=bool)
    curved[[*switching, *ca.jacobian_sparsity(J.nz[:], x).get_col()]] = True
    n = len(array.system.coordinates)
    motion = [k for k, (j, order) in enumerate(array.determined) if j < n and order < 2]
    every = ca.vertcat(symbols, names)
    return Equations(
        array, symbols, walk_of(steps, symbols), walk_of(residual, every), walk_of(J.nz[:], every), J.sparsity(),
        curved, motion, switching,
    )  # fmt: skip


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
    full = 1 << (count - 1).bit_length()
    padded = [np.concatenate([each, np.repeat(each[:, -1:], full - count, axis=1)], axis=1) for each in (p, *columns)]
    jets = np.concatenate([jets, np.repeat(jets[-1:], full - count, axis=0)])
    results = mapped(function, full)(side_by_side(jets), *padded)
    results = results if isinstance(results, (list, tuple)) else [results]
    return [each.reshape(-1, full, order="F")[:, :count].copy() for each in results]


def path_models(problem: Problem, ring: Arithmetic, begin: Array, end: Array, order: int) -> Model:
    """Return models of the path and its derivatives on intervals, in the order of the equations' symbols."""
    coefficients, radii = problem.reference.enclosure(begin, end, order, ring.degrees[0])
    count = len(begin)
    c = np.zeros((ring.degrees[0] + 1, len(ring.nodes) // (ring.degrees[0] + 1), radii[0].size, count))
    c[:, 0] = np.moveaxis(coefficients.reshape(count, -1, ring.degrees[0] + 1), 0, 2).swapaxes(0, 1)
    return c.reshape(len(ring.nodes), -1, count), radii.reshape(count, -1).T.copy()


def parameter_models(ring: Arithmetic, p: Array, boxed: dict[int, tuple[float, float]], count: int) -> Model:
    """Return models of the parameters: numbers, and intervals in the order of the arithmetic's variables."""
    c, r = ring.constant(np.tile(p[:, None], count))
    shaped = c.reshape(*(d + 1 for d in ring.degrees), *c.shape[1:])
    for axis, (k, (low, high)) in enumerate(boxed.items(), 1):
        shaped[(*(0 for _ in ring.degrees), k)] = (low + high) / 2.0
        shaped[(*(int(axis == each) for each in range(len(ring.degrees))), k)] = (high - low) / 2.0
        r[k] = 4e-16 * max(abs(low), abs(high))
    return c, r
