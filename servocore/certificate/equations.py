"""The equations of a flat problem, prepared for proofs, and the interval Newton test of their solution.

The unknowns are those of the derivative array. For rates of inputs the array is differentiated once more: the same
structure with all offsets one higher. The test goes block by block and shows that there is one solution near an
approximation, at every instant of an interval.

E(x, t, p) = 0 with the Jacobian J = dE/dx in block triangular form. About an approximation x_hat, a polynomial, and
within x_hat + D, the test takes approximate inverses Y of the diagonal blocks and, with r the residual of x_hat,

    A >= |I - Y J|,    Z >= |Y r|,    A rho + Z <= rho <= D.

x -> x - Y E(x) then maps x_hat + rho into itself and contracts: rho > 0 and A rho < rho make the spectral radius of A
less than one (Collatz & Wielandt). So there is exactly one solution in x_hat + D, it lies in x_hat + rho,
and J is regular there (Krawczyk, Computing 4 (1969) 187; Rump, Acta Numerica 19 (2010) 287, section 13). Unknowns that
J does not depend on need no D: the solution is unique whatever they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import casadi as ca
import numpy as np

from servocore.certificate.chebyshev import UNIT, UP, Arithmetic, Model, arithmetic, magnitude, model_of, norm
from servocore.certificate.walk import CONSTANT, Walk, lowered
from servocore.errors import InvalidReference
from servocore.numerics.compiled_calls import Array, Mask
from servocore.numerics.components import Part, places_of, triangular_blocks
from servocore.numerics.memoization import made_once
from servocore.numerics.step_operations import KINKS, computed, holds_any, rebuilt
from servocore.problem import Problem, ResolvedSystem
from servocore.structure.derivative_array import DerivativeArray, determining, differentiated_once_more, jacobian

Box: TypeAlias = Mapping[int, tuple[float, float]]
"""Intervals of parameters, by their numbers."""

_ROOM = 1.0 + 1e-2  # radii are larger by that, so that iterations for them end
_ROUNDED = 1.0 + 1e-6  # and so that the test holds with the rounding of its own sums
_LEAST = 1e-17  # of an unknown's magnitude: radii are positive
_ITERATIONS = 60
_SURELY = 0.99  # less than one, with the rounding of a sum
_KNOWN = 0.1  # radius: a step is one at the least, and known but for rounding elsewhere
_COARSE = 3  # degree in time of the Jacobian and of approximate inverses of its blocks


class Equations:
    """A derivative array for proofs, with the block triangular form of its Jacobian.

    Operations that are constant between jumps, such as signs, are arguments of residual and Jacobian: where a value is
    not known, all of them are tried.

    Parameters
    ----------
    resolved : ResolvedSystem
        The system.
    raised : bool
        Whether the array is differentiated once more, for rates.
    varied : bool
        Whether the derivatives of the unknowns by the states are unknowns too, column by column behind the others.
    whole : bool
        Whether all unknowns are in one block: radii of many blocks add up from each to the next.
    of : int, optional
        Number of an unknown, of whose equations alone these are; all when not given.

    Attributes
    ----------
    array : DerivativeArray
        The array.
    answering : DerivativeArray
        The one whose inversion answers.
    answered : list of int
        Places of the unknowns among its own.
    symbols : casadi.SX
        Unknowns, states of the internal dynamics, path with its derivatives, parameters, time: arguments of the walks.
    steps : Walk
        Of operations that are constant between jumps.
    residual, jacobian : Walk
        Of the equations, and of the entries of their Jacobian; arguments are the symbols and the steps.
    flow : Walk
        If varied: of the rates of the states and their derivatives by the states, column by column.
    motion, switching, inputs : list of int
        Unknowns that are coordinates and velocities: they cannot jump; that the steps depend on; and that are inputs.
    steady, curved : ndarray of bool
        Unknowns that may not jump with the equations, of motion or switching; that the Jacobian or the steps depend on.
    free : ndarray of bool
        Unknowns that may differ at joints: rates and derivatives by the states may jump, others are unique wherever
        they are.
    blocks : tuple of Part
        The diagonal blocks of the Jacobian in that form, each behind those that it depends on.
    sizes, block : ndarray of int
        Numbers of entries of the blocks, and the block of each unknown.
    entries : list of ndarray of int
        Places of the entries of each block.
    alike : dict of int to ndarray of int
        The same of all blocks with a number of rows.
    inside, own : ndarray of int
        Places of entries of the Jacobian within the blocks, row by row, and among its own entries.
    begins, unknowns : ndarray of int
        Of I - Y J: where its rows begin among its entries, and the columns of these.
    test, newton : Walk
        From the entries of Y and of J to those of I - Y J, and from those of Y and of r to Y r.
    """

    def __init__(
        self, resolved: ResolvedSystem, raised: bool, varied: bool = False, whole: bool = False, of: int | None = None
    ) -> None:
        self.answering = differentiated_once_more(resolved.array) if raised else resolved.array
        array = self.array = self.answering if of is None else determining(self.answering, of)
        self.answered = self.answering.places(array.determined)
        x, gamma = array.column(array.determined), ca.vec(array.system.gamma[:, : array.reference_order + 1])
        s, (residual, names, steps) = array.column(array.states), _without_steps(array.residual)
        if varied:
            V = ca.SX.sym("V", x.numel(), s.numel())
            rates = array.column(tuple((j, order + 1) for j, order in array.states))
            slopes, change = (ca.mtimes(ca.jacobian(f, x), V) + ca.jacobian(f, s) for f in (rates, residual))
            x, residual = ca.vertcat(x, ca.vec(V)), ca.vertcat(residual, ca.vec(change))
        self.symbols = ca.vertcat(x, s, gamma, array.system.p, ca.SX.sym("t"))
        if varied:
            self.flow = Walk(ca.vertcat(rates, ca.vec(slopes)), self.symbols)
        every = ca.vertcat(self.symbols, names)
        # Leibniz' rule takes all equations as they are, without names and without derivatives by the states.
        bare = array is self.answering and not (varied or names.numel())
        J = jacobian(array, array.determined) if bare else ca.jacobian(residual, x)
        self.steps, self.residual = Walk(steps, self.symbols), Walk(residual, every)
        self.jacobian = Walk(J.nz[:], every)
        n = len(array.system.coordinates)
        self.motion = [k for k, (j, order) in enumerate(array.determined) if j < n and order < 2]
        self.switching = ca.jacobian_sparsity(steps, x).get_col()
        first = len(array.names) - len(array.system.inputs)
        self.inputs = [k for k, (j, order) in enumerate(array.determined) if j >= first and not order]
        bent = ca.jacobian_sparsity(J.nz[:], x).get_col()
        either = ([*self.switching, *some] for some in (self.motion, bent))
        self.steady, self.curved = (np.isin(np.arange(x.numel()), some) for some in either)
        held = [k for k, each in enumerate(array.determined) if each in resolved.array.unknowns]
        self.free = ~self.curved | ~np.isin(np.arange(x.numel()), held)
        size, every_one = x.numel(), np.arange(x.numel())
        one = Part(every_one, every_one, np.arange(J.nnz()), places_of(J.sparsity()))
        self.blocks = (one,) if whole else triangular_blocks(J.sparsity())
        self.sizes = np.array([len(each.rows) ** 2 for each in self.blocks])
        self.entries = np.split(np.arange(self.sizes.sum()), np.cumsum(self.sizes)[:-1])
        rows = {len(each.rows) for each in self.blocks}
        self.alike = {n: np.concatenate([own for own in self.entries if len(own) == n * n]) for n in rows}
        self.block = np.zeros(size, dtype=int)
        Y, entries, r = (ca.SX.sym(name, n) for name, n in (("Y", self.sizes.sum()), ("J", J.nnz()), ("r", size)))
        inverse, inside = ca.SX(size, size), list[Array]()
        for k, (each, own) in enumerate(zip(self.blocks, self.entries, strict=True)):
            n, self.block[each.columns] = len(each.rows), k
            inverse[each.columns.tolist(), each.rows.tolist()] = ca.reshape(Y[own.tolist()], n, n).T
            inside.append(own[0] + n * each.places[0] + each.places[1])
        self.inside, self.own = np.concatenate(inside), np.concatenate([each.entries for each in self.blocks])
        off = (ca.SX.eye(size) - ca.mtimes(inverse, ca.SX(J.sparsity(), entries))).T  # CasADi counts by columns
        self.begins, self.unknowns = np.array(off.sparsity().colind()[:-1]), np.array(off.sparsity().row())
        self.test = Walk(off.nz[:], ca.vertcat(Y, entries))
        self.newton = Walk(ca.mtimes(inverse, r), ca.vertcat(Y, r))

    def around(self, block: int) -> str:
        """Return the names of some equations of a block."""
        names = self.array.signature.equations.equations
        return ", ".join([*dict.fromkeys(names[self.array.rows[k][0]] for k in self.blocks[block].rows)][:3])


equations_of = made_once(Equations)
"""Return the equations of a system, prepared once."""


def _without_steps(expression: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return an expression of names for operations that are constant between jumps, these names, and the operations."""
    names, steps, compared = ca.SX(0, 1), ca.SX(0, 1), dict[int, tuple[int, ...]]()

    def named(operation: int, taken: Sequence[ca.SX]) -> ca.SX:
        nonlocal names, steps
        # Kinks are written by signs, which have a derivative that is bounded where they switch.
        result = (lowered if operation in {ca.OP_FMAX, ca.OP_FMIN, ca.OP_CALL} else computed)(operation, taken)
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


