"""Integrations at constant step, evaluated at any instants by CasADi's interpreter or by one call of machine code.

States between the steps come from the polynomial of degree seven through values and rates at four of them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import prod
from threading import Lock
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.numerics.compiled_calls import Array
from servocore.numerics.just_in_time import JustInTime
from servocore.numerics.machine_code import Build
from servocore.numerics.memoization import made_once
from servocore.numerics.stepped_run_code import NO_MEMORY, NODES, SOUND, run_source
from servocore.numerics.vector_code import build_of_source
from servocore.numerics.vectorized import addresses, in_threads, loader, threads_for, widened

_BYTES = 8
_MOST_LOOPS = 32  # compiled loops that are kept, with memory for their arguments
_BESIDE = np.arange(NODES)[:, None]

Weigh = Callable[..., list[Array]]


@dataclass(frozen=True, eq=False)
class Run:
    """Steps from initial states, of one case or of many; arrays that differ between cases have a leading axis of cases.

    Attributes
    ----------
    begin, end : float
        First and last time, in s.
    count : int
        Number of steps, three or more.
    path : ndarray, shape (rows, count + 1)
        Path at the steps, the one after the last included, whose rates are read.
    numbers : ndarray, shape (size,)
        Coefficients of the path, where that is a formula.
    settings : ndarray, shape (1 + parameters,)
        The step in s, and the parameters.
    start : ndarray, shape (states,)
        Initial states.
    """

    begin: float
    end: float
    count: int
    path: Array
    numbers: Array
    settings: Array
    start: Array

    @property
    def h(self) -> float:
        """Step in s, the same for all cases."""
        return float(self.settings.flat[0])

    @property
    def cases(self) -> int | None:
        """Number of cases; None for a single one without an axis."""
        return max((len(array) for array, deep in self._arrays if deep), default=None)

    @property
    def _arrays(self) -> list[tuple[Array, bool]]:
        """The arrays, and whether each has an axis of cases."""
        arrays = (self.start, 1), (self.path, 2), (self.numbers, 1), (self.settings, 1)
        return [(array, array.ndim > own) for array, own in arrays]

    def part(self, cases: int | slice) -> Run:
        """Return one case without the axis, or some of them."""
        start, path, numbers, settings = (array[cases] if deep else array for array, deep in self._arrays)
        return replace(self, start=start, path=path, numbers=numbers, settings=settings)

    @cached_property  # used by every call
    def as_c(self) -> tuple[Any, Any, list[Array]]:
        """Sizes and addresses for machine code, and the arrays at these addresses."""
        held = [np.ascontiguousarray(array) for array, _ in self._arrays] + [np.array([self.begin, self.end])]
        apart = [
            array.strides[0] // _BYTES if deep else 0 for array, (_, deep) in zip(held, self._arrays, strict=False)
        ]
        sizes = [self.cases or 1, self.count, self.path.shape[-1], *apart]
        return (ctypes.c_long * len(sizes))(*sizes), (ctypes.c_void_p * len(held))(*addresses(held)), held


@dataclass(frozen=True, eq=False)
class Between:
    """Positions of instants between the steps of a run.

    Attributes
    ----------
    beside : ndarray, shape (4, N)
        Indices of the four steps around every instant.
    weights : ndarray, shape (2, 4, N)
        Hermite weights of the values there, and of the rates times h.
    """

    beside: npt.NDArray[np.intp]
    weights: Array

    @classmethod
    def of(cls, t: Array, run: Run, weigh: Weigh) -> Between:
        """Prepare for instants (N,) of a run; `weigh` is `hermite_weights` at so many instants."""
        (found,) = weigh(t, np.array([[run.begin], [run.h], [run.count + 1.0 - NODES]]))
        rows = np.ascontiguousarray(found)
        return cls(rows[0].astype(np.intp) + _BESIDE, rows[1:].reshape(2, NODES, -1))

    def states(self, table: Array) -> Array:
        """Return states (states, N) from values and rates times h, (2, states, count + 1)."""
        of_values, of_rates = table.take(self.beside, axis=2) * self.weights[:, None]
        terms = of_values + of_rates  # summed in the order of machine code, for the same digits
        halves = terms[:, :2] + terms[:, 2:]
        states: Array = halves[:, 0] + halves[:, 1]
        return states


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants at which runs are read, with their positions between the steps of the last run.

    Attributes
    ----------
    t : ndarray, shape (N,)
        In s; it must not change.
    path : ndarray, shape (rows, N), or (cases, rows, N)
        Path at these instants.
    """

    t: Array
    path: Array
    _between: dict[tuple[float, float, int], Between] = field(default_factory=dict, repr=False)

    def between(self, run: Run, weigh: Callable[[int], Weigh]) -> Between | None:
        """Return their positions between the steps of a run; None if an instant lies outside of it."""
        key = run.begin, run.end, run.count
        known = self._between.get(key)
        if known is None and self.t.min() >= run.begin and self.t.max() <= run.end:
            known = Between.of(self.t, run, weigh(len(self.t)))
            self._between.clear()
            self._between[key] = known
        return known

    def part(self, cases: int | slice) -> Instants:
        """Return the instants of one case, or of some."""
        return Instants(self.t, self.path[cases], self._between) if self.path.ndim > 2 else self

    @cached_property  # used by every call with the same instants
    def as_c(self) -> tuple[int, int, int, int, int, list[Array]]:
        """Addresses of times and path, strides of rows and cases of the path, number of instants, and the arrays.

        The last instant is repeated until a register is full.
        """
        t, path = (np.ascontiguousarray(widened(each)) for each in (self.t, self.path))
        lane = path.strides[0] // _BYTES if path.ndim > 2 else 0
        times, places = addresses([t, path])
        return times, places, len(t), lane, len(t), [t, path]


