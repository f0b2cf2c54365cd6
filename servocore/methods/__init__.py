"""Methods turn a `Dae` into the equations of one time step: one file each."""

from servocore.methods.backward_euler import BackwardEuler
from servocore.methods.base import Discretisation, Method

__all__ = ["BackwardEuler", "Discretisation", "Method"]
