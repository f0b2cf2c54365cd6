"""The cases: a crane, a way, limits, and the best duration known of a plan on 80 intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import servocore as sc
from servocore.planning.report import PlanReport

WEIGHT = -98.1
"""M_w that holds the load at rest, N m."""

LINE = ((5, 0, -5), (-2, 2, -2))
WAYPOINTS = ((5, 0, -5), (3.5, 1.5, -3.4), (1.5, 2.6, -2.6), (-0.3, 2.6, -2.3), (-2, 2, -2))
DEFAULT = {"M_b": 1000, "F": 60, "swing": "5 deg"}


@dataclass(frozen=True)
class Case:
    """One manoeuvre.

    Attributes
    ----------
    name : str
        What it shows.
    scene : str
        Name of the scene.
    way : reference or waypoints
        What is passed through.
    limits : mapping of str to bounds
        As `Scene.with_limits` takes them.
    known : float
        Best duration known on 80 intervals with continuous inputs, s.
    free : Space, optional
        Where only the ends of the way are given: what load and rope keep clear of.
    """

    name: str
    scene: str
    way: Any
    limits: Mapping[str, Any]
    known: float
    free: sc.Space | None = None

    def plan(self, intervals: int = 80) -> tuple[sc.Reference, PlanReport]:
        """Return the plan and what is known about it."""
        return sc.fastest(sc.scenes.REGISTRY[self.scene](), self.way, self.limits, free=self.free, intervals=intervals)


@dataclass(frozen=True, kw_only=True, eq=False)
class Hop(sc.Reference):
    """From one point to another at even speed, with a hop on the way: z + height (4 s (1 - s))^3."""

    start: tuple[float, ...]
    end: tuple[float, ...]
    height: float

    @classmethod
    def over(cls, start: tuple[float, ...], end: tuple[float, ...], height: float) -> Hop:
        """Return the hop in one second."""
        return cls(
            start_time=0.0, end_time=1.0, dimension=3, max_order=99, smoothness=0, start=start, end=end, height=height
        )

    def _derivatives(self, t: np.ndarray, order: int) -> np.ndarray:
        hop = self.height * np.polynomial.Polynomial([0.0, 4.0, -4.0]) ** 3
        way = np.subtract(self.end, self.start)
        found = np.zeros((len(t), order + 1, 3))
        found[:, 0] = np.array(self.start) + t[:, None] * way
        if order:
            found[:, 1] = way
        for k in range(order + 1):
            found[:, k, 2] += (hop.deriv(k) if k else hop)(t)
        return found


_WIDE = {
    "M_b": 400,
    "F": 200,
    "M_w": (WEIGHT - 6, WEIGHT + 6),
    "swing": "8 deg",
    "tension": (900, 1060),
    "s.rate": 1.2,
}
_ROOM = {"s": (1, None), "z": (-6, -1)}
_LEVEL = ((5, 0, -5), (-2, 2, -5))
_DRIVES = {"M_b": 1000, "F": 100, "M_w": (WEIGHT - 10, WEIGHT + 10), "swing": "8 deg", **_ROOM}
_WALL, _BALL = sc.Box((1.5, 1, -5), (0.4, 3, 1.2)), sc.Sphere((1.5, 1, -5), 1.5)

CASES = (
    Case("1 default", "rotary_crane", LINE, DEFAULT, 7.126),
    Case(
        "2 wide set",
        "rotary_crane",
        LINE,
        _WIDE,
        6.478,
    ),
    Case("3 slewing torque", "rotary_crane", LINE, {"M_b": 200, "F": 300, "swing": "15 deg"}, 6.893),
    Case(
        "4 winch torque",
        "rotary_crane",
        LINE,
        {"M_b": 3000, "F": 500, "M_w": (WEIGHT - 2, WEIGHT + 2), "tension": (950, 1020)},
        8.454,
    ),
    Case("5 swing", "rotary_crane", LINE, {"M_b": 3000, "F": 500, "swing": "3 deg"}, 7.811),
    Case("6 trolley speed", "rotary_crane", LINE, {"M_b": 1000, "F": 150, "swing": "8 deg", "s.rate": 0.6}, 9.494),
    Case("7 curved", "rotary_crane", WAYPOINTS, DEFAULT, 7.265),
    Case(
        "8 hop",
        "rotary_crane",
        Hop.over((5, 0, -5), (-2, 2, -5), 2.0),
        {"M_b": 1000, "F": 100, "M_w": (WEIGHT - 10, WEIGHT + 10), "swing": "8 deg"},
        7.879,
    ),
    Case(
        "9 overhead",
        "overhead_crane",
        ((0, -4), (5, -1)),
        {"F": 200, "M_w": (WEIGHT - 15, WEIGHT + 15), "swing": "15 deg", "s.rate": 2.5},
        3.638,
    ),
    Case("10 overhead, level", "overhead_crane", ((0, -4), (5, -4)), {"F": 200}, 3.463),
    Case(
        "11 free, limits of 1",
        "rotary_crane",
        LINE,
        {**DEFAULT, "M_w": (WEIGHT - 20, WEIGHT + 20), **_ROOM},
        6.634,
        sc.Space(),
    ),
    Case("12 free, limits of 2", "rotary_crane", LINE, {**_WIDE, **_ROOM}, 5.706, sc.Space()),
    Case("13 free, over a wall", "rotary_crane", _LEVEL, _DRIVES, 5.372, sc.Space((_WALL,))),
    Case("14 free, past a sphere", "rotary_crane", _LEVEL, _DRIVES, 5.370, sc.Space((_BALL,))),
)
"""All of them; those of the rotary crane with its own data."""
