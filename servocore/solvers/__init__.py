"""Routes from a problem to its solution, and forward dynamics to try one: one file each."""

from servocore.solvers.adaptive import Adaptive
from servocore.solvers.batch import Batch
from servocore.solvers.boundary_value import BoundaryValue
from servocore.solvers.conserving import EnergyMomentum
from servocore.solvers.dynamic_inversion import DynamicInversion
from servocore.solvers.exact_inversion import ExactInversion
from servocore.solvers.route import Route
from servocore.solvers.simulate import simulate
from servocore.solvers.solve import solve
from servocore.solvers.sundials import Sundials

__all__ = [
    "Adaptive",
    "Batch",
    "BoundaryValue",
    "DynamicInversion",
    "EnergyMomentum",
    "ExactInversion",
    "Route",
    "Sundials",
    "simulate",
    "solve",
]
