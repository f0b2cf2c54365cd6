r"""The rotary crane of the paper, sections 3 and 5: a slewing bridge, a trolley on it, a winch, a load on a rope.

          axis
           |   bridge angle phi (M_b)
           |=========[trolley]======      z = 0, trolley at distance s (F)
           |             \
           |              \  rope l, paid out by the winch (M_w)
                           o load (x, y, z), z < 0

The load's path is prescribed; five degrees of freedom, three inputs. The data below are a declared assumption: the
paper's tables are not reproduced here.

Data of the scene: the lumped parameters J_b, m_t, m, J_w, r_w, g of five degrees of freedom, model ``points``.
``bodies`` (the paper's 42 redundant coordinates) and ``generalized`` (its five) read the same parameters and give the
same inputs. Left out: the effects in `EFFECTS` except the winch's inertia.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from servocore.errors import InvalidSetting
from servocore.model.drawing import Part
from servocore.model.effects import NO_EFFECTS
from servocore.model.generalize import generalize
from servocore.model.limits import Limit
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.angle_wrapping import wrapped_angle
from servocore.numerics.compiled_calls import Array
from servocore.references.rest_to_rest import rest_to_rest
from servocore.scenes import hanging_load, jets
from servocore.scenes.crane_carriages import SlewingBridge
from servocore.scenes.crane_effects import crane_effects, flexible, friction
from servocore.scenes.crane_levels import Crane
from servocore.scenes.hanging_load import ROPE, SWING, TENSION

PARAMETERS = Parameters(
    Parameter("bridge_inertia", 480.0, "kg.m2", 1e-3, 1e9, "J_b, of bridge, trolley and winch at s = 0"),
    *hanging_load.PARAMETERS,
)
INPUTS = (
    Quantity("M_b", "N.m", "slewing torque on the bridge, positive as phi"),
    Quantity("F", "N", "force on the trolley along the bridge, positive as s"),
    hanging_load.WINCH,
)
OUTPUTS = (
    Quantity("x", "m", "load position"),
    Quantity("y", "m", "load position"),
    Quantity("z", "m", "load position, negative below the girder"),
)

PHI = Quantity("phi", "rad", "bridge angle", wraps=True)
TROLLEY = Quantity("s", "m", "distance of the trolley from the slewing axis", positive=True)

CRANE = Crane("rotary crane", SlewingBridge(PHI, TROLLEY), PARAMETERS, INPUTS, OUTPUTS, (4.0, 0.0, -5.0))
SMALLEST_RADIUS = 1e-3
"""The trolley must stay farther from the slewing axis than this, in m: on the axis phi is undefined."""


SIGNED_TROLLEY = Quantity("s", "m", "trolley position along the bridge, negative beyond the slewing axis")


def points(trolley: Quantity = TROLLEY, *, invariant: bool = False) -> MechanicalSystem:
    """Nine coordinates, four constraints: M constant, g quadratic, M_b acting on d through q-dependent B.

    q = (d, p, s, l, r): bridge direction d (mass J_b), trolley point p (mass m_t), trolley distance s (massless),
    rope length l (mass J_w/r_w^2), load r; constraints |d|^2 = 1, p = s d, |r - p|^2 = l^2. For `invariant` see
    `SlewingBridge`.
    """
    return replace(CRANE, carriage=SlewingBridge(PHI, trolley, invariant)).points(reported=(trolley, ROPE))


def generalized(trolley: Quantity = TROLLEY) -> MechanicalSystem:
    """Five generalized coordinates phi, s, l and two swing angles, derived from `points` by q = F(mu).

    The swing angles turn with the bridge: alpha in its plane, beta out of it. Singular where beta = 90 degrees.
    """
    base = points(trolley)
    coordinates = Coordinates(
        PHI, trolley, ROPE,
        Quantity("swing_in", "rad", "swing in the bridge's plane, outwards"),
        Quantity("swing_out", "rad", "swing out of the bridge's plane, towards larger phi"),
    )  # fmt: skip
    phi, s, rope_length, alpha, beta = ca.vertsplit(coordinates.q)
    along = ca.vertcat(ca.cos(phi), ca.sin(phi))
    rope = rope_length * hanging_load.rope_beside(along, alpha, beta)
    load = rope + ca.vertcat(s * along, 0)
    start = base.gamma
    return generalize(
        base,
        coordinates,
        ca.vertcat(along, s * along, s, rope_length, load),
        guess=_swinging_guess(start, base.parameters),
        # Without multipliers the tension follows from the load's prescribed acceleration.
        observables={TENSION: hanging_load.tension(start, base.parameters), SWING: hanging_load.swing_angle(rope)},
        name="rotary crane, generalized",
    )


def _swinging_guess(gamma: ca.SX, p: Parameters) -> ca.SX:
    """Return (phi, s, l, swing angles) with the rope along the load's acceleration less gravity."""
    trolley, rope_length, direction = hanging_load.suspension(gamma, p)
    s = ca.norm_2(trolley)
    swings = hanging_load.swings_beside(trolley / s, direction)
    return ca.vertcat(ca.atan2(trolley[1], trolley[0]), s, rope_length, swings)


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
        M_b, F, M_w, phi, s, l, tension, swing, x, y, z.
    """
    J_b, m_t = parameters["bridge_inertia"], parameters["trolley_mass"]
    (P_x, P_y), pull, _, answer = hanging_load.follow(reference, parameters, OUTPUTS)
    s, phi = jets.sqrt(P_x**2 + P_y**2), jets.atan2(P_y, P_x)
    cos, sin = P_x.value / s.value, P_y.value / s.value
    pull_along, pull_across = cos * pull[0] + sin * pull[1], cos * pull[1] - sin * pull[0]
    (s0, s1, s2), (phi0, phi1, phi2) = s.derivatives()[:3], phi.derivatives()[:3]
    return {
        "M_b": (J_b + m_t * s0**2) * phi2 + 2 * m_t * s0 * s1 * phi1 - s0 * pull_across,
        "F": m_t * (s2 - s0 * phi1**2) - pull_along,
        "phi": np.unwrap(phi0),
        "s": s0,
        **answer,
    }


LIMITS = (
    *hanging_load.limits("girder"),
    Limit(
        "the trolley's distance from the slewing axis",
        "m",
        SMALLEST_RADIUS,
        "the trolley reaches the slewing axis",
        lambda gamma, p: ca.norm_2(hanging_load.suspension(gamma, p)[0]),
    ),
)


def drawing(v: Mapping[str, Any]) -> list[Part]:
    """Return bridge, trolley, rope and load."""
    axis = (0, 0, 0)
    by_points = "p_x" in v  # a bridge that bends has no angle of its own
    trolley = (v["p_x"], v["p_y"], 0) if by_points else (v["s"] * ca.cos(v["phi"]), v["s"] * ca.sin(v["phi"]), 0)
    load = (v["x"], v["y"], v["z"])
    return hanging_load.drawn(trolley, load, Part("post", (axis,)), Part("bridge", (axis, trolley)))


def through_axis(reference: Array, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Evaluate the closed form along a path that may cross the slewing axis: s changes sign, phi does not jump.

    The times must increase. Between two instants a turn of phi by more than a right angle counts as a crossing.
    """
    answer = closed_form(reference, parameters)
    jumps = np.abs(wrapped_angle(np.diff(answer["phi"]))) > np.pi / 2
    sign = np.concatenate([[1.0], np.cumprod(np.where(jumps, -1.0, 1.0))])
    angle = np.unwrap(answer["phi"] + np.where(sign < 0.0, np.pi, 0.0))
    return {**answer, "s": sign * answer["s"], "F": sign * answer["F"], "phi": angle}


