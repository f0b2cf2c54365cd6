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

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.certificate.chebyshev import Arithmetic, Model, arithmetic, magnitude, model_of, norm
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
class Blocks:
    """The block triangular form of a Jacobian, with rows and columns in its order.

    Attributes
    ----------
    rows, columns : ndarray of int
        Equations and unknowns in the order of the form.
    ends : ndarray of int
        Where blocks begin, and where the last one ends.
    whole : ndarray of int, shape (2, N)
        Rows and columns of the entries of the blocks, row by row.
    inside, own : ndarray of int
        Places, among them, of those that the Jacobian has, and theirs in the Jacobian.
    beside : ndarray of int, shape (3, N)
        Rows and columns of what lies beside the blocks, and its places in the Jacobian.
    test : Walk
        From the entries of Y, of J and of r to those of I - Y J, and of Y r.
    """

    rows: Places
    columns: Places
    ends: Places
    whole: Places
    inside: Places
    own: Places
    beside: Places
    test: Walk

    def around(self, unknown: int) -> list[int]:
        """Return the equations of the block that determines an unknown."""
        last = int(np.searchsorted(self.ends, np.flatnonzero(self.columns == unknown)[0], side="right"))
        return self.rows[self.ends[last - 1] : self.ends[last]].tolist()  # type: ignore[no-any-return]  # NumPy's stubs


@made_once
def blocks_of(equations: Equations) -> Blocks:
    """Prepare the test of equations. The form is lower triangular: the first block depends on no other."""
    size = equations.transposed.size1()
    _, rows, columns, bounds, *_ = equations.transposed.T.btf()
    ends = np.unique(bounds)
    # CasADi counts entries by columns, so the matrices are transposed; the pattern of the blocks is symmetric.
    permuted, entry = equations.transposed.sub(columns, rows)
    places = np.array([permuted.get_col(), permuted.row(), entry])
    whole = ca.diagcat(*(ca.Sparsity.dense(n, n) for n in np.diff(ends).tolist()))
    inside = np.array(whole.get_nz((size * places[0] + places[1]).tolist()))
    own, beside = places[:, inside >= 0], places[:, inside < 0]
    Y, J, r = (ca.SX.sym(name, n) for name, n in (("Y", whole.nnz()), ("J", own.shape[1]), ("r", size)))
    given = ca.Sparsity.triplet(size, size, own[1].tolist(), own[0].tolist())
    inverse, matrix = ca.SX(whole, Y).T, ca.SX(given, J).T
    off = ca.project((ca.SX.eye(size) - ca.mtimes(inverse, matrix)).T, whole)
    test = walk_of(ca.vertcat(off.nz[:], ca.mtimes(inverse, r[rows])), ca.vertcat(Y, J, r))
    pattern = np.array([whole.get_col(), whole.row()])
    return Blocks(np.array(rows), np.array(columns), ends, pattern, inside[inside >= 0], own[2], beside, test)


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
    anywhere = model_of(x, np.where(equations.curved[:, None], D, 0.0))
    steps = equations.steps(ring, np.concatenate([anywhere, given], axis=1))
    residual = equations.residual(ring, np.concatenate([model_of(x), given, steps], axis=1))
    jacobian = equations.jacobian(ring, np.concatenate([anywhere, given, steps], axis=1))
    Y = _inverses(blocks, ring, jacobian[:, blocks.own])
    off = blocks.test(ring, np.concatenate([Y, jacobian[:, blocks.own], residual], axis=1))
    found, entries = magnitude(off), Y.shape[1]
    A, Z = found[:entries], np.maximum(found[entries:], _LEAST * sizes[blocks.columns, None])
    rho, holds = _fixed(blocks, A, Z, magnitude(Y), magnitude(jacobian[:, blocks.beside[2]]))
    first = blocks.ends[np.searchsorted(blocks.ends, holds.argmin(axis=0), side="right") - 1]
    proved, order = holds.all(axis=0), np.argsort(blocks.columns)
    switches, failed = np.asarray((steps[-1] > _KNOWN).any(axis=0)), np.where(proved, -1, blocks.columns[first])
    return np.where(proved, rho, np.inf)[order], switches, failed, off[:-1, entries:][:, order]


def _inverses(blocks: Blocks, ring: Arithmetic, J: Model) -> Model:
    """Return models without a radius of inverses of the blocks, interpolated at few nodes: any will do."""
    coarse, (rows, _, boxes) = arithmetic((min(_INVERTED, ring.degrees[0]), *ring.degrees[1:])), J.shape
    nodes = len(coarse.nodes)
    values = np.zeros((nodes, blocks.whole.shape[1], boxes))
    values[:, blocks.inside] = np.tensordot(ring.rows(coarse.nodes), J[:-1], 1)
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
    Y = np.zeros((rows, *found.shape[1:]))
    Y[:nodes] = coarse.tried(found)[:-1]
    return Y


def _fixed(blocks: Blocks, A: Array, Z: Array, Y: Array, J: Array) -> tuple[Array, Array]:
    """Return rho (unknowns, boxes) with A rho + |Y| |J| rho + Z <= rho, by iteration, and where that holds."""
    rho, holds = Z, np.zeros(Z.shape, dtype=bool)
    for _ in range(_ITERATIONS):
        earlier = _multiplied(blocks.beside, J, rho)
        image = _multiplied(blocks.whole, A, rho) + _multiplied(blocks.whole, Y, earlier) + Z
        holds = np.asarray((image * _ROUNDED <= rho) & np.isfinite(image))
        settled = holds.all(axis=0) | ~np.isfinite(image).all(axis=0)
        if settled.all():
            break
        rho = np.where(settled, rho, image * _ROOM)
    return rho, holds


def _multiplied(pattern: Places, entries: Array, x: Array) -> Array:
    """Return the product of sparse matrices with entries (N, boxes), row by row, and vectors (columns, boxes)."""
    product = np.zeros_like(x)
    if len(entries):
        first = np.flatnonzero(np.diff(pattern[0], prepend=-1))
        product[pattern[0][first]] = np.add.reduceat(entries * x[pattern[1]], first, axis=0)
    return product