def given_models(problem: Problem, array: DerivativeArray, ring: Arithmetic, ends: Array, boxed: Box) -> Model:
    """Return models of the path and its derivatives, the parameters and the time, as the walks take them.

    Intervals have begins and ends, shape (2, N).
    Parameters with an interval are variables of the arithmetic, in their order.
    """
    (begin, end), first, count = ends, ring.degrees[0] + 1, ends.shape[1]
    coefficients, radii = problem.reference.enclosure(begin, end, array.reference_order, first - 1)
    wanted = (count, array.reference_order + 1, problem.reference.dimension)
    if (np.shape(coefficients), np.shape(radii)) != ((*wanted, first), wanted):
        raise InvalidReference(
            f"{type(problem.reference).__name__}: an enclosure must be coefficients of shape {(*wanted, first)} and"
            f" radii of shape {wanted}, not {np.shape(coefficients)} and {np.shape(radii)}"
        )
    path = np.zeros((len(ring.nodes) + 1, radii[0].size, count))
    path[:-1].reshape(first, -1, radii[0].size, count)[:, 0] = coefficients.reshape(count, -1, first).T
    path[-1] = np.where(radii >= 0.0, radii, np.inf).reshape(count, -1).T
    rest = ring.constant(np.tile([[each] for each in (*problem.p, 0.0)], count))
    corners = [(-1, ends), *((k, np.array(interval)[:, None]) for k, interval in boxed.items())]
    for axis, (k, (low, high)) in enumerate(corners):
        rest[0, k] = (low + high) / 2.0
        rest[np.flatnonzero(ring.orders.sum(axis=0) * (ring.orders[axis] == 1) == 1), k] = (high - low) / 2.0
        rest[-1, k] = 4e-16 * np.maximum(np.abs(low), np.abs(high))
    return np.concatenate([path, rest], axis=1)


