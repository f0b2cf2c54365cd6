"""`Space`: the obstacles of a plan, the parts that keep clear of them, and the clearance along a path."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from servocore.errors import InvalidReference, InvalidSetting
from servocore.model.symbols import Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.planning.obstacles import Box, Obstacle, Sphere, least_distance
from servocore.references.base import Reference

_NEAR = 2e-4  # of a body's size: so near at an end there is no feasible plan
_PARTS = ("load", "rope", "bridge")


@dataclass(frozen=True)
class Space:
    """Obstacles of a plan with a free path; bounds of the space are limits of the outputs.

    Parameters
    ----------
    keep_out : tuple of Sphere or Box
        Bodies.
    clearance_of : tuple of str
        Parts kept clear of them: ``load``, ``rope`` (from the load to the trolley), ``bridge`` (from the origin to the
        trolley). Rope and bridge are those of a load that hangs from a trolley at height zero.
    """

    keep_out: tuple[Obstacle, ...] = ()
    clearance_of: tuple[str, ...] = ("load", "rope")

    def __post_init__(self) -> None:
        if not all(isinstance(body, Sphere | Box) for body in self.keep_out):
            raise InvalidSetting("the obstacles of a plan must be a tuple of Sphere and Box")
        for part in self.clearance_of:
            if part not in _PARTS:
                raise InvalidSetting(f"{part!r} is no part that can keep clear; there are {', '.join(_PARTS)}")

    @classmethod
    def of_texts(cls, texts: Iterable[str], dimension: int, clearance_of: str | None = None) -> Space:
        """Return the space that texts describe, such as ``sphere 1 2 -3 0.5`` or ``box 1 2 -3 0.4 3 1.2``.

        Parameters
        ----------
        texts : iterable of str
            A body each: its kind, its centre, then a radius or half sizes; m.
        dimension : int
            How many coordinates a centre has.
        clearance_of : str, optional
            Parts that keep clear, with commas between: ``load,rope,bridge``.

        Returns
        -------
        Space
            With the parts that a plan keeps clear by default if none are given.

        Raises
        ------
        InvalidSetting
            If a text is no body, or there is no such part.
        """
        bodies = tuple(_obstacle(text, dimension) for text in texts)
        parts = cls.clearance_of if clearance_of is None else tuple(part.strip() for part in clearance_of.split(","))
        return cls(bodies, parts)

    def require(self, system: MechanicalSystem, *, hangs: bool) -> None:
        """Raise `InvalidSetting` unless a system has the parts, and as many dimensions as the bodies.

        Parameters
        ----------
        system : MechanicalSystem
            The scene with these parts.
        hangs : bool
            Whether the load hangs from a trolley at height zero.
        """
        dimension = len(system.outputs)
        for body in self.keep_out:
            if len(body.centre) != dimension:
                raise InvalidSetting(f"{body} has not the {dimension} dimensions of {system.name}")
        if self.keep_out and not hangs and set(self.clearance_of) - {"load"}:
            raise InvalidSetting(
                f"{system.name} has no rope that is known to hang from a trolley at height zero, nor a bridge: plan"
                " with clearance_of=('load',)"
            )

    def thickened(self, size: float) -> Space:
        """Return the space with bodies that are at least a size thick to every side of their centres.

        Parameters
        ----------
        size : float
            In m.

        Returns
        -------
        Space
            Otherwise the same.
        """
        return replace(self, keep_out=tuple(body.thickened(size) for body in self.keep_out))

    def require_rest(self, name: str, place: Array) -> None:
        """Raise `InvalidReference` unless everything is clear at rest at a place.

        Parameters
        ----------
        name : str
            Of the scene.
        place : ndarray, shape (m,)
            Of the load, m.
        """
        load, at_rest = ca.SX(ca.DM(place)), ca.SX.zeros(len(place))
        for body in self.keep_out:
            for begin, end in self._segments(load, at_rest, 1.0):
                near = body.nearest(begin, end)
                if float(body.row(near)) < 1.0 - _NEAR:
                    continue
                distance = float(body.distance(np.asarray(ca.DM(near)).ravel()))
                where = f"{-distance:.3g} m inside {body}"
                if distance > 0.0:
                    where = f"{distance:.3g} m from {body}, within the rounded body that plans keep out of"
                at = ", ".join(f"{coordinate:.4g}" for coordinate in place)
                raise InvalidReference(
                    f"{name}: no path is clear: at rest at ({at}) a point of {', '.join(self.clearance_of)} is {where}"
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
        if not self.keep_out or not self.clearance_of:
            return ca.SX(0, 1)
        gravity = parameters["gravity"] if "gravity" in parameters.names else ca.SX(0)
        segments = self._segments(gamma[:, 0], gamma[:, 2], gravity)
        return ca.vertcat(*[body.row(body.nearest(*segment)) for body in self.keep_out for segment in segments])

    def clearance(self, path: Reference, gravity: float) -> float:
        """Return the least distance of anything from a body along a path, in m; infinite without any.

        Between two instants nothing moves farther than its ends do. Wherever that might lead into a body, the
        interval is refined, so that no body is too small to be seen.

        Parameters
        ----------
        path : Reference
            Of the load.
        gravity : float
            In m/s2.

        Returns
        -------
        float
            In m; negative within a body, and where no instant shows that there is a way past it.
        """

        def ends(t: Array) -> list[tuple[Array, Array]]:
            jets = path.jet(t, 2)
            load, acceleration = jets[:, 0].T, jets[:, 2].T
            return [(begin.T, end.T) for begin, end in self._segments(load, acceleration, gravity)]

        distances = [
            least_distance(lambda t, k=k: ends(t)[k], body.distance, path.start_time, path.end_time)  # type: ignore[misc]  # a lambda has no annotations
            for body in self.keep_out
            for k in range(len(ends(np.zeros(1))))
        ]
        return min(distances, default=np.inf)

    def _segments(self, load: Any, acceleration: Any, gravity: Any) -> list[tuple[Any, Any]]:
        """Return the ends of the parts, by coordinates: expressions, or arrays (m, N) for many instants.

        The rope lies along the load's acceleration less gravity, up to the trolley at height zero.
        """
        if not set(self.clearance_of) - {"load"}:
            return [(load, load)] if self.clearance_of else []
        last = load.shape[0] - 1
        trolley = load - load[last] / (gravity + acceleration[last]) * acceleration
        trolley[last] = 0.0
        segments = [(0.0 * load, trolley)] if "bridge" in self.clearance_of else []
        if "rope" in self.clearance_of:  # it ends at the load
            return [(load, trolley), *segments]
        return [(load, load), *segments] if "load" in self.clearance_of else segments


def _obstacle(text: str, dimension: int) -> Obstacle:
    kind, *words = text.replace(",", " ").split() or [""]
    try:
        numbers = tuple(float(word) for word in words)
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
