"""Servo constraint problems: the inputs that make a mechanical system's output follow a path.

>>> import servocore as sc
>>> solution = sc.solve(sc.scenes.rotary_crane(), sc.Projected(), sc.BackwardEuler(), step=0.1)
>>> solution["M_b"].shape, solution.unit("M_b")
((201,), 'N.m')
"""

from importlib import import_module
from typing import TYPE_CHECKING

from servocore import scenes
from servocore.analysis import StructureReport, analyse
from servocore.dae import Dae, Equation, Unknown
from servocore.errors import (
    InconsistentStart,
    IntegrationFailed,
    InvalidModel,
    InvalidReference,
    InvalidSetting,
    LimitBroken,
    PlanningFailed,
    ServocoreError,
    ServocoreWarning,
)
from servocore.formulations import Formulation, Original, Projected, Reduced
from servocore.methods import (
    BDF,
    BackwardEuler,
    Discretisation,
    Gauss,
    GeneralizedAlpha,
    Method,
    Orders,
    RadauIIA,
    Start,
    Trapezoidal,
)
from servocore.model.drawing import Part
from servocore.model.effects import Effect, Effects
from servocore.model.generalize import generalise
from servocore.model.limits import Limit
from servocore.model.potentials import Potential
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MAX_REFERENCE_ORDER, MechanicalSystem
from servocore.numerics.machine_code import c_compiler
from servocore.numerics.square_systems import SquareSystem
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.profiles import DEGREE3, DEGREE5, DEGREE7, DEGREE9, DEGREE13, TIME_LAWS, Profile, three_phase
from servocore.references.rest_to_rest import rest_to_rest
from servocore.solution import Margin, Solution, Statistics
from servocore.solvers.adaptive import Adaptive
from servocore.solvers.boundary_value import BoundaryValue
from servocore.solvers.exact_inversion import ExactInversion
from servocore.solvers.route import Route
from servocore.solvers.solve import solve
from servocore.stepping.program import Program, StepReport

if TYPE_CHECKING:
    from servocore.effects.drives import Drives
    from servocore.effects.report import EffectRow, EffectsReport
    from servocore.effects.study import effects
    from servocore.export.estimates import SampledEstimates
    from servocore.export.feedback import SampledFeedback
    from servocore.export.fmu import export_fmu, export_plant, export_trajectory
    from servocore.export.plant_model import PlantWishes
    from servocore.export.trajectory_model import TrajectoryWishes
    from servocore.export.wasm import export_wasm
    from servocore.model.limit_files import factors_of_texts, limits_given, read_limits
    from servocore.model.parameter_files import read_parameters
    from servocore.planning.durations import shortest_duration
    from servocore.planning.fastest import fastest
    from servocore.planning.flat_system import to_control
    from servocore.planning.obstacles import Box, Sphere
    from servocore.planning.report import PlanReport
    from servocore.planning.sensitivities import Sensitivities, sensitivities
    from servocore.planning.space import Space
    from servocore.planning.sweep import sweep
    from servocore.references.csv_file import csv_of, from_csv, waypoints_from_csv
    from servocore.references.periodic import figure_of_eight, periodic
    from servocore.references.splines import sampled, through
    from servocore.solvers.batch import Batch
    from servocore.solvers.dynamic_inversion import DynamicInversion
    from servocore.solvers.energy_momentum import EnergyMomentum
    from servocore.solvers.simulate import simulate
    from servocore.solvers.sundials import Sundials
    from servocore.stepping.forward_dynamics import compile_plant
    from servocore.stepping.plant import Plant
    from servocore.stepping.rotation_update import RotationUpdate
    from servocore.stepping.stepper import Stepper
    from servocore.view.page import LivePart, live_part, view

__version__ = "0.2.0"

