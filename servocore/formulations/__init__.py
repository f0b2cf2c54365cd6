"""Formulations turn a `MechanicalSystem` into a `Dae`: one file each."""

from servocore.formulations.base import Formulation
from servocore.formulations.original import Original
from servocore.formulations.projected import Projected
from servocore.formulations.reduced import Reduced

__all__ = ["Formulation", "Original", "Projected", "Reduced"]
