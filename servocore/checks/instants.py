"""Instants along a path at which limits are looked at."""

from __future__ import annotations

import numpy as np

from servocore.references.base import FloatArray, Reference

_FEWEST, _MOST = 400, 20_000
_EACH = 16  # on a stretch of the path


def survey(reference: Reference) -> FloatArray:
    """Return instants evenly on every stretch of the path, in all not too few and not too many."""
    ends = reference.stretches
    pieces = len(ends) - 1
    each = max(_EACH, -(-_FEWEST // pieces))
    each = max(1, min(each, _MOST // pieces))
    fractions = np.arange(each) / each
    return np.append((ends[:-1, None] + np.diff(ends)[:, None] * fractions).ravel(), ends[-1])
