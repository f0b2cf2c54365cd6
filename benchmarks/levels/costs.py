"""What was measured of the models of a scene: values, for tables and machines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Spread:
    """Median and quartiles of repeated measurements."""

    median: float
    lower: float
    upper: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Summarize at least one value."""
        lower, median, upper = (float(percentile) for percentile in np.percentile(values, (25, 50, 75)))
        return cls(median, lower, upper)


@dataclass(frozen=True)
class Cost:
    """One model by one route.

    Attributes
    ----------
    unknowns : int or None
        Of one instant.
    microseconds : Spread or None
        Processor time an instant, of the bare compiled loop.
    error : float or None
        Largest error of any input, as a fraction of that input's largest value; None without an exact answer.
    method : str
        Name of the method of the route.
    refusal : str
        Why the route does not work for this model; the rest is then None.
    """

    unknowns: int | None = None
    microseconds: Spread | None = None
    error: float | None = None
    method: str = ""
    refusal: str = ""


@dataclass(frozen=True)
class Level:
    """One model of a scene: its size, its structure and what it costs by each route."""

    scene: str
    model: str
    needed: bool
    coordinates: int
    index: int
    internal_degrees_of_freedom: int
    costs: dict[str, Cost]
