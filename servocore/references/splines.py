"""Smooth paths through waypoints and through samples: splines, of degree 9 by default."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidReference, require_real
from servocore.references.base import FloatArray, numbers_of, points, positive_time, times_of
from servocore.references.bspline import REST_ORDER, Ends, fit, interpolation_knots, joined, to_path
from servocore.references.piecewise import PiecewisePolynomial
from servocore.references.profiles import three_phase

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

ROUNDING = 1e-12
"""Samples without a tolerance are taken as exact up to this fraction of the largest coordinate."""

DOUBT = 0.25
"""Largest fraction of its peak by which a derivative may depend on the choice of samples, by default."""

_MANY_ROUGH, _WORTH = 20_000, 0.01  # samples; a tolerance that is more than this part of the extent hides the path
_FEW, _PER_UNKNOWN = 5_000, 5  # samples fitted first where there are very many


def through(
    waypoints: npt.ArrayLike,
    times: npt.ArrayLike | None = None,
    duration: float | None = None,
    *,
    rest_order: int = REST_ORDER,
    velocities: npt.ArrayLike | None = None,
    stops: npt.ArrayLike | None = None,
) -> PiecewisePolynomial:
    """Smooth path through waypoints, from rest to rest.

    The spline of degree 2 k + 1, k = `rest_order`, with knots at the waypoints: C^(2 k) between start and end,
    where derivatives 1 to k vanish; of all such curves, it has the least integral of ``|gamma^(k + 1)|^2``. Between
    two waypoints alone it is `rest_to_rest` with a polynomial of that degree, `DEGREE9` for k = 4. Before the
    start and after the end it rests. It does not stop at inner waypoints unless in `stops`, and may swing out where
    neighbouring legs differ much in speed: choose times, or velocities, accordingly.

    Parameters
    ----------
    waypoints : array_like, shape (n, dimension)
        At least two points in m.
    times : array_like, shape (n,), optional
        When to be there, in s, increasing.
    duration : float, optional
        Instead of times: the whole time in s. Times are then chosen so that the way along the polyline of
        waypoints is a three-phase motion with ramps of a quarter of the duration, and start at 0.
    rest_order : int
        The k above, one or more: as many derivatives as the inputs contain (velocity, acceleration, jerk, snap).
    velocities : array_like, shape (n, dimension), optional
        In m/s, to be met at the waypoints; NaN where any is right. The path is C^(2 k - 1) there.
    stops : array_like of bool, shape (n,), optional
        Where the path comes to rest in between: derivatives 1 to k vanish.

    Returns
    -------
    PiecewisePolynomial
        The path, `smoothness` k, `max_order` 2 k + 1, exact at the waypoints.

    Raises
    ------
    InvalidReference
        If waypoints or times are not finite, times do not increase, neighbouring waypoints coincide and no
        times are given, not exactly one of times and duration is given, `rest_order` is not a whole number from 1, or
        the path would move where it rests.
    """
    return joined_legs(waypoints, times, duration, rest_order, velocities, stops, "waypoint {}".format)


def joined_legs(
    waypoints: npt.ArrayLike,
    times: npt.ArrayLike | None,
    duration: float | None,
    rest_order: int,
    velocities: npt.ArrayLike | None,
    stops: npt.ArrayLike | None,
    called: Callable[[int], str],
) -> PiecewisePolynomial:
    """Return the path of `through`; refusals call a waypoint, which they know by its number, as the caller does."""
    resting = Ends(start=True, end=True, order=rest_order)
    table = points(waypoints, "waypoint")
    if len(table) < 2:
        raise InvalidReference("a path needs at least two waypoints, not one")
    if (times is None) == (duration is None):
        raise InvalidReference("give either the times of the waypoints or the duration of the whole path")
    at = _chord_times(table, duration) if duration is not None else _increasing(times, len(table), "waypoint")
    ends = [0, *_inner_stops(stops, len(table)), len(table) - 1]
    speeds = _speeds(velocities, table, ends, called)
    speeds[ends] = np.nan  # the path rests there
    legs = []
    for first, last in pairwise(ends):
        leg = slice(first, last + 1)
        known = np.isfinite(speeds[leg]).all(axis=1)
        knots = np.sort(np.concatenate([interpolation_knots(at[leg], resting), at[leg][known]]))
        spline = fit(at[leg], table[leg], knots, resting, speeds[leg])
        legs.append(to_path(spline, resting, None))
    return joined(legs)


def _inner_stops(stops: npt.ArrayLike | None, count: int) -> list[int]:
    """Return the numbers of inner waypoints at which the path rests."""
    if stops is None:
        return []
    wanted = np.asarray(stops)
    if wanted.shape != (count,) or wanted.dtype != bool:
        raise InvalidReference(f"the stops of {count} waypoints are {count} times True or False")
    return [int(place) for place in np.flatnonzero(wanted[1:-1]) + 1]


def _speeds(
    velocities: npt.ArrayLike | None, waypoints: FloatArray, rests: Sequence[int], called: Callable[[int], str]
) -> FloatArray:
    """Return velocities (n, dimension), NaN where none is given; refuse those that move where the path rests."""
    if velocities is None:
        return np.full_like(waypoints, np.nan)
    speeds = numbers_of(velocities, "the velocities of waypoints").copy()
    if speeds.shape != waypoints.shape or np.isinf(speeds).any():
        raise InvalidReference(
            f"{waypoints.shape} waypoints need as many finite velocities (NaN where any is right), not an array of"
            f" shape {speeds.shape}"
        )
    partly = np.flatnonzero(np.isfinite(speeds).any(axis=1) & np.isnan(speeds).any(axis=1))
    if partly.size:
        raise InvalidReference(f"{called(partly[0])} has a velocity in some directions only: give all or none")
    for waypoint in rests:
        if np.nan_to_num(speeds[waypoint]).any():
            raise InvalidReference(f"{called(waypoint)} has a velocity, but the path rests there")
    return speeds


def sampled(
    t: npt.ArrayLike,
    positions: npt.ArrayLike,
    tolerance: float | None = None,
    *,
    rest_order: int = REST_ORDER,
    doubt: float = DOUBT,
) -> PiecewisePolynomial:
    """Smooth path through, or close to, many samples of position.

    The least-squares spline of degree 2 k + 1, k = `rest_order`, with the fewest evenly chosen knots (1, 2, 4, ...
    pieces) that comes within the tolerance of every sample; if it takes more than a third of the samples as
    unknowns, the interpolating spline. Few knots keep rounding out of the derivatives. Ends count as being at rest
    (derivatives 1 to k zero) if the samples agree with that as well as without; the path then rests outside,
    otherwise the end polynomial goes on.

    The samples are checked for consistency: the path is fitted twice more, each time to every second sample.
    Derivative k must be the same within a fraction `doubt` of its peak; corners, jumps and noise fail, since there it
    grows with the density of the samples. The distance of the samples left out is the `fit_error`, an upper estimate;
    `refitted` returns both paths again, and `Solution.fit_effect` what they change in the inputs.

    Parameters
    ----------
    t : array_like, shape (n,)
        Sample times in s, increasing, at least 4 k + 4; they need not be evenly spaced.
    positions : array_like, shape (n, dimension)
        Samples in m.
    tolerance : float, optional
        How far the path may stay away from a sample, in m: the size of the noise or of the rounding. Without
        it, the samples are taken as exact to 1e-12 of their largest coordinate.
    rest_order : int
        The k above, one or more: as many derivatives as the inputs contain (velocity, acceleration, jerk, snap).
    doubt : float
        Largest fraction of its peak by which derivative k may depend on the choice of samples, positive.

    Returns
    -------
    PiecewisePolynomial
        The path; `max_order` 2 k + 1; `smoothness` 2 k, or k if it rests at an end.

    Raises
    ------
    InvalidReference
        If samples are not finite, too few, not increasing in time, too rough (naming the time), or a setting is wrong.
    """
    free = Ends(start=False, end=False, order=rest_order)
    table = points(positions, "sample")
    times = _increasing(t, len(table), "sample")
    if len(table) < (fewest := fewest_samples(rest_order)):
        raise InvalidReference(
            f"{len(table)} samples are too few: a sampled path needs at least {fewest}, half of them to fit it"
            " and half to check it (a path through fewer points is a path through waypoints)"
        )
    require_real(tolerance or 0.0, "the tolerance of a sampled path", "a length in m", InvalidReference)
    require_real(doubt, "the doubt about a sampled path", "a positive fraction", InvalidReference)
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance >= 0.0):
        raise InvalidReference(f"the tolerance of a sampled path must be a length in m, not {tolerance}")
    if not doubt > 0.0:
        raise InvalidReference(f"the doubt about a sampled path must be a positive fraction, not {doubt}")
    allowed = max(tolerance or 0.0, ROUNDING * float(np.abs(table).max()))
    try:
        return _within(times, table, free, allowed, doubt)
    except InvalidReference as error:
        enough = _tolerance_that_does(times, table, free, doubt)
        raise InvalidReference(f"{error}; {enough:.2g} m would do" if enough else str(error)) from None


def fewest_samples(rest_order: int = REST_ORDER) -> int:
    """Return how many samples `sampled` needs: half of them must determine a polynomial that the others check."""
    return 4 * (rest_order + 1)


def _tolerance_that_does(t: FloatArray, positions: FloatArray, free: Ends, doubt: float) -> float | None:
    """Return the least tolerance, in two digits, with which rough samples make a path; None if none is worth it."""
    if len(t) > _MANY_ROUGH:
        return None  # dozens of fits
    extent = float(np.ptp(positions, axis=0).max())
    for inner_knots in reversed([*_even_knots(t, max(len(t) // 3 - free.degree, 1))]):
        distance = float(_distance(fit(t, positions, inner_knots, free)(t), positions).max())
        digit = 10.0 ** (np.floor(np.log10(max(distance, 1e-300))) - 1.0)
        tolerance = float(np.ceil(distance / digit) * digit)
        if tolerance > _WORTH * extent:
            return None
        with suppress(InvalidReference):
            _within(t, positions, free, tolerance, doubt)
            return tolerance
    return None


class _Fit(NamedTuple):
    """A spline, how its ends were treated, and its inner knots if they are to stay (None: interpolation)."""

    spline: BSpline
    ends: Ends
    inner_knots: FloatArray | None


def _even_knots(t: FloatArray, most: int) -> Iterator[FloatArray]:
    """Yield the inner knots of 1, 2, 4, ... pieces, at most so many: evenly chosen samples."""
    for k in range(max(most, 0).bit_length()):
        yield t[np.linspace(0, len(t) - 1, 2**k + 1).round().astype(int)[1:-1]]


def _fewest_knots(t: FloatArray, positions: FloatArray, free: Ends, allowed: float) -> _Fit | None:
    """Return the coarsest fit within `allowed` (m), preferably at rest at its ends, or None."""
    for inner_knots in _even_knots(t, len(t) // 3 - free.degree):
        if _surely_too_few(t, positions, inner_knots, free, allowed):
            continue
        fitted = _Fit(fit(t, positions, inner_knots, free), free, inner_knots)
        if _distance(fitted.spline(t), positions).max() > allowed:
            continue
        for start, end in ((True, True), (True, False), (False, True)):
            ends = replace(free, start=start, end=end)
            spline = fit(t, positions, inner_knots, ends)
            if _distance(spline(t), positions).max() <= allowed:
                return _Fit(spline, ends, inner_knots)
        return fitted
    return None


def _surely_too_few(t: FloatArray, positions: FloatArray, inner_knots: FloatArray, free: Ends, allowed: float) -> bool:
    """Whether a few of very many samples show that no spline with these knots is within `allowed` of them all.

    The root of the mean square distance from these few is least for their own least-squares spline. For any other it is
    larger, and the largest distance from all samples is larger still.
    """
    few = max(_FEW, _PER_UNKNOWN * (len(inner_knots) + free.degree + 1))
    if 4 * few > len(t):
        return False
    chosen = np.linspace(0, len(t) - 1, few).round().astype(int)
    spline = fit(t[chosen], positions[chosen], inner_knots, free)
    return bool(np.sqrt(np.mean(_distance(spline(t[chosen]), positions[chosen]) ** 2)) > allowed)


def _interpolation(t: FloatArray, positions: FloatArray, free: Ends) -> _Fit:
    """Return the spline through all samples; an end rests if that predicts left-out samples as well."""
    rounding = 100.0 * np.finfo(np.float64).eps * float(np.abs(positions).max())
    moving, start, end = (
        np.max([_distance(half(t), positions) for half in _half_fits(t, positions, ends)], axis=0)
        for ends in (free, replace(free, start=True), replace(free, end=True))
    )
    near = free.degree + 1  # samples that the treatment of an end moves most
    ends = replace(
        free,
        start=bool(start[:near].max() <= 2.0 * moving[:near].max() + rounding),
        end=bool(end[-near:].max() <= 2.0 * moving[-near:].max() + rounding),
    )
    return _Fit(fit(t, positions, interpolation_knots(t, ends), ends), ends, None)


def _half_fits(
    t: FloatArray, positions: FloatArray, ends: Ends, inner_knots: FloatArray | None = None
) -> Iterator[BSpline]:
    """Fit every second sample, then every other one, first and last with both; by interpolation if without knots."""
    for first in (2, 1):
        chosen = np.zeros(len(t), dtype=bool)
        chosen[first::2] = chosen[[0, -1]] = True
        kept = np.flatnonzero(chosen)
        knots = interpolation_knots(t[kept], ends) if inner_knots is None else inner_knots
        yield fit(t[kept], positions[kept], knots, ends)


def _within(t: FloatArray, positions: FloatArray, free: Ends, allowed: float, share: float) -> PiecewisePolynomial:
    """Return the path with the fewest knots within `allowed` of the samples, or through them; see `sampled`.

    It is trusted if fits to every second sample agree with it.
    """
    fitted = _fewest_knots(t, positions, free, allowed) or _interpolation(t, positions, free)
    order, near = fitted.ends.order, fitted.ends.degree + 1
    judged, halves = fitted.spline(t, nu=order), list(_half_fits(t, positions, fitted.ends, fitted.inner_knots))
    error = max(_distance(curve(t), positions).max() for curve in (fitted.spline, *halves))
    doubt = np.max([_distance(half(t, nu=order), judged) for half in halves], axis=0)
    peak = np.linalg.norm(judged, axis=1).max()
    slightest = float(np.abs(positions).max()) / (t[-1] - t[0]) ** order  # of a path worth the name
    limit = share * max(peak, slightest)
    inside = slice(near, -near)  # trouble anywhere also shakes the ends: look for its cause inside
    worst = int(np.argmax(doubt))
    if doubt[inside].max(initial=0.0) > limit:
        worst = near + int(np.argmax(doubt[inside]))
    if not doubt[worst] <= limit:
        raise InvalidReference(
            f"the samples are too rough near t = {t[worst]:.6g} s: fits to every second sample differ by "
            f"{doubt[worst]:.3g} m/s^{order} in the derivative of order {order} (limit {limit:.3g}) and by up to "
            f"{error:.3g} m in position; there is a corner or a jump, the samples are too far apart, or they are "
            "rounded or noisy and need a tolerance"
        )
    path = to_path(fitted.spline, fitted.ends, float(error))
    return replace(path, refitted=partial(_refitted, t, positions, fitted.ends, fitted.inner_knots))


def _refitted(
    t: FloatArray, positions: FloatArray, ends: Ends, inner_knots: FloatArray | None
) -> tuple[PiecewisePolynomial, PiecewisePolynomial]:
    """Return the paths of `_half_fits`: each from half of the data, so that they differ as its errors do."""
    one, other = (to_path(spline, ends, None) for spline in _half_fits(t, positions, ends, inner_knots))
    return one, other


def _distance(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(a - b, axis=1))


def _increasing(t: npt.ArrayLike | None, count: int, what: str) -> FloatArray:
    """Check times (n,) in s: one for each of the `count` rows, finite, increasing."""
    column = numbers_of([] if t is None else t, f"the times of {what}s")
    if column.shape != (count,):
        raise InvalidReference(f"{count} {what}s need {count} times, not an array of shape {column.shape}")
    times = points(column[:, None], f"time of {what}")[:, 0]
    stuck = np.flatnonzero(np.diff(times) <= 0.0)
    if stuck.size:
        row = stuck[0] + 1
        raise InvalidReference(
            f"times must increase, but {what} {row} is at {times[row]} s after one at {times[row - 1]} s"
        )
    return times


def _chord_times(waypoints: FloatArray, duration: float) -> FloatArray:
    """Find the times (n,) at which a three-phase motion along the polyline passes the waypoints."""
    positive_time(duration, "duration")
    chords = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    repeated = np.flatnonzero(chords == 0.0)
    if repeated.size:
        raise InvalidReference(
            f"waypoints {repeated[0]} and {repeated[0] + 1} coincide: give the times of the waypoints"
        )
    way = np.concatenate([[0.0], np.cumsum(chords)])
    way /= way[-1]
    times = times_of(lambda t: three_phase().jet(t, duration - t, duration, 0)[:, 0], way, 0.0, duration)
    times[0], times[-1] = 0.0, duration
    return times
