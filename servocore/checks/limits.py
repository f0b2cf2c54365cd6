"""Whether a reference keeps the limits of its scene at all times, also between the instants of a grid."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from servocore.checks.instants import survey
from servocore.model.limits import Limit
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.limit_margins import compile_margins, limit_texts, limits_order
from servocore.stepping.path_function import PathFunction
from servocore.stepping.program import LimitText, require_margins

_VALLEYS = 4  # lowest local minima of a limit that are looked at more closely
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
    texts = limit_texts(limits)
    t = survey(problem.reference)
    margins = _margins(problem, limits, t, native)
    _require_kept(texts, margins, t)
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
            require_margins((texts[rows[lane]],), lows[lane, deepest[[lane]]], float(grid[deepest[lane], lane]))
        below = grid[np.maximum(deepest - 1, 0), lanes]
        above = grid[np.minimum(deepest + 1, _REFINED_POINTS - 1), lanes]


def _require_kept(texts: tuple[LimitText, ...], margins: Array, t: Array) -> None:
    for text, margin in zip(texts, margins, strict=True):
        broken = ~(margin > 0.0)
        if broken.any():
            first = int(broken.argmax())
            require_margins((text,), margin[[first]], float(t[first]))


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
    for text, margin in zip(limit_texts(limits), _margins(problem, limits, t, native), strict=True):
        lowest = int(np.nan_to_num(margin, nan=-np.inf).argmin())
        require_margins((text,), margin[[lowest]], float(t[lowest]))


def _margins(problem: Problem, limits: tuple[Limit, ...], t: Array, native: bool | None) -> Array:
    """Return how far each limit is at the instants, shape (limits, N)."""
    return problem.resolved.once(_compiled_margins, limits, native)(problem, t)[0]


def _compiled_margins(resolved: ResolvedSystem, limits: tuple[Limit, ...], native: bool | None) -> PathFunction:
    order = limits_order(resolved.system, limits)
    return PathFunction(compile_margins(resolved.system, limits, order), native, resolved.system.name)
