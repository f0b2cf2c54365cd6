"""Distance of a moving straight segment from a convex obstacle: along the segment, and bounded between instants."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from servocore.numerics.compiled_calls import Array

_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
_SHRINKS = 32  # of the part of a segment where a body is nearest: to 2e-7 of it
_INSTANTS = 20_001  # of the first grid
_SPLIT, _LEVELS, _MOST = 16, 4, 1_000_000  # pieces of a doubtful interval, how often it is split, pieces at the most

Ends = Callable[[Array], tuple[Array, Array]]
"""Instants (N,) -> where a segment begins and ends, (N, m) each."""

Distance = Callable[[Array], Array]
"""Places (N, m) -> how far they are outside of a convex body, negative within."""


def least_distance(ends: Ends, distance: Distance, begin: float, end: float) -> float:
    """Return how near a moving segment comes to a body, in m.

    Parameters
    ----------
    ends : callable
        Of the segment.
    distance : callable
        From the body.
    begin, end : float
        Of the time.

    Returns
    -------
    float
        Negative where it enters the body, and where it cannot be told from doing so: where, between the closest
        instants looked at, it might move as far as the body is away.
    """
    t = np.linspace(begin, end, _INSTANTS)
    spans, least = np.column_stack([t[:-1], t[1:]]), np.inf
    for level in range(_LEVELS):
        pieces = 1 if level == 0 else _SPLIT
        edges = spans[:, :1] + np.diff(spans, axis=1) * np.linspace(0.0, 1.0, pieces + 1)
        instants, places = np.unique(edges, return_inverse=True)
        begins_and_ends = ends(instants)
        distances = segment_distance(*begins_and_ends, distance)
        least = min(least, float(distances.min()))
        if least < 0.0:
            return least
        places = places.reshape(edges.shape)
        first, second = places[:, :-1].ravel(), places[:, 1:].ravel()
        moved = np.max([np.linalg.norm(points[second] - points[first], axis=1) for points in begins_and_ends], axis=0)
        # Between two instants no point moves farther than the ends do, so that no distance can fall below this.
        room = (distances[first] + distances[second] - moved) / 2.0
        doubtful = room <= 0.0
        if not doubtful.any():
            return least
        spans = np.column_stack([instants[first], instants[second]])[doubtful]
        if len(spans) * _SPLIT > _MOST:
            break
    return float(room.min())


def segment_distance(begin: Array, end: Array, distance: Distance) -> Array:
    """Return how far segments are from a convex body, by the golden section: along a segment the distance is convex.

    Parameters
    ----------
    begin, end : ndarray, shape (N, m)
        Of the segments.
    distance : callable
        From the body.

    Returns
    -------
    ndarray, shape (N,)
        In m, negative within.
    """
    low, high = np.zeros((len(begin), 1)), np.ones((len(begin), 1))
    least = np.minimum(distance(begin), distance(end))
    if np.array_equal(begin, end):
        return least
    for _ in range(_SHRINKS):
        inner = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        values = [distance(begin + fraction * (end - begin)) for fraction in inner]
        least = np.minimum(least, np.minimum(*values))
        rises = (values[0] < values[1])[:, None]
        low, high = np.where(rises, low, inner[0]), np.where(rises, inner[1], high)
    return least