# Use: to look at a problem, solve it, try the answer.
__all__ = [
    "BDF",
    "DEGREE3",
    "DEGREE5",
    "DEGREE7",
    "DEGREE9",
    "DEGREE13",
    "TIME_LAWS",
    "Adaptive",
    "BackwardEuler",
    "Batch",
    "BoundaryValue",
    "Box",
    "Drives",
    "DynamicInversion",
    "EffectRow",
    "EffectsReport",
    "EnergyMomentum",
    "ExactInversion",
    "Gauss",
    "GeneralizedAlpha",
    "InconsistentStart",
    "IntegrationFailed",
    "InvalidModel",
    "InvalidReference",
    "InvalidSetting",
    "Limit",
    "LimitBroken",
    "LivePart",
    "Margin",
    "Original",
    "PlanReport",
    "PlanningFailed",
    "Plant",
    "PlantWishes",
    "Potential",
    "Profile",
    "Program",
    "Projected",
    "RadauIIA",
    "Reduced",
    "Reference",
    "RotationUpdate",
    "SampledEstimates",
    "SampledFeedback",
    "Scene",
    "Sensitivities",
    "ServocoreError",
    "ServocoreWarning",
    "Solution",
    "Space",
    "Sphere",
    "Statistics",
    "StepReport",
    "Stepper",
    "StructureReport",
    "Sundials",
    "TrajectoryWishes",
    "Trapezoidal",
    "analyse",
    "compile_plant",
    "csv_of",
    "effects",
    "export_fmu",
    "export_plant",
    "export_trajectory",
    "export_wasm",
    "factors_of_texts",
    "fastest",
    "figure_of_eight",
    "from_csv",
    "limits_given",
    "live_part",
    "periodic",
    "read_limits",
    "read_parameters",
    "rest_to_rest",
    "sampled",
    "scenes",
    "sensitivities",
    "shortest_duration",
    "simulate",
    "solve",
    "sweep",
    "three_phase",
    "through",
    "to_control",
    "view",
    "waypoints_from_csv",
]
# Extend: for systems, formulations, methods and routes of one's own.
__all__ += [
    "MAX_REFERENCE_ORDER",
    "Coordinates",
    "Dae",
    "Discretisation",
    "Effect",
    "Effects",
    "Equation",
    "Formulation",
    "MechanicalSystem",
    "Method",
    "Orders",
    "Parameter",
    "Parameters",
    "Part",
    "Problem",
    "Quantity",
    "Route",
    "SquareSystem",
    "Start",
    "Unknown",
    "c_compiler",
    "generalise",
]

# These are half of what there is to import, and most programs analyse and solve.
_LATER = {
    "Batch": "servocore.solvers.batch",
    "Box": "servocore.planning.obstacles",
    "Drives": "servocore.effects.drives",
    "DynamicInversion": "servocore.solvers.dynamic_inversion",
    "EffectRow": "servocore.effects.report",
    "EffectsReport": "servocore.effects.report",
    "EnergyMomentum": "servocore.solvers.energy_momentum",
    "LivePart": "servocore.view.page",
    "PlanReport": "servocore.planning.report",
    "Plant": "servocore.stepping.plant",
    "PlantWishes": "servocore.export.plant_model",
    "RotationUpdate": "servocore.stepping.rotation_update",
    "SampledEstimates": "servocore.export.estimates",
    "SampledFeedback": "servocore.export.feedback",
    "Sensitivities": "servocore.planning.sensitivities",
    "Space": "servocore.planning.space",
    "Sphere": "servocore.planning.obstacles",
    "Stepper": "servocore.stepping.stepper",
    "Sundials": "servocore.solvers.sundials",
    "TrajectoryWishes": "servocore.export.trajectory_model",
    "compile_plant": "servocore.stepping.forward_dynamics",
    "csv_of": "servocore.references.csv_file",
    "effects": "servocore.effects.study",
    "export_fmu": "servocore.export.fmu",
    "export_plant": "servocore.export.fmu",
    "export_trajectory": "servocore.export.fmu",
    "export_wasm": "servocore.export.wasm",
    "factors_of_texts": "servocore.model.limit_files",
    "fastest": "servocore.planning.fastest",
    "figure_of_eight": "servocore.references.periodic",
    "from_csv": "servocore.references.csv_file",
    "limits_given": "servocore.model.limit_files",
    "live_part": "servocore.view.page",
    "periodic": "servocore.references.periodic",
    "read_limits": "servocore.model.limit_files",
    "read_parameters": "servocore.model.parameter_files",
    "sampled": "servocore.references.splines",
    "sensitivities": "servocore.planning.sensitivities",
    "shortest_duration": "servocore.planning.durations",
    "simulate": "servocore.solvers.simulate",
    "sweep": "servocore.planning.sweep",
    "through": "servocore.references.splines",
    "to_control": "servocore.planning.flat_system",
    "view": "servocore.view.page",
    "waypoints_from_csv": "servocore.references.csv_file",
}


# A room that is imported for the first time takes the place of the function of its name: so that comes first.
for _room in ("effects", "view"):
    import_module(f"servocore.{_room}")
    del globals()[_room]


def __getattr__(name: str) -> object:
    """Import a public name at its first use."""
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(_LATER[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, those that are imported later too."""
    return sorted({*globals(), *__all__})
