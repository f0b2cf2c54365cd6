r"""The rotary crane of the paper in 42 coordinates: three rigid bodies, a load point, phi, s and beta.

          z |
            |=========[trolley, winch]======  d1     bridge, turns by phi about z
            |<----- s ---->\
                            \   rope, paid out by the winch: l = r_w beta
                             o  load (x, y, z), z < 0

    18  orthonormality of the directors of bridge, trolley and winch
     5  bridge on the ground      revolute about z
     5  trolley on the bridge     prismatic along d1
     5  winch on the trolley      revolute about d2
     1  rope                      |load - winch|^2 - (r_w beta)^2 = 0
     1  phi                       -sin(phi) d1_x + cos(phi) d1_y = 0
     1  s                         (trolley - bridge) . d1 - s = 0
     1  beta                      the angle of the winch on the trolley, as phi

M_b drives phi, F drives s, M_w drives beta. The drum's centre is the trolley's, in the plane z = 0.

Only lumped parameters matter for the motion, and the bodies are chosen so that exactly these come out; how
they are shared is a declared assumption. The drum, symmetric about its horizontal axis, has a vertical
inertia of at least J_w/2; of the rest R = J_b - J_w/2 the drum takes WINCH_SHARE, the trolley TROLLEY_SHARE
and the bridge what remains. So three real bodies exist if and only if R > 0. Where tuned parameters break
this, the bodies are no longer real, but their sums, and so all exact inputs and motions, remain those of the
lumped parameters.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import casadi as ca

from servocore.model.quantity import Quantity
from servocore.model.rotationless.assembly import Assembly
from servocore.model.rotationless.joints import angle, displacement, distance, prismatic, revolute
from servocore.model.rotationless.parts import GROUND, PointMass, RigidBody, turned
from servocore.model.symbols import Parameters
from servocore.scenes import hanging_load
from servocore.scenes.rotary_crane import INPUTS, OUTPUTS, PARAMETERS, PHI, TROLLEY

if TYPE_CHECKING:
    from servocore.model.system import MechanicalSystem

BRIDGE_MASS = 60.0
"""kg. Rests on the slewing axis, so it enters no equation of motion."""

BRIDGE_SLENDERNESS = 0.05
"""Inertia of the bridge about its long axis, of that about the others."""

TROLLEY_SHARE, WINCH_SHARE = 0.002, 0.001
"""Fractions of R = J_b - J_w/2 for the trolley, and for the winch in addition to J_w/2."""

WINCH_MASS_SHARE = 0.3
"""Fraction of the trolley mass that is the winch's."""

_Z, _ALONG, _ACROSS = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def bodies() -> MechanicalSystem:
    """Return the crane with n = 42 coordinates and m_h = 37 constraints, section 5 of the paper."""
    crane = Assembly(
        parts=(
            *_bodies(PARAMETERS),
            PointMass("load", PARAMETERS["load_mass"]),
            Quantity("phi", "rad"),
            Quantity("s", "m"),
            Quantity("beta", "rad", nominal=10.0),
        ),
        parameters=PARAMETERS,
        gravity=(0.0, 0.0, -PARAMETERS["gravity"]),
    )
    phi, s, beta = (crane.augmented(name) for name in ("phi", "s", "beta"))
    length = PARAMETERS["winch_radius"] * beta
    load, winch = crane.point("load").position, crane.body("winch").origin
    constraints = _constraints(crane, length)
    lam = crane.multipliers(constraints)
    system = crane.system(
        "rotary crane, bodies",
        constraints=constraints,
        multipliers=lam,
        inputs=dict(zip(INPUTS, (phi, s, beta), strict=True)),
        outputs=dict(zip(OUTPUTS, ca.vertsplit(load), strict=True)),
        guess=lambda y: _hanging(PARAMETERS, y, y[:2], -y[2]),
        home=(4.0, 0.0, -5.0),
        observables={
            **dict(zip((PHI, TROLLEY), (phi, s), strict=True)),
            hanging_load.ROPE: length,
            hanging_load.TENSION: 2 * length * lam["rope"],
            hanging_load.SWING: hanging_load.swing_angle(load - winch),
        },
    )
    place, hanging, _ = hanging_load.suspension(system.gamma, PARAMETERS)
    return replace(system, guess=crane.configuration(_hanging(PARAMETERS, system.gamma[:, 0], place, hanging)))


def _bodies(p: Parameters) -> tuple[RigidBody, RigidBody, RigidBody]:
    """Bridge, trolley and winch; all directors agree with the ground's at phi = beta = 0."""
    drum = p["winch_inertia"] / 2
    rest = p["bridge_inertia"] - drum
    bridge = (1 - TROLLEY_SHARE - WINCH_SHARE) * rest
    trolley = TROLLEY_SHARE * rest
    across_drum = drum + WINCH_SHARE * rest
    return (
        RigidBody("bridge", BRIDGE_MASS, (BRIDGE_SLENDERNESS * bridge, bridge, bridge)),
        RigidBody("trolley", (1 - WINCH_MASS_SHARE) * p["trolley_mass"], (trolley,) * 3),
        RigidBody("winch", WINCH_MASS_SHARE * p["trolley_mass"], (across_drum, p["winch_inertia"], across_drum)),
    )


def _constraints(crane: Assembly, length: ca.SX) -> dict[str, ca.SX]:
    """Joints, rope and definitions: 19 rows besides the 18 of orthonormality."""
    bridge, trolley, winch = (crane.body(name) for name in ("bridge", "trolley", "winch"))
    mast = GROUND.at(axis=_Z), bridge.at(axis=_Z)
    rail = bridge.at(axis=_ALONG), trolley.at(axis=_ALONG)
    shaft = trolley.at(axis=_ACROSS), winch.at(axis=_ACROSS)
    return {
        "mast": revolute(*mast),
        "rail": prismatic(*rail),
        "shaft": revolute(*shaft),
        "rope": distance(winch.at(), crane.point("load"), length),
        "phi": angle(*mast, crane.augmented("phi")),
        "s": displacement(*rail, crane.augmented("s")),
        "beta": angle(*shaft, crane.augmented("beta")),
    }


def _hanging(p: Parameters, load: ca.SX, place: ca.SX, length: ca.SX) -> dict[str, object]:
    """Return the configuration with the trolley at a place off the slewing axis and the load on a rope."""
    phi, beta = ca.atan2(place[1], place[0]), length / p["winch_radius"]
    bridge, trolley = turned(_Z, phi), ca.vertcat(place, 0)
    return {
        "bridge": ((0, 0, 0), bridge),
        "trolley": (trolley, bridge),
        "winch": (trolley, ca.mtimes(bridge, turned(_ACROSS, beta))),
        "load": load,
        "phi": phi,
        "s": ca.norm_2(place),
        "beta": beta,
    }
