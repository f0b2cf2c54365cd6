r"""Cars in a row, joined by springs: the first is to follow a path, the force acts on the last.

      u          k_2, d_2        k_1, d_1
    ----> [m_3]---/\/\/\---[m_2]---/\/\/\---[m_1]        two cars: [m_2]---/\/\/\---[m_1]
    -------|----------------|----------------|-----> x
          x_3              x_2              x_1 = y

Data of the scene: masses m_1 ... m_n, stiffnesses k_1 ... k_(n-1) and rest lengths d_1 ... d_(n-1) of n degrees of
freedom, one input; model ``points``, whose coordinates are the positions.
Left out: friction and damping (with them the inverse problem has internal dynamics), and the length of the cars. The
scene has no limits: the equations are linear, and hold even where cars would pass through one another.

The balance of car i gives the next car from the ones before,

    x_(i+1) = x_i - d_i + (m_1 x_1'' + ... + m_i x_i'')/k_i,    u = m_1 x_1'' + ... + m_n x_n'',

so that u needs the derivative of order 2 n of the path: index 2 n + 1, no internal dynamics. The scene shows what a
high index costs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, TypeAlias

import casadi as ca

from servocore.errors import InvalidModel, described
from servocore.model.drawing import Part
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MAX_REFERENCE_ORDER, MechanicalSystem, reference_symbols
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import diagonal
from servocore.references.profiles import polynomial
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes import jets

MOST_MASSES = MAX_REFERENCE_ORDER // 2
"""A chain of n masses needs the derivative of order 2 n of its path."""


Values: TypeAlias = "Mapping[str, float] | Parameters"
"""Numbers or symbols by name."""


@dataclass(frozen=True)
class Chain(ABC):
    """Masses in a row, joined by springs: the first follows the path, the force acts on the last.

    Calling it makes the model, as a `Scene` does. Equal chains compare equal, so they share one.

    Attributes
    ----------
    count : int
        Number n of masses.
    """

    count: int
    what: ClassVar[str] = "masses"

    title: ClassVar[str]
    force: ClassVar[Quantity]
    output: ClassVar[Quantity]

    @abstractmethod
    def position(self, i: int) -> Quantity:
        """Return the position of mass i = 1 ... n."""

    @abstractmethod
    def parameters(self) -> Parameters:
        """Return the parameters of masses and springs."""

    @abstractmethod
    def data(self, values: Values) -> tuple[list[Any], list[Any], list[Any]]:
        """Return n masses (kg), n - 1 stiffnesses (N/m) and n - 1 rest lengths (m), from the first mass on."""

    def __call__(self) -> MechanicalSystem:
        """Return n coordinates without constraints: M constant and diagonal, V quadratic."""
        p = self.parameters()
        masses, stiffnesses, rest_lengths = self.data(p)
        coordinates = Coordinates(*map(self.position, range(1, self.count + 1)))
        gamma = reference_symbols(1)
        potential, guess = ca.SX(0), [gamma[0, 0]]
        for (one, other), k, d in zip(pairwise(ca.vertsplit(coordinates.q)), stiffnesses, rest_lengths, strict=True):
            potential += k * (one - other - d) ** 2 / 2
            guess.append(guess[-1] - d)
        return MechanicalSystem(
            name=self.title.format(self.count),
            coordinates=coordinates,
            parameters=p,
            inputs=(self.force,),
            outputs=(self.output,),
            mass=diagonal(masses),
            potential=potential,
            input_matrix=-ca.jacobian(coordinates.q[-1], coordinates.q),
            output=coordinates.q[0],
            gamma=gamma,
            guess=ca.vertcat(*guess),
        )

    def closed_form(self, reference: Array, values: Mapping[str, float]) -> dict[str, Array]:
        """Exact force and positions for reference jets (N, orders, 1) of order 2 n or higher."""
        (first,) = jets.components(reference)
        masses, stiffnesses, rest_lengths = self.data(values)
        x, force = [first], masses[0] * first.d().d()
        for mass, stiffness, length in zip(masses[1:], stiffnesses, rest_lengths, strict=True):
            x.append(x[-1] - length + force / stiffness)
            force = force + mass * x[-1].d().d()
        positions = {self.position(i).name: position.value for i, position in enumerate(x, 1)}
        return {self.force.name: force.value, **positions, self.output.name: first.value}

    def places(self, v: Mapping[str, Any]) -> list[Any]:
        """Return where the masses are on their line, in m, from what a solution reports."""
        return [v[self.position(i).name] for i in range(1, self.count + 1)]

    def drawing(self, v: Mapping[str, Any]) -> list[Part]:
        """Return springs and masses; the mass that follows the path is the last."""
        points = [(place, 0, 0) for place in self.places(v)]
        springs = [Part("spring", pair) for pair in pairwise(points)]
        return [*springs, *(Part("box", (each,), str(i)) for i, each in reversed(list(enumerate(points, 1))))]

    def scene(self, name: str, duration: float) -> Scene:
        """Return the scene in which the first mass moves from 0 m to 1 m in a time (s).

        Raises
        ------
        InvalidModel
            If there are too few masses, or more than a model has derivatives of the path for.
        """
        if not isinstance(self.count, int) or self.count < 2:
            raise InvalidModel(f"a chain of {self.what} has at least 2 of them, not {described(self.count)}")
        if self.count > MOST_MASSES:
            raise InvalidModel(
                f"{self.count} {self.what} need derivatives of the path up to order {2 * self.count}, but a model has"
                f" symbols for {MAX_REFERENCE_ORDER} only: at most {MOST_MASSES} {self.what}"
            )
        return Scene(
            name=name,
            models={"points": self},
            reference=rest_to_rest((0.0,), (1.0,), duration, polynomial(4 * self.count + 1)),
            closed_form=self.closed_form,
            closed_form_order=2 * self.count,
            drawing=self.drawing,
        )


class Cars(Chain):
    """Cars with masses, stiffnesses and rest lengths of their own, counted from the first."""

    what, title = "cars", "{} cars, points"
    force = Quantity("u", "N", "force on the last car, positive forwards")
    output = Quantity("y", "m", "position of the first car")

    def position(self, i: int) -> Quantity:
        """Return x_i."""
        return Quantity(f"x_{i}", "m", f"position of car {i}")

    def parameters(self) -> Parameters:
        """Return masses, stiffnesses and rest lengths."""
        springs = range(1, self.count)
        return Parameters(
            *(Parameter(f"mass_{i}", 1.0, "kg", 1e-3, 1e9, f"m_{i}") for i in range(1, self.count + 1)),
            *(Parameter(f"stiffness_{i}", 50.0, "N/m", 1e-3, 1e12, f"k_{i}, cars {i} and {i + 1}") for i in springs),
            *(Parameter(f"rest_length_{i}", 0.5, "m", 1e-3, 1e3, f"d_{i}, cars {i} and {i + 1}") for i in springs),
        )

    def data(self, values: Values) -> tuple[list[Any], list[Any], list[Any]]:
        """Return the values of the parameters, kind by kind."""
        springs = range(1, self.count)
        return (
            [values[f"mass_{i}"] for i in range(1, self.count + 1)],
            [values[f"stiffness_{i}"] for i in springs],
            [values[f"rest_length_{i}"] for i in springs],
        )


def cars(count: int = 2) -> Scene:
    """Return a row of cars with its default manoeuvre: the first moves from 0 m to 1 m in 4 s.

    The path is the polynomial of degree 4 n + 1, the lowest whose derivatives up to 2 n rest at both ends.

    Parameters
    ----------
    count : int
        Number n of cars, 2 to `MOST_MASSES`.

    Returns
    -------
    Scene
        With its models and its path.

    Raises
    ------
    InvalidModel
        If there are too few cars, or more than a model has derivatives of the path for.
    """
    return Cars(count).scene("cars", 4.0)
