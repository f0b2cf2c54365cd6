"""What a call of `DynamicInversion` costs beside its steps: the call, less what it calls, from a loop without Python.

A call of `DynamicInversion` takes steps, and evaluates the inputs at the instants: that is what one compiled function
does, or the loops of CasADi's interpreter. The same function with the same arguments is called again from a loop in C
(the interpreter's loops again on memory of their own), and what a call takes longer is beside the steps: checks,
arguments, results, and what is looked up. New instants are a table that was not asked for in the call before; the
interpreter then evaluates the polynomials between steps for them, which is part of what it calls, as it always is of
the compiled function. Calls follow one another here, so that all lies in the caches; among other work, as in the tables
of the study, they take longer. Sizes are numbers of steps, those of three tolerances.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

import servocore as sc
from benchmarks.chart.candidate import Array
from benchmarks.chart.own import PREPARED, PREPARED_TOLERANCES
from benchmarks.chart.timing import processor_time
from servocore.errors import InvalidSetting
from servocore.numerics.machine_code import Build, built
from servocore.numerics.stepped_runs import hermite_weights, map_of, row_of

SCENES: dict[str, Callable[[], sc.Scene]] = {
    "mass on car": sc.scenes.mass_on_car,
    "passive joint arm": sc.scenes.passive_joint_arm,
}
WORDS = "interpreted", "machine code"
TABLES = "", ", new instants"
MOST = 50.0
"""Microseconds that a call may take beside its steps."""
INSTANTS, CALLS, REPEATS = 201, 20, 40

_AGAIN = """
typedef int run(const long *, const double *const *, const double *, const double *, long, long, long, double *);
int sc_again(long times, run *of, const long *sizes, const double *const *in, const double *t, const double *path,
             long row, long lane, long count, double *out) {
 int answer = 0;
 for (long k = 0; k < times; ++k) answer |= of(sizes, in, t, path, row, lane, count, out);
 return answer;
}
"""

Run = Callable[[], object]


def name_of(scene: str) -> str:
    """Return how the rows of a scene are called."""
    return f"{PREPARED}, {scene}, {INSTANTS} instants"


def beside(words: str, table: str) -> str:
    """Return the name of the quantity that is judged."""
    return f"beside the steps, {words}{table}"


def judged() -> list[tuple[str, str]]:
    """Return what is to keep below `MOST`: (what, quantity)."""
    return [(name_of(scene), beside(words, table)) for scene in SCENES for words in WORDS for table in TABLES]


def measure_calls(smoke: bool = False) -> Iterator[tuple[str, int, str, float, str]]:
    """Measure all scenes: (what, steps, quantity, value, unit); of machine code, nothing without a compiler."""
    for name, make in [*SCENES.items()][: 1 if smoke else None]:
        for tolerance in PREPARED_TOLERANCES[: 1 if smoke else None]:
            for words in WORDS:
                try:
                    inputs = sc.DynamicInversion(make(), tolerance=tolerance, native=words == WORDS[1])
                except InvalidSetting:
                    continue
                for quantity, value in _one(inputs, words, 2 if smoke else REPEATS):
                    yield name_of(name), inputs.steps, quantity, value, "us"


def _one(inputs: sc.DynamicInversion, words: str, repeats: int) -> Iterator[tuple[str, float]]:
    path = inputs._problem.reference
    t = np.linspace(path.start_time, path.end_time, INSTANTS)
    tables = [t - 1e-9 * k * (t - path.start_time) for k in range(CALLS)]
    calls: dict[str, Run] = {
        TABLES[0]: lambda: [inputs(t) for _ in range(CALLS)],
        TABLES[1]: lambda: [inputs(each) for each in tables],
    }
    calls[TABLES[1]]()
    bare = _in_c(inputs, t) if words == WORDS[1] else _interpreted(inputs)
    times = _microseconds([*calls.values(), *bare.values()], repeats)
    of_calls, of_bare = times[: len(calls)], times[len(calls) :]
    for table, whole, work in zip(TABLES, of_calls, of_bare, strict=True):
        yield f"a call, {words}{table}", whole
        yield f"its steps and inputs alone, {words}{table}", work
        yield beside(words, table), whole - work


def _in_c(inputs: sc.DynamicInversion, t: Array) -> dict[str, Run]:
    """Return the compiled function in a loop; instants that are new make no difference to it."""
    again = ctypes.CDLL(str(built(Build(_AGAIN, "a loop")))).sc_again
    many, one = ctypes.c_void_p, ctypes.c_long
    again.restype, again.argtypes = ctypes.c_int, [one, *[many] * 5, one, one, one, many]
    (sizes, arrays, _), instants = inputs._run.as_c, inputs._instants(t)
    code = inputs._steps.runs._code.best(INSTANTS)
    if code is None:
        raise ArithmeticError("there is no machine code")
    compiled, values = ctypes.cast(code, many), np.empty((len(inputs.inputs), INSTANTS))

    def run() -> Array:
        if again(CALLS, compiled, sizes, arrays, *instants.as_c[:5], values.ctypes.data):
            raise ArithmeticError("the function does not find the inputs sound")
        return values

    if not np.array_equal(run().T, inputs(t)):
        raise ArithmeticError("the function alone gives other inputs")
    return dict.fromkeys(TABLES, run)


def _interpreted(inputs: sc.DynamicInversion) -> dict[str, Run]:
    """Return the interpreter's loops, on the arguments of the last call."""
    runs = inputs._steps.runs
    steps = row_of(runs.step, inputs.steps + 1)
    loops = [steps, map_of(runs.read, 2, INSTANTS), map_of(hermite_weights(), 1, INSTANTS)]

    def again(of: Sequence[Run]) -> None:
        for _ in range(CALLS):
            for evaluate in of:
                evaluate()

    every = [each._evaluate for each in loops]
    return {TABLES[0]: partial(again, every[:2]), TABLES[1]: partial(again, every)}


def _microseconds(runs: Sequence[Run], repeats: int) -> list[float]:
    """Return the smallest processor time of every run, each of them in its turn, for one of its calls."""
    found = []
    for _ in range(repeats):
        times = []
        for run in runs:
            begin = processor_time()
            run()
            times.append(processor_time() - begin)
        found.append(times)
    return [1e6 * min(times) / CALLS for times in zip(*found, strict=True)]
