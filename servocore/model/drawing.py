"""What a scene looks like: parts drawn between points, which follow from what a solution reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from servocore.errors import InvalidSetting

KINDS = ("rope", "bar", "bridge", "rail", "spring", "post", "box", "body", "pin")
"""Kinds of parts. A rope, a bar and a spring join two points; a bridge goes from its first point through its second, as
far as that ever gets; a rail goes through its point along an axis; a post stands on the ground below its point; a box,
a body and a pin are at their point."""

_ENDS = {"rope": 2, "bar": 2, "bridge": 2, "spring": 2}

Point: TypeAlias = tuple[Any, Any, Any]
"""x, y, z in m, z upwards: numbers or expressions."""


@dataclass(frozen=True)
class Part:
    """One part of a drawing.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    points : tuple of points
        (x, y, z) in m: two for what joins points, one for the others.
    name : str
        What is written beside a box or a body.
    colour : str
        Name of the quantity that colours it, such as ``tension``; none when empty.
    along : int
        Axis of a rail: 0, 1 or 2 for x, y or z.

    Raises
    ------
    InvalidSetting
        If there is no such kind, or it takes another number of points.
    """

    kind: str
    points: tuple[Point, ...]
    name: str = ""
    colour: str = ""
    along: int = 0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidSetting(f"there is no part of kind {self.kind} to be drawn; there are {', '.join(KINDS)}")
        if len(self.points) != _ENDS.get(self.kind, 1) or any(len(point) != 3 for point in self.points):
            raise InvalidSetting(
                f"a {self.kind} is drawn at {_ENDS.get(self.kind, 1)} points of three coordinates each, not"
                f" {self.points!r}"
            )


Drawing: TypeAlias = Callable[[Mapping[str, Any]], Sequence[Part]]
"""Symbols of what a solution reports and of the parameters, by name -> the parts."""
