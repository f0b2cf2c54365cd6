r"""The gantry crane: a bridge on two rails, a trolley across it, a winch on the trolley, a load on a rope, in space.

          ---- s_x (F_x) ---->
    ======[     bridge     ]==========      rails along x, z = 0
          [   trolley      ]                s_y (F_y) across the rails, on the bridge
                \
                 \  rope l, paid out by the winch (M_w)
                  o load (x, y, z), z < 0

Data of the scene: m_b, m_t, m, J_w, r_w, g of five degrees of freedom, three inputs; model ``points``.
``generalized`` has two swing angles in place of the load's position.
Left out: the effects in `EFFECTS` except the winch's inertia; skewing of the bridge.

With a path in the plane y = constant this is the overhead crane, whose trolley then carries the bridge along.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from servocore.model.drawing import Part
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Parameter, Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes import hanging_load
from servocore.scenes.crane_carriages import Rails
from servocore.scenes.crane_effects import crane_effects, flexible, friction
from servocore.scenes.crane_levels import Crane

PARAMETERS = Parameters(
    Parameter("bridge_mass", 40.0, "kg", 0.0, 1e9, "m_b, moves along x only"), *hanging_load.PARAMETERS
)
INPUTS = (
    Quantity("F_x", "N", "force on the bridge, positive as s_x"),
    Quantity("F_y", "N", "force on the trolley along the bridge, positive as s_y"),
    hanging_load.WINCH,
)
OUTPUTS = (
    Quantity("x", "m", "load position along the rails"),
    Quantity("y", "m", "load position across the rails"),
    Quantity("z", "m", "load position, negative below the trolley"),
)
BRIDGE = Quantity("s_x", "m", "bridge position along the rails")
TROLLEY = Quantity("s_y", "m", "trolley position on the bridge")
RAILS = Rails((BRIDGE, TROLLEY), ("bridge_mass", "trolley_mass"), ("bridge_friction", "trolley_friction"))
CRANE = Crane("gantry crane", RAILS, PARAMETERS, INPUTS, OUTPUTS, (1.0, 1.0, -4.0))
SWINGS = (
    Quantity("swing_x", "rad", "swing along the rails, positive where the load is ahead"),
    Quantity("swing_y", "rad", "swing across the rails, positive where the load is ahead"),
)


def points() -> MechanicalSystem:
    """Six coordinates q = (s_x, s_y, l, x, y, z), one constraint: the rope reaches from trolley to load."""
    return CRANE.points()


def generalized() -> MechanicalSystem:
    """Five generalized coordinates s_x, s_y, l and two swing angles; singular where swing_y = 90 degrees."""
    return hanging_load.swinging(points(), "gantry crane, generalized", [BRIDGE, TROLLEY], SWINGS)


def closed_form(reference: Array, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Exact inputs and motion for reference jets of order four or higher: the crane is flat in the load position.

    Parameters
    ----------
    reference : ndarray, shape (N, orders, 3)
        Load position and its derivatives.
    parameters : mapping of str to float
        All six parameters.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        F_x, F_y, M_w, s_x, s_y, l, tension, swing, x, y, z.
    """
    (s_x, s_y), (pull_x, pull_y), _, answer = hanging_load.follow(reference, parameters, OUTPUTS)
    m_b, m_t = parameters["bridge_mass"], parameters["trolley_mass"]
    return {
        "F_x": (m_b + m_t) * s_x.derivatives()[2] - pull_x,
        "F_y": m_t * s_y.derivatives()[2] - pull_y,
        "s_x": s_x.value,
        "s_y": s_y.value,
        **answer,
    }


def drawing(v: Mapping[str, Any]) -> list[Part]:
    """Return bridge, trolley, rope and load."""
    trolley, load = (v["s_x"], v["s_y"], 0), (v["x"], v["y"], v["z"])
    return hanging_load.drawn(trolley, load, Part("rail", ((v["s_x"], 0, 0),), along=1))


LIMITS = hanging_load.limits("trolley")


EFFECTS = crane_effects(
    CRANE,
    [BRIDGE, TROLLEY],
    [
        friction(Parameter("bridge_friction", 14.7, "N", 0.0, 1e9, "dry friction of the bridge's drive")),
        flexible("bridge", "the bridge", 6.0, BRIDGE),
    ],
    rope=1.5,
)


def gantry_crane() -> Scene:
    """Return the gantry crane with its default manoeuvre, (0, 0, -5) m to (6, 3, -2) m in 6 s.

    Returns
    -------
    Scene
        With its models and its path.
    """
    return Scene(
        name="gantry_crane",
        models={"points": points, "generalized": generalized},
        reference=rest_to_rest((0.0, 0.0, -5.0), (6.0, 3.0, -2.0), 6.0),
        closed_form=closed_form,
        limits=LIMITS,
        tracked="load",
        effects=EFFECTS,
        drawing=drawing,
    )
