"""Servo constraint problems: the inputs that make a mechanical system's output follow a path.

>>> import servocore as sc
>>> solution = sc.solve(sc.scenes.rotary_crane(), sc.Projected(), sc.BackwardEuler(), step=0.1)
>>> solution["M_b"].shape, solution.unit("M_b")
((201,), 'N.m')
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from servocore import scenes
    from servocore.analysis import StructureReport, analyse
    from servocore.dae import Dae, Equation, Unknown
    from servocore.effects.drives import Drives
    from servocore.effects.report import EffectRow, EffectsReport
    from servocore.effects.study import effects
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
    from servocore.export.estimates import SampledEstimates
    from servocore.export.feedback import SampledFeedback
    from servocore.export.fmu import export_fmu, export_plant, export_trajectory
    from servocore.export.plant_model import PlantWishes
    from servocore.export.trajectory_model import TrajectoryWishes
    from servocore.export.wasm import export_wasm
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
    from servocore.model.limit_files import factors_of_texts, limits_given, read_limits
    from servocore.model.limits import Limit
    from servocore.model.parameter_files import read_parameters
    from servocore.model.potentials import Potential
    from servocore.model.quantity import Quantity
    from servocore.model.scene import Scene
    from servocore.model.symbols import Coordinates, Parameter, Parameters
    from servocore.model.system import MAX_REFERENCE_ORDER, MechanicalSystem
    from servocore.numerics.machine_code import c_compiler
    from servocore.numerics.square_systems import SquareSystem
    from servocore.planning.durations import shortest_duration
    from servocore.planning.fastest import fastest
    from servocore.planning.flat_system import to_control
    from servocore.planning.obstacles import Box, Sphere
    from servocore.planning.report import PlanReport
    from servocore.planning.sensitivities import Sensitivities, sensitivities
    from servocore.planning.space import Space
    from servocore.planning.sweep import sweep
    from servocore.problem import Problem
    from servocore.references.base import Reference
    from servocore.references.csv_file import csv_of, from_csv, waypoints_from_csv
    from servocore.references.periodic import figure_of_eight, periodic
    from servocore.references.profiles import (
        DEGREE3,
        DEGREE5,
        DEGREE7,
        DEGREE9,
        DEGREE13,
        TIME_LAWS,
        Profile,
        three_phase,
    )
    from servocore.references.rest_to_rest import rest_to_rest
    from servocore.references.splines import sampled, through
    from servocore.solution import Margin, Solution, Statistics
    from servocore.solvers.adaptive import Adaptive
    from servocore.solvers.batch import Batch
    from servocore.solvers.boundary_value import BoundaryValue
    from servocore.solvers.dynamic_inversion import DynamicInversion
    from servocore.solvers.energy_momentum import EnergyMomentum
    from servocore.solvers.exact_inversion import ExactInversion
    from servocore.solvers.route import Route
    from servocore.solvers.simulate import simulate
    from servocore.solvers.solve import solve
    from servocore.solvers.sundials import Sundials
    from servocore.stepping.forward_dynamics import compile_plant
    from servocore.stepping.plant import Plant
    from servocore.stepping.program import Program, StepReport
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

# Imported at their first use: programs need some of them, and a command line heeds Ctrl-C before it imports any.
_HOMES = {
    "Adaptive": "servocore.solvers.adaptive",
    "BDF": "servocore.methods",
    "BackwardEuler": "servocore.methods",
    "Batch": "servocore.solvers.batch",
    "BoundaryValue": "servocore.solvers.boundary_value",
    "Box": "servocore.planning.obstacles",
    "Coordinates": "servocore.model.symbols",
    "DEGREE13": "servocore.references.profiles",
    "DEGREE3": "servocore.references.profiles",
    "DEGREE5": "servocore.references.profiles",
    "DEGREE7": "servocore.references.profiles",
    "DEGREE9": "servocore.references.profiles",
    "Dae": "servocore.dae",
    "Discretisation": "servocore.methods",
    "Drives": "servocore.effects.drives",
    "DynamicInversion": "servocore.solvers.dynamic_inversion",
    "Effect": "servocore.model.effects",
    "EffectRow": "servocore.effects.report",
    "Effects": "servocore.model.effects",
    "EffectsReport": "servocore.effects.report",
    "EnergyMomentum": "servocore.solvers.energy_momentum",
    "Equation": "servocore.dae",
    "ExactInversion": "servocore.solvers.exact_inversion",
    "Formulation": "servocore.formulations",
    "Gauss": "servocore.methods",
    "GeneralizedAlpha": "servocore.methods",
    "InconsistentStart": "servocore.errors",
    "IntegrationFailed": "servocore.errors",
    "InvalidModel": "servocore.errors",
    "InvalidReference": "servocore.errors",
    "InvalidSetting": "servocore.errors",
    "Limit": "servocore.model.limits",
    "LimitBroken": "servocore.errors",
    "LivePart": "servocore.view.page",
    "MAX_REFERENCE_ORDER": "servocore.model.system",
    "Margin": "servocore.solution",
    "MechanicalSystem": "servocore.model.system",
    "Method": "servocore.methods",
    "Orders": "servocore.methods",
    "Original": "servocore.formulations",
    "Parameter": "servocore.model.symbols",
    "Parameters": "servocore.model.symbols",
    "Part": "servocore.model.drawing",
    "PlanReport": "servocore.planning.report",
    "PlanningFailed": "servocore.errors",
    "Plant": "servocore.stepping.plant",
    "PlantWishes": "servocore.export.plant_model",
    "Potential": "servocore.model.potentials",
    "Problem": "servocore.problem",
    "Profile": "servocore.references.profiles",
    "Program": "servocore.stepping.program",
    "Projected": "servocore.formulations",
    "Quantity": "servocore.model.quantity",
    "RadauIIA": "servocore.methods",
    "Reduced": "servocore.formulations",
    "Reference": "servocore.references.base",
    "RotationUpdate": "servocore.stepping.rotation_update",
    "Route": "servocore.solvers.route",
    "SampledEstimates": "servocore.export.estimates",
    "SampledFeedback": "servocore.export.feedback",
    "Scene": "servocore.model.scene",
    "Sensitivities": "servocore.planning.sensitivities",
    "ServocoreError": "servocore.errors",
    "ServocoreWarning": "servocore.errors",
    "Solution": "servocore.solution",
    "Space": "servocore.planning.space",
    "Sphere": "servocore.planning.obstacles",
    "SquareSystem": "servocore.numerics.square_systems",
    "Start": "servocore.methods",
    "Statistics": "servocore.solution",
    "StepReport": "servocore.stepping.program",
    "Stepper": "servocore.stepping.stepper",
    "StructureReport": "servocore.analysis",
    "Sundials": "servocore.solvers.sundials",
    "TIME_LAWS": "servocore.references.profiles",
    "TrajectoryWishes": "servocore.export.trajectory_model",
    "Trapezoidal": "servocore.methods",
    "Unknown": "servocore.dae",
    "analyse": "servocore.analysis",
    "c_compiler": "servocore.numerics.machine_code",
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
    "generalise": "servocore.model.generalize",
    "limits_given": "servocore.model.limit_files",
    "live_part": "servocore.view.page",
    "periodic": "servocore.references.periodic",
    "read_limits": "servocore.model.limit_files",
    "read_parameters": "servocore.model.parameter_files",
    "rest_to_rest": "servocore.references.rest_to_rest",
    "sampled": "servocore.references.splines",
    "sensitivities": "servocore.planning.sensitivities",
    "shortest_duration": "servocore.planning.durations",
    "simulate": "servocore.solvers.simulate",
    "solve": "servocore.solvers.solve",
    "sweep": "servocore.planning.sweep",
    "three_phase": "servocore.references.profiles",
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
    """Import a public name, or a room, at its first use."""
    if name in _HOMES:
        value: object = getattr(import_module(_HOMES[name]), name)
    elif name.startswith("_") or find_spec(f"{__name__}.{name}") is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    else:
        value = import_module(f"{__name__}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, those that are still to be imported too."""
    return sorted({*globals(), *__all__})
