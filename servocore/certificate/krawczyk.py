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

import numpy as np

from servocore.certificate.chebyshev import UNIT, Arithmetic, Model, magnitude, norm
from servocore.certificate.equations import Equations, Places
from servocore.numerics.compiled_calls import Array

_ROOM = 1.0 + 1e-3  # radii are larger by that, so that the test holds with the rounding of its own sums
_LEAST = 1e-17  # of an unknown's magnitude: radii are positive


def radii(
    equations: Equations, ring: Arithmetic, x: Array, given: Model, D: Array, sizes: Array
) -> tuple[Array, Array]:
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
        The radii, whether within D or not.
    failed : ndarray of int, shape (boxes,)
        The first unknown that was not proved, in the order of the stages; -1 if all were.
    """
    wide = np.where(equations.curved[:, None], D, 0.0)
    residual = equations.residual(ring, _joined(x, np.zeros_like(wide), given))
    jacobian = equations.jacobian(ring, _joined(x, wide, given))
    weights = magnitude(jacobian)
    rho, failed = np.full_like(wide, np.inf), np.full(x.shape[2], -1)
    for stage, (A, inverse, own) in zip(equations.stages, _tests(ring, equations, residual, jacobian), strict=True):
        at, column, entry = stage.beside
        beside = np.zeros((own.shape[0] * own.shape[1], own.shape[2]))
        np.add.at(beside, at, weights[entry] * rho[column])
        Z = own + np.einsum("bijk,bjk->bik", inverse, beside.reshape(own.shape)) * _ROOM
        Z = np.maximum(Z, _LEAST * sizes[stage.columns][:, :, None])
        rho[stage.columns] = found = _fixed(A, Z)
        bad = ~np.isfinite(found).all(axis=1)
        first = stage.columns[bad.argmax(axis=0), 0]
        failed = np.where((failed < 0) & bad.any(axis=0), first, failed)
    return rho, failed


def _joined(x: Array, r: Array, given: Model) -> Model:
    return np.concatenate([x, given[0]], axis=1), np.concatenate([r, given[1]])


def _tests(ring: Arithmetic, equations: Equations, residual: Model, jacobian: Model) -> list[tuple[Array, ...]]:
    """Return the arrays of the test for the blocks of each stage: all blocks of one size are handled together."""
    sizes = [stage.rows.shape[1] for stage in equations.stages]
    found = dict[int, tuple[Array, ...]]()
    for size in set(sizes):
        same = [k for k, each in enumerate(sizes) if each == size]
        rows, entries = (
            np.concatenate([getattr(equations.stages[k], name) for k in same]) for name in ("rows", "entries")
        )
        ends = np.cumsum([len(equations.stages[k].rows) for k in same])[:-1]
        parts = (np.split(part, ends) for part in _tested(ring, rows, entries, residual, jacobian))
        found.update(zip(same, zip(*parts, strict=True), strict=True))
    return [found[k] for k in range(len(sizes))]


def _tested(
    ring: Arithmetic, rows: Places, entries: Places, residual: Model, jacobian: Model
) -> tuple[Array, Array, Array]:
    """Return bounds of |I - Y J|, |Y| and |Y r| of blocks of one size, shape (blocks, size, ..., boxes)."""
    size = rows.shape[1]
    terms, boxes = len(residual[0]), residual[0].shape[2]
    # One more entry, zero, for those that a block does not have.
    c = np.concatenate([jacobian[0], np.zeros((terms, 1, boxes))], axis=1)[:, entries]
    r = np.concatenate([jacobian[1], np.zeros((1, boxes))])[entries]
    Y = _inverses(ring, c)
    zero = np.zeros(Y.shape[1:])
    # Y J and Y r as products of models: they cancel as polynomials, before magnitudes are taken.
    YJ = [_product(ring, (Y[:, :, :, [k]], zero[:, :, [k]]), (c[:, :, [k]], r[:, [k]])) for k in range(size)]
    b = residual[0][:, rows][:, :, None], residual[1][rows][:, None]
    Yr = [_product(ring, (Y[:, :, :, k], zero[:, :, k]), (b[0][:, :, :, k], b[1][:, :, k])) for k in range(size)]
    return _sum(YJ, np.eye(size)[None, :, :, None]), norm(Y) * (1.0 + 1e-14), _sum(Yr, 0.0)


def _product(ring: Arithmetic, a: Model, b: Model) -> Model:
    """Return products of models with more axes than one between terms and boxes."""
    shape = np.broadcast_shapes(a[0].shape, b[0].shape)
    left, right = (
        (
            np.broadcast_to(c, shape).reshape(shape[0], -1, shape[-1]),
            np.broadcast_to(r, shape[1:]).reshape(-1, shape[-1]),
        )
        for c, r in (a, b)
    )
    found, radius = ring.product(left, right)
    return found.reshape(shape), radius.reshape(shape[1:])


def _sum(each: list[Model], constant: Array | float) -> Array:
    """Return bounds of |constant - sum| of models: a sum of m terms is off by m units of all their coefficients."""
    c = -np.sum([part[0] for part in each], axis=0)
    c[0] += constant
    noise = (len(each) + 1) * UNIT * np.sum([norm(part[0]) for part in each], axis=0)
    return np.asarray(
        (norm(c) + np.sum([part[1] for part in each], axis=0) + noise + UNIT * np.abs(constant)) * (1.0 + 1e-14)
    )


def _inverses(ring: Arithmetic, c: Array) -> Array:
    """Return coefficients of interpolated inverses of matrices (terms, blocks, size, size, boxes); any will do."""
    terms, count, size, _, boxes = c.shape
    values = ring.values(c.reshape(terms, -1, boxes)).reshape(-1, count, size, size, boxes)
    matrices = np.moveaxis(values, -1, 2)
    matrices = np.where(np.isfinite(matrices).all(axis=(-1, -2), keepdims=True), matrices, np.eye(size))
    try:
        found = np.linalg.inv(matrices)
    except np.linalg.LinAlgError:
        found = np.linalg.pinv(matrices)
    lined = np.moveaxis(found, 2, -1).reshape(len(values), -1, boxes)
    return ring.interpolated(np.asarray(lined, dtype=np.float64)).reshape(terms, count, size, size, boxes)


def _fixed(A: Array, Z: Array) -> Array:
    """Return rho (blocks, size, boxes) with A rho + Z <= rho, infinite where none is found."""
    size = Z.shape[1]
    good = np.asarray(np.isfinite(A).all(axis=(1, 2)) & np.isfinite(Z).all(axis=1))
    matrices = np.where(good[..., None, None], np.eye(size) - _ROOM * np.moveaxis(A, 3, 1), np.eye(size))
    right = _ROOM * np.moveaxis(Z, 2, 1)
    try:
        tried = right / matrices[..., 0] if size == 1 else np.linalg.solve(matrices, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return np.full_like(Z, np.inf)
    tried = np.moveaxis(tried, 1, 2)
    image = np.einsum("bijk,bjk->bik", A, tried) + Z
    holds = good[:, None] & (tried > 0.0).all(axis=1, keepdims=True)
    return np.where(holds & (image * (1.0 + 1e-6) <= tried).all(axis=1, keepdims=True), tried, np.inf)
