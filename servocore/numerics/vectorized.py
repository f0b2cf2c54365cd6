"""A compiled function at many instants, and of many cases: by CasADi's interpreter, or as machine code."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array, mapped, repeated
from servocore.numerics.just_in_time import LANES, NAME, JustInTime

if TYPE_CHECKING:
    from pathlib import Path
    from types import ModuleType

    from servocore.numerics.machine_code import Build

_BYTES = 8
_AT_ONCE = 1 << 16  # instants that the interpreter evaluates together: a million would fill the memory
_PER_THREAD = 100_000  # instants that are worth a thread of their own

Result = TypeVar("Result")


class Vectorized:
    """A function at many instants, of arguments that vary with the instant and of arguments that all share.

    Parameters
    ----------
    function : casadi.Function
        With dense arguments and results; one of expressions can become machine code.
    along : sequence of bool
        Which arguments vary with the instant.
    native, of_what, again
        See `JustInTime`, also for exceptions; `of_what` names it in messages.
    """

    def __init__(
        self, function: ca.Function, along: Sequence[bool], native: bool | None, of_what: str, *, again: bool = False
    ) -> None:
        self.function, self._along = function, tuple(along)
        self._sizes = [function.numel_out(k) for k in range(function.n_out())]
        self._of_what = of_what
        self._code = JustInTime(self._build, loader(None, *[_LONG] * 2, *[_ARRAY] * 4, _LONG), native, again)

    def _build(self) -> Build | None:
        from servocore.numerics import vector_code  # noqa: PLC0415 - few compile

        return vector_code.build_of_source(lambda: self._source(vector_code), self._of_what, self.function)

    def _source(self, code: ModuleType) -> str:
        return str(code.vector_source(self.function, self._along))

    def ready(self, count: int, called: bool = True) -> bool:
        """Whether machine code for so many instants is compiled; with `called`, count a call."""
        return self._code.best(count, called) is not None

    def __call__(self, *arguments: Array) -> list[Array]:
        """Evaluate.

        Parameters
        ----------
        *arguments : ndarray
            Shape (rows, N) or (cases, rows, N) if it varies with the instant, (size,) or (cases, size) if it is
            shared. Entries of a row must be contiguous.

        Returns
        -------
        list of ndarray
            Results, shape (rows, N), or (cases, rows, N) if an argument has cases.
        """
        cases, count, batch = 1, 0, False
        for argument, along in zip(arguments, self._along, strict=True):
            count = argument.shape[-1] if along else count
            if argument.ndim == 2 + along:
                cases, batch = len(argument), True
        run = self._code.best(count * cases)
        if run is not None and count:
            results = self._in_machine_code(run, arguments, cases, count)
            return results if batch else [result[0] for result in results]
        if not batch:
            return self.interpreted(*arguments)
        pairs = list(zip(arguments, self._along, strict=True))
        parts = [self.interpreted(*(a[k] if a.ndim == 2 + along else a for a, along in pairs)) for k in range(cases)]
        return [np.stack(of_cases) for of_cases in zip(*parts, strict=True)]

    def interpreted(self, *arguments: Array) -> list[Array]:
        """Evaluate one case by CasADi's interpreter."""
        count = arguments[self._along.index(True)].shape[-1]
        if not count:
            return [np.empty((size, 0)) for size in self._sizes]
        parts = []
        for k in range(0, count, _AT_ONCE):
            size = min(_AT_ONCE, count - k)
            pairs = zip(arguments, self._along, strict=True)
            some = (a[:, k : k + size] if along else repeated(a, size) for a, along in pairs)
            results = mapped(self.function, size)(*some)
            parts.append([result.reshape(-1, size, order="F") for result in results])
        return [np.concatenate(of_parts, axis=1) for of_parts in zip(*parts, strict=True)] if parts[1:] else parts[0]

    def _in_machine_code(self, run: Any, arguments: tuple[Array, ...], cases: int, count: int) -> list[Array]:
        arguments, width = self._widened(arguments), max(count, LANES)
        results = [np.empty((cases, size, width)) for size in self._sizes]
        threads = threads_for(cases * count)
        by_case = cases >= threads

        def some(first: int, last: int) -> None:
            pairs = zip(arguments, self._along, strict=True)
            shares = np.s_[first:last] if by_case else np.s_[..., first:last]
            part = [a[shares] if (a.ndim == 2 + along if by_case else along) else a for a, along in pairs]
            self._run(run, part, [result[shares] for result in results], width if by_case else last - first)

        if threads < 2:
            self._run(run, arguments, results, width)
        else:
            in_threads(threads, cases if by_case else width, some)
        return results if width == count else [result[..., :count] for result in results]

    def _run(self, run: Any, arguments: Sequence[Array], results: list[Array], count: int) -> None:
        """Run machine code; rows of the results may be slices of longer ones."""
        held = [a if a.strides[-1] == _BYTES else np.ascontiguousarray(a) for a in arguments]
        pairs = list(zip(held, self._along, strict=True))
        row = [a.strides[-2] // _BYTES if along else 0 for a, along in pairs]
        lane = [a.strides[0] // _BYTES if a.ndim == 2 + along else 0 for a, along in pairs]
        places, ends = _longs(addresses(held)), _longs(addresses(results))
        run(len(results[0]), count, places, _longs(row), _longs(lane), ends, results[0].strides[-2] // _BYTES)

    def _widened(self, arguments: tuple[Array, ...]) -> tuple[Array, ...]:
        return tuple(widened(a) if along else a for a, along in zip(arguments, self._along, strict=True))


class Extremes(Vectorized):
    """Highest and lowest value of every result over the instants.

    A call returns arrays (2, rows), or (cases, 2, rows): NaN where a value is not finite at some instant.
    """

    def interpreted(self, *arguments: Array) -> list[Array]:
        """Evaluate one case by CasADi's interpreter."""
        return [extremes_of(values) for values in super().interpreted(*arguments)]

    def _source(self, code: ModuleType) -> str:
        return str(code.extremes_source(self.function, self._along))

    def _in_machine_code(self, run: Any, arguments: tuple[Array, ...], cases: int, count: int) -> list[Array]:
        results = [np.empty((cases, 2, size)) for size in self._sizes]
        self._run(run, self._widened(arguments), results, max(count, LANES))
        return results


_LONG, _ARRAY = ctypes.c_long, ctypes.c_void_p


def loader(result: Any, *kinds: Any) -> Callable[[Path], Any]:
    """Return the function that loads machine code with arguments and a result of these kinds from a library."""

    def load(library: Path) -> Any:
        run = getattr(ctypes.CDLL(str(library)), NAME)
        run.restype, run.argtypes = result, kinds
        return run

    return load


def widened(values: Array) -> Array:
    """Repeat the last instant of values (..., N) until a register is full."""
    count = values.shape[-1]
    return values if count >= LANES else values[..., np.minimum(np.arange(LANES), count - 1)]


def extremes_of(rows: Array) -> Array:
    """Return highest and lowest values (..., 2, rows) of rows (..., rows, N), NaN where one is not finite."""
    extremes = np.stack([rows.max(axis=-1), rows.min(axis=-1)], axis=-2)
    extremes[~np.isfinite(extremes).all(axis=-2, keepdims=True).repeat(2, axis=-2)] = np.nan
    return extremes


def addresses(arrays: Sequence[Array]) -> list[int]:
    """Return the memory addresses of arrays."""
    return [array.__array_interface__["data"][0] for array in arrays]


_LONGS = [ctypes.c_long * size for size in range(33)]


def _longs(values: list[int]) -> Any:
    size = len(values)
    return (_LONGS[size] if size < len(_LONGS) else ctypes.c_long * size)(*values)


def threads_for(count: int) -> int:
    """Return the number of threads for so many instants, of all cases together."""
    return 1 if count < 2 * _PER_THREAD else min(_processors(), count // _PER_THREAD)


def in_threads(threads: int, count: int, task: Callable[[int, int], Result]) -> list[Result]:
    """Run a task (first, last) on slices of `count` items, one per thread; return the results."""
    if threads < 2:
        return [task(0, count)]
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - seldom needed

    ends = np.linspace(0, count, threads + 1).astype(int).tolist()
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(task, ends[:-1], ends[1:]))


def _processors() -> int:
    """Return the number of usable processors."""
    known = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    named = os.environ.get("OMP_NUM_THREADS", "")
    return min(known, int(named)) if named.isdecimal() and int(named) else known
