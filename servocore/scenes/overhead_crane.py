r"""The overhead crane: a trolley on a straight girder, a winch on it, a load on a rope, in a vertical plane.

        |---- s (F) ---->
    ====[trolley]==============      z = 0
            \
             \  rope l, paid out by the winch (M_w)
              o load (x, z), z < 0

Data of the scene: m_t, m, J_w, r_w, g of three degrees of freedom, two inputs; model ``points``.
``generalized`` has the swing angle in place of the load's position.
Left out: the effects in `EFFECTS` except the winch's inertia; the third dimension (see the gantry crane).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from servocore.model.drawing import Part
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes import hanging_load
from servocore.scenes.crane_carriages import Rails
from servocore.scenes.crane_effects import crane_effects, flexible, friction
from servocore.scenes.crane_levels import Crane

PARAMETERS = Parameters(*hanging_load.PARAMETERS)
INPUTS = (Quantity("F", "N", "force on the trolley, positive as s"), hanging_load.WINCH)
OUTPUTS = (Quantity("x", "m", "load position"), Quantity("z", "m", "load position, negative below the girder"))
TROLLEY = Quantity("s", "m", "trolley position")
RAIL = Rails((TROLLEY,), ("trolley_mass",), ("trolley_friction",))
CRANE = Crane("overhead crane", RAIL, PARAMETERS, INPUTS, OUTPUTS, (1.0, -4.0))
SWING = Quantity("swing", "rad", "angle of the rope from the vertical, positive where the load is ahead")


def points() -> MechanicalSystem:
    """Four coordinates q = (s, l, x, z), one constraint (x - s)^2 + z^2 = l^2."""
    return CRANE.points()


def generalized() -> MechanicalSystem:
    """Three generalized coordinates s, l and the swing angle."""
    return hanging_load.swinging(points(), "overhead crane, generalized", [TROLLEY], [SWING])


def closed_form(reference: Array, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Exact inputs and motion for reference jets (N, orders, 2) of order four or higher."""
    (s,), (pull,), _, answer = hanging_load.follow(reference, parameters, OUTPUTS)
    force = parameters["trolley_mass"] * s.derivatives()[2] - pull
    return {"F": force, "s": s.value, **answer}


def drawing(v: Mapping[str, Any]) -> list[Part]:
    """Return rail, trolley, rope and load."""
    trolley, load = (v["s"], 0, 0), (v["x"], 0, v["z"])
    return hanging_load.drawn(trolley, load, Part("rail", ((0, 0, 0),)))


LIMITS = hanging_load.limits("girder")


EFFECTS = crane_effects(
    CRANE,
    [TROLLEY],
    [friction(), flexible("rail", "the trolley", 6.0, TROLLEY)],
    rope=0.7,
    sling=0.4,
)


def overhead_crane() -> Scene:
    """Return the overhead crane with its default manoeuvre, (0, -4) m to (5, -1) m in 3 s.

    Returns
    -------
    Scene
        With its models and its path.
    """
    return Scene(
        name="overhead_crane",
        models={"points": points, "generalized": generalized},
        reference=rest_to_rest((0.0, -4.0), (5.0, -1.0), 3.0),
        closed_form=closed_form,
        limits=LIMITS,
        tracked="load",
        effects=EFFECTS,
        drawing=drawing,
    )
