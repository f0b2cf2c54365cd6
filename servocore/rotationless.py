"""Mechanisms in the rotationless formulation: constant mass matrix, quadratic constraints (section 1.1).

A rigid body has twelve coordinates, the position of its reference point and three directors; no angles,
hence no singular orientations. An `Assembly` lists the parts, joints are functions of places on them that
return constraints, and `Assembly.system` makes a `MechanicalSystem` of both. One page with an example:
docs/howto/assemble-a-mechanism.md.
"""

from servocore.model.rotationless.assembly import Assembly
from servocore.model.rotationless.flexible import Beam, ElasticRope, Section
from servocore.model.rotationless.joints import (
    angle,
    cylindrical,
    displacement,
    distance,
    fixed,
    on_line,
    on_plane,
    prismatic,
    revolute,
    rope,
    spherical,
)
from servocore.model.rotationless.parts import GROUND, Frame, Place, PointMass, RigidBody, turned

__all__ = [
    "GROUND",
    "Assembly",
    "Beam",
    "ElasticRope",
    "Frame",
    "Place",
    "PointMass",
    "RigidBody",
    "Section",
    "angle",
    "cylindrical",
    "displacement",
    "distance",
    "fixed",
    "on_line",
    "on_plane",
    "prismatic",
    "revolute",
    "rope",
    "spherical",
    "turned",
]
