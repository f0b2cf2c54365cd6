"""Methods turn a `Dae` into the equations of one time step: one file each."""

from servocore.methods.backward_euler import BackwardEuler
from servocore.methods.base import Discretisation, Method, Orders, Start
from servocore.methods.bdf import BDF
from servocore.methods.collocation import Gauss, RadauIIA
from servocore.methods.generalized_alpha import GeneralizedAlpha
from servocore.methods.trapezoidal import Trapezoidal

__all__ = [
    "BDF",
    "BackwardEuler",
    "Discretisation",
    "Gauss",
    "GeneralizedAlpha",
    "Method",
    "Orders",
    "RadauIIA",
    "Start",
    "Trapezoidal",
]
