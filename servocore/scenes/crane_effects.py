"""Effects that crane models neglect, as data. Their values are declared assumptions, not measured cranes.

Sources that assumptions name:

* Armstrong-Helouvry, Control of Machines with Friction, Kluwer 1991: Coulomb and viscous friction in drives.
* Dynamics and Control of Bridge Cranes Transporting Distributed-Mass Payloads, ASME J. Dyn. Syst. Meas. Control 132
  (2010) 014505: the double pendulum of hook and payload.
* Spong, Modeling and Control of Elastic Joint Robots, ASME J. Dyn. Syst. Meas. Control 109 (1987) 310-319: a drive's
  inertia before a linear spring.
* White, Fluid Mechanics, McGraw-Hill: the drag coefficient, force by rho A v^2/2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from servocore.model.effects import Effect, Effects
from servocore.model.quantity import Quantity
from servocore.model.symbols import Parameter
from servocore.scenes.crane_levels import Crane, overhang
from servocore.scenes.hanging_load import ROPE

MOST_LUMPS = 4
_HOOK = Parameter("hook_mass", 5.0, "kg", 1e-6, 1e9, "of the hook; the load is lighter by as much")
_AIR = (
    Parameter("drag_area", 1.0, "m2", 0.0, 1e6, "drag coefficient times area of the load"),
    Parameter("air_density", 1.25, "kg/m3", 0.0, 100.0, "of the air"),
)
_MOTOR = Parameter("motor_share", 0.3, "1", 1e-3, 0.999, "of the inertia that belongs to the drive")

ELASTIC_ROPE = Effect(
    "elastic rope",
    "The rope is a linear spring of stiffness EA/l without damping, l the length paid out (Hooke's law).",
    (Parameter("rope_stiffness", 5e6, "N", 1.0, 1e10, "EA"),),
)
WINCH_INERTIA = Effect(
    "winch inertia",
    "The scene has the winch's inertia (Euler's law); without it the torque is the rope's tension times the radius.",
    left_out=True,
)
AIR_DRAG = Effect(
    "air drag",
    "The load has the drag of still air, c_d rho A v^2/2 (White, Fluid Mechanics) with constant c_d A.",
    _AIR,
)
WIND = Effect(
    "wind",
    "The load has the same drag by air that moves steadily along x; no gusts, a modelling assumption.",
    (*_AIR, Parameter("wind_speed", 8.0, "m/s", -100.0, 100.0, "along x")),
    includes=("air drag",),
)
ROPE_EXIT = Effect(
    "sheave offset",
    "The rope leaves the trolley at a fixed point beside its centre and below the rail; a sheave of no radius, a"
    " modelling assumption.",
    (
        Parameter("exit_side", 0.15, "m", -1e3, 1e3, "to the side of the trolley's centre"),
        Parameter("exit_drop", 0.5, "m", 0.0, 1e3, "below the rail"),
    ),
)


def hook(sling: float) -> Effect:
    """Return the effect of a hook between rope and slings; `sling` is their length in m."""
    return Effect(
        "hook",
        "The hook is a point mass between rope and slings: a double pendulum (ASME J. Dyn. Syst. 132, 014505).",
        (_HOOK, Parameter("sling_length", sling, "m", 1e-3, 1e3, "from the hook to the load")),
    )


def load_inertia(centre: float, gyration: float) -> Effect:
    """Return the effect of a load that is a rigid body, below the hook by `centre`, with a radius of gyration in m."""
    return Effect(
        "load inertia",
        "The load is a rigid body below the hook; the path is that of its centre of oscillation, k^2/a below its centre"
        " of mass (Huygens 1673), where an equimomental pair of points leaves no internal dynamics.",
        (
            _HOOK,
            Parameter("body_centre", centre, "m", 1e-3, 1e3, "a, from the hook to the centre of mass"),
            Parameter("body_gyration", gyration, "m", 1e-3, 1e3, "k, radius of gyration about a level axis"),
        ),
        includes=("hook",),
    )


def rope_mass_effect(lumps: int, piece: float) -> Effect:
    """Return the effect of a rope's mass in a number of lumps; `piece` is the length they stand for, in m."""
    return Effect(
        "rope mass" if lumps == 1 else f"rope mass {lumps}",
        f"The rope's lowest piece is {lumps} point mass{'es' if lumps > 1 else ''} fixed to its material, what is paid"
        " out above weighs on the winch, wound up it belongs to the trolley: modelling assumptions.",
        (
            Parameter("rope_mass", 1.0, "kg/m", 0.0, 1e6, "of a metre of rope"),
            Parameter("rope_piece", piece, "m", 1e-3, 1e4, "length that the lumps stand for, shorter than the rope"),
        ),
        listed=lumps == 1,
    )


def friction(*drives: Parameter) -> Effect:
    """Return the effect of dry and viscous friction in every drive; `drives` has those before trolley and winch."""
    return Effect(
        "friction",
        "Every drive has Coulomb and viscous friction (Armstrong-Helouvry 1991), the first smoothed as c tanh(v/v_0), a"
        " modelling assumption.",
        (
            *drives,
            Parameter("trolley_friction", 10.8, "N", 0.0, 1e9, "dry friction of the trolley"),
            Parameter("winch_friction", 29.0, "N", 0.0, 1e9, "dry friction of the winch as a force of the rope"),
            Parameter("viscous_share", 0.2, "s/m", 0.0, 1e6, "viscous friction by dry friction"),
            Parameter("creep", 0.01, "m/s", 1e-6, 1e3, "v_0, rate at which dry friction is 76 % of its full value"),
        ),
    )


def flexible(part: str, what: str, frequency: float, measured: Quantity) -> Effect:
    """Return the effect of a flexible part behind the drive that measures a position, and then that of its motor."""
    swinging = Parameter("bridge_frequency", frequency, "Hz", 1e-2, 1e3, "of drive against the rest, both ends free")
    return Effect(
        f"flexible {part}",
        f"Between the drive and {what} is a linear spring without damping (Spong 1987); the drive measures its side.",
        (_MOTOR, swinging),
        drives={measured.name: f"{measured.name}_motor"},
    )


def crane_effects(
    crane: Crane, rails: Sequence[Quantity], own: Sequence[Effect], *, rope: float, sling: float = 1.0
) -> Effects:
    """Return the effects that the scene of a crane declares.

    Parameters
    ----------
    crane : Crane
        Without effects.
    rails : sequence of Quantity
        What its drives measure beside the rope's length.
    own : sequence of Effect
        Friction and the flexible part; the others all cranes share.
    rope : float
        Length in m that the lumps of a rope mass stand for; the rope must stay longer.
    sling : float
        Length in m below the hook; a load inertia is as long.
    """
    ropes = (rope_mass_effect(count + 1, rope) for count in range(MOST_LUMPS))
    loads = (hook(sling), load_inertia(sling, sling / 2))
    declared = (ELASTIC_ROPE, *ropes, WINCH_INERTIA, AIR_DRAG, WIND, *loads, *own, ROPE_EXIT)
    measured = tuple(quantity.name for quantity in (*rails, ROPE))
    hanging = tuple(quantity.name for quantity in overhang(crane.outputs))
    return Effects(declared, measured, hanging, replace(crane, effects=declared))
