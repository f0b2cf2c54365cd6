"""Whether the derivatives of a user's path are those of its positions."""

from __future__ import annotations

import numpy as np

from servocore.errors import InvalidReference
from servocore.references.base import FloatArray, Reference

_WINDOWS, _PART = 9, 1 / 64  # so many, each such a part of the duration
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_HIGHEST = 8  # order that is checked
_WRONG = 0.05  # of a change: a junction within a window leaves less in most windows
_ROUND_OFF = 1e-8  # of the values


def require_consistent(path: Reference) -> None:
    """Raise `InvalidReference` if derivatives of a path are not the rates of its positions and lower derivatives.

    The exact inversion takes them as they are, and every equation would hold with inputs that belong to no motion.

    Parameters
    ----------
    path : Reference
        Of a class of a user's own.
    """
    length = _PART * path.duration
    # Golden sections lie on no regular grid of junctions.
    begin = path.start_time + (path.duration - length) * np.modf(0.5 + 0.618034 * np.arange(_WINDOWS))[0]
    nodes = begin[:, None] + length * (1.0 + _NODES) / 2.0
    order = min(path.max_order, _HIGHEST)
    first, last, inside = (path.jet(t, order) for t in (begin, begin + length, nodes.ravel()))
    wanted = (_WINDOWS, order + 1, path.dimension)
    if first.shape != wanted:
        raise InvalidReference(f"{type(path).__name__}: derivatives at {_WINDOWS} times must have the shape {wanted},"
                               f" not {first.shape}")  # fmt: skip
    _require_polynomials(path, begin)
    slopes = inside.reshape(_WINDOWS, len(_NODES), order + 1, path.dimension)
    integrals = np.einsum("j,wjkd->wkd", _WEIGHTS * length / 2.0, slopes)
    sizes = np.einsum("j,wjkd->wkd", _WEIGHTS * length / 2.0, np.abs(slopes))
    for k in range(min(order, path.smoothness + 1)):
        change = last[:, k] - first[:, k]
        off = np.abs(change - integrals[:, k + 1])
        largest = np.abs(slopes[:, :, k]).max(axis=1)
        allowed = _WRONG * np.maximum(np.abs(change), sizes[:, k + 1]) + _ROUND_OFF * largest
        wrong = off > allowed
        if (wrong.sum(axis=0) > _WINDOWS // 2).any():
            w, d = (int(place) for place in np.argwhere(wrong & (wrong.sum(axis=0) > _WINDOWS // 2))[0])
            what = "the position" if k == 0 else f"the derivative of order {k}"
            raise InvalidReference(
                f"{type(path).__name__}: the derivative of order {k + 1} of component {d} is not that of the path: from"
                f" t = {begin[w]:.6g} s to {begin[w] + length:.6g} s {what} changes by {change[w, d]:.4g}, and its"
                f" integral is {integrals[w, k + 1, d]:.4g}"
            )


def _require_polynomials(path: Reference, t: FloatArray) -> None:
    """Raise `InvalidReference` unless `joints` are times of the path, and `degree`, if given, that of polynomials."""
    joints, name, ends = path.joints, type(path).__name__, (path.start_time, path.end_time)
    rising = isinstance(joints, np.ndarray) and joints.ndim == 1 and len(joints) > 1 and (np.diff(joints) > 0.0).all()
    if not rising or (joints[0], joints[-1]) != ends:
        raise InvalidReference(f"{name}: joints must be an array of times that rise from {ends[0]} to {ends[1]} s")
    degree = path.degree
    if degree is None or degree >= path.max_order:
        return
    jet = path.jet(t, max(degree, 0) + 1)
    if degree < 0 or (np.abs(jet[:, -1]) > _ROUND_OFF * np.abs(jet[:, -2]).max() / path.duration).any():
        raise InvalidReference(f"{name}: the path has a degree of more than {degree} between its joints")
