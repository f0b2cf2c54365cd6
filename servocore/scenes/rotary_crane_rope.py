r"""The rotary crane on a flexible rope: a plant for `EnergyMomentum`, with as many elements as one likes.

          |=========[trolley]======
          |             \   paid out or wound up above the first node: straight, stiff, its weight on the winch
          |              o  node 0
                          \ rope_piece metres of rope in N elements, fixed to the rope's material
                           o node N is the load

The elements are an `ElasticRope`, from node 0 to the load. Hoisting changes the length above them only: nodes that slid
along the rope would make the mass matrix depend on the configuration. Rope that is wound up belongs to the trolley.
With N to infinity it is what the effects ``rope mass``, ``rope mass 2``, ... with ``elastic rope`` approach by lumps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from servocore.model.potentials import Potential
from servocore.model.rotationless.flexible import ElasticRope, require_elements
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MechanicalSystem
from servocore.scenes.hanging_load import SWING, TENSION, swing_angle

ROPE_PARAMETERS = (
    Parameter("rope_mass", 1.0, "kg/m", 0.0, 1e6, "of a metre of rope"),
    Parameter("rope_piece", 1.5, "m", 1e-3, 1e4, "length of the elements together, shorter than the rope"),
    Parameter("rope_stiffness", 5e6, "N", 1.0, 1e10, "EA"),
)


@dataclass(frozen=True)
class OnRope:
    """A factory of a crane's nine invariant coordinates with a flexible rope.

    Parameters
    ----------
    base : callable
        Makes the crane on a stiff rope without mass, which is its last constraint.
    elements : int
        Of the rope; a whole number, one at least.
    """

    base: Callable[[], MechanicalSystem]
    elements: int

    def __post_init__(self) -> None:
        require_elements("rope rope", self.elements)  # at once: True equals 1 where models are looked up

    def __call__(self) -> MechanicalSystem:
        """Return the crane."""
        base = self.base()
        p = Parameters(*base.parameters.declared, *ROPE_PARAMETERS)
        part = ElasticRope("rope", p["rope_piece"], self.elements, p["rope_stiffness"], p["rope_mass"])
        part.check(p)
        c, count = Coordinates(*base.coordinates.quantities, *part.quantities[:-3]), len(base.coordinates)
        old = ca.vertcat(base.q, base.p)
        new = ca.vertcat(c.q[:count], *(p[name] for name in base.parameters.names))
        load, length, trolley = c.q[count - 3 : count], c["l"], ca.vertcat(c["p_x"], c["p_y"], 0)
        nodes, above = ca.vertcat(c.q[count:], load), length - p["rope_piece"]
        first = nodes[:3]
        weight = part.first_moment(nodes)[2] + p["rope_mass"] * above * first[2] / 2
        guess = ca.substitute(base.guess, old, new)
        observables = {key: ca.substitute(ca.SX(expression), old, new) for key, expression in base.observables.items()}
        return MechanicalSystem(
            name=f"{base.name}, rope of {self.elements} elements",
            coordinates=c,
            parameters=p,
            inputs=base.inputs,
            outputs=base.outputs,
            mass=_mass(ca.substitute(base.mass, old, new), c, part),
            potential=Potential(
                ca.substitute(ca.SX(base.potential), old, new) + p["gravity"] * weight, part.stored(nodes)
            ),
            constraints=ca.vertcat(
                ca.substitute(base.constraints, old, new)[:-1], ca.sumsqr(first - trolley) - above**2
            ),
            input_matrix=ca.horzcat(ca.substitute(base.input_matrix, old, new), ca.SX(3, len(c) - count)),
            output=load,
            multipliers=base.lam,
            gamma=base.gamma,
            guess=ca.vertcat(guess, *_straight(guess, p["rope_piece"], self.elements)),
            home=base.home,
            observables={**observables, TENSION: 2 * base.lam[3] * above, SWING: swing_angle(first - trolley)},
        )


def _mass(base: ca.SX, c: Coordinates, part: ElasticRope) -> ca.SX:
    """Return the mass matrix: that of the crane, whose trolley bears the rope less, and that of the elements."""
    found, count = ca.SX(len(c), len(c)), base.size1()
    found[:count, :count] = base
    for name in ("p_x", "p_y"):
        found[c.names.index(name), c.names.index(name)] -= part.mass
    places = [*range(count, len(c)), *range(count - 3, count)]
    found[places, places] += part.mass_matrix
    return ca.sparsify(found)


def _straight(guess: ca.SX, length: ca.SX, elements: int) -> list[ca.SX]:
    """Return nodes on the line from the load to the trolley, from the first one on."""
    load, trolley = guess[-3:], ca.vertcat(guess[2:4], 0)
    up = (trolley - load) / ca.norm_2(trolley - load)
    return [load + length * (1 - k / elements) * up for k in range(elements)]


def at_rest(scene: Scene) -> dict[str, float]:
    """Return the start of a simulation: the crane at rest with its load where the path begins, the rope hanging.

    Parameters
    ----------
    scene : Scene
        With a model that an `OnRope` makes.
    """
    system, known = scene.model(), scene.parameter_values()
    elements = (len(system.coordinates) - 9) // 3
    x, y, height = (float(coordinate) for coordinate in scene.reference.jet(scene.reference.start_time, 0)[0])
    size, radius = known["rope_piece"] / elements, math.hypot(x, y)
    heights = [height]
    for k in range(elements):
        pull = known["gravity"] * (known["load_mass"] + known["rope_mass"] * size * (k + 0.5))
        heights.append(heights[-1] + size * (1 + pull / known["rope_stiffness"]))
    values = {"d_x": x / radius, "d_y": y / radius, "p_x": x, "p_y": y, "s": radius, "x": x, "y": y, "z": height}
    values["l"] = known["rope_piece"] - heights[-1]
    for k in range(elements):
        values |= {f"rope.{k}.x": x, f"rope.{k}.y": y, f"rope.{k}.z": heights[elements - k]}
    return values | {f"{name}_dot": 0.0 for name in values}
