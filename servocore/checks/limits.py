"""Whether a reference keeps the limits of its scene at all times, also between the instants of a grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidReference, LimitBroken
from servocore.model.limits import Limit
from servocore.numerics.compiled_calls import Array
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.references.base import survey
from servocore.stepping.observation import compile_margins, limits_order
from servocore.stepping.path_function import PathFunction

_VALLEYS = 4  # lowest local minima of a limit that are refined
_CAUTION = 4.0  # between instants a smooth margin falls by an eighth of its second difference
_REFINED_POINTS = 21
_REFINEMENTS = 4


def require_feasible(problem: Problem, t: Array | None = None, native: bool | None = False) -> None:
    """Raise `InvalidReference` if the path breaks a limit anywhere, or at the instants `t` one that counts there only.

    `native` says whether machine code may evaluate the limits; see `Vectorized`.

    The margins are surveyed on a grid that follows the stretches of the path. Around the lowest local minima of each
    the grid is refined to 1e-4 of its spacing, unless they are so high that nothing between two instants can matter.
    """
    of_path = tuple(limit for limit in problem.limits if limit.of_path)
    _require_at(problem, tuple(each for each in of_path if each.at_instants_only), t, native)
    limits = tuple(each for each in of_path if not each.at_instants_only)
    if not limits:
        return
    t = survey(problem.reference)
    margins = _margins(problem, limits, t, native)
    _require_kept(limits, margins, t)
    if not _may_fall_to_zero(margins):
        return
    rows, places = _valleys(margins)
    below, above = t[np.maximum(places - 1, 0)], t[np.minimum(places + 1, len(t) - 1)]
    lanes = np.arange(len(rows))
    for _ in range(_REFINEMENTS):  # all valleys of all limits at once
        grid = np.linspace(below, above, _REFINED_POINTS)
        margins = _margins(problem, limits, grid.ravel(), native).reshape(len(limits), *grid.shape)
        lows = margins[rows, :, lanes]
        deepest = np.nan_to_num(lows, nan=-np.inf).argmin(axis=1)
        for lane in lanes[~(lows[lanes, deepest] > 0.0)]:
            _require_margin(limits[rows[lane]], lows[lane, deepest[lane]], float(grid[deepest[lane], lane]))
        below = grid[np.maximum(deepest - 1, 0), lanes]
        above = grid[np.minimum(deepest + 1, _REFINED_POINTS - 1), lanes]


def _require_kept(limits: tuple[Limit, ...], margins: Array, t: Array) -> None:
    for limit, margin in zip(limits, margins, strict=True):
        broken = ~(margin > 0.0)
        if broken.any():
            first = int(broken.argmax())
            _require_margin(limit, margin[first], float(t[first]))


def _require_margin(limit: Limit, margin: float, time: float) -> None:
    """Raise `InvalidReference` for a margin that is not positive."""
    # Written so that NaN is refused: it is neither above nor below.
    if not margin > 0.0:
        raise InvalidReference(
            f"at t = {time:.6g} s {limit.reason}: {limit.quantity} is {margin + limit.bound:.4g} {limit.unit},"
            f" it must stay above {limit.bound:g} {limit.unit}"
        )


def _may_fall_to_zero(margins: Array) -> bool:
    """Whether a margin (limits, N) may reach zero between instants, to judge by its second differences nearby."""
    bends = np.abs(np.diff(margins, 2, axis=1))
    nearby = np.concatenate([bends[:, :1], bends[:, :1], bends, bends[:, -1:], bends[:, -1:]], axis=1)
    largest = np.maximum(np.maximum(nearby[:, :-2], nearby[:, 1:-1]), nearby[:, 2:])
    return bool((margins <= _CAUTION * largest).any())


def _valleys(margins: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return rows and columns of the lowest local minima of every row, as many of each row (it saves compiling)."""
    padded = np.pad(margins, ((0, 0), (1, 1)), constant_values=np.inf)
    is_valley = (margins <= padded[:, :-2]) & (margins <= padded[:, 2:])
    places = np.argsort(np.where(is_valley, margins, np.inf), axis=1, kind="stable")[:, :_VALLEYS]
    return np.repeat(np.arange(len(margins)), places.shape[1]), places.ravel()


