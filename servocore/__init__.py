"""Servo constraint problems: the inputs that make a mechanical system's output follow a path.

>>> import servocore as sc
>>> solution = sc.solve(sc.scenes.rotary_crane(), sc.Projected(), sc.BackwardEuler(), step=0.1)
>>> solution["M_b"].shape, solution.unit("M_b")
((201,), 'N.m')
"""

import ast
from functools import cache
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
    from servocore.export.routes import SteppedRoutes
    from servocore.export.trajectory_model import TrajectoryWishes
    from servocore.export.wasm import export_wasm
    from servocore.formulations.base import Formulation
    from servocore.formulations.original import Original
    from servocore.formulations.projected import Projected
    from servocore.formulations.reduced import Reduced
    from servocore.methods.backward_euler import BackwardEuler
    from servocore.methods.base import Discretisation, Method, Orders, Start
    from servocore.methods.bdf import BDF
    from servocore.methods.collocation import Gauss, RadauIIA
    from servocore.methods.generalized_alpha import GeneralizedAlpha
    from servocore.methods.trapezoidal import Trapezoidal
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
    from servocore.solvers.batch import Batch
    from servocore.solvers.boundary_value import BoundaryValue
    from servocore.solvers.dynamic_inversion import DynamicInversion
    from servocore.solvers.energy_momentum import EnergyMomentum
    from servocore.solvers.exact_inversion import ExactInversion
    from servocore.solvers.route import Adaptive, Route
    from servocore.solvers.simulate import simulate
    from servocore.solvers.solve import solve
    from servocore.solvers.sundials import Sundials
    from servocore.stepping.forward_dynamics import Plant, compile_plant
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
    "SteppedRoutes",
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

# A room that is imported for the first time takes the place of the function of its name: so that comes first.
for _room in ("effects", "view"):
    import_module(f"servocore.{_room}")
    del globals()[_room]


@cache  # at the first use of a name: programs need some of them, and a command line heeds Ctrl-C before it imports any
def _homes() -> dict[str, str]:
    """Return the modules of the public names: those that type checkers import them from, above."""
    with open(__file__, encoding="utf-8") as file:
        source = file.read()
    imports = [each for each in ast.walk(ast.parse(source)) if isinstance(each, ast.ImportFrom)]
    return {alias.name: str(each.module) for each in imports for alias in each.names}


def __getattr__(name: str) -> object:
    """Import a public name, or a room, at its first use."""
    home = _homes()[name] if name in __all__ else __name__
    if home != __name__:
        value: object = getattr(import_module(home), name)
    elif name.startswith("_") or find_spec(f"{__name__}.{name}") is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    else:
        value = import_module(f"{__name__}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, those that are still to be imported too."""
    return sorted({*globals(), *__all__})
