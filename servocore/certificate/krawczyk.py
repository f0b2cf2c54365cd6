"""The interval Newton test, block by block: one solution near an approximation, at every instant of an interval.

E(x, t, p) = 0 with the Jacobian J = dE/dx in block triangular form. About an approximation x_hat, a polynomial, and
within x_hat + D, the test takes for each block b an approximate inverse Y and, with r the residual of x_hat,

    Z = |Y r_b| + |Y| sum over earlier blocks e of |J_be| rho_e,    A >= |I - Y J_bb|,    A rho_b + Z <= rho_b <= D_b.

x_b -> x_b - Y E_b(x) then maps x_hat_b + rho_b into itself and contracts: rho > 0 and A rho < rho make the spectral
radius of A less than one (Collatz & Wielandt). So there is exactly one solution in x_hat + D, it lies in x_hat + rho,
and J is regular there (Krawczyk, Computing 4 (1969) 187; Rump, Acta Numerica 19 (2010) 287, section 13). Unknowns that
J does not depend on need no D: the solution is unique whatever they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import Arithmetic, Model, arithmetic, magnitude, norm
from servocore.certificate.equations import Equations
from servocore.certificate.programs import UP, Places
from servocore.certificate.walk import Walk, walk_of
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once

_ROOM = 1.0 + 1e-2  # radii are larger by that, so that iterations for them end
_ROUNDED = 1.0 + 1e-6  # and so that the test holds with the rounding of its own sums
_LEAST = 1e-17  # of an unknown's magnitude: radii are positive
_ITERATIONS = 60
_KNOWN = 0.1  # radius: a step is one at the least, and known but for rounding elsewhere
_INVERTED = 4  # degree in time of approximate inverses


@dataclass(frozen=True, eq=False)
class Sums:
    """A sparse matrix with entries that are given later, to multiply with.

    Attributes
    ----------
    rows, columns : ndarray of int
        Of the entries, sorted by rows.
    """

    rows: Places
    columns: Places

    @cached_property
    def first(self) -> Places:
        """Where rows begin."""
        return np.flatnonzero(np.diff(self.rows, prepend=-1))

    def __call__(self, entries: Array, x: Array) -> Array:
        """Return the product of the matrix with `entries` (N, boxes) and vectors (columns, boxes)."""
        if len(self.first) == len(x):
            return np.asarray(np.add.reduceat(entries * x[self.columns], self.first, axis=0))
        product = np.zeros_like(x)
        if len(self.rows):
            product[self.rows[self.first]] = np.add.reduceat(entries * x[self.columns], self.first, axis=0)
        return product


@dataclass(frozen=True, eq=False)
class Blocks:
    """The block triangular form of a Jacobian, with rows and columns in its order.

    Attributes
    ----------
    rows, columns : ndarray of int
        Equations and unknowns in the order of the form.
    ends : ndarray of int
        Where blocks begin, and where the last one ends.
    within, inside, own : Sums, ndarray of int, ndarray of int
        The blocks; places, among their entries, of those that the Jacobian has, and theirs in the Jacobian.
    beside, others : Sums, ndarray of int
        What lies beside them, and its places in the Jacobian.
    test : Walk
        From the entries of Y, of J and of r to those of I - Y J, and of Y r.
    """

    rows: Places
    columns: Places
    ends: Places
    within: Sums
    inside: Places
    own: Places
    beside: Sums
    others: Places
    test: Walk

    def around(self, unknown: int) -> list[int]:
        """Return the equations of the block that determines an unknown."""
        last = int(np.searchsorted(self.ends, np.flatnonzero(self.columns == unknown)[0], side="right"))
        return self.rows[self.ends[last - 1] : self.ends[last]].tolist()  # type: ignore[no-any-return]  # NumPy's stubs


@made_once
def blocks_of(equations: Equations) -> Blocks:
    """Prepare the test of equations. The form is lower triangular: the first block depends on no other."""
    pattern, size = equations.pattern, equations.pattern.size1()
    _, rows, columns, bounds, *_ = pattern.btf()
    ends = np.unique(bounds)
    sizes = np.diff(ends)
    permuted, numbers = pattern.sub(rows, columns)
    by_rows = np.lexsort((permuted.get_col(), permuted.row()))
    at, column, entry = (np.array(each)[by_rows] for each in (permuted.row(), permuted.get_col(), numbers))
    block = np.repeat(np.arange(len(sizes)), sizes)
    same, first, width = block[at] == block[column], ends[:-1][block], sizes[block]
    # Entries of the blocks, row by row, and where each row of them begins.
    whole_rows, begin = np.repeat(np.arange(size), width), np.cumsum(width) - width
    whole_columns = np.arange(len(whole_rows)) - np.repeat(begin - first, width)
    inside = (begin - first)[at[same]] + column[same]
    Y, J, r = (ca.SX.sym(name, n) for name, n in (("Y", len(whole_rows)), ("J", len(inside)), ("r", size)))
    # CasADi counts entries by columns, so the matrices are transposed; the pattern of the blocks is symmetric.
    whole = ca.Sparsity.triplet(size, size, whole_columns.tolist(), whole_rows.tolist())
    given = ca.Sparsity.triplet(size, size, column[same].tolist(), at[same].tolist())
    inverse, matrix = ca.SX(whole, Y).T, ca.SX(given, J).T
    off = ca.project((ca.SX.eye(size) - ca.mtimes(inverse, matrix)).T, whole)
    test = walk_of(ca.vertcat(off.nz[:], ca.mtimes(inverse, r[rows])), ca.vertcat(Y, J, r))
    return Blocks(
        np.array(rows), np.array(columns), ends, Sums(whole_rows, whole_columns), inside, entry[same],
        Sums(at[~same], column[~same]), entry[~same], test,
    )  # fmt: skip


def radii(
    equations: Equations, ring: Arithmetic, x: Array, given: Model, D: Array, sizes: Array
) -> tuple[Array, npt.NDArray[np.bool_], Array, Array]:
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
    sizes : ndarray, shape (unknowns,)
        Magnitudes of the unknowns.

    Returns
    -------
    rho : ndarray, shape (unknowns, boxes)
        The radii, whether within D or not, for any values that `equations.steps` take within D.
    switches : ndarray of bool, shape (boxes,)
        Whether one of these takes more than one value.
    failed : ndarray of int, shape (boxes,)
        The first unknown of the first block that was not proved; -1 if all were.
    shift : ndarray, shape (terms, unknowns, boxes)
        What a step of Newton's method, block by block, would take off x_hat.
    """
    blocks = blocks_of(equations)
    wide = np.where(equations.curved[:, None], D, 0.0)
    anywhere = joined((x, wide), given)
    steps = equations.steps(ring, anywhere)
    residual = equations.residual(ring, joined((x, np.zeros_like(wide)), given, steps))
    jacobian = equations.jacobian(ring, joined(anywhere, steps))
    own = jacobian[0][:, blocks.own], jacobian[1][blocks.own]
    Y = _inverses(blocks, ring, own[0])
    off = blocks.test(ring, joined((Y, np.zeros(Y.shape[1:])), own, residual))
    found = magnitude(off)
    A, Z = found[: Y.shape[1]], np.maximum(found[Y.shape[1] :], _LEAST * sizes[blocks.columns, None])
    beside = magnitude((jacobian[0][:, blocks.others], jacobian[1][blocks.others]))
    rho, holds = _fixed(blocks, A, Z, norm(Y) * UP, beside)
    first = blocks.ends[np.searchsorted(blocks.ends, holds.argmin(axis=0), side="right") - 1]
    proved, order = holds.all(axis=0), np.argsort(blocks.columns)
    switches, failed = np.asarray((steps[1] > _KNOWN).any(axis=0)), np.where(proved, -1, blocks.columns[first])
    return np.where(proved, rho, np.inf)[order], switches, failed, off[0][:, Y.shape[1] :][:, order]


