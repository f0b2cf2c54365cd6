"""`Assembly`: a list of parts with their coordinates, from which mechanisms are assembled."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias, TypeVar

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, described, require_kind
from servocore.model.model_validation import equal_at_a_point
from servocore.model.potentials import Potential
from servocore.model.quantity import Quantity
from servocore.model.rotationless.flexible import Line
from servocore.model.rotationless.joints import Distance
from servocore.model.rotationless.parts import Augmented, Frame, Part, Place, PointMass, RigidBody, Scalar
from servocore.model.symbols import Coordinates, Parameters, require_unique
from servocore.model.system import MechanicalSystem, reference_symbols
from servocore.numerics.expressions import as_expression

Named = TypeVar("Named")

Configuration: TypeAlias = Mapping[str, Any]
"""By name of the part: (position, directors) of a body or of every node, positions of points, augmented value."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """Parts of a mechanism, in the order of their coordinates.

    Parameters
    ----------
    parts : sequence of RigidBody, PointMass, Beam, ElasticRope or Quantity
        A `Quantity` adds an augmented coordinate: a massless angle, displacement or rope length.
    parameters : Parameters
        Constants that mass properties and places may use.
    gravity : sequence of three
        Acceleration of free fall, m/s^2: numbers or expressions of parameters.

    Raises
    ------
    InvalidModel
        If a name is used twice, or mass properties are impossible at the default parameters.

    Attributes
    ----------
    coordinates : Coordinates
        Of all parts.
    mass : casadi.SX
        Constant mass matrix, shape (n, n); zero for augmented coordinates.
    potential : casadi.SX
        Potential of gravity and of flexible parts, J.
    orthonormality : casadi.SX
        Six constraints of every rigid body and node, in the order of the parts.
    """

    parts: Sequence[Part | Quantity]
    parameters: Parameters
    gravity: Sequence[Scalar]
    coordinates: Coordinates = field(init=False)
    mass: ca.SX = field(init=False)
    potential: ca.SX = field(init=False)
    orthonormality: ca.SX = field(init=False)

    def __post_init__(self) -> None:
        require_kind(self.parts, (list, tuple), "the parts of an assembly", "a sequence of them", InvalidModel)
        for part in self.parts:
            wanted = "a RigidBody, PointMass, Beam, ElasticRope or Quantity"
            require_kind(part, (Part, Quantity), "a part", wanted, InvalidModel)
        require_kind(self.parameters, Parameters, "the parameters of an assembly", "Parameters(...)", InvalidModel)
        require_unique([part.name for part in self.parts], "parts")
        for part in self._parts:
            part.check(self.parameters)
        coordinates = Coordinates(*(quantity for part in self._parts for quantity in part.quantities))
        object.__setattr__(self, "coordinates", coordinates)
        object.__setattr__(self, "mass", ca.sparsify(ca.diagcat(*[part.mass_matrix for part in self._parts])))
        gravity = ca.sparsify(as_expression(self.gravity, "gravity"))
        constants = [float(entry) for entry in ca.vertsplit(ca.densify(gravity)) if entry.is_constant()]
        if gravity.shape != (3, 1) or not np.isfinite(constants).all():
            raise InvalidModel(f"gravity must be three finite numbers, not {self.gravity}")
        placed = list(zip(self._parts, self._slices, strict=True))
        potential = -sum((ca.dot(gravity, part.first_moment(q)) for part, q in placed), ca.SX(0))
        stored = [energy for part, q in placed for energy in part.stored(q)]
        rows = ca.vertcat(ca.SX(0, 1), *[part.internal_constraints(q) for part, q in placed])
        object.__setattr__(self, "potential", Potential(potential, stored) if stored else potential)
        object.__setattr__(self, "orthonormality", rows)

    @cached_property
    def _parts(self) -> list[Part]:
        """The parts, with a part for every augmented coordinate."""
        return [Augmented(part) if isinstance(part, Quantity) else part for part in self.parts]

    def body(self, name: str) -> Frame:
        """Return the frame of a rigid body, for its joints."""
        return self._frames_of(name, RigidBody, "body")[0]

    def point(self, name: str) -> Place:
        """Return the place of a point mass; its triad is that of the ground."""
        return self._frames_of(name, PointMass, "point mass")[0].at()

    def node(self, name: str, node: int) -> Frame:
        """Return the frame of a node of a beam, or of a point of a rope (its directors the ground's); -1 is the last.

        Raises
        ------
        InvalidModel
            If there is no such beam or rope, or no such node.
        """
        frames = self._frames_of(name, Line, "beam or rope")
        if not -len(frames) <= node < len(frames):
            raise InvalidModel(f"{name} has no node {node}")
        return frames[node]

    def augmented(self, name: str) -> ca.SX:
        """Return the symbol of an augmented coordinate."""
        return self._found(name, Augmented, "augmented coordinate")[1]

    def configuration(self, values: Configuration) -> ca.SX:
        """Return q, shape (n,), from (position, directors) of bodies, positions of points, augmented values.

        Raises
        ------
        InvalidModel
            If a part is missing or unknown, or a value has the wrong size.
        """
        require_kind(values, Mapping, "a configuration", "values by name of the part", InvalidModel)
        names = [part.name for part in self._parts]
        if sorted(values) != sorted(names):
            raise InvalidModel(f"a configuration must give {', '.join(names)}, not {', '.join(values) or 'nothing'}")
        columns = []
        for part in self._parts:
            what, needed = f"the configuration of {part.name}", len(part.quantities)
            if part.many:
                require_kind(values[part.name], (list, tuple), what, "a list of its nodes", InvalidModel)
            pieces = list(values[part.name]) if part.many else [values[part.name]]
            if part.directed:
                for node in pieces:
                    require_kind(node, (list, tuple), what, "(position, directors)", InvalidModel)
                pieces = [piece for node in pieces for piece in node]
            column = ca.vertcat(*[ca.vec(as_expression(piece, what)) for piece in pieces])
            if column.numel() != needed:
                raise InvalidModel(f"{what} needs {needed} values, not {column.numel()}")
            columns.append(column)
        return ca.densify(ca.vertcat(ca.SX(0, 1), *columns))

    def system(
        self,
        name: str,
        *,
        constraints: Mapping[str, ca.SX],
        inputs: Mapping[Quantity, ca.SX],
        outputs: Mapping[Quantity, ca.SX],
        guess: Callable[[ca.SX], Configuration],
        home: tuple[float, ...] = (),
        multipliers: Mapping[str, ca.SX] | None = None,
        observables: Mapping[Quantity, ca.SX] | None = None,
        force: ca.SX | None = None,
    ) -> MechanicalSystem:
        """Return the mechanical system of these parts and joints.

        Parameters
        ----------
        name : str
            Name of the system in messages.
        constraints : mapping of str to casadi.SX
            Rows that vanish, by name of the joint. Orthonormality of the directors is added in front of them.
        inputs : mapping of Quantity to casadi.SX
            For every input the scalar function e(q) that it drives: u acts as the generalized force
            u grad e(q). A torque drives an angle, a force drives a displacement.
        outputs : mapping of Quantity to casadi.SX
            For every component of the servo output the function of q that follows the reference.
        guess : callable
            Function of a reference y, shape (m,), that returns an argument of `configuration`: a configuration near
            it. Newton's method starts there, so that it decides between branches.
        home : tuple of float, optional
            A regular value of the servo output; ones when not given.
        multipliers : mapping of str to casadi.SX, optional
            Result of `multipliers`, if observables use them.
        observables : mapping of Quantity to casadi.SX, optional
            Further reported quantities. The tension of every rope is added, as ``rope.tension`` of a joint ``rope``,
            unless it is among them: it must stay positive.
        force : casadi.SX, optional
            Applied forces f(q, v, p), shape (n,).
        """
        constraints = _expressions(constraints, f"{name}: constraints")
        inputs, outputs = _expressions(inputs, f"{name}: inputs"), _expressions(outputs, f"{name}: outputs")
        if not callable(guess):
            raise InvalidModel(f"{name}: guess must be a function of the reference, not {described(guess)}")
        q, driven = self.coordinates.q, ca.vertcat(ca.SX(0, 1), *inputs.values())
        lam = self.multipliers(constraints) if multipliers is None else multipliers
        gamma = reference_symbols(len(inputs))
        return MechanicalSystem(
            name=name,
            coordinates=self.coordinates,
            parameters=self.parameters,
            inputs=tuple(inputs),
            outputs=tuple(outputs),
            mass=self.mass,
            output=ca.vertcat(ca.SX(0, 1), *outputs.values()),
            input_matrix=ca.sparsify(-ca.jacobian(driven, q)),
            potential=self.potential,
            force=ca.SX.zeros(q.numel()) if force is None else force,
            constraints=ca.vertcat(self.orthonormality, *constraints.values()),
            multipliers=ca.vertcat(lam[""], *[lam[key] for key in constraints]),
            gamma=gamma,
            guess=self.configuration(guess(gamma[:, 0])),
            home=home,
            observables=self._with_tensions(observables or {}, constraints, lam),
            constraint_names=self._row_names(constraints),
        )

    def multipliers(self, constraints: Mapping[str, ca.SX]) -> Mapping[str, ca.SX]:
        """Return symbols of the multipliers by name of the joint, '' for those of orthonormality."""
        rows = {"": self.orthonormality, **constraints}
        return {key: ca.SX.sym(f"lam_{key or 'orthonormality'}", row.numel()) for key, row in rows.items()}

    def _with_tensions(
        self, observables: Mapping[Quantity, ca.SX], constraints: Mapping[str, ca.SX], lam: Mapping[str, ca.SX]
    ) -> dict[Quantity, ca.SX]:
        """Return the observables with the tension of every rope among them, declared positive."""
        with_tensions = dict(observables)
        for name, row in constraints.items():
            if not (isinstance(row, Distance) and row.is_rope(self.coordinates.q)):
                continue
            tension = row.tension(lam[name])
            same = [quantity for quantity, value in with_tensions.items() if equal_at_a_point(value, tension)]
            with_tensions = {replace(k, tension=True) if k in same else k: value for k, value in with_tensions.items()}
            if not same:
                with_tensions[Quantity(f"{name}.tension", "N", f"tension of {name}", tension=True)] = tension
        return with_tensions

    def _row_names(self, constraints: Mapping[str, ca.SX]) -> tuple[str, ...]:
        """Name every row by its joint, with a number where that has several."""
        bodies = [name for part in self._parts if part.directed for name in part.nodes]
        directors = ("d1.d1", "d2.d2", "d3.d3", "d2.d3", "d3.d1", "d1.d2")
        joints = [
            name if rows.numel() == 1 else f"{name} {k + 1}"
            for name, rows in constraints.items()
            for k in range(rows.numel())
        ]
        return (*(f"{name} {pair}" for name in bodies for pair in directors), *joints)

    @property
    def _slices(self) -> list[ca.SX]:
        """Return the coordinates of every part."""
        ends = itertools.accumulate((len(part.quantities) for part in self._parts), initial=0)
        return [self.coordinates.q[a:b] for a, b in itertools.pairwise(ends)]

    def _frames_of(self, name: str, kind: Any, what: str) -> list[Frame]:
        part, q = self._found(name, kind, what)
        return part.frames(q)

    def _found(self, name: str, kind: Any, what: str) -> tuple[Part, ca.SX]:
        """Return a part of a kind and its coordinates."""
        listed = [each for each in zip(self._parts, self._slices, strict=True) if isinstance(each[0], kind)]
        for part, q in listed:
            if part.name == name:
                return part, q
        there_are = ", ".join(part.name for part, _ in listed) or "none"
        raise InvalidModel(f"no {what} is called {name}; there are {there_are}")


def _expressions(values: Mapping[Named, Any], what: str) -> dict[Named, ca.SX]:
    """Return the values of a mapping as expressions; raises `InvalidModel` if it is not a mapping."""
    require_kind(values, Mapping, what, "expressions by name", InvalidModel)
    return {key: as_expression(value, f"{what}: {getattr(key, 'name', key)}") for key, value in values.items()}
