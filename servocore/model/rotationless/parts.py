"""Parts of a mechanism: rigid bodies, point masses, the ground, and places on them where joints sit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, TypeAlias

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, described, require_kind
from servocore.model.potentials import Energy
from servocore.model.quantity import Quantity
from servocore.model.symbols import Parameters
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import as_expression

Scalar: TypeAlias = "float | ca.SX"
"""A number, or an expression of parameters."""

_AXES = ("x", "y", "z")
_DIRECTED = 12  # coordinates of a node with directors
_ROUND_OFF = 1e-9  # relative: an inertia is physical within this


class Part:
    """A part of a mechanism: one node, or several, each a position or a position with three directors.

    Attributes
    ----------
    name : str
        Of the part.
    directed : bool
        Whether the nodes have directors.
    many : bool
        Whether a configuration lists nodes.
    """

    name: str
    directed: ClassVar[bool] = False
    many: ClassVar[bool] = False

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes."""
        return (self.name,)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All coordinates, node by node: x, y, z and d1_x, ..., d3_z behind the name of the node."""
        entries = ("", *(f"d{k}_" for k in (1, 2, 3))) if self.directed else ("",)
        return tuple(
            Quantity(f"{node}.{entry}{axis}", "1" if entry else "m")
            for node in self.nodes
            for entry in entries
            for axis in _AXES
        )

    @property
    def mass_matrix(self) -> ca.SX:
        """Constant mass matrix of the coordinates; zero of a part without mass."""
        return ca.SX(len(self.quantities), len(self.quantities))

    def first_moment(self, q: ca.SX) -> ca.SX:  # noqa: ARG002 - of the coordinates of a part with mass
        """Return mass times position of the centre of mass, shape (3,), kg m."""
        return ca.SX(3, 1)

    def check(self, parameters: Parameters) -> None:
        """Raise `InvalidModel` if a length, mass or stiffness is impossible at default parameters."""

    def frames(self, q: ca.SX) -> list[Frame]:
        """Return the frames of all nodes for the coordinates `q`; without directors they have those of the ground."""
        if self.directed:
            return [Frame(each[:3], ca.reshape(each[3:], 3, 3)) for each in ca.vertsplit(q, _DIRECTED)]
        return [Frame(each, GROUND.directors) for each in ca.vertsplit(q, len(_AXES))]

    def centre_of_mass(self, q: ca.SX) -> ca.SX:
        """Return the mean of the places of nodes joined by straight lines of equal mass."""
        places = [frame.origin for frame in self.frames(q)]
        middles = [(a + b) / 2 for a, b in pairwise(places)] or places
        return sum(middles[1:], middles[0]) / len(middles)

    def internal_constraints(self, q: ca.SX) -> ca.SX:
        """Return d_i . d_j - delta_ij of all nodes with directors, six each."""
        rows = [_orthonormality(frame) for frame in self.frames(q)] if self.directed else []
        return ca.vertcat(ca.SX(0, 1), *rows)

    def stored(self, q: ca.SX) -> list[tuple[Energy, ca.SX]]:  # noqa: ARG002 - of the coordinates of flexible parts
        """Return the elastic energies, none of a rigid part."""
        return []


@dataclass(frozen=True, eq=False)
class Augmented(Part):
    """A coordinate without mass, defined by a constraint."""

    quantity: Quantity

    @property
    def name(self) -> str:  # type: ignore[override]  # never assigned: that of its quantity
        """Name of the coordinate."""
        return self.quantity.name

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """The coordinate."""
        return (self.quantity,)


@dataclass(frozen=True, eq=False)
class RigidBody(Part):
    """A rigid body with twelve coordinates: its reference point r and its directors d1, d2, d3.

    The material point with body coordinates (a, b, c) is at r + a d1 + b d2 + c d3. Thus the kinetic energy
    is a quadratic form in the velocities with constant coefficients: the mass m, the first moments m c and
    the second moments E + m c c^T, where c is the centre of mass and E = tr(J)/2 I - J the Euler tensor.

    Parameters
    ----------
    name : str
        The coordinates are called ``name.x``, ..., ``name.d1_x``, ..., ``name.d3_z``.
    mass : float or casadi.SX
        In kg; a number or an expression of parameters, not negative.
    inertia : sequence
        Inertia tensor J about the centre of mass in directions of the directors, kg m^2: the three principal
        values, or a symmetric 3 x 3 matrix as rows.
    centre : sequence of three
        Centre of mass in body coordinates, m. At zero the reference point is the centre of mass.
    """

    name: str
    mass: Scalar
    inertia: Sequence[Any]
    centre: Sequence[Scalar] = (0.0, 0.0, 0.0)
    directed: ClassVar[bool] = True

    @property
    def mass_matrix(self) -> ca.SX:
        """Constant mass matrix of (r, d1, d2, d3), shape (12, 12)."""
        centre = _vector(self.centre)
        first = self.mass * centre
        second = self.euler_tensor + ca.mtimes(first, centre.T)
        small = ca.blockcat([[ca.SX(self.mass), first.T], [first, second]])
        return ca.sparsify(ca.kron(small, ca.SX.eye(3)))

    @property
    def euler_tensor(self) -> ca.SX:
        """E = tr(J)/2 I - J about the centre of mass, shape (3, 3): second moments of the mass."""
        inertia = self.inertia_tensor
        return ca.trace(inertia) / 2 * ca.SX.eye(3) - inertia

    @property
    def inertia_tensor(self) -> ca.SX:
        """J about the centre of mass, shape (3, 3)."""
        tensor = as_expression(self.inertia, f"body {self.name}: inertia")
        if tensor.shape not in ((3, 1), (3, 3)):
            raise InvalidModel(f"body {self.name}: inertia needs three principal values or three rows of three numbers")
        return ca.diag(tensor) if tensor.size2() == 1 else tensor

    def first_moment(self, q: ca.SX) -> ca.SX:
        """Return mass times position of the centre of mass, shape (3,), for the twelve coordinates `q`."""
        (frame,) = self.frames(q)
        return self.mass * frame.point(self.centre)

    def check(self, parameters: Parameters) -> None:
        """Raise `InvalidModel` if no distribution of mass has these moments at default parameters."""
        require_kind(self.name, str, "the name of a body", "a text", InvalidModel)
        what = f"body {self.name}"
        _check_mass(what, self.mass, parameters)
        inertia, centre = number(self.inertia_tensor, parameters), number(_vector(self.centre), parameters)
        for values, name in ((inertia, "inertia"), (centre, "centre of mass")):
            if not np.isfinite(values).all():
                raise InvalidModel(
                    f"{what}: its {name} holds {values[~np.isfinite(values)][0]}, which is no finite number"
                )
        scale = max(float(np.abs(inertia).max()), 1e-300)
        if not np.abs(inertia - inertia.T).max() <= _ROUND_OFF * scale:
            raise InvalidModel(f"{what}: the inertia tensor is not symmetric")
        smallest, middle, largest = np.linalg.eigvalsh(inertia)
        if smallest < -_ROUND_OFF * scale:
            raise InvalidModel(f"{what}: the inertia tensor has the negative principal value {smallest:g} kg m^2")
        if smallest + middle < largest - _ROUND_OFF * scale:
            raise InvalidModel(
                f"{what}: the principal inertias {smallest:g}, {middle:g} and {largest:g} kg m^2 violate"
                " the triangle inequality, no distribution of mass has them"
            )


@dataclass(frozen=True, eq=False)
class PointMass(Part):
    """A particle with three coordinates ``name.x``, ``name.y``, ``name.z``; `mass` in kg, not negative."""

    name: str
    mass: Scalar

    @property
    def mass_matrix(self) -> ca.SX:
        """Constant mass matrix, shape (3, 3)."""
        return self.mass * ca.SX.eye(3)

    def first_moment(self, q: ca.SX) -> ca.SX:
        """Return mass times position."""
        return self.mass * q

    def check(self, parameters: Parameters) -> None:
        """Raise `InvalidModel` if the mass is negative at default parameters."""
        require_kind(self.name, str, "the name of a point mass", "a text", InvalidModel)
        _check_mass(f"point {self.name}", self.mass, parameters)


@dataclass(frozen=True, eq=False)
class Place:
    """A point with a right-handed orthonormal triad fixed in a body: where a joint sits.

    Attributes
    ----------
    position : casadi.SX
        Shape (3,), m.
    normal, binormal, axis : casadi.SX
        The triad, shape (3,) each; joints turn about or slide along `axis`.
    """

    position: ca.SX
    normal: ca.SX
    binormal: ca.SX
    axis: ca.SX


@dataclass(frozen=True, eq=False)
class Frame:
    """Reference point, shape (3,), and directors, the columns of a matrix of shape (3, 3), of a body."""

    origin: ca.SX
    directors: ca.SX

    def point(self, components: Sequence[Scalar]) -> ca.SX:
        """Return the position of the material point with these body coordinates, m."""
        return self.origin + self.vector(components)

    def vector(self, components: Sequence[Scalar]) -> ca.SX:
        """Return the vector with these components in the directors."""
        return ca.mtimes(self.directors, _vector(components))

    def at(
        self,
        point: Sequence[Scalar] = (0.0, 0.0, 0.0),
        axis: Sequence[float] = (0.0, 0.0, 1.0),
        normal: Sequence[float] | None = None,
    ) -> Place:
        """Return the place of a joint.

        Parameters
        ----------
        point : sequence of three
            Body coordinates, m; numbers or expressions of parameters.
        axis : sequence of three
            Direction in body coordinates, of any length but zero.
        normal : sequence of three, optional
            Zero direction of angles; its component along the axis is dropped. The director after the
            axis when not given (d1 for d3, d2 for d1, d3 for d2).

        Raises
        ------
        InvalidModel
            If the axis is zero or the normal is parallel to it.
        """
        triad = _triad(axis, normal)
        return Place(self.point(point), *(self.vector(list(director)) for director in triad))


GROUND = Frame(ca.SX.zeros(3), ca.SX.eye(3))
"""The inertial frame; `gravity` of the assembly decides which axis is vertical."""


def _orthonormality(frame: Frame) -> ca.SX:
    d1, d2, d3 = ca.horzsplit(frame.directors)
    return ca.vertcat(
        ca.dot(d1, d1) - 1, ca.dot(d2, d2) - 1, ca.dot(d3, d3) - 1,
        ca.dot(d2, d3), ca.dot(d3, d1), ca.dot(d1, d2),
    )  # fmt: skip


def turned(axis: Sequence[float] | Array, angle: Scalar) -> ca.SX:
    """Return directors turned by `angle` (rad) about `axis`, which must not be zero, shape (3, 3)."""
    e, angle = _unit(axis, "axis"), as_expression(angle, "the angle")
    cross = ca.SX(ca.sparsify(ca.skew(ca.DM(e))))
    along = ca.SX(ca.sparsify(ca.DM(np.outer(e, e))))
    return ca.cos(angle) * (ca.SX.eye(3) - along) + ca.sin(angle) * cross + along


def _triad(axis: Sequence[float], normal: Sequence[float] | None) -> tuple[Array, Array, Array]:
    e = _unit(axis, "axis")
    following = np.eye(3)[(int(np.abs(e).argmax()) + 1) % 3]
    n = following if normal is None else _unit(normal, "normal")
    across = n - (n @ e) * e
    if np.linalg.norm(across) < 1e-6:
        raise InvalidModel(f"the normal {tuple(map(float, n))} is parallel to the axis {tuple(map(float, e))}")
    n = across / np.linalg.norm(across)
    return n, np.cross(e, n), e


def _unit(direction: Sequence[float] | Array, what: str) -> Array:
    try:
        values = np.array([float(entry) for entry in direction])
    except (TypeError, ValueError, RuntimeError):
        raise InvalidModel(f"the {what} must be three numbers, not {described(direction)}") from None
    length = float(np.linalg.norm(values)) if values.shape == (3,) else 0.0
    if not 0.0 < length < np.inf:
        raise InvalidModel(f"the {what} {tuple(direction)} is no direction in space")
    return values / length


def _vector(components: Sequence[Scalar]) -> ca.SX:
    column = as_expression(components, "a vector in space")
    if column.shape != (3, 1):
        raise InvalidModel(f"a vector in space has 3 components, not {column.numel()}")
    return ca.sparsify(column)


def number(expression: Any, parameters: Parameters) -> Array:
    """Evaluate an expression of parameters at their default values."""
    quantity = as_expression(expression, "a mass property")
    function = ca.Function("number", [parameters.p], [quantity], {"allow_free": True})
    if function.get_free():
        raise InvalidModel(f"mass properties hold symbols that are no parameters: {function.get_free()}")
    return np.asarray(function(parameters.values()))


def _check_mass(what: str, mass: Scalar, parameters: Parameters) -> None:
    value = float(number(mass, parameters)[0, 0])
    if not 0.0 <= value < np.inf:
        raise InvalidModel(f"{what}: its mass is {value:g} kg, it must be finite and must not be negative")
