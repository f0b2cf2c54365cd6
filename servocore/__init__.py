"""Servo constraint problems: the inputs that make a mechanical system's output follow a path.

>>> import servocore as sc
>>> solution = sc.solve(sc.scenes.rotary_crane(), sc.Projected(), sc.BackwardEuler(), step=0.1)
>>> solution["M_b"], solution.unit("M_b")
"""

from servocore import scenes
from servocore.solvers.accuracy import Adaptive, Fixed
from servocore.analysis import StructureReport, analyse
from servocore.solvers.boundary_value import BoundaryValue
from servocore.errors import (
    InconsistentStart,
    IntegrationFailed,
    InvalidModel,
    InvalidReference,
    InvalidSetting,
    ServocoreError,
    ServocoreWarning,
)
from servocore.solvers.exact_inversion import ExactInversion
from servocore.formulations import Formulation, Original, Projected, Reduced
from servocore.methods import BDF, BackwardEuler, Gauss, GeneralizedAlpha, Method, Orders, RadauIIA, Trapezoidal
from servocore.model.parameter_files import read_parameters
from servocore.stepping.plant import Plant, compile_plant
from servocore.stepping.program import Program, StepReport
from servocore.references import (
    DEGREE3,
    DEGREE5,
    DEGREE7,
    DEGREE9,
    DEGREE13,
    Profile,
    Reference,
    figure_of_eight,
    from_csv,
    periodic,
    rest_to_rest,
    sampled,
    three_phase,
    through,
    waypoints_from_csv,
)
from servocore.model.scene import Limit, Scene
from servocore.solvers.simulate import simulate
from servocore.solution import Solution, Statistics
from servocore.solvers.solve import solve
from servocore.stepping.stepper import Stepper
from servocore.model.symbols import Coordinates, Parameter, Parameters, Quantity
from servocore.model.system import MechanicalSystem, generalise

__version__ = "0.1.0"

__all__ = [
    "BDF",
    "DEGREE3",
    "DEGREE5",
    "DEGREE7",
    "DEGREE9",
    "DEGREE13",
    "Adaptive",
    "BackwardEuler",
    "BoundaryValue",
    "Coordinates",
    "ExactInversion",
    "Fixed",
    "Formulation",
    "Gauss",
    "GeneralizedAlpha",
    "InconsistentStart",
    "IntegrationFailed",
    "InvalidModel",
    "InvalidReference",
    "InvalidSetting",
    "Limit",
    "MechanicalSystem",
    "Method",
    "Orders",
    "Original",
    "Parameter",
    "Parameters",
    "Plant",
    "Profile",
    "Program",
    "Projected",
    "Quantity",
    "RadauIIA",
    "Reduced",
    "Reference",
    "Scene",
    "ServocoreError",
    "ServocoreWarning",
    "Solution",
    "Statistics",
    "StepReport",
    "Stepper",
    "StructureReport",
    "Trapezoidal",
    "analyse",
    "compile_plant",
    "figure_of_eight",
    "from_csv",
    "generalise",
    "periodic",
    "read_parameters",
    "rest_to_rest",
    "sampled",
    "scenes",
    "simulate",
    "solve",
    "three_phase",
    "through",
    "waypoints_from_csv",
]
