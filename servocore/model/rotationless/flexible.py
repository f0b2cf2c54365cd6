"""Flexible parts: geometrically exact beams with directors at their nodes, and ropes of points.

Strains are products of positions and directors, so that they are invariant under rotations, discretized too (Betsch and
Steinmann 2002), and their energies are those of quadratic invariants, which `EnergyMomentum` conserves.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import casadi as ca

from servocore.errors import InvalidModel, require_count, require_kind
from servocore.model.potentials import Energy
from servocore.model.rotationless.parts import Part, Scalar, number
from servocore.model.symbols import Parameters


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


class Line(Part):
    """A flexible part of N elements of equal length, with nodes ``name.0``, ..., ``name.N``."""

    length: Scalar
    elements: int
    many: ClassVar[bool] = True

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes."""
        return tuple(f"{self.name}.{k}" for k in range(self.elements + 1))

    @property
    def _shared(self) -> ca.SX:
        """Integrals of the products of linear shape functions, shape (N + 1, N + 1), m."""
        masses = ca.SX(self.elements + 1, self.elements + 1)
        for k in range(self.elements):
            masses[k : k + 2, k : k + 2] += ca.SX([[2, 1], [1, 2]]) * (self.length / self.elements / 6)
        return masses

    def _require_length(self, what: str, parameters: Parameters) -> None:
        require_elements(what, self.elements)
        _positive(f"{what}: its length", self.length, parameters)


@dataclass(frozen=True, eq=False)
class Beam(Line):
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
    directed: ClassVar[bool] = True

    @property
    def mass_matrix(self) -> ca.SX:
        """Constant mass matrix: of positions and of the first two directors; the third have none."""
        weights = ca.diag(ca.vertcat(ca.SX(self.section.line_mass), *self.section.inertias, 0))
        return ca.sparsify(ca.kron(self._shared, ca.kron(weights, ca.SX.eye(3))))

    def first_moment(self, q: ca.SX) -> ca.SX:
        """Return mass times position of the centre of mass, shape (3,)."""
        return self.section.line_mass * self.length * self.centre_of_mass(q)

    def stored(self, q: ca.SX) -> list[tuple[Energy, ca.SX]]:
        """Return the energies of all strains: six an element."""
        size = self.length / self.elements
        section, energies = self.section, list[tuple[Energy, ca.SX]]()
        for a, b in pairwise(self.frames(q)):
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

    def check(self, parameters: Parameters) -> None:
        """Raise `InvalidModel` if a length, mass or stiffness is impossible at default parameters."""
        section = self.section
        self._require_length(f"beam {self.name}", parameters)
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
class ElasticRope(Line):
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
    def mass(self) -> Scalar:
        """In kg."""
        return self.line_mass * self.length

    @property
    def mass_matrix(self) -> ca.SX:
        """Constant mass matrix of positions that change linearly between the points."""
        return ca.sparsify(ca.kron(self.line_mass * self._shared, ca.SX.eye(3)))

    def first_moment(self, q: ca.SX) -> ca.SX:
        """Return mass times position of the centre of mass, shape (3,)."""
        return self.mass * self.centre_of_mass(q)

    def stored(self, q: ca.SX) -> list[tuple[Energy, ca.SX]]:
        """Return the energies of all pieces, by the squares of their lengths."""
        size = self.length / self.elements
        energy = stretching(self.axial * size)
        return [(energy, ca.sumsqr(b.origin - a.origin) / size**2) for a, b in pairwise(self.frames(q))]

    def check(self, parameters: Parameters) -> None:
        """Raise `InvalidModel` if a length, mass or stiffness is impossible at default parameters."""
        self._require_length(f"rope {self.name}", parameters)
        _positive(f"rope {self.name}: its axial stiffness", self.axial, parameters)
        _positive(f"rope {self.name}: its line mass", self.line_mass, parameters, or_zero=True)


def stretching(stiffness: Scalar) -> Energy:
    """Return the energy of a piece of rope, of E A times its length, by the square of its relative length."""
    return lambda x: stiffness / 2 * (ca.sqrt(x) - 1) ** 2


def _quadratic(stiffness: Scalar, free: float) -> Energy:
    return lambda x: stiffness / 2 * (x - free) ** 2


def require_elements(what: str, elements: object) -> None:
    """Raise `InvalidModel` unless `elements` is a positive integer."""
    require_count(elements, 1, f"{what}: its number of elements", InvalidModel)


def _positive(what: str, value: Scalar, parameters: Parameters, *, or_zero: bool = False) -> None:
    numeric = float(number(value, parameters)[0, 0])
    if not (numeric > 0.0 or (or_zero and numeric == 0.0)) or numeric == float("inf"):
        raise InvalidModel(f"{what} is {numeric:g}, it must be finite and {'not negative' if or_zero else 'positive'}")
