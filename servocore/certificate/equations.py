"""The equations of a flat problem, prepared for proofs: residual, Jacobian, its blocks, and answers at instants.

The unknowns are those of the derivative array. For rates of inputs the array is differentiated once more: the same
structure with all offsets one higher.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import Arithmetic, Model
from servocore.certificate.walk import Walk, walk_of
from servocore.numerics.compiled_calls import Array, mapped, side_by_side
from servocore.numerics.expressions import highest_derivative, time_derivative
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.structure.derivative_array import DerivativeArray, nominal
from servocore.structure.inversion import inversion

Places = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Equations:
    """A derivative array for proofs.

    Attributes
    ----------
    array : DerivativeArray
        Differentiated once more for rates.
    symbols : casadi.SX
        Unknowns, path with its derivatives, parameters: the arguments of the walks.
    residual, jacobian : Walk
        Of the equations, and of the entries of their Jacobian.
    pattern : casadi.Sparsity
        Of the Jacobian.
    curved : ndarray of bool
        Unknowns that the Jacobian depends on.
    """

    array: DerivativeArray
    symbols: ca.SX
    residual: Walk
    jacobian: Walk
    pattern: ca.Sparsity
    curved: npt.NDArray[np.bool_]

    @property
    def path_order(self) -> int:
        """Highest derivative of the path that enters."""
        return self.array.reference_order

    @cached_property
    def motion(self) -> list[int]:
        """Unknowns that are coordinates and velocities: they cannot jump."""
        n = len(self.array.system.coordinates)
        return [k for k, (j, order) in enumerate(self.array.unknowns) if j < n and order < 2]

    @cached_property
    def inputs(self) -> list[int]:
        """Places of the inputs among the unknowns."""
        first = len(self.array.names) - len(self.array.system.inputs)
        return self.array.places((j, 0) for j in range(first, len(self.array.names)))

    def walk(self, expressions: Iterable[ca.SX], rates: bool = False) -> Walk:
        """Return expressions of q, v, lam, u, gamma and p, or their rates, as a walk of the same arguments."""
        system, y = self.array.system, self.array.y
        n = len(system.coordinates)
        old, new = ca.vertcat(system.q, system.v, system.lam, system.u), ca.vertcat(y[:n, 0], y[:n, 1], y[n:, 0])
        (values,) = ca.substitute([ca.vertcat(ca.SX(0, 1), *expressions)], [old], [new])
        return walk_of(time_derivative(values, y, system.gamma) if rates else values, self.symbols)


@made_once
def equations_of(resolved: ResolvedSystem, raised: bool) -> Equations:
    """Prepare the equations of a system; `raised` with the rates."""
    array = _raised(resolved.array) if raised else resolved.array
    x, gamma = array.column(array.unknowns), ca.vec(array.system.gamma[:, : array.reference_order + 1])
    symbols, J = ca.vertcat(x, gamma, array.system.p), ca.jacobian(array.residual, x)
    curved = np.zeros(x.numel(), dtype=bool)
    curved[np.array(ca.jacobian_sparsity(J.nz[:], x).get_col(), dtype=np.intp)] = True
    return Equations(array, symbols, walk_of(array.residual, symbols), walk_of(J.nz[:], symbols), J.sparsity(), curved)


@made_once
def _raised(array: DerivativeArray) -> DerivativeArray:
    """Differentiate a derivative array once more."""
    system, c, d = array.system, array.signature.equation_offsets, array.signature.variable_offsets
    y = array.y
    if max(d) + 1 >= y.size2():
        last = [ca.SX.sym(f"{name}{chr(39) * y.size2()}") for name in array.names]
        y = ca.horzcat(y, ca.vertcat(*last))
    highest = [array.rows.index((i, order)) for i, order in enumerate(c)]
    new = time_derivative(array.residual[highest], y, system.gamma)
    if system.time.numel():
        later = system.gamma[-1, 2:]
        new = ca.substitute(new, later, ca.SX.zeros(later.shape))
    residual = ca.vertcat(array.residual, new)
    return replace(
        array, y=y, residual=residual, unknowns=tuple((j, k) for j in range(len(d)) for k in range(d[j] + 2)),
        rows=(*array.rows, *((i, order + 1) for i, order in enumerate(c))),
        reference_order=highest_derivative(residual, system.gamma),
    )  # fmt: skip


# Answers at instants --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Answers:
    """Unknowns of equations at instants, in plain floating point: centres of the enclosures.

    Attributes
    ----------
    problem : Problem
        With path and parameters.
    equations : Equations
        Perhaps with rates.
    """

    problem: Problem
    equations: Equations

    def from_guess(self, t: Array, p: Array) -> Array:
        """Return the unknowns (size, N) at instants with parameters (n_p, N), from the model's guess; NaN for none."""
        jets = self._jets(t, self.problem.array.reference_order)
        found, _, residual = _at_points(inversion(self.problem.array).function, jets, p)
        return self._completed(np.where(np.isfinite(residual.max(axis=0)), found, np.nan), t, p)

    def from_near(self, t: Array, p: Array, guess: Array) -> Array:
        """Return the same by Newton's method from guesses (size, N)."""
        jets = self._jets(t, self.problem.array.reference_order)
        found, _, residual = _at_points(inversion(self.problem.array).search, jets, p, guess[self._own])
        return self._completed(np.where(np.isfinite(residual.max(axis=0)), found, np.nan), t, p)

    @cached_property
    def _own(self) -> list[int]:
        """Places of the unknowns of the array that is not differentiated once more."""
        return self.equations.array.places(self.problem.array.unknowns)

    @cached_property
    def rates(self) -> npt.NDArray[np.bool_]:
        """Whether an unknown is new in the array that is differentiated once more."""
        new = np.ones(len(self.equations.array.unknowns), dtype=bool)
        new[self._own] = False
        return new

    def _jets(self, t: Array, order: int) -> Array:
        return self.problem.reference.jet(t, order)

    def _completed(self, found: Array, t: Array, p: Array) -> Array:
        """Return unknowns with the rates of the highest derivatives: they enter their equations linearly."""
        if len(self._own) == len(self.equations.array.unknowns):
            return found
        rest, matrix = _at_points(_rate_equations(self.equations), self._jets(t, self.equations.path_order), p, found)
        size = len(rest)
        matrices = matrix.reshape(size, size, -1, order="F")
        rates = np.full((size, len(t)), np.nan)
        good = np.isfinite(found).all(axis=0) & np.isfinite(matrices).all(axis=(0, 1))
        rates[:, good] = _solved(np.moveaxis(matrices[..., good], 2, 0), -rest.T[good]).T
        everything = np.empty((len(self.equations.array.unknowns), len(t)))
        everything[self._own] = found
        everything[self.rates] = rates
        return everything

    @cached_property
    def magnitudes(self) -> Array:
        """Negligible size of each unknown: 1e-6 of its nominal magnitude within the duration of the path."""
        array, duration = self.problem.array, self.problem.reference.duration
        unknowns = self.equations.array.unknowns
        return np.array([1e-6 * nominal(array.system, j) / duration**order for j, order in unknowns])

    def predicted(self, x: Array, before: tuple[Array, float] | None, step: float) -> Array:
        """Return unknowns (size, N) a step of time on: by their derivatives, the highest by those a step before."""
        unknowns = self.equations.array.unknowns
        guess, place = x.copy(), {unknown: k for k, unknown in enumerate(unknowns)}
        for k, (j, order) in enumerate(unknowns):
            factor, higher = step, order + 1
            while (j, higher) in place:
                guess[k] += factor * x[place[j, higher]]
                factor, higher = factor * step / (higher - order + 1), higher + 1
            if higher == order + 1 and before is not None:
                guess[k] += (x[k] - before[0][k]) * step / before[1]
        return guess


