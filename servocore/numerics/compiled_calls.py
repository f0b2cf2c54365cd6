"""Compiled functions called on NumPy arrays in place, without CasADi's matrix conversions.

The conversions cost ten times what a small function itself takes.
"""

from __future__ import annotations

from threading import Lock

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.numerics.memoization import made_once

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Places = npt.NDArray[np.intp]

_LONG = 1000  # results of a function that is called instant by instant: mapped, its values would pass through memory


def lock_arrays(record: object, *names: str) -> None:
    """Replace the arrays of a frozen record by read-only views; the arrays themselves stay writable."""
    for name in names:
        view = np.asarray(getattr(record, name)).view()
        view.flags.writeable = False
        object.__setattr__(record, name, view)


class Call:
    """A `casadi.Function` with dense arguments and results, as a function of arrays.

    Parameters
    ----------
    function : casadi.Function
        The function to call.

    Notes
    -----
    Arguments are not broadcast: each must have exactly as many entries as the function declares. Matrices
    are read and returned column by column (Fortran order), vectors are one-dimensional. Threads that share a `Call`
    take turns: its buffer holds one set of arguments.

    CasADi writes no results if an evaluation fails, as for a linear system that is exactly singular. All results are
    then NaN.
    """

    def __init__(self, function: ca.Function) -> None:
        self._buffer, self._evaluate = function.buffer()
        self._sizes = [function.numel_in(k) for k in range(function.n_in())]
        self._shapes = [function.size_out(k) for k in range(function.n_out())]
        for k in range(function.n_out()):
            if function.nnz_out(k) != function.numel_out(k):
                raise ValueError(f"result {k} of {function.name()} is sparse")
        self._name, self._turn = function.name(), Lock()

    def __call__(self, *arguments: npt.ArrayLike) -> tuple[Array, ...]:
        """Evaluate; raises ValueError if an argument has the wrong size."""
        held = []
        for k, (argument, size) in enumerate(zip(arguments, self._sizes, strict=True)):
            # ravel(order="F") copies only arrays that are not in column-major order
            flat = np.asarray(argument, dtype=np.float64).ravel(order="F")
            if flat.size != size:
                raise ValueError(f"argument {k} of {self._name} has {flat.size} entries, expected {size}")
            held.append(flat)
        results = [np.empty(rows * columns) for rows, columns in self._shapes]
        with self._turn:
            for k, flat in enumerate(held):
                if flat.size:
                    self._buffer.set_arg(k, flat.data)
            for k, result in enumerate(results):
                if result.size:
                    self._buffer.set_res(k, result.data)
                    result[-1] = np.nan  # overwritten on success: to test it costs less than CasADi's return value
            self._evaluate()
            if any(result.size and result[-1] != result[-1] for result in results) and self._buffer.ret():
                for result in results:
                    result.fill(np.nan)
        return tuple(
            result if columns == 1 else result.reshape((rows, columns), order="F")
            for result, (rows, columns) in zip(results, self._shapes, strict=True)
        )


@made_once
def call_of(function: ca.Function) -> Call:
    """Return the call of a function."""
    return Call(function)


def at_instants(function: ca.Function, *columns: Array, jets: Array, p: Array) -> tuple[Array, ...]:
    """Evaluate a function of (*columns, gamma, p) at many instants at once.

    Parameters
    ----------
    function : casadi.Function
        With column vectors, a reference jet of shape (m, orders) and the parameters as arguments.
    *columns : ndarray, shape (size, N)
        One column per instant.
    jets : ndarray, shape (N, orders, m)
        Reference jets.
    p : ndarray
        Parameters, the same at all instants.

    Returns
    -------
    tuple of ndarray, shape (rows, columns * N)
        The results of the instants side by side.
    """
    if function.numel_out(0) > _LONG:
        instants = zip(*(column.T for column in columns), jets, strict=True)
        each = [call_of(function)(*states, jet.T, p) for *states, jet in instants]
        return tuple(np.column_stack(results) for results in zip(*each, strict=True))
    results = mapped(function, len(jets))(*columns, side_by_side(jets), repeated(p, len(jets)))
    sizes = [(function.size1_out(k), function.size2_out(k) * len(jets)) for k in range(function.n_out())]
    return tuple(result.reshape(size, order="F") for result, size in zip(results, sizes, strict=True))


@made_once  # to build these costs more than to evaluate them, and runs of one length follow one another
def mapped(function: ca.Function, count: int) -> Call:
    """Return a function of `count` instants side by side."""
    return Call(function.map(count))


@made_once
def chained(function: ca.Function, count: int) -> Call:
    """Return `count` evaluations in a row, the first result of each being the first argument of the next."""
    return Call(function.mapaccum(f"{function.name()}_loop", count))


def repeated(values: Array, count: int) -> Array:
    """Return values (size,) as columns (size, count), in the order in which a `Call` reads them."""
    return np.full((count, len(values)), values).T


def side_by_side(jets: Array) -> Array:
    """Lay reference jets (N, orders, m) side by side as CasADi maps them: (m, N * orders)."""
    return jets.reshape(-1, jets.shape[2]).T
