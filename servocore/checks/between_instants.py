"""Checks between the instants of a run: poles of inputs and tensions, peaks, and values of a wrong sign.

An input that grows towards a pole and comes back from it is small again at the next instant. Its second differences
stand out from those around: there, and only there, exact inversions are computed in between.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import partial

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import IntegrationFailed, ServocoreWarning
from servocore.model.quantity import Quantity
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.numerics.vectorized import Vectorized
from servocore.problem import Problem, ResolvedSystem
from servocore.solution import Solution

_STANDS_OUT = 4.0  # of the second differences beside it
_BESIDE = 3, 5  # from so many instants away to so many, on either side
_ROUND_OFF = 1e-7  # of the peak: a second difference that says nothing
_TIMES = 10.0  # the largest value at the instants: a peak that a run hides
_HUGE = 1e9  # times its typical magnitude: a peak that needs a word though an instant shows it
_POLE = 1e6  # times the largest value at the instants: it grows without bound
_FEW_TURNS, _OFTEN = 6, 0.05  # instants at which coordinates turn back, and their share
_SECTIONS, _ROUNDS = 17, 11
_NEARBY = 6  # rounds: as far as an eighth to this power of two intervals; nearer a singularity round-off may be all


def suspected_poles(problem: Problem, solution: Solution, native: bool | None = False) -> list[tuple[int, int]]:
    """Return (channel, instant) beside which an input or an observable may grow beyond all that a solution reports.

    `native` says whether machine code may look first whether there is any; see `Vectorized`.
    """
    t = solution.t
    if len(t) < 4 * _BESIDE[1] or len(solution.channels) < len(problem.system.inputs):
        return []
    columns, positive, coordinates = _watched(problem.resolved, solution.channels)
    if native is not False:
        alarm = _compiled_alarm(problem.resolved, solution.channels, native)
        if alarm.ready(len(t)) and not _alarming(alarm, solution.values, [*columns, *coordinates], positive):
            return []
    values = solution.values.T[[*columns, *coordinates]]
    standing_out = _marked(values, positive)
    own = set(problem.system.inputs)
    inputs = [row for row, k in enumerate(columns) if solution.channels[k] in own]
    turning_back = standing_out[len(columns) :].any(axis=0)  # coordinates do so short of a pole
    if turning_back.sum() <= max(_FEW_TURNS, _OFTEN * len(t)):  # a spinning body stands out everywhere
        standing_out[inputs] |= turning_back
    return [(columns[row], int(k) + 1) for row, k in np.argwhere(standing_out[: len(columns)])]


def _marked(values: Array, positive: list[int], peaks: Array | None = None) -> npt.NDArray[np.bool_]:
    """Return where values (rows, N) stand out, or may lose a sign that they must have; shape (rows, N - 2)."""
    bend = values[:, :-2] - values[:, 1:-1]
    bend -= values[:, 1:-1]
    bend += values[:, 2:]
    np.abs(bend, out=bend)
    marks = _standing_out(bend, _ROUND_OFF * (_peaks(values) if peaks is None else peaks))
    marks[positive] |= values[positive, 1:-1] <= bend[positive]
    return marks


def _peaks(values: Array) -> Array:
    peaks: Array = np.maximum(values.max(axis=1), -values.min(axis=1))
    return peaks


def _alarming(alarm: Vectorized, values: Array, rows: list[int], positive: list[int]) -> bool:
    """Whether something of values (N, channels) stands out: the first test of `_marked`, without storage.

    At both ends, where neighbours are missing, it looks itself.
    """
    known, ends = np.ascontiguousarray(values.T), 4 * _BESIDE[1]
    peaks, width = _peaks(known), 2 * _BESIDE[0] + 3
    inner = known.shape[1] - width + 1
    (alarms,) = alarm(*(known[:, k : k + inner] for k in range(width)), _ROUND_OFF * peaks)
    return bool(alarms.any()) or any(
        _marked(known[rows, part], positive, peaks[rows]).any() for part in (slice(ends), slice(-ends, None))
    )


@made_once
def _compiled_alarm(resolved: ResolvedSystem, channels: tuple[Quantity, ...], native: bool | None) -> Vectorized:
    """Compile (values at instants in a row, least) -> whether one stands out in the middle."""
    (columns, positive, coordinates), near = _watched(resolved, channels), _BESIDE[0]
    instants = [ca.SX.sym(f"at{k}", len(channels)) for k in range(2 * near + 3)]
    least, any_alarm = ca.SX.sym("least", len(channels)), ca.SX(0)
    for row, k in enumerate([*columns, *coordinates]):
        before, here, after = (
            ca.fabs(((instants[at - 1][k] - instants[at][k]) - instants[at][k]) + instants[at + 1][k])
            for at in (1, 1 + near, 1 + 2 * near)
        )
        beside = _STANDS_OUT * ca.fmax(before, after)
        any_alarm = ca.logic_or(any_alarm, ca.logic_and(here > least[k], here > beside))
        if row in positive:
            any_alarm = ca.logic_or(any_alarm, instants[1 + near][k] <= here)
    function = ca.Function("sc_alarm", [*instants, least], [ca.densify(any_alarm)])
    return Vectorized(function, [True] * len(instants) + [False], native, resolved.system.name)


def _standing_out(bend: Array, least: Array) -> npt.NDArray[np.bool_]:
    """Whether second differences (rows, N) are larger than those some instants beside, and than a negligible change.

    Few stand out of their own row: comparing neighbours is enough for most runs.
    """
    near, far = _BESIDE
    stands_out = bend > least[:, None]
    times = _STANDS_OUT * bend
    stands_out[:, near:] &= bend[:, near:] > times[:, :-near]
    stands_out[:, :-near] &= bend[:, :-near] > times[:, near:]
    if stands_out.any():
        rows, places = np.nonzero(stands_out)
        padded = np.pad(bend, ((0, 0), (far, far)))
        offsets = [far + sign * k for k in range(near, far + 1) for sign in (-1, 1)]
        beside = padded[rows[:, None], places[:, None] + offsets].max(axis=1)
        stands_out[rows, places] = bend[rows, places] > np.maximum(_STANDS_OUT * beside, least[rows])
    return stands_out


@made_once
def _watched(resolved: ResolvedSystem, channels: tuple[Quantity, ...]) -> tuple[list[int], list[int], list[int]]:
    """Return which channels are inputs or observables but angles, which of these must be positive, and coordinates."""
    system = resolved.system
    known = {*system.inputs, *system.observables}
    columns = [k for k, channel in enumerate(channels) if channel in known and channel.unit != "rad"]
    coordinates = [
        k for k, channel in enumerate(channels) if channel in system.coordinates.quantities and k not in columns
    ]
    return columns, [row for row, k in enumerate(columns) if channels[k].positive], coordinates


def refuse_or_warn_of_poles(
    solution: Solution, suspected: list[tuple[int, int]], values: Callable[[int, Array], Array]
) -> bool:
    """Refuse or warn of poles and peaks that exact inversions find beside some instants; return whether it warned.

    Parameters
    ----------
    solution : Solution
        Of a problem without internal dynamics.
    suspected : list of (int, int)
        Channels and instants.
    values : callable
        (channel, times (N,)) -> its exact values, shape (N,).

    Raises
    ------
    IntegrationFailed
        If something has a pole, or a sign that it must not have.

    Warns
    -----
    ServocoreWarning
        If something is much larger between two instants than at all of them, or than its typical magnitude.
    """
    hidden: dict[str, tuple[float, str]] = {}
    for channel, k in suspected:
        quantity, t = solution.channels[channel], solution.t
        sizes = np.abs(solution.values[:, channel])
        peak = float(sizes.max())
        begin, end = float(t[max(k - 1, 0)]), float(t[min(k + 1, len(t) - 1)])
        for time, value, nearby in _extremes(partial(values, channel), begin, end, quantity.positive):
            at = f"at t = {time:.9g} s {quantity.name} is {value:.4g} {quantity.unit}"
            if quantity.positive and not value > 0.0:
                raise IntegrationFailed(f"{solution.route}: between two instants, {at}, {quantity.wrong_sign}")
            if not nearby > peak and not quantity.positive:
                continue  # round-off, where the equations are singular and this value is not
            if not abs(value) < _POLE * peak:
                raise IntegrationFailed(
                    f"{solution.route}: {quantity.name} has a pole between two instants: {at}, and no more than"
                    f" {peak:.4g} {quantity.unit} at all instants"
                )
            usual = float(np.median(sizes))
            huge = abs(value) > _HUGE * quantity.magnitude and abs(value) > _TIMES * usual
            if huge or abs(value) > _TIMES * peak:
                said = f"{at}, at the instants at most {peak:.4g} and mostly {usual:.4g} {quantity.unit}"
                hidden[quantity.name] = max(hidden.get(quantity.name, (0.0, "")), (abs(value) / peak, said))
    if hidden:
        worst = max(hidden, key=lambda name: hidden[name][0])
        others = ", ".join(name for name in hidden if name != worst)
        warnings.warn(
            f"{solution.route}: the path passes close to a pole: {hidden[worst][1]}"
            f"{f'; so do {others} grow' if others else ''}; limits by name refuse such a path",
            ServocoreWarning,
            stacklevel=4,
        )
    return bool(hidden)


def _extremes(
    evaluate: Callable[[Array], Array], begin: float, end: float, downwards: bool
) -> Iterator[tuple[float, float, float]]:
    """Yield where a function is largest in magnitude between two times, and where it is smallest if requested.

    With the time and the value comes the largest magnitude that is seen before the last rounds, some millionths of the
    interval away.
    """
    for measure in (np.abs, np.negative) if downwards else (np.abs,):
        first, last, nearby = begin, end, 0.0
        for round_ in range(_ROUNDS):
            t = np.linspace(first, last, _SECTIONS)
            values = evaluate(t)
            known = np.nan_to_num(measure(values), nan=np.inf, posinf=np.inf)
            k = int(known.argmax())
            if round_ == _NEARBY:
                nearby = float(np.abs(np.nan_to_num(values, nan=np.inf)).min())
            first, last = t[max(k - 1, 0)], t[min(k + 1, _SECTIONS - 1)]
        yield float(t[k]), float(values[k]), nearby