def _require_at(problem: Problem, limits: tuple[Limit, ...], t: Array | None, native: bool | None) -> None:
    if not limits or t is None:
        return
    for limit, margin in zip(limits, _margins(problem, limits, t, native), strict=True):
        lowest = int(np.nan_to_num(margin, nan=-np.inf).argmin())
        _require_margin(limit, margin[lowest], float(t[lowest]))


def _margins(problem: Problem, limits: tuple[Limit, ...], t: Array, native: bool | None) -> Array:
    """Return how far each limit is at the instants, shape (limits, N)."""
    return _compiled_margins(problem.resolved, limits, native)(problem, t)[0]


@made_once
def _compiled_margins(resolved: ResolvedSystem, limits: tuple[Limit, ...], native: bool | None) -> PathFunction:
    order = limits_order(resolved.system, limits)
    return PathFunction(compile_margins(resolved.system, limits, order), native, resolved.system.name)


_ROUND_OFF = 1e-9  # of the bounds: beyond them by less is on them
_BEND = 0.05  # of its range: a quantity that changes by more between two instants is evaluated in between
_SLIGHT = 1e-4  # of the bounds: a range that says nothing
_MOST_INSTANTS = 20_000
_HALVINGS = 50
_SECTIONS, _ROUNDS = 9, 5