@made_once
def hermite_weights() -> ca.Function:
    """Return (time, [begin; h; last]) -> the first of four steps around it, and weights of their values and rates.

    Rates are those times h; no later step than the `last` is the first of four.
    """
    t, run, values, rates = ca.SX.sym("t"), ca.SX.sym("run", 3), list[ca.SX](), list[ca.SX]()
    place = (t - run[0]) / run[1]
    first = ca.fmax(ca.fmin(ca.floor(place) - (NODES // 2 - 1), run[2]), 0.0)
    s = place - first
    for i in range(NODES):
        others = [j for j in range(NODES) if j != i]
        basis = prod(s - j for j in others) * (1.0 / prod(i - j for j in others))
        slope = sum(1.0 / (i - j) for j in others)
        rates.append((s - i) * (basis * basis))
        values.append(basis * basis - (2.0 * slope) * rates[-1])
    return ca.Function("sc_hermite", [t, run], [ca.vertcat(first, *values, *rates)], {"cse": True})


class _InPlace:
    """An interpreted function of expressions with memory of its own for arguments and results.

    To copy small arguments takes half the time of passing their addresses. Threads take turns.
    """

    def __init__(self, function: ca.Function) -> None:
        self._buffer, self._evaluate = function.buffer()
        self._arguments = [np.empty(function.size_in(k), order="F") for k in range(function.n_in())]
        self._results = [np.empty(function.size_out(k), order="F") for k in range(function.n_out())]
        for k, array in enumerate(self._arguments):
            if array.size:
                self._buffer.set_arg(k, array.ravel(order="F").data)
        for k, array in enumerate(self._results):
            self._buffer.set_res(k, array.ravel(order="F").data)
        self._turn = Lock()

    def __call__(self, *arguments: Array) -> list[Array]:
        """Evaluate; an argument of one column is taken for all columns."""
        with self._turn:
            for memory, argument in zip(self._arguments, arguments, strict=True):
                memory[...] = argument
            self._evaluate()
            return [result.copy(order="K") for result in self._results]


# Construction costs more than evaluation, and each holds memory for its arguments.


@partial(made_once, most=_MOST_LOOPS)
def row_of(step: ca.Function, count: int) -> _InPlace:
    """Return so many steps in a row, from the first argument."""
    return _InPlace(step.mapaccum("sc_steps", count))


@partial(made_once, most=_MOST_LOOPS)
def map_of(function: ca.Function, along: int, count: int) -> _InPlace:
    """Return a function at so many instants, along which its first arguments vary."""
    same = [*range(along, function.n_in())]
    return _InPlace(function.map(f"{function.name()}_map", "serial", count, same, []))


class SteppedRuns:
    """Runs of one step function, read by another.

    Parameters
    ----------
    step : casadi.Function
        (states, path, numbers, [h; p]) -> (states after a step, rates before it).
    read : casadi.Function
        (states, path, numbers, p) -> results, from states and path at the same instant.
    positive : range
        Indices of the results that must be positive.
    native, of_what
        See `JustInTime`, also for exceptions; `of_what` names it in messages.
    """

    def __init__(
        self, step: ca.Function, read: ca.Function, positive: range, native: bool | None, of_what: str
    ) -> None:
        self.step, self.read, self._positive = step, read, positive
        self._columns = int(read.numel_out(0))
        self._weights = hermite_weights()
        self._of_what, many = of_what, ctypes.c_void_p
        self._code = JustInTime(self._build, loader(ctypes.c_int, *[many] * 4, *[ctypes.c_long] * 3, many), native)

    def _build(self) -> Build | None:
        step, read = self.step, self.read
        return build_of_source(lambda: run_source(step, self._weights, read, self._positive), self._of_what, step, read)

    def __call__(self, run: Run, instants: Instants) -> tuple[Array, bool]:
        """Step and read.

        Returns
        -------
        values : ndarray, shape (columns, N), or (cases, columns, N)
            Results.
        sound : bool
            Whether all times lie within the run, and all values are finite and of the right sign. Values of times
            outside the run are meaningless.
        """
        count, cases = len(instants.t), run.cases
        if not count:
            return np.empty((*(() if cases is None else (cases,)), self._columns, 0)), True
        code = self._code.best(count * (cases or 1))
        if code is not None:
            return _in_machine_code(code, run, instants, cases, self._columns)
        if cases is None:
            return self._interpreted(run, instants)
        found = [self._interpreted(run.part(case), instants.part(case)) for case in range(cases)]
        return np.stack([values for values, _ in found]), all(sound for _, sound in found)

    def states(self, run: Run) -> Array:
        """Return the states at the steps of a single case and their rates times h, (2, states, count + 1)."""
        step = row_of(self.step, run.count + 1)
        ends, rates = step(run.start[:, None], run.path, run.numbers[:, None], run.settings[:, None])
        table = np.empty((2, *rates.shape))
        table[0, :, 0], table[0, :, 1:] = run.start, ends[:, :-1]
        np.multiply(rates, run.h, out=table[1])
        return table

    def _interpreted(self, run: Run, instants: Instants) -> tuple[Array, bool]:
        count, between = len(instants.t), instants.between(run, self.weigh)
        if between is None:
            return np.full((self._columns, count), np.nan), False
        states = between.states(self.states(run))
        (values,) = map_of(self.read, 2, count)(states, instants.path, run.numbers[:, None], run.settings[1:, None])
        signs = values[self._positive.start : self._positive.stop]
        return values, bool(np.isfinite(values).all() and (not len(signs) or (signs > 0.0).all()))

    def weigh(self, count: int) -> Weigh:
        """Return the weights of four steps at so many instants."""
        return map_of(self._weights, 1, count)


def _in_machine_code(code: Any, run: Run, instants: Instants, cases: int | None, columns: int) -> tuple[Array, bool]:
    count = len(instants.t)
    values = np.empty((cases or 1, columns, instants.as_c[4]))

    def some(first: int, last: int) -> bool:
        whole, part = cases is None or last - first == cases, slice(first, last)
        sizes, arrays, _held = (run if whole else run.part(part)).as_c
        t, path, row, lane, width, _read = (instants if whole else instants.part(part)).as_c
        (target,) = addresses([values[part]])
        answer = code(sizes, arrays, t, path, row, lane, width, target)
        if answer == NO_MEMORY:
            raise MemoryError
        return bool(answer == SOUND)

    sound = all(in_threads(min(cases or 1, threads_for((cases or 1) * count)), cases or 1, some))
    values = values if len(values[0, 0]) == count else values[..., :count]
    return values if cases is not None else values[0], sound