# The interval Newton test ---------------------------------------------------------------------------------------------


def radii(
    equations: Equations, ring: Arithmetic, x: Array, given: Model, D: Array, sizes: Array
) -> tuple[Array, Mask, Array, Array]:
    """Return bounds (unknowns, boxes) of the distance of the one solution from polynomials; infinite for no proof.

    Parameters
    ----------
    equations : Equations
        What is solved.
    ring : Arithmetic
        Of the polynomials.
    x : ndarray, shape (terms, unknowns, boxes)
        Coefficients of x_hat.
    given : Model
        Of path and parameters.
    D : ndarray, shape (unknowns, boxes)
        Where solutions are looked for.
    sizes : ndarray, shape (unknowns, 1)
        Magnitudes of the unknowns.

    Returns
    -------
    rho : ndarray, shape (unknowns, boxes)
        The radii, whether within D or not, for any values that `equations.steps` take within D.
    switches : ndarray of bool, shape (boxes,)
        Whether one of these takes more than one value.
    failed : ndarray of int, shape (boxes,)
        The first block that was not proved; -1 if all were.
    shift : ndarray, shape (terms, unknowns, boxes)
        What a step of Newton's method, block by block, would take off x_hat.
    """
    anywhere = np.concatenate([model_of(x, np.where(equations.curved[:, None], D, 0.0)), given], axis=1)
    steps = equations.steps(ring, anywhere)
    residual = equations.residual(ring, np.concatenate([model_of(x), given, steps], axis=1))
    # A degree in time that is less serves for A, which only has to be small.
    coarse = arithmetic((min(_COARSE, ring.degrees[0]), *ring.degrees[1:]))
    terms, full = len(coarse.nodes), np.concatenate([anywhere, steps], axis=1)
    J = equations.jacobian(coarse, model_of(full[:terms], norm(full[terms:]) * UP))
    Y = _inverses(equations, coarse, coarse.values(J[:, equations.own]))
    inverse = np.insert(Y, terms, np.zeros((len(x) - terms, 1, 1)), axis=0)
    newton = equations.newton(ring, np.concatenate([inverse, residual], axis=1))
    A = magnitude(equations.test(coarse, np.concatenate([Y, J], axis=1)))
    Z = np.maximum(magnitude(newton), _LEAST * sizes)
    rho, holds = _fixed(equations, A, Z)
    proved, switches = holds.all(axis=0), np.asarray((steps[-1] > _KNOWN).any(axis=0))
    failed = np.where(holds, len(holds), equations.block[:, None]).min(axis=0)
    return np.where(proved, rho, np.inf), switches, np.where(proved, -1, failed), newton[:-1]


