"""Routes from a problem to its solution, and forward dynamics to try one: one file each."""

from servocore.solvers.adaptive import Adaptive
from servocore.solvers.boundary_value import BoundaryValue
from servocore.solvers.conserving import EnergyMomentum
from servocore.solvers.exact_inversion import ExactInversion
from servocore.solvers.route import Route
from servocore.solvers.simulate import simulate
from servocore.solvers.solve import solve

__all__ = ["Adaptive", "BoundaryValue", "EnergyMomentum", "ExactInversion", "Route", "simulate", "solve"]