def bodies() -> MechanicalSystem:
    """Forty-two coordinates, 37 constraints: the rotationless model of the paper."""
    from servocore.scenes.rotary_crane_bodies import bodies as assembled  # noqa: PLC0415 - other models need no parts

    return assembled()


SIGNED_MODELS = {"points": partial(points, SIGNED_TROLLEY), "generalized": partial(generalized, SIGNED_TROLLEY)}
"""Factories of the models whose trolley may pass through the slewing axis, made once: partials compare as objects."""


INVARIANT_MODELS = {"points": partial(points, invariant=True)}
"""Factories of the model for integration that conserves angular momentum."""


EFFECTS = crane_effects(
    CRANE,
    [PHI, TROLLEY],
    [
        friction(Parameter("bridge_friction", 10.0, "N.m", 0.0, 1e9, "dry friction of the slewing drive")),
        flexible("bridge", "the bridge", 3.0, PHI),
    ],
    rope=1.5,
)


def rotary_crane(*, across_axis: bool = False, invariant: bool = False, rope_elements: int = 0) -> Scene:
    """Return the rotary crane with its default manoeuvre, (5, 0, -5) m to (-2, 2, -2) m in 20 s.

    Parameters
    ----------
    across_axis : bool
        Whether the trolley may pass through the slewing axis to negative s, on a girder that reaches beyond it. The
        path then decides only between the instants: on the axis itself phi is undefined, and an instant that falls
        there is refused.
    invariant : bool
        Whether rotations about the axis shall leave every constraint as it is, also where it does not vanish: what
        `EnergyMomentum` needs. The nine coordinates are the same.
    rope_elements : int
        How many elements a flexible rope shall have, see `servocore.scenes.rotary_crane_rope`: an invariant plant to
        be simulated, from `at_rest` on.

    Returns
    -------
    Scene
        With its models and its path.

    Raises
    ------
    InvalidSetting
        If the trolley may pass through the axis of an invariant model.
    """
    if across_axis and (invariant or rope_elements):
        raise InvalidSetting("the rotary crane is written for the crossing of its axis, or invariant, not both")
    crane = Scene(
        name="rotary_crane",
        models={"points": points, "generalized": generalized, "bodies": bodies},
        reference=rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 20.0),
        closed_form=closed_form,
        limits=LIMITS,
        tracked="load",
        effects=EFFECTS,
        drawing=drawing,
    )
    if rope_elements:
        from servocore.scenes.rotary_crane_rope import OnRope  # noqa: PLC0415 - other models need no parts

        plant = OnRope(INVARIANT_MODELS["points"], rope_elements)
        return replace(crane, models={"rope": plant}, effects=NO_EFFECTS, closed_form=None, limits=())
    if not across_axis:
        return replace(crane, models=INVARIANT_MODELS, effects=NO_EFFECTS) if invariant else crane
    limits = (*LIMITS[:-1], replace(LIMITS[-1], at_instants_only=True))
    signed = replace(crane, models=SIGNED_MODELS, closed_form=through_axis, limits=limits, follow_branch=True)
    return replace(signed, effects=NO_EFFECTS)
