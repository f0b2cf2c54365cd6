"""Where a load, its rope and the bridge above may not be: spheres and boxes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from servocore.errors import InvalidReference, InvalidSetting
from servocore.model.symbols import Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array

_POWER = 8
_TIP = 1e-6
_NEAR = 2e-4  # of a body's size: so near at an end leaves a plan no room
_PLANNED, _CHECKED = 6, 41  # points on a rope, or on a bridge


@dataclass(frozen=True)
class Sphere:
    """All places nearer to a centre than a radius.

    Parameters
    ----------
    centre : tuple of float
        As many coordinates as the scene has outputs, m.
    radius : float
        In m.
    """

    centre: tuple[float, ...]
    radius: float

    def __post_init__(self) -> None:
        if not 0.0 < self.radius < np.inf:
            raise InvalidSetting(f"the radius of a sphere must be positive, not {self.radius:g} m")
        _require_finite(self.centre)

    def row(self, place: ca.SX) -> ca.SX:
        """Return an expression that is below one outside.

        Parameters
        ----------
        place : casadi.SX, shape (m,)
            A place, in m.

        Returns
        -------
        casadi.SX
            A number without unit.
        """
        away = (place - ca.DM(self.centre)) / self.radius
        return 2.0 - ca.sqrt(ca.sumsqr(away) + _TIP**2)

    def distance(self, places: Array) -> Array:
        """Return how far places (..., m) are outside, in m; negative within.

        Parameters
        ----------
        places : ndarray, shape (..., m)
            In m.

        Returns
        -------
        ndarray, shape (...)
            In m.
        """
        return np.asarray(np.linalg.norm(places - np.array(self.centre), axis=-1) - self.radius)


@dataclass(frozen=True)
class Box:
    """All places that differ from a centre by less than half sizes, along every axis.

    Parameters
    ----------
    centre, half : tuple of float
        As many numbers as the scene has outputs, m.
    """

    centre: tuple[float, ...]
    half: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.half) != len(self.centre) or not min(self.half) > 0.0:
            raise InvalidSetting(f"a box needs a positive half size along each axis, not {self.half}")
        _require_finite((*self.centre, *self.half))

    def row(self, place: ca.SX) -> ca.SX:
        """Return an expression that is below one outside a smooth body around the box, which is a little larger.

        Parameters
        ----------
        place : casadi.SX, shape (m,)
            A place, in m.

        Returns
        -------
        casadi.SX
            A number without unit.
        """
        sizes = np.array(self.half) * len(self.half) ** (1.0 / _POWER)
        away = (place - ca.DM(self.centre)) / ca.DM(sizes)
        return 2.0 - (ca.sum1(away**_POWER) + _TIP**_POWER) ** (1.0 / _POWER)

    def distance(self, places: Array) -> Array:
        """Return how far places (..., m) are outside, in m; negative within.

        Parameters
        ----------
        places : ndarray, shape (..., m)
            In m.

        Returns
        -------
        ndarray, shape (...)
            In m.
        """
        over = np.abs(places - np.array(self.centre)) - np.array(self.half)
        outside = np.linalg.norm(np.maximum(over, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(over.max(axis=-1), 0.0))


Body: TypeAlias = Sphere | Box
_PARTS = ("load", "rope", "bridge")


@dataclass(frozen=True)
class Space:
    """What a plan that chooses its own way keeps clear of; bounds of the space are limits of the outputs.

    Parameters
    ----------
    keep_out : tuple of Sphere or Box
        Bodies.
    parts : tuple of str
        What keeps clear of them: ``load``, ``rope`` (from the load to the trolley), ``bridge`` (from the origin to the
        trolley). Rope and bridge are those of a load that hangs from a trolley at height zero.
    """

    keep_out: tuple[Body, ...] = ()
    parts: tuple[str, ...] = ("load", "rope")

    def __post_init__(self) -> None:
        if not all(isinstance(body, Sphere | Box) for body in self.keep_out):
            raise InvalidSetting("what a plan keeps out of must be a tuple of Sphere and Box")
        for part in self.parts:
            if part not in _PARTS:
                raise InvalidSetting(f"{part} is no part that can keep clear; there are {', '.join(_PARTS)}")

    @classmethod
    def of_texts(cls, texts: Iterable[str], dimension: int) -> Space:
        """Return the space that texts describe, such as ``sphere 1 2 -3 0.5`` or ``box 1 2 -3 0.4 3 1.2``.

        Parameters
        ----------
        texts : iterable of str
            A body each: its kind, its centre, then a radius or half sizes; m.
        dimension : int
            How many coordinates a centre has.

        Returns
        -------
        Space
            With the parts that a plan keeps clear by default.

        Raises
        ------
        InvalidSetting
            If a text is no body.
        """
        return cls(tuple(_body(text, dimension) for text in texts))

    def require(self, system: MechanicalSystem, tracked: str) -> None:
        """Raise `InvalidSetting` unless a system has the parts, and as many dimensions as the bodies.

        Parameters
        ----------
        system : MechanicalSystem
            Whose parts are to stay clear.
        tracked : str
            The part that follows the path, such as ``load``.
        """
        dimension = len(system.outputs)
        for body in self.keep_out:
            if len(body.centre) != dimension:
                raise InvalidSetting(f"{body} has not the {dimension} dimensions of {system.name}")
        hangs = tracked == "load" and "gravity" in system.parameters.names
        if self.keep_out and not hangs and set(self.parts) - {"load"}:
            raise InvalidSetting(f"{system.name} has no rope or bridge that is known: plan with parts=('load',)")

    def require_rest(self, name: str, place: Array) -> None:
        """Raise `InvalidReference` unless everything is clear at rest at a place.

        Parameters
        ----------
        name : str
            Of the scene.
        place : ndarray, shape (m,)
            Of what follows the path, m.
        """
        for body in self.keep_out:
            for point in self._places(place, np.zeros(len(place)), 1.0, _CHECKED):
                if float(body.row(ca.SX(ca.DM(point)))) < 1.0 - _NEAR:
                    continue
                away = float(body.distance(np.array(point)))
                where = f"{-away:.3g} m inside {body}"
                if away > 0.0:
                    where = f"{away:.3g} m from {body}, within the rounded body that plans keep out of"
                here = ", ".join(f"{each:.4g}" for each in place)
                raise InvalidReference(
                    f"{name}: no way keeps clear: at rest at ({here}) a point of {', '.join(self.parts)} is {where}"
                )

    def rows(self, gamma: ca.SX, parameters: Parameters) -> ca.SX:
        """Return expressions of the path's derivatives that are below one where everything is clear.

        Parameters
        ----------
        gamma : casadi.SX, shape (m, orders)
            The path and its derivatives.
        parameters : Parameters
            Of the model, with its gravity.

        Returns
        -------
        casadi.SX, shape (rows,)
            Numbers without unit.
        """
        if not self.keep_out:
            return ca.SX(0, 1)
        gravity = parameters["gravity"] if "gravity" in parameters.names else ca.SX(0)
        jets = [gamma[:, 0], gamma[:, 2]]
        places = self._places(jets[0], jets[1], gravity, _PLANNED)
        return ca.vertcat(*[body.row(ca.vertcat(*place)) for body in self.keep_out for place in places])

    def clearance(self, jets: Array, gravity: float) -> float:
        """Return the least distance of anything from a body along jets (N, orders, m), in m; infinite without any.

        Parameters
        ----------
        jets : ndarray, shape (N, orders, m)
            The path and its derivatives.
        gravity : float
            In m/s2.

        Returns
        -------
        float
            In m.
        """
        columns = jets[:, 0].T, jets[:, 2].T
        places = self._places(*columns, gravity, _CHECKED)
        distances = [float(body.distance(np.stack(place, axis=-1)).min()) for body in self.keep_out for place in places]
        return min(distances, default=np.inf)

    def _places(self, load: Any, force: Any, gravity: Any, count: int) -> list[list[Any]]:
        """Return the points looked at, by coordinates: expressions, or arrays for many instants."""
        dimension = load.shape[0]
        here = [load[k] for k in range(dimension)]
        places = [here] if "load" in self.parts else []
        if not set(self.parts) - {"load"}:
            return places
        reach = -here[-1] / (gravity + force[dimension - 1])
        above = [*(here[k] + reach * force[k] for k in range(dimension - 1)), 0.0 * here[-1]]
        parts = np.linspace(0.0, 1.0, count)
        if "rope" in self.parts:
            places += [[(1 - f) * a + f * b for a, b in zip(here, above, strict=True)] for f in parts[1:].tolist()]
        if "bridge" in self.parts:
            places += [[f * each for each in above] for f in parts.tolist()]
        return places


def _require_finite(numbers: Iterable[float]) -> None:
    for each in numbers:
        if not np.isfinite(each):
            raise InvalidSetting(f"a body to keep out of needs finite numbers, not {each}")


def _body(text: str, dimension: int) -> Body:
    kind, *rest = text.replace(",", " ").split() or [""]
    try:
        numbers = tuple(float(each) for each in rest)
    except ValueError:
        numbers = ()
    centre, sizes = numbers[:dimension], numbers[dimension:]
    if kind == "sphere" and len(centre) == dimension and len(sizes) == 1:
        return Sphere(centre, sizes[0])
    if kind == "box" and len(centre) == len(sizes) == dimension:
        return Box(centre, sizes)
    raise InvalidSetting(
        f"--keep-out {text!r} is neither 'sphere' with a centre of {dimension} numbers and a radius, nor 'box' with a"
        f" centre and half sizes"
    )