def block_signs(equations: Equations, J: Model) -> Array:
    """Return the signs of the determinants of the diagonal blocks, shape (blocks, N); zero where one is not known.

    With rows C of size one, NumPy's sign is that of C + F, |F| <= n 2^(n-1) gamma_n, by Gaussian elimination with
    partial pivoting (Higham, *Accuracy and Stability*, theorem 9.3 and section 9.4). An approximate inverse X with
    |I - X J| < 1 for all J within R + |F| of C shows that none of these is singular: all have the same sign.

    Parameters
    ----------
    equations : Equations
        With the blocks.
    J : Model
        Of degree 0, shape (2, entries, N): the entries of the Jacobian and their radii R at instants.
    """
    count = J.shape[2]
    dense, signs = np.zeros((2, equations.sizes.sum(), count)), np.zeros((len(equations.blocks), count))
    dense[:, equations.inside] = J[:, equations.own]
    for k, own in enumerate(equations.entries):
        n = len(equations.blocks[k].rows)
        C, R = np.nan_to_num(dense[:, own].reshape(2, n, n, count).transpose(0, 3, 1, 2))
        size = np.maximum(np.abs(C).max(axis=2, keepdims=True), _LEAST)
        C, R, X = C / size, R / size, np.linalg.pinv(C / size)
        off = np.abs(np.eye(n) - X @ C) + np.abs(X) @ (R + (n**2 * 2.0 ** (n - 1) + n + 3.0) * UNIT)
        signs[k] = np.where(off.sum(axis=2).max(axis=1) < _SURELY, np.linalg.slogdet(C).sign, 0.0)
    return signs


def _inverses(equations: Equations, ring: Arithmetic, entries: Array) -> Model:
    """Return interpolants of inverses of the blocks from entries (nodes, N, boxes) of these: any will do."""
    nodes, boxes = len(entries), entries.shape[2]
    values = np.zeros((nodes, equations.sizes.sum(), boxes))
    values[:, equations.inside] = entries
    for size, where in equations.alike.items():
        matrices = np.moveaxis(values[:, where].reshape(nodes, -1, size, size, boxes), -1, 2)
        matrices = np.where(np.isfinite(matrices).all(axis=(-1, -2), keepdims=True), matrices, np.eye(size))
        try:
            inverses = 1.0 / matrices if size == 1 else np.linalg.inv(matrices)
        except np.linalg.LinAlgError:
            inverses = np.linalg.pinv(matrices)
        values[:, where] = np.moveaxis(inverses, 2, -1).reshape(nodes, -1, boxes)
    return ring.tried(values)


def _fixed(equations: Equations, A: Array, Z: Array) -> tuple[Array, Array]:
    """Return rho (unknowns, boxes) with A rho + Z <= rho, by iteration, and where that holds."""
    rho, holds = Z, np.zeros(Z.shape, dtype=bool)
    for _ in range(_ITERATIONS):
        image = np.add.reduceat(A * rho[equations.unknowns], equations.begins, axis=0) + Z
        holds = np.asarray((image * _ROUNDED <= rho) & np.isfinite(image))
        settled = holds.all(axis=0) | ~np.isfinite(image).all(axis=0)
        if settled.all():
            break
        rho = np.where(settled, rho, image * _ROOM)
    return rho, holds
