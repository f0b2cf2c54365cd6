"""A compiled function at many instants, and of many cases: by CasADi's interpreter, or as machine code."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from servocore.numerics.compiled_calls import Array, mapped
from servocore.numerics.just_in_time import LANES, NAME, JustInTime

if TYPE_CHECKING:
    from pathlib import Path

    from servocore.numerics.machine_code import Build

_BYTES = 8
_AT_ONCE = 1 << 16  # instants that the interpreter evaluates together: a million would fill the memory
_PER_THREAD = 100_000  # instants that are worth a thread of their own


class Vectorized:
    """A function of arguments that go along with the instants and of others that are shared by all.

    Parameters
    ----------
    function : casadi.Function
        With dense arguments and results; one of expressions can become machine code.
    along : sequence of bool
        Which arguments go along with the instants.
    native, of_what, again
        See `JustInTime`, also for what is raised; `of_what` is for messages.
    """

    def __init__(
        self, function: ca.Function, along: Sequence[bool], native: bool | None, of_what: str, *, again: bool = False
    ) -> None:
        self.function, self._along = function, tuple(along)
        self._sizes = [function.numel_out(k) for k in range(function.n_out())]
        self._of_what = of_what
        self._code = JustInTime(self._build, _loaded, native, again)

    def _build(self) -> Build | None:
        from servocore.numerics.vector_code import build_of_vectors  # noqa: PLC0415 - few compile

        return build_of_vectors(self.function, self._along, self._of_what)

    def ready(self, count: int, called: bool = True) -> bool:
        """Whether machine code is there for so many instants; a call (is this one?) brings it nearer."""
        return self._code.best(count, called) is not None

    def __call__(self, *arguments: Array) -> list[Array]:
        """Evaluate.

        Parameters
        ----------
        *arguments : ndarray
            Of one that goes along, shape (rows, N), or (cases, rows, N); of one that is shared, (size,), or
            (cases, size). Entries of a row must lie side by side.

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
        parts = [self.interpreted(*self._of_case(arguments, case)) for case in range(cases)]
        return [np.stack(of_cases) for of_cases in zip(*parts, strict=True)]

    def interpreted(self, *arguments: Array) -> list[Array]:
        """Evaluate one case by CasADi's interpreter."""
        count = arguments[self._along.index(True)].shape[-1]
        if not count:
            return [np.empty((size, 0)) for size in self._sizes]
        parts = [
            self._together(
                [a[:, k : k + _AT_ONCE] if along else a for a, along in zip(arguments, self._along, strict=True)]
            )
            for k in range(0, count, _AT_ONCE)
        ]
        return [np.concatenate(of_parts, axis=1) for of_parts in zip(*parts, strict=True)] if parts[1:] else parts[0]

    def _together(self, arguments: Sequence[Array]) -> list[Array]:
        count = arguments[self._along.index(True)].shape[-1]
        pairs = zip(arguments, self._along, strict=True)
        results = mapped(self.function, count)(*[a if along else np.tile(a, count) for a, along in pairs])
        return [result.reshape(-1, count, order="F") for result in results]

    def _of_case(self, arguments: tuple[Array, ...], case: int) -> list[Array]:
        return [a[case] if a.ndim == 2 + along else a for a, along in zip(arguments, self._along, strict=True)]

    def _in_machine_code(self, run: Any, arguments: tuple[Array, ...], cases: int, count: int) -> list[Array]:
        if count < LANES:
            widened = self._in_machine_code(run, self._widened(arguments, count), cases, LANES)
            return [result[..., :count] for result in widened]
        held, row, lanes = self._placed(arguments)
        results = [np.empty((cases, size, count)) for size in self._sizes]
        sources, targets = (addresses(arrays) for arrays in (held, results))
        threads = threads_for(cases * count)
        if threads < 2:
            run(cases, count, _longs(sources), row, _longs(lanes), _longs(targets), count)
            return results

        def some(first: int, last: int, begin: int, end: int) -> None:
            """Evaluate some cases at some instants."""
            places = [
                source + _BYTES * (first * lane + begin * along)
                for source, lane, along in zip(sources, lanes, self._along, strict=True)
            ]
            ends = [
                target + _BYTES * (first * size * count + begin)
                for target, size in zip(targets, self._sizes, strict=True)
            ]
            run(last - first, end - begin, _longs(places), row, _longs(lanes), _longs(ends), count)

        from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - few have so much to do

        by_case = cases >= threads
        parts = np.linspace(0, cases if by_case else count, threads + 1).astype(int).tolist()
        shares = [(a, b, 0, count) if by_case else (0, cases, a, b) for a, b in pairwise(parts)]
        with ThreadPoolExecutor(threads) as pool:
            for task in [pool.submit(some, *share) for share in shares]:
                task.result()
        return results

    def _widened(self, arguments: tuple[Array, ...], count: int) -> tuple[Array, ...]:
        """Repeat the last instant until a register is full."""
        some = np.minimum(np.arange(LANES), count - 1)
        return tuple(a[..., some] if along else a for a, along in zip(arguments, self._along, strict=True))

    def _placed(self, arguments: tuple[Array, ...]) -> tuple[list[Array], Any, list[int]]:
        """Return the arguments as the compiled function reads them, and how far rows and cases lie apart."""
        held = [a if a.strides[-1] == _BYTES else np.ascontiguousarray(a) for a in arguments]
        pairs = list(zip(held, self._along, strict=True))
        row = _longs([a.strides[-2] // _BYTES if along else 0 for a, along in pairs])
        return held, row, [a.strides[0] // _BYTES if a.ndim == 2 + along else 0 for a, along in pairs]


class Extremes(Vectorized):
    """Highest and lowest value of every result over the instants; what is between them is not kept.

    A call returns arrays (2, rows), or (cases, 2, rows): NaN where a value is no finite number at some instant.
    """

    def interpreted(self, *arguments: Array) -> list[Array]:
        """Evaluate one case by CasADi's interpreter."""
        return [extremes_of(values) for values in super().interpreted(*arguments)]

    def _build(self) -> Build | None:
        from servocore.numerics.vector_code import build_of_extremes  # noqa: PLC0415 - few compile

        return build_of_extremes(self.function, self._along, self._of_what)

    def _in_machine_code(self, run: Any, arguments: tuple[Array, ...], cases: int, count: int) -> list[Array]:
        if count < LANES:
            return self._in_machine_code(run, self._widened(arguments, count), cases, LANES)
        held, row, lanes = self._placed(arguments)
        results = [np.empty((cases, 2, size)) for size in self._sizes]
        run(cases, count, _longs(addresses(held)), row, _longs(lanes), _longs(addresses(results)), count)
        return results


def _loaded(library: Path) -> Any:
    """Return what runs from a library."""
    run = getattr(ctypes.CDLL(str(library)), NAME)
    run.restype, many = None, ctypes.c_void_p
    run.argtypes = [ctypes.c_long, ctypes.c_long, many, many, many, many, ctypes.c_long]
    return run


def extremes_of(rows: Array) -> Array:
    """Return highest and lowest values (..., 2, rows) of rows (..., rows, N), NaN where one is no finite number."""
    extremes = np.stack([rows.max(axis=-1), rows.min(axis=-1)], axis=-2)
    extremes[~np.isfinite(extremes).all(axis=-2, keepdims=True).repeat(2, axis=-2)] = np.nan
    return extremes


def addresses(arrays: Sequence[Array]) -> list[int]:
    """Return the addresses of arrays in memory, for machine code."""
    return [array.__array_interface__["data"][0] for array in arrays]


_LONGS = [ctypes.c_long * size for size in range(33)]


def _longs(values: list[int]) -> Any:
    size = len(values)
    return (_LONGS[size] if size < len(_LONGS) else ctypes.c_long * size)(*values)


def threads_for(count: int) -> int:
    """Return how many threads so many instants are worth, of all cases together."""
    return 1 if count < 2 * _PER_THREAD else min(_processors(), count // _PER_THREAD)


def _processors() -> int:
    """Return how many threads may run at once."""
    known = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    named = os.environ.get("OMP_NUM_THREADS", "")
    return min(known, int(named)) if named.isdecimal() and int(named) else known
