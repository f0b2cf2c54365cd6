"""Mechanisms in the rotationless formulation: constant mass matrix, quadratic constraints (section 1.1).

A rigid body has twelve coordinates, the position of its reference point and three directors; no angles,
hence no singular orientations. An `Assembly` lists the parts, joints are functions of places on them that
return constraints, and `Assembly.system` makes a `MechanicalSystem` of both. One page with an example:
docs/howto/assemble-a-mechanism.md.
"""

# ruff: noqa: I001, PLC0414 - every name is exported; a line is a module with all its names
from servocore.model.rotationless.assembly import Assembly as Assembly
from servocore.model.rotationless.flexible import Beam as Beam, ElasticRope as ElasticRope, Section as Section
from servocore.model.rotationless.joints import (
    angle as angle,
    cylindrical as cylindrical,
    displacement as displacement,
    distance as distance,
    fixed as fixed,
    on_line as on_line,
    on_plane as on_plane,
    prismatic as prismatic,
    revolute as revolute,
    rope as rope,
    spherical as spherical,
)
from servocore.model.rotationless.parts import (
    GROUND as GROUND,
    Frame as Frame,
    Place as Place,
    PointMass as PointMass,
    RigidBody as RigidBody,
    turned as turned,
)