@dataclass(frozen=True, eq=False)
class LimitSurvey:
    """Limits along a path, and the values that they compare, shape (limits, N), at any instants."""

    name: str
    limits: tuple[Limit, ...]
    wraps: tuple[bool, ...]
    evaluate: Callable[[Array], Array]
    sizes: tuple[float, ...] = ()

    def require(self, t: Array) -> None:
        """Raise `LimitBroken` for the limit that is broken first; `t` are instants to begin with."""
        t, values = self._dense(t)
        sized = replace(self, sizes=tuple(map(size_of_bounds, self.limits, values)))
        broken = [(*found, row) for row in range(len(self.limits)) if (found := sized._broken(row, t, values[row]))]
        if broken:
            first, worst, value, row = min(broken)
            raise LimitBroken(broken_limit(self.name, self.limits[row], first, worst, value))

    def _dense(self, t: Array) -> tuple[Array, Array]:
        """Return instants between which no quantity changes much, and the values there."""
        values = self._unwrapped(self.evaluate(t))
        while True:
            known = np.where(np.isfinite(values), values, 0.0)
            sizes = np.maximum(np.ptp(known, axis=1), _SLIGHT * np.array(list(map(size_of_bounds, self.limits, known))))
            steep = np.abs(np.diff(known, axis=1)) > _BEND * sizes[:, None]
            at = np.flatnonzero((steep & (np.diff(t) > 1e-9 * np.ptp(t))).any(axis=0))
            if not len(at) or len(t) + len(at) > _MOST_INSTANTS:
                return t, values
            middle = (t[at] + t[at + 1]) / 2
            values = self._unwrapped(np.insert(values, at + 1, self.evaluate(middle), axis=1))
            t = np.insert(t, at + 1, middle)

    def _unwrapped(self, values: Array) -> Array:
        for row in np.flatnonzero(self.wraps):
            values[row] = np.unwrap(values[row])
        return values

    def _broken(self, row: int, t: Array, values: Array) -> tuple[float, float, float] | None:
        """Return when a limit is broken first, and when it is worst and how the quantity is then; None if never."""
        margins = self._margin(row, values)
        bad = np.flatnonzero(~(margins >= 0.0))
        first = int(bad[0]) if len(bad) else len(t)
        for k in self._valleys(margins[: first + 1]):
            at, margin, value = self._lowest(row, t, values, int(k))
            if not margin >= 0.0:
                before = max(int(k) - 1, 0)
                return self._crossing(row, float(t[before]), at, float(values[before])), at, value
        if not len(bad):
            return None
        spell = bad[: 1 + int(np.argmax(np.diff([*bad, len(t) + 1]) > 1))]
        at, _, value = self._lowest(row, t, values, int(spell[np.nan_to_num(margins[spell], nan=-np.inf).argmin()]))
        if first == 0:
            return float(t[0]), at, value
        return self._crossing(row, float(t[first - 1]), float(t[first]), float(values[first - 1])), at, value

    def _valleys(self, margins: Array) -> npt.NDArray[np.intp]:
        """Return local minima that may come down to zero between instants, to judge by second differences."""
        if len(margins) < 3 or not np.isfinite(margins[:-1]).all():
            return np.zeros(0, dtype=np.intp)
        bend = np.abs(np.diff(margins, 2))
        low = (margins[1:-1] <= margins[:-2]) & (margins[1:-1] <= margins[2:]) & (margins[1:-1] <= bend)
        return np.flatnonzero(low & (margins[1:-1] >= 0.0)) + 1

    def _lowest(self, row: int, t: Array, values: Array, k: int) -> tuple[float, float, float]:
        """Return where a margin is lowest around an instant, that margin and the value."""
        begin, end, found = t[max(k - 1, 0)], t[min(k + 1, len(t) - 1)], (float(t[k]), 0.0, float(values[k]))
        if not np.isfinite(values[k]):
            return found
        for _ in range(_ROUNDS):
            at = np.linspace(begin, end, _SECTIONS)
            tried = self._near(row, at, float(values[k]))
            margins = np.nan_to_num(self._margin(row, tried), nan=np.inf)
            lowest = int(margins.argmin())
            begin, end = at[max(lowest - 1, 0)], at[min(lowest + 1, _SECTIONS - 1)]
            found = float(at[lowest]), float(margins[lowest]), float(tried[lowest])
        return found

    def _crossing(self, row: int, good: float, bad: float, near: float) -> float:
        """Return the first time at which a limit is broken, between one at which it is kept and one at which not."""
        for _ in range(_HALVINGS):
            middle = (good + bad) / 2
            if not good < middle < bad:
                break
            kept = self._margin(row, self._near(row, np.array([middle]), near))[0] >= 0.0
            good, bad = (middle, bad) if kept else (good, middle)
        return bad

    def _margin(self, row: int, values: Array) -> Array:
        return margin_within(self.limits[row], values, self.sizes[row])

    def _near(self, row: int, t: Array, near: float) -> Array:
        """Return the values of one row; an angle known up to full turns comes out near the value given."""
        values: Array = self.evaluate(t)[row]
        return values + 2.0 * np.pi * np.round((near - values) / (2.0 * np.pi)) if self.wraps[row] else values


def margin_within(limit: Limit, values: Array, size: float) -> Array:
    """Return how far values are within a limit, negative beyond it; a value on it up to round-off is within."""
    margins: Array = np.minimum(values - limit.bound, limit.upper - values) + _ROUND_OFF * size
    if limit.rate:  # of the length of a vector, where that is zero
        margins = np.where(np.isnan(margins), np.inf, margins)
    return margins


def size_of_bounds(limit: Limit, values: Array) -> float:
    """Return the size of the bounds, where these are zero that of the values."""
    known = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    bounds = max((abs(each) for each in (limit.bound, limit.upper) if np.isfinite(each)), default=0.0)
    return float(bounds or known)


def broken_limit(name: str, limit: Limit, first: float, worst: float, value: float) -> str:
    """Return the sentence that says when a limit is broken, and how far the quantity goes beyond it."""
    below = value - limit.bound < limit.upper - value
    which, bound = ("lower", limit.bound) if below else ("upper", limit.upper)
    why = f" {limit.reason}:" if limit.reason else ""
    if not np.isfinite(value):
        return f"{name}: at t = {first:.6g} s{why} {limit.quantity} is not finite, and has a limit"
    return (
        f"{name}: at t = {first:.6g} s{why} {limit.quantity} goes beyond its {which} limit of {limit.with_unit(bound)};"
        f" it reaches {limit.with_unit(value)} at t = {worst:.6g} s"
    )