def _solved(matrices: Array, right: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrices, right[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        return np.full_like(right, np.nan)


@made_once
def _rate_equations(equations: Equations) -> ca.Function:
    """Compile (gamma, p, unknowns without the new ones) -> the new equations at zero rates, and their matrix."""
    array = equations.array
    d = array.signature.variable_offsets
    new = array.column(tuple((j, order + 1) for j, order in enumerate(d)))
    old = array.column(tuple((j, k) for j, order in enumerate(d) for k in range(order + 1)))
    rows = array.residual[array.residual.numel() - new.numel() :]
    zero = ca.SX.zeros(new.numel())
    gamma = array.system.gamma[:, : array.reference_order + 1]
    rest, matrix = ca.substitute([rows, ca.jacobian(rows, new)], [new], [zero])
    return ca.Function("sc_rates", [gamma, array.system.p, old], [ca.densify(rest), ca.densify(ca.vec(matrix))])


def _at_points(function: ca.Function, jets: Array, p: Array, *columns: Array) -> list[Array]:
    """Evaluate a function of (gamma, p, *columns) at N points, filled up to a power of two: few maps are compiled."""
    count = len(jets)
    full = 1 << (count - 1).bit_length()
    padded = [np.concatenate([each, np.repeat(each[:, -1:], full - count, axis=1)], axis=1) for each in (p, *columns)]
    jets = np.concatenate([jets, np.repeat(jets[-1:], full - count, axis=0)])
    results = mapped(function, full)(side_by_side(jets), *padded)
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
