r"""The elastic bar, as a chain of N masses: its free end is to follow a path, the force acts on the other end.

     m [o]=====================================|---> u         bar of length L, stiffness E A, mass rho A a metre
        |---> w_1 = y                          |---> w_N
        X = 0                                X = L

        [m_1]--/\/\--[m_2]--/\/\--  ...  --/\/\--[m_N]--> u    N nodes, N - 1 springs k = E A (N - 1)/L

Data of the scene: L, E A, rho A and the end mass m; model ``points``, whose coordinates are the displacements w_i of
the nodes. An inner node carries the mass of one piece, rho A L/(N - 1), an end node half of that, the first m besides.
Left out: damping, bending, large strain.

The chain is that of the cars: index 2 N + 1, no internal dynamics, closed form by jets. The bar itself obeys the wave
equation, and d'Alembert gives what moves its free end along gamma (`dalembert`), with c = sqrt(E A/(rho A)):

    w(X, t) = (gamma(t + X/c) + gamma(t - X/c))/2 + c m/(2 E A) (gamma'(t + X/c) - gamma'(t - X/c)),
    u(t) = E A/(2 c) (gamma'(t + L/c) - gamma'(t - L/c)) + m/2 (gamma''(t + L/c) + gamma''(t - L/c)).

The force starts L/c before the free end moves and ends L/c after: pre-actuation, the time a wave needs. No chain does
that, for its inputs hold derivatives of the path at one instant. With N they become the Taylor series of gamma(t + L/c)
and gamma(t - L/c). So within the motion, farther than L/c from its start and end, the chain converges to the bar, with
the square of 1/(N - 1). Nearer to them it converges to something else: it continues the path beyond its ends as the
polynomial that it is between them, not as rest. A chain models the bar for paths that are slow compared with L/c.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Parameter, Parameters
from servocore.numerics.compiled_calls import Array
from servocore.references.base import Reference
from servocore.scenes.cars import Chain, Values

PARAMETERS = Parameters(
    Parameter("length", 1.0, "m", 1e-3, 1e6, "L"),
    Parameter("axial_stiffness", 100.0, "N", 1e-3, 1e15, "E A"),
    Parameter("line_mass", 1.0, "kg/m", 1e-3, 1e9, "rho A"),
    Parameter("end_mass", 0.5, "kg", 0.0, 1e9, "m, at the free end"),
)


class Bar(Chain):
    """The bar cut into equal pieces, whose masses are halved between the nodes at their ends."""

    title = "elastic bar, {} points"
    force = Quantity("u", "N", "force on the driven end, away from the free end")
    output = Quantity("y", "m", "displacement of the free end")

    def position(self, i: int) -> Quantity:
        """Return w_i."""
        return Quantity(f"w_{i}", "m", f"displacement of node {i}")

    def parameters(self) -> Parameters:
        """Return `PARAMETERS`."""
        return PARAMETERS

    def data(self, values: Values) -> tuple[list[Any], list[Any], list[Any]]:
        """Return masses and stiffnesses of the pieces; displacements count from rest."""
        pieces = self.count - 1
        piece = values["line_mass"] * values["length"] / pieces
        stiffness = values["axial_stiffness"] * pieces / values["length"]
        masses = [values["end_mass"] + piece / 2, *[piece] * (self.count - 2), piece / 2]
        return masses, [stiffness] * pieces, [0.0] * pieces

    def places(self, v: Mapping[str, Any]) -> list[Any]:
        """Return where the nodes are: displacements count from where they rest."""
        rest = (v["length"] * i / (self.count - 1) for i in range(self.count))
        return [x + displacement for x, displacement in zip(rest, super().places(v), strict=True)]


def dalembert(
    t: Array, reference: Reference, parameters: Mapping[str, float], section: float | None = None
) -> dict[str, Array]:
    """Exact solution of the continuous bar at one of its sections, when the free end follows the path.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in s, also before the start of the path and after its end.
    reference : Reference
        Path of the free end, with two derivatives, at rest before and after.
    parameters : mapping of str to float
        All four parameters.
    section : float, optional
        X in m, distance from the free end; the driven end, X = L, when not given.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        u, force through the section in N, positive in tension: at the driven end the input; w, its displacement in m.
    """
    length, axial_stiffness, line_mass, end_mass = (parameters[name] for name in PARAMETERS.names)
    speed = np.sqrt(axial_stiffness / line_mass)
    delay = (length if section is None else section) / speed
    early, late = (np.moveaxis(reference.jet(t + shift, 2)[..., 0], -1, 0) for shift in (delay, -delay))
    difference, total = early - late, early + late
    return {
        "u": axial_stiffness / (2 * speed) * difference[1] + end_mass / 2 * total[2],
        "w": total[0] / 2 + speed * end_mass / (2 * axial_stiffness) * difference[1],
    }


def elastic_bar(count: int = 3) -> Scene:
    """Return the bar as a chain with its default manoeuvre: the free end moves from 0 m to 1 m in 2 s.

    The path is the polynomial of degree 4 N + 1, the lowest whose derivatives up to 2 N rest at both ends.

    Parameters
    ----------
    count : int
        Number N of masses, 2 to `servocore.scenes.cars.MOST_MASSES`.

    Returns
    -------
    Scene
        With its models and its path.

    Raises
    ------
    InvalidModel
        If there are too few masses, or more than a model has derivatives of the path for.
    """
    return Bar(count).scene("elastic_bar", 2.0)
