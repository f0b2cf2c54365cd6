"""Drawings of scenes: parts between points, which are expressions of the quantities that a solution reports.

A system without a drawing of its scene is drawn as bodies and points, by the names of its coordinates.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca

from servocore.errors import InvalidModel, InvalidSetting
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem
from servocore.numerics.components import filled
from servocore.numerics.expressions import as_expression

KINDS = ("rope", "bar", "bridge", "rail", "spring", "post", "box", "body", "pin")
"""Kinds of parts. A rope, a bar and a spring join two points; a bridge goes from its first point to the farthest place
of its second; a rail goes through its point along an axis; a post stands on the ground below its point; a box, a body
and a pin are at their point."""

_AXES = "xyz"
_NAMED = re.compile(r"(?:(?P<of>.+)[._])?(?P<axis>[xyz])(?:_(?P<number>\w+))?")
_MOST_POINTS = 400
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
        (x, y, z) in m: two for a part that joins points, one for the others.
    name : str
        Label of a box or a body.
    colour : str
        Name of the quantity that colours it, such as ``tension``; none when empty.
    along : int
        Axis of a rail: 0, 1 or 2 for x, y or z.

    Raises
    ------
    InvalidSetting
        If the kind is unknown, or takes another number of points.
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
"""Symbols of reported quantities and of parameters, by name -> the parts."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Parts between points, and the positions of the points.

    Attributes
    ----------
    parts : list of dict
        Kind, name, places among the points, index of the quantity that colours it, axis.
    points : int
        Number of points.
    reported, coordinates : casadi.SX
        Symbols of the reported quantities; x, y, z of one point after the other, expressions of these and parameters.
    tracked : int or None
        The point that follows the path.
    flat : bool
        Whether all points lie in the plane y = 0.
    """

    parts: list[dict[str, Any]]
    points: int
    reported: ca.SX
    coordinates: ca.SX
    tracked: int | None
    flat: bool

    def about(self) -> dict[str, Any]:
        """Return the data for the page."""
        shown = {each: getattr(self, each) for each in ("parts", "points", "tracked", "flat")}
        return {**shown, "grounded": any(part["kind"] in ("body", "post") for part in self.parts)}


def picture_of(system: MechanicalSystem, reported: Sequence[Quantity], drawing: Drawing | None) -> Picture:
    """Return the picture of a system.

    Parameters
    ----------
    system : MechanicalSystem
        The system.
    reported : sequence of Quantity
        Quantities that a solution reports, in this order.
    drawing : callable or None
        Drawing of the scene; None for bodies and points by the names of coordinates.

    Raises
    ------
    InvalidModel
        If a drawing uses a quantity that is not reported, or does not return parts.
    """
    symbols = {quantity.name: ca.SX.sym(quantity.name) for quantity in reported}
    known = {**dict(zip(system.parameters.names, ca.vertsplit(system.p), strict=True)), **symbols}
    try:
        parts = list(drawing(known)) if drawing is not None else _found(system, symbols)
    except KeyError as error:
        raise InvalidModel(
            f"{system.name}: its drawing uses {error}, which is not reported; there are {', '.join(known)}"
        ) from None
    if not all(isinstance(part, Part) for part in parts):
        raise InvalidModel(f"{system.name}: its drawing must be a sequence of Part")
    names, listed = list(symbols), list[dict[str, Any]]()
    points: dict[str, ca.SX] = {}
    for part in parts:
        corners = [
            ca.vertcat(*[as_expression(entry, f"{system.name}: a point of its drawing") for entry in point])
            for point in part.points
        ]
        points |= {str(corner): corner for corner in corners}
        if part.colour and part.colour not in names:
            raise InvalidModel(f"{system.name}: its drawing is coloured by {part.colour}, which is not reported")
        listed.append({
            "kind": part.kind,
            "name": part.name,
            "places": [list(points).index(str(corner)) for corner in corners],
            "colour": names.index(part.colour) if part.colour else None,
            "along": part.along,
        })  # fmt: skip
    values, coordinates = ca.vertcat(ca.SX(0, 1), *symbols.values()), ca.vertcat(ca.SX(0, 1), *points.values())
    depth = ca.vertcat(ca.SX(0, 1), *[corner[1] for corner in points.values()])
    flat = all(entry.is_zero() for entry in ca.vertsplit(depth)) if points else True
    return Picture(listed, len(points), values, coordinates, _tracked(listed), flat)


def _tracked(parts: Sequence[Mapping[str, Any]]) -> int | None:
    """Return the point of the last body, or box where there is none: the load."""
    kinds = [part["kind"] for part in parts]
    bodies = [part["places"][0] for part in parts if part["kind"] == ("body" if "body" in kinds else "box")]
    return bodies[-1] if bodies else None


# Bodies and points by the names of coordinates ----------------------------------------------------------------------


def _found(system: MechanicalSystem, symbols: Mapping[str, ca.SX]) -> list[Part]:
    """Return a body for coordinates x, y, z of one name, and bars or springs between connected ones."""
    points: dict[str, dict[str, str]] = {}
    for name in system.coordinates.names:
        match = _NAMED.fullmatch(name)
        if match and not re.search(r"[._]d\d?$|^d$", match["of"] or ""):
            points.setdefault(match["of"] or match["number"] or "", {})[match["axis"]] = name
    if not points:
        points = {
            quantity.name: {"x": quantity.name} for quantity in system.coordinates.quantities if quantity.unit == "m"
        }
    points = dict(list(points.items())[:_MOST_POINTS])
    where = {of: _point(named, symbols) for of, named in points.items()}
    bars = [
        Part(kind, (where[one], where[other]))
        for kind, one, other in _joined(system, {name: of for of, named in points.items() for name in named.values()})
    ]
    return [*bars, *(Part("body", (place,), of) for of, place in where.items())]


def _point(named: Mapping[str, str], symbols: Mapping[str, ca.SX]) -> Point:
    x, y, z = (symbols[named[axis]] if axis in named else ca.SX(0) for axis in _AXES)
    # Two coordinates span a vertical plane.
    return (x, ca.SX(0), y) if "y" in named and "z" not in named else (x, y, z)


def _joined(system: MechanicalSystem, owners: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Return pairs of points that one holonomic constraint holds (bars), or one term of the potential (springs)."""
    q, names = system.q, system.coordinates.names
    held = filled(ca.DM(ca.jacobian_sparsity(system.constraints, q), 1.0))
    joined: dict[tuple[str, str], str] = {}
    for row in held:
        bodies = list(dict.fromkeys(owners[name] for name, on in zip(names, row, strict=True) if on and name in owners))
        if len(bodies) == 2:
            joined.setdefault((bodies[0], bodies[1]), "bar")
    stiffness = filled(ca.DM(ca.hessian(system.potential, q)[0].sparsity(), 1.0))
    for i, one in enumerate(names):
        for j, other in enumerate(names[:i]):
            if stiffness[i][j] and one in owners and other in owners and owners[one] != owners[other]:
                joined.setdefault((owners[other], owners[one]), "spring")
    return [(kind, one, other) for (one, other), kind in joined.items()]
