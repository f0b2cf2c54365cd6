"""Parts of a mechanism: rigid bodies, point masses, the ground, and places on them where joints sit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, described, require_kind
from servocore.model.quantity import Quantity
from servocore.model.symbols import Parameters
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import as_expression

Scalar: TypeAlias = "float | ca.SX"
"""A number, or an expression of parameters."""

_AXES = ("x", "y", "z")
_ROUND_OFF = 1e-9  # relative: an inertia is physical within this


@dataclass(frozen=True, eq=False)
class RigidBody:
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

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """The twelve coordinates."""
        return frame_quantities(self.name)

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

    @property
    def nodes(self) -> tuple[str, ...]:
        """Name of the body, which has directors."""
        return (self.name,)

    def pieces(self, value: Any) -> Any:
        """Return position and directors in a configuration."""
        return value

    def weight_centre(self, q: ca.SX) -> ca.SX:
        """Return the position of the centre of mass, shape (3,), for the twelve coordinates `q`."""
        return frame_of(q).point(self.centre)

    def internal_constraints(self, q: ca.SX) -> ca.SX:
        """Return d_i . d_j = delta_ij, shape (6,)."""
        return orthonormality(q)

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
class PointMass:
    """A particle with three coordinates ``name.x``, ``name.y``, ``name.z``; `mass` in kg, not negative."""

    name: str
    mass: Scalar

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """The three coordinates."""
        return position_quantities(self.name)

    @property
    def mass_matrix(self) -> ca.SX:
        """Constant mass matrix, shape (3, 3)."""
        return self.mass * ca.SX.eye(3)

    @property
    def nodes(self) -> tuple[str, ...]:
        """Empty: a point mass has no directors."""
        return ()

    def pieces(self, value: Any) -> Any:
        """Return the position in a configuration, as a tuple."""
        return (value,)

    def weight_centre(self, q: ca.SX) -> ca.SX:
        """Return `q`, its position."""
        return q

    def internal_constraints(self, q: ca.SX) -> ca.SX:  # noqa: ARG002 - as for a body
        """Return none, shape (0,)."""
        return ca.SX(0, 1)

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


def frame_of(q: ca.SX) -> Frame:
    """Return the frame of a body with the twelve coordinates `q`."""
    return Frame(q[:3], ca.reshape(q[3:], 3, 3))


def orthonormality(q: ca.SX) -> ca.SX:
    """Return d_i . d_j - delta_ij, shape (6,), of the directors among twelve coordinates `q`."""
    d1, d2, d3 = ca.horzsplit(frame_of(q).directors)
    return ca.vertcat(
        ca.dot(d1, d1) - 1, ca.dot(d2, d2) - 1, ca.dot(d3, d3) - 1,
        ca.dot(d2, d3), ca.dot(d3, d1), ca.dot(d1, d2),
    )  # fmt: skip


def turned(axis: Sequence[float], angle: Scalar) -> ca.SX:
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


def _unit(direction: Sequence[float], what: str) -> Array:
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


def position_quantities(name: str) -> tuple[Quantity, ...]:
    """Return the three coordinates of a position."""
    return tuple(Quantity(f"{name}.{axis}", "m") for axis in _AXES)


def frame_quantities(name: str) -> tuple[Quantity, ...]:
    """Return the twelve coordinates of a frame: a position and three directors."""
    directors = (Quantity(f"{name}.d{k}_{axis}") for k in (1, 2, 3) for axis in _AXES)
    return (*position_quantities(name), *directors)


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
