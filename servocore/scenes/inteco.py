r"""The laboratory crane 3DCrane of INTECO: a gantry crane of 0.5 m with friction, whose inputs are duty cycles.

          ---- s_x (u_x) ---->
    ======[       rail       ]========      rails along x, z = 0
          [  cart   ]                       s_y (u_y) along the rail
               \
                \  line l, paid out by the lift motor (u_l)
                 o payload (x, y, z), z < 0

Data of the scene: masses of rail, cart and payload, inertia of the lift drive as a mass on the line, and for each drive
the force k at full duty, dry friction in both directions and viscous friction; model ``points``. A drive exerts

    k u - c v - (d_+ (1 + T)/2 + d_- (1 - T)/2) T,    T = tanh(v/v_0),    u in [-1, 1],

so that its dry friction is d_+ forwards and d_- backwards, smoothed within v_0. Ranges of the rails are limits.
Left out: friction that depends on the position, sticking, drag of the line, motors' inertia of rail and cart.

Published (Vicente-Martinez and Ramirez-Laboreo, arXiv 2509.13330, with its simulator Crane3DSim): payload 0.457 kg,
cart 1.155 kg, rail 2.20 kg, line 0.13 to 1 m, ranges 0.505 m and 0.625 m, and the form of these equations with friction
that differs by direction. Viscous friction is that of the maker's model (100, 82 and 75 N.s/m), as public simulations
of the crane have it. The identified forces at full duty, dry friction and inertias are in a binary file of the authors
that could not be read here: their values below are declared assumptions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Parameter, Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes.crane_levels import Crane
from servocore.scenes.gantry_crane import INPUTS as FORCES
from servocore.scenes.gantry_crane import LIMITS, OUTPUTS, RAILS, drawing
from servocore.scenes.gantry_crane import closed_form as frictionless
from servocore.scenes.hanging_load import follow

DRIVES = {"s_x": "x", "s_y": "y", "l": "l"}
"""Letters of the drives by the positions that they move."""
_DATA = {"x": ("rail", 60.0, 5.0, 5.8, 100.0), "y": ("cart", 50.0, 3.5, 4.1, 82.0), "l": ("line", 40.0, 2.0, 2.6, 75.0)}


def _drive(letter: str, what: str, gain: float, forwards: float, backwards: float, viscous: float) -> list[Parameter]:
    return [
        Parameter(f"gain_{letter}", gain, "N", 1e-6, 1e9, f"k, force on the {what} at full duty"),
        Parameter(f"dry_{letter}_forwards", forwards, "N", 0.0, 1e9, f"d_+, dry friction of the {what}"),
        Parameter(f"dry_{letter}_backwards", backwards, "N", 0.0, 1e9, f"d_-, dry friction of the {what}"),
        Parameter(f"viscous_{letter}", viscous, "N.s/m", 0.0, 1e9, f"c, viscous friction of the {what}"),
    ]


PARAMETERS = Parameters(
    Parameter("bridge_mass", 2.20, "kg", 0.0, 1e9, "m_s, of the rail, moves along x only"),
    Parameter("trolley_mass", 1.155, "kg", 1e-3, 1e9, "m_w, of the cart"),
    Parameter("load_mass", 0.457, "kg", 1e-3, 1e9, "m_c, of the payload"),
    Parameter("winch_inertia", 2.0, "kg.m2", 1e-6, 1e9, "of the lift drive, for a drum of winch_radius"),
    Parameter("winch_radius", 1.0, "m", 1e-3, 1e3, "of a drum that turns as fast as the line moves", fixed=True),
    Parameter("gravity", 9.81, "m/s2", 1e-3, 1e3, "g", fixed=True),
    *(parameter for letter, data in _DATA.items() for parameter in _drive(letter, *data)),
    Parameter("creep", 0.02, "m/s", 1e-6, 1e3, "v_0, where dry friction is 76 % of its value", fixed=True),
)
INPUTS = tuple(
    Quantity(f"u_{letter}", "1", f"duty cycle of the drive of the {data[0]}") for letter, data in _DATA.items()
)


def _friction(rate: Any, side: Any, values: Mapping[str, Any] | Parameters, letter: str) -> Any:
    """Return the friction of a drive against its rate, N; `side` is tanh(rate/v_0)."""
    forwards, backwards = (values[f"dry_{letter}_{way}"] for way in ("forwards", "backwards"))
    return (forwards * (1 + side) / 2 + backwards * (1 - side) / 2) * side + values[f"viscous_{letter}"] * rate


def points() -> MechanicalSystem:
    """Six coordinates q = (s_x, s_y, l, x, y, z), one constraint: the gantry crane with duty cycles and friction."""
    crane = Crane("inteco", RAILS, PARAMETERS, FORCES, OUTPUTS, (0.2, 0.3, -2.0)).points()
    force, rows = ca.SX(crane.force), []
    for name, letter in DRIVES.items():
        place = crane.coordinates.names.index(name)
        rate = crane.coordinates.velocity(name)
        force[place] -= _friction(rate, ca.tanh(rate / PARAMETERS["creep"]), PARAMETERS, letter)
        rows.append(-PARAMETERS[f"gain_{letter}"] * ca.jacobian(crane.coordinates[name], crane.q))
    return replace(crane, inputs=INPUTS, force=force, input_matrix=ca.vertcat(*rows))


def closed_form(reference: Array, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Exact duty cycles and motion for reference jets of order four or higher: the gantry crane's, and friction."""
    load = np.asarray(reference)
    answer = frictionless(load, parameters)
    answer["M_w"] = answer["M_w"] / parameters["winch_radius"]  # the duty of the line's drive is one of a force
    trolley, _, rope, _ = follow(load, parameters, OUTPUTS)
    for letter, place, force in zip(DRIVES.values(), (*trolley, rope), ("F_x", "F_y", "M_w"), strict=True):
        rate = place.d().value
        friction = _friction(rate, np.tanh(rate / parameters["creep"]), parameters, letter)
        answer[f"u_{letter}"] = (answer.pop(force) + friction) / parameters[f"gain_{letter}"]
    return answer


def inteco() -> Scene:
    """Return the laboratory crane with its default manoeuvre, 0.3 m, 0.4 m and 0.25 m upwards in 3 s.

    Returns
    -------
    Scene
        With its model, its path, and the ranges of rails, line and duty cycles as limits.
    """
    scene = Scene(
        name="inteco",
        models={"points": points},
        reference=rest_to_rest((0.1, 0.1, -0.6), (0.4, 0.5, -0.35), 3.0),
        closed_form=closed_form,
        limits=LIMITS,
        tracked="load",
        drawing=drawing,
    )
    ranges = {"s_x": (0.0, 0.505), "s_y": (0.0, 0.625), "l": (0.13, 1.0)}
    return scene.with_limits(**ranges, **{each.name: 1.0 for each in INPUTS})