def joined(*some: Model) -> Model:
    """Return models one after the other."""
    some = tuple(each for each in some if each[1].size) or some[:1]
    if len(some) == 1:
        return some[0]
    return np.concatenate([c for c, _ in some], axis=1), np.concatenate([r for _, r in some])


def _inverses(blocks: Blocks, ring: Arithmetic, c: Array) -> Array:
    """Return coefficients (terms, entries, boxes) of inverses of the blocks, interpolated at few nodes: any will do."""
    coarse, (terms, _, boxes) = arithmetic((min(_INVERTED, ring.degrees[0]), *ring.degrees[1:])), c.shape
    nodes = len(coarse.nodes)
    values = np.zeros((nodes, len(blocks.within.rows), boxes))
    values[:, blocks.inside] = (ring.rows(coarse.nodes) @ c.reshape(terms, -1)).reshape(nodes, -1, boxes)
    found, sizes = np.empty_like(values), np.diff(blocks.ends)
    for size in np.unique(sizes).tolist():
        where = ((np.cumsum(sizes**2) - sizes**2)[sizes == size, None] + np.arange(size**2)).ravel()
        matrices = np.moveaxis(values[:, where].reshape(nodes, -1, size, size, boxes), -1, 2)
        matrices = np.where(np.isfinite(matrices).all(axis=(-1, -2), keepdims=True), matrices, np.eye(size))
        try:
            inverses = 1.0 / matrices if size == 1 else np.linalg.inv(matrices)
        except np.linalg.LinAlgError:
            inverses = np.linalg.pinv(matrices)
        found[:, where] = np.moveaxis(inverses, 2, -1).reshape(nodes, -1, boxes)
    Y = np.zeros((terms, *found.shape[1:]))
    Y[:nodes] = coarse.interpolated(found)
    return np.where(np.isfinite(Y), Y, 0.0)


def _fixed(blocks: Blocks, A: Array, Z: Array, Y: Array, J: Array) -> tuple[Array, Array]:
    """Return rho (unknowns, boxes) with A rho + |Y| |J| rho + Z <= rho, by iteration, and where that holds."""
    rho, holds = Z, np.zeros(Z.shape, dtype=bool)
    for _ in range(_ITERATIONS):
        image = blocks.within(A, rho) + blocks.within(Y, blocks.beside(J, rho)) + Z
        holds = np.asarray((image * _ROUNDED <= rho) & np.isfinite(image))
        settled = holds.all(axis=0) | ~np.isfinite(image).all(axis=0)
        if settled.all():
            break
        rho = np.where(settled, rho, image * _ROOM)
    return rho, holds
