"""Flexible parts: geometrically exact beams with directors at their nodes, and ropes of points.

Strains are products of positions and directors, so that they are invariant under rotations, discretized too (Betsch and
Steinmann 2002), and their energies are those of quadratic invariants, which `EnergyMomentum` conserves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca

from servocore.errors import InvalidModel, require_count, require_kind
from servocore.model.potentials import Energy
from servocore.model.quantity import Quantity
from servocore.model.rotationless.parts import (
    Frame,
    Scalar,
    frame_of,
    frame_quantities,
    number,
    orthonormality,
    position_quantities,
)
from servocore.model.symbols import Parameters

_NODE = 12  # coordinates of a node with directors


@dataclass(frozen=True, eq=False)
class Section:
    """Stiffnesses and inertias of a beam's cross section, constant along it.

    Parameters
    ----------
    axial : number or casadi.SX
        E A, N.
    shear : pair
        G A along d1 and d2, N.
    bending : pair
        E I about d1 and d2, N m^2.
    torsion : number or casadi.SX
        G J, N m^2.
    line_mass : number or casadi.SX
        rho A, kg/m.
    inertias : pair
        Integrals of rho xi^2 over the section, along d1 and d2, kg m.
    """

    axial: Scalar
    shear: tuple[Scalar, Scalar]
    bending: tuple[Scalar, Scalar]
    torsion: Scalar
    line_mass: Scalar
    inertias: tuple[Scalar, Scalar] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Beam:
    """A beam after Simo and Reissner, along its third directors.

    Node k has twelve coordinates, position and directors, as a rigid body has: ``name.k.x``, ..., ``name.k.d3_z``.
    Between two nodes positions and directors are interpolated linearly, and strains are taken in the middle:

        Gamma_i = d_i . r' - delta_i3        K_i: half of d_k . d_j' - d_j . d_k' less the free curvature

    Parameters
    ----------
    name : str
        Of the beam.
    length : number or casadi.SX
        In m.
    elements : int
        Number of elements N; there are N + 1 nodes.
    section : Section
        Stiffnesses and inertias.
    curvature : sequence of three
        Free curvature about d1, d2 and d3, numbers in 1/m; straight when not given.
    """

    name: str
    length: Scalar
    elements: int
    section: Section
    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes."""
        return tuple(f"{self.name}.{k}" for k in range(self.elements + 1))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All coordinates, node by node."""
        return tuple(quantity for node in self.nodes for quantity in frame_quantities(node))

    @property
    def mass(self) -> Scalar:
        """In kg."""
        return self.section.line_mass * self.length

    @property
    def mass_matrix(self) -> ca.SX:
        """Constant mass matrix: of positions and of the first two directors; the third have none."""
        weights = ca.diag(ca.vertcat(ca.SX(self.section.line_mass), *self.section.inertias, 0))
        return ca.sparsify(ca.kron(_shared(self.elements, self.length), ca.kron(weights, ca.SX.eye(3))))

    def frame(self, q: ca.SX, node: int) -> Frame:
        """Return the frame of a node; -1 is the last one."""
        first = _NODE * range(self.elements + 1)[node]
        return frame_of(q[first : first + _NODE])

    def weight_centre(self, q: ca.SX) -> ca.SX:
        """Return the centre of mass, shape (3,)."""
        return _centre([self.frame(q, k).origin for k in range(self.elements + 1)])

    def internal_constraints(self, q: ca.SX) -> ca.SX:
        """Return the orthonormality of the directors of all nodes, shape (6 (N + 1),)."""
        return ca.vertcat(*[orthonormality(entry) for entry in ca.vertsplit(q, _NODE)])

    def stored(self, q: ca.SX) -> list[tuple[Energy, ca.SX]]:
        """Return the energies of all strains: six an element."""
        frames = [self.frame(q, k) for k in range(self.elements + 1)]
        size = self.length / self.elements
        section, energies = self.section, list[tuple[Energy, ca.SX]]()
        for a, b in pairwise(frames):
            stretch = (b.origin - a.origin) / size
            first, last = ca.horzsplit(a.directors), ca.horzsplit(b.directors)
            for k, stiffness in enumerate((*section.shear, section.axial)):
                strain = ca.dot((first[k] + last[k]) / 2, stretch)
                energies.append((_quadratic(stiffness * size, float(k == 2)), strain))
            for k, stiffness in enumerate((*section.bending, section.torsion)):
                i, j = (k + 1) % 3, (k + 2) % 3
                turn = (ca.dot(first[j], last[i]) - ca.dot(first[i], last[j])) / (2 * size)
                energies.append((_quadratic(stiffness * size, self.curvature[k]), turn))
        return energies

    def pieces(self, value: Any) -> list[Any]:
        """Return positions and directors of all nodes in a configuration, one after the other."""
        return [piece for node in value for piece in node]

    def check(self, parameters: Parameters) -> None:
        """Raise `InvalidModel` if a length, mass or stiffness is impossible at default parameters."""
        section = self.section
        _check(f"beam {self.name}", self.length, self.elements, parameters)
        require_kind(section, Section, f"beam {self.name}: its section", "a Section", InvalidModel)
        for what, value in (
            ("axial stiffness", section.axial), ("torsional stiffness", section.torsion),
            *(("shear stiffness", stiffness) for stiffness in section.shear),
            *(("bending stiffness", stiffness) for stiffness in section.bending),
        ):  # fmt: skip
            _positive(f"beam {self.name}: its {what}", value, parameters)
        for what, value in (("line mass", section.line_mass), *(("inertia", inertia) for inertia in section.inertias)):
            _positive(f"beam {self.name}: its {what}", value, parameters, or_zero=True)


@dataclass(frozen=True, eq=False)
class ElasticRope:
    """A rope of points with elastic pieces between them; node k has the coordinates ``name.k.x``, ``.y``, ``.z``.

    The energy of a piece of length h is h E A (|r'| - 1)^2 / 2; in compression it pushes.

    Parameters
    ----------
    name : str
        Of the rope.
    length : number or casadi.SX
        Free length, m.
    elements : int
        Number of pieces N; there are N + 1 points.
    axial : number or casadi.SX
        E A, N.
    line_mass : number or casadi.SX
        In kg/m.
    """

    name: str
    length: Scalar
    elements: int
    axial: Scalar
    line_mass: Scalar

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the points; none of them has directors."""
        return ()

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All coordinates, point by point."""
        return tuple(quantity for k in range(self.elements + 1) for quantity in position_quantities(f"{self.name}.{k}"))

    @property
    def mass(self) -> Scalar:
        """In kg."""
        return self.line_mass * self.length

    @property
    def mass_matrix(self) -> ca.SX:
        """Constant mass matrix of positions that change linearly between the points."""
        return ca.sparsify(ca.kron(self.line_mass * _shared(self.elements, self.length), ca.SX.eye(3)))

    def points(self, q: ca.SX) -> list[ca.SX]:
        """Return the positions, shape (3,) each."""
        return ca.vertsplit(q, 3)

    def weight_centre(self, q: ca.SX) -> ca.SX:
        """Return the centre of mass, shape (3,)."""
        return _centre(self.points(q))

    def internal_constraints(self, q: ca.SX) -> ca.SX:  # noqa: ARG002 - as for a body
        """Return none, shape (0,)."""
        return ca.SX(0, 1)

    def stored(self, q: ca.SX) -> list[tuple[Energy, ca.SX]]:
        """Return the energies of all pieces, by the squares of their lengths."""
        size = self.length / self.elements

        def energy(x: ca.SX) -> ca.SX:
            return self.axial * size / 2 * (ca.sqrt(x) - 1) ** 2

        return [(energy, ca.sumsqr(b - a) / size**2) for a, b in pairwise(self.points(q))]

    def pieces(self, value: Any) -> list[Any]:
        """Return the positions of the points in a configuration."""
        return list(value)

    def check(self, parameters: Parameters) -> None:
        """Raise `InvalidModel` if a length, mass or stiffness is impossible at default parameters."""
        _check(f"rope {self.name}", self.length, self.elements, parameters)
        _positive(f"rope {self.name}: its axial stiffness", self.axial, parameters)
        _positive(f"rope {self.name}: its line mass", self.line_mass, parameters, or_zero=True)


Flexible = Beam | ElasticRope


def _quadratic(stiffness: Scalar, free: float) -> Energy:
    return lambda x: stiffness / 2 * (x - free) ** 2


def _shared(elements: int, length: Scalar) -> ca.SX:
    """Return integrals of the products of linear shape functions, shape (N + 1, N + 1), m."""
    masses = ca.SX(elements + 1, elements + 1)
    for k in range(elements):
        masses[k : k + 2, k : k + 2] += ca.SX([[2, 1], [1, 2]]) * (length / elements / 6)
    return masses


def _centre(places: Sequence[ca.SX]) -> ca.SX:
    """Return the mean of places joined by straight lines of equal mass."""
    middles = [(a + b) / 2 for a, b in pairwise(places)]
    return sum(middles[1:], middles[0]) / len(middles)


def require_elements(what: str, elements: object) -> None:
    """Raise `InvalidModel` unless `elements` is a positive integer."""
    require_count(elements, 1, f"{what}: its number of elements", InvalidModel)


def _check(what: str, length: Scalar, elements: int, parameters: Parameters) -> None:
    require_elements(what, elements)
    _positive(f"{what}: its length", length, parameters)


def _positive(what: str, value: Scalar, parameters: Parameters, *, or_zero: bool = False) -> None:
    numeric = float(number(value, parameters)[0, 0])
    if not (numeric > 0.0 or (or_zero and numeric == 0.0)) or numeric == float("inf"):
        raise InvalidModel(f"{what} is {numeric:g}, it must be finite and {'not negative' if or_zero else 'positive'}")
