r"""A load on an extensible rope with mass, below a carriage with a drive in every direction: in a plane or in space.

             F_z
              ^
    F_x <--[carriage s]      N elements of rope, each a spring E A/h between points that carry its mass
               \
                o node N - 1
                 \           material coordinate X: 0 at the load, L at the carriage
                  o load (x, z), which follows the path

Data of the scene: m_t, m, L, rho A, E A, g; model ``points``, whose coordinates are the positions of all points.
An element carries the mass rho A h at its ends, half of it at each.
Left out: bending, damping, air; a winch (the rope's length is fixed, the carriage moves in every direction).

The lumped rope is flat in the load's position and of index 2 N + 3: from the load upwards, with the force f_1 =
m_0 (gamma'' + g e_z) that the lowest element exerts,

    r_k = r_(k-1) + h (1/|f_k| + 1/(E A)) f_k,    f_(k+1) = f_k + m_k (r_k'' + g e_z),

and the last force is that of the drives. With N to infinity this is the rope itself,

    r_X = (1/|n| + 1/(E A)) n,    n_X = rho A (r_tt + g e_z),    r(0, t) = gamma,    n(0, t) = m (gamma'' + g e_z),

an initial value problem in X that `servocore.scenes.rope_marching` solves. The drives then work from a wave's travel
time before the path to as long after it: no lumped rope does that, for its inputs hold derivatives of the path at one
instant only. See Thoma and Kotyczka, arXiv 2501.11522, and Stroehle and Betsch on space-time discretization.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from operator import add
from typing import Any

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, described
from servocore.model.drawing import Part
from servocore.model.potentials import Potential
from servocore.model.quantity import Quantity
from servocore.model.rotationless.flexible import require_elements, stretching
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MAX_REFERENCE_ORDER, MechanicalSystem, reference_symbols
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import diagonal, time_derivative
from servocore.references.profiles import polynomial
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes import jets
from servocore.scenes.hanging_load import SWING, TAUT, TENSION, swing_angle

PARAMETERS = Parameters(
    Parameter("trolley_mass", 10.0, "kg", 1e-3, 1e9, "m_t, of the carriage"),
    Parameter("load_mass", 100.0, "kg", 1e-3, 1e9, "m"),
    Parameter("rope_length", 8.0, "m", 1e-3, 1e4, "L, of the rope without load"),
    Parameter("rope_mass", 1.0, "kg/m", 0.0, 1e6, "rho A"),
    Parameter("rope_stiffness", 1e5, "N", 1.0, 1e12, "E A"),
    Parameter("gravity", 9.81, "m/s2", 1e-3, 1e3, "g", fixed=True),
)
_MOST_EXACT = 3  # elements: finer ropes start Newton's method from points that are as fast as the load
_MOST_SOLVED = MAX_REFERENCE_ORDER // 2 - 1  # elements: N of them need the path's derivative of order 2 N + 2


@dataclass(frozen=True)
class HeavyRope:
    """A factory of the lumped rope; equal settings share one model.

    Attributes
    ----------
    elements : int
        Their number N.
    dimension : int
        2 in the plane of x and z, 3 in space.
    """

    elements: int
    dimension: int

    def __post_init__(self) -> None:
        require_elements("heavy rope", self.elements)
        if self.dimension not in (2, 3):
            raise InvalidModel(f"a heavy rope has 2 or 3 dimensions, not {described(self.dimension)}")

    @property
    def axes(self) -> str:
        """Letters of the directions, the vertical last."""
        return "xz" if self.dimension == 2 else "xyz"

    def point(self, k: int) -> tuple[Quantity, ...]:
        """Return the position of point k: 0 is the load, N the carriage."""
        if not k:
            return tuple(Quantity(axis, "m", "load position") for axis in self.axes)
        name, what = ("s", "carriage") if k == self.elements else (f"p{k}", f"point {k} of the rope")
        return tuple(Quantity(f"{name}_{axis}", "m", f"position of the {what}") for axis in self.axes)

    def masses(self, values: Mapping[str, Any] | Parameters) -> list[Any]:
        """Return the masses of all points from the load upwards, kg."""
        piece = values["rope_mass"] * values["rope_length"] / self.elements
        inner = [piece] * (self.elements - 1)
        return [values["load_mass"] + piece / 2, *inner, values["trolley_mass"] + piece / 2]

    def __call__(self) -> MechanicalSystem:
        """Return all points without constraints: M constant and diagonal, the energy of springs by squared lengths."""
        p, coordinates = PARAMETERS, Coordinates(*(each for k in range(self.elements + 1) for each in self.point(k)))
        points, gamma = ca.vertsplit(coordinates.q, self.dimension), reference_symbols(self.dimension)
        masses, size, axial = self.masses(p), p["rope_length"] / self.elements, p["rope_stiffness"]
        strains = [ca.sumsqr(above - below) / size**2 for below, above in pairwise(points)]
        weight = sum(mass * p["gravity"] * point[-1] for mass, point in zip(masses, points, strict=True))
        drives = tuple(Quantity(f"F_{axis}", "N", f"force on the carriage along {axis}") for axis in self.axes)
        return MechanicalSystem(
            name=f"heavy rope of {self.elements} elements, points",
            coordinates=coordinates,
            parameters=p,
            inputs=drives,
            outputs=self.point(0),
            mass=diagonal([mass for mass in masses for _ in self.axes]),
            potential=Potential(weight, [(stretching(axial * size), strain) for strain in strains]),
            input_matrix=-ca.jacobian(points[-1], coordinates.q),
            output=points[0],
            gamma=gamma,
            guess=self._guess(gamma, masses),
            observables={
                TENSION: axial * (ca.sqrt(strains[0]) - 1),
                SWING: swing_angle(points[0] - points[-1]),
            },
        )

    def _guess(self, gamma: ca.SX, masses: Sequence[ca.SX]) -> ca.SX:
        """Return the recursion of the lumped rope, exact but for fine ropes: it selects taut elements."""
        p, force = PARAMETERS, ca.SX.zeros(self.dimension)
        points, up = [gamma[:, 0]], ca.vertcat(*[0] * (self.dimension - 1), p["gravity"])
        acceleration = gamma[:, 2]
        for mass in masses[:-1]:
            force += mass * (acceleration + up)
            points.append(
                points[-1] + p["rope_length"] / self.elements * (1 / ca.norm_2(force) + 1 / p["rope_stiffness"]) * force
            )
            if self.elements <= _MOST_EXACT:
                acceleration = time_derivative(time_derivative(points[-1], gamma), gamma)
        return ca.vertcat(*points)

    def closed_form(self, reference: Array, values: Mapping[str, float]) -> dict[str, Array]:
        """Exact forces and positions for reference jets (N, orders, dimension) of order 2 N + 2 or higher."""
        place = list(jets.components(reference))
        size, axial, g = values["rope_length"] / self.elements, values["rope_stiffness"], values["gravity"]
        force, places, tensions = [jets.Jet.constant(0.0, place[0].order)] * self.dimension, [place], []
        for mass in self.masses(values):
            weight = [each.d().d() + (g if k == self.dimension - 1 else 0.0) for k, each in enumerate(places[-1])]
            force = [f + mass * a for f, a in zip(force, weight, strict=True)]
            tension = jets.sqrt(reduce(add, (f**2 for f in force)))
            tensions.append(tension)
            places.append([r + size * (1 / tension + 1 / axial) * f for r, f in zip(places[-1], force, strict=True)])
        answer = {f"F_{axis}": f.value for axis, f in zip(self.axes, force, strict=True)}
        for k in range(self.elements + 1):
            answer |= {each.name: r.value for each, r in zip(self.point(k), places[k], strict=True)}
        *level, up = (low.value - top.value for low, top in zip(places[0], places[self.elements], strict=True))
        lean = level[0] if self.dimension == 2 else np.hypot(*level)
        return answer | {TENSION.name: tensions[0].value, SWING.name: np.arctan2(lean, -up)}

    def at_rest(self, values: Mapping[str, float], load: Sequence[float]) -> dict[str, float]:
        """Return the start of a simulation by name: the rope hangs at rest, its load in a place (m)."""
        size, weight, point, start = values["rope_length"] / self.elements, 0.0, list(load), dict[str, float]()
        for k, mass in enumerate(self.masses(values)):
            start |= {each.name: float(x) for each, x in zip(self.point(k), point, strict=True)}
            weight += values["gravity"] * mass
            point[-1] += size * (1.0 + weight / values["rope_stiffness"])
        return start | {f"{name}_dot": 0.0 for name in start}

    def drawing(self, v: Mapping[str, Any]) -> list[Part]:
        """Return carriage, rope and load."""
        depth = (0,) if self.dimension == 2 else ()
        points = [
            (v[each[0].name], *(depth or (v[each[1].name],)), v[each[-1].name])
            for each in map(self.point, range(self.elements + 1))
        ]
        ropes = [Part("rope", pair, colour=TENSION.name) for pair in pairwise(points)]
        return [*ropes, Part("box", (points[-1],), "carriage"), Part("body", (points[0],), "load")]


def heavy_rope(elements: int = 2, dimension: int = 2) -> Scene:
    """Return the load on a heavy rope with its default manoeuvre, 5 m along and 1 m upwards in 6 s.

    The path is the polynomial of degree 4 N + 5, the lowest whose derivatives up to 2 N + 2 rest at both ends. Ropes of
    more than five elements are plants for `simulate`: every derivative triples the expressions of their inversion.

    Parameters
    ----------
    elements : int
        Number N of elements of the rope.
    dimension : int
        2 in a plane, 3 in space.

    Returns
    -------
    Scene
        With its models and its path.

    Raises
    ------
    InvalidModel
        If there is no element, or the dimension is neither 2 nor 3.
    """
    model = HeavyRope(elements, dimension)
    across = () if dimension == 2 else (2.0,)
    start, end = (0.0, *(0.0 for _ in across), -8.0), (5.0, *across, -7.0)
    order = min(elements, _MOST_SOLVED)
    return Scene(
        name="heavy_rope",
        models={"points": model},
        reference=rest_to_rest(start, end, 6.0, polynomial(4 * order + 5)),
        closed_form=model.closed_form if elements <= _MOST_SOLVED else None,
        closed_form_order=2 * order + 2,
        limits=(TAUT,),
        tracked="load",
        drawing=model.drawing,
    )
