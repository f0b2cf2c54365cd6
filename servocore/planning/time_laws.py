"""Given laws, as fast as limits allow: starts of a plan, and laws for comparison."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from servocore.numerics.compiled_calls import Array
from servocore.planning.integrator_chains import Law, sampled_law
from servocore.planning.transcription import Task
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.profiles import DEGREE9, DEGREE13, PolynomialProfile, Profile, polynomial, three_phase
from servocore.references.timed_path import TimedPath

_FINE, _DRAWN = 2001, 400
_LOOKED_AT, _SEARCHED_AT = (201, 2001), (61, 601)  # instants, coarse and fine: by a formula, by Newton's method
_FACTOR = 1.04
_TRIED = 120
_HALVINGS = 24
_RAMPS = (0.02, 0.5)
_TRIED_RAMPS, _ROUNDS = 13, 4

LONGEST = 1e6
"""Seconds that laws to compare with may take."""


def smooth_polynomial(length: int) -> PolynomialProfile:
    """Return the polynomial law from rest to rest with as many derivatives zero at its ends as a chain is long."""
    return {4: DEGREE9, 6: DEGREE13}.get(length) or polynomial(2 * length + 1)


def peaks(profile: Profile, order: int) -> Array:
    """Return the largest derivatives 0 to `order` at duration one."""
    return np.asarray(np.abs(_jets(np.zeros(1), np.ones(1), profile, order, _FINE)[0]).max(axis=1))


def polynomial_path(curve: PiecewisePolynomial, duration: float, length: int) -> TimedPath:
    """Return a curve with the polynomial law in a duration, for pictures: nearly exact."""
    law = law_between(np.zeros(1), np.ones(1), length, smooth_polynomial(length), duration, _DRAWN)
    return TimedPath.of(curve, law.path())


def law_between(start: Array, end: Array, length: int, profile: Profile, duration: float, intervals: int) -> Law:
    """Return a law of one profile for all chains, on a grid."""
    jets = _jets(start, end, profile, length, intervals + 1) / duration ** np.arange(length + 1)[:, None]
    return sampled_law(jets.transpose(1, 2, 0), duration, length)


def shortest(task: Task, profile: Profile) -> float:
    """Return the shortest duration at which a law keeps all limits; infinite if there is none."""
    coarse, fine = (partial(_kept, task, _jets_of(task, profile, k)) for k in range(2))
    return shortest_kept(fine, coarse)


def shortest_kept(kept: Callable[[float], bool], roughly: Callable[[float], bool] = lambda _: True) -> float:
    """Return the shortest duration at which a law keeps all limits; infinite if there is none.

    A longer one may break a limit again, so that durations are tried from short to long.

    Parameters
    ----------
    kept : callable
        Whether a law of a duration keeps all limits.
    roughly : callable, optional
        The same at less cost; False must be right.
    """

    def both(duration: float) -> bool:
        return roughly(duration) and kept(duration)

    longest = 1.0
    while not both(longest):
        longest *= 2.0
        if longest > LONGEST:
            return np.inf
    return _first_kept(both, (longest * _FACTOR ** np.arange(-_TRIED, 1)).tolist(), _HALVINGS)


def shortest_three_phase(task: Task, near: float) -> tuple[float, float]:
    """Return the shortest duration of a three-phase law and the ramp's share of it; `near` is that of another law."""
    durations = dict[float, float]()
    low, high = _RAMPS
    tried = (near * _FACTOR ** np.arange(-_TRIED // 4, _TRIED // 8)).tolist()
    for _ in range(_ROUNDS):
        for ramp in np.linspace(low, high, _TRIED_RAMPS).tolist():
            if ramp not in durations:
                jets = _jets_of(task, three_phase(ramp), 0)
                durations[ramp] = _first_kept(partial(_kept, task, jets), tried, _HALVINGS // 3)
        best = min(durations, key=lambda each: durations[each])
        reach = (high - low) / (_TRIED_RAMPS - 1)
        low, high = max(best - reach, _RAMPS[0]), min(best + reach, _RAMPS[1])
    return shortest(task, three_phase(best)), best


def _first_kept(kept: Callable[[float], bool], tried: Sequence[float], halvings: int) -> float:
    """Return the first of some durations at which limits are kept, less what bisection saves; infinite without one."""
    good = next((duration for duration in tried if kept(duration)), np.inf)
    bad = good / _FACTOR
    for _ in range(halvings if good < np.inf else 0):
        middle = (bad + good) / 2.0
        bad, good = (bad, middle) if kept(middle) else (middle, good)
    return good


def _jets_of(task: Task, profile: Profile, fine: int) -> Array:
    counts = _SEARCHED_AT if task.inner.size else _LOOKED_AT
    return _jets(task.start, task.end, profile, task.orders - 1, counts[fine])


def _jets(start: Array, end: Array, profile: Profile, order: int, count: int) -> Array:
    """Return chains' derivatives by a profile at duration one, shape (C, order + 1, count)."""
    parts = np.linspace(0.0, 1.0, count)
    jets: Array = (end - start)[:, None, None] * profile.jet(parts, 1.0 - parts, 1.0, order).T
    jets[:, 0] += start[:, None]
    return jets


def _kept(task: Task, jets: Array, duration: float) -> bool:
    """Whether a law keeps the limits, without the margin of a plan."""
    stretched = jets / duration ** np.arange(jets.shape[1])[:, None]
    bounds = np.where(np.isfinite(task.lower), -1.0, -np.inf)[:, None]
    values, integrands = task.values(stretched)
    kept = ((values <= 1.0) & (values >= bounds)).all()
    return bool(kept and (task.over_all(integrands[:, None], duration) <= 0.0).all())
