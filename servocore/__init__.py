"""Feedforward inputs by inverse dynamics: servo-constraint problems of underactuated mechanical systems.

`solve` computes the inputs that make the outputs of a mechanical system follow a prescribed trajectory: exactly at each
instant where the system is flat, by stable inversion or time stepping where it has internal dynamics.

>>> import servocore as sc
>>> solution = sc.solve(sc.scenes.rotary_crane(), step=0.1)
>>> solution["M_b"].shape, solution.unit("M_b")
((201,), 'N.m')
"""

import ast
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

# ruff: noqa: I001 - a line is a module with all its names
# The public names, each with the module that it is imported from at its first use.
if TYPE_CHECKING:
    from servocore import scenes as scenes
    from servocore.analysis import analyse as analyse
    from servocore.certificate.certify import certify as certify
    from servocore.dae import Dae as Dae
    from servocore.effects.position_loops import PositionLoops as PositionLoops
    from servocore.effects.study import effects as effects
    from servocore.errors import (
        InconsistentStart as InconsistentStart,
        IntegrationFailed as IntegrationFailed,
        InvalidModel as InvalidModel,
        InvalidReference as InvalidReference,
        InvalidSetting as InvalidSetting,
        LimitBroken as LimitBroken,
        PlanningFailed as PlanningFailed,
        ServocoreError as ServocoreError,
        ServocoreWarning as ServocoreWarning,
    )
    from servocore.export.about import About as About
    from servocore.export.fmu import (
        export_fmu as export_fmu,
        export_plant as export_plant,
        export_ssp as export_ssp,
        export_trajectory as export_trajectory,
    )
    from servocore.export.native_model import HostRules as HostRules
    from servocore.export.plant_model import PlantOptions as PlantOptions
    from servocore.export.routes import SteppedRoutes as SteppedRoutes
    from servocore.export.sampled_laws import (
        SampledEstimates as SampledEstimates,
        SampledFeedback as SampledFeedback,
    )
    from servocore.export.trajectory_model import TrajectoryOptions as TrajectoryOptions
    from servocore.export.wasm import export_wasm as export_wasm
    from servocore.formulations.base import Formulation as Formulation
    from servocore.formulations.original import Original as Original
    from servocore.formulations.projected import Projected as Projected
    from servocore.formulations.reduced import Reduced as Reduced
    from servocore.identification.excitation import excitation as excitation
    from servocore.identification.identify import identify as identify
    from servocore.identification.result import Identified as Identified
    from servocore.identification.synthetic_log import measured as measured
    from servocore.importers.options import Elastic as Elastic
    from servocore.methods.backward_euler import BackwardEuler as BackwardEuler
    from servocore.methods.base import (
        Discretization as Discretization,
        Method as Method,
        Orders as Orders,
        Start as Start,
    )
    from servocore.methods.bdf import BDF as BDF
    from servocore.methods.collocation import Gauss as Gauss, RadauIIA as RadauIIA
    from servocore.methods.generalized_alpha import GeneralizedAlpha as GeneralizedAlpha
    from servocore.methods.trapezoidal import Trapezoidal as Trapezoidal
    from servocore.model.drawing import Part as Part
    from servocore.model.drives import Drive as Drive
    from servocore.model.generalize import generalize as generalize
    from servocore.model.limits import Limit as Limit
    from servocore.model.parameter_files import read_limits as read_limits, read_parameters as read_parameters
    from servocore.model.potentials import Potential as Potential
    from servocore.model.quantity import Quantity as Quantity
    from servocore.model.scene import Scene as Scene
    from servocore.model.symbols import Coordinates as Coordinates, Parameter as Parameter, Parameters as Parameters
    from servocore.model.system import MAX_REFERENCE_ORDER as MAX_REFERENCE_ORDER, MechanicalSystem as MechanicalSystem
    from servocore.numerics.square_systems import SquareSystem as SquareSystem
    from servocore.planning.durations import shortest_duration as shortest_duration
    from servocore.planning.fastest import fastest as fastest
    from servocore.planning.flat_system import to_control as to_control
    from servocore.planning.obstacles import Box as Box, Sphere as Sphere
    from servocore.planning.sensitivities import sensitivities as sensitivities
    from servocore.planning.space import Space as Space
    from servocore.planning.sweep import sweep as sweep
    from servocore.problem import Problem as Problem
    from servocore.references.base import Reference as Reference
    from servocore.references.csv_file import (
        path_to_csv as path_to_csv,
        from_csv as from_csv,
        waypoints_from_csv as waypoints_from_csv,
    )
    from servocore.references.periodic import figure_of_eight as figure_of_eight, periodic as periodic
    from servocore.references.profiles import (
        DEGREE3 as DEGREE3,
        DEGREE5 as DEGREE5,
        DEGREE7 as DEGREE7,
        DEGREE9 as DEGREE9,
        DEGREE13 as DEGREE13,
        TIME_LAWS as TIME_LAWS,
        Profile as Profile,
        three_phase as three_phase,
    )
    from servocore.references.rest_to_rest import rest_to_rest as rest_to_rest
    from servocore.references.splines import sampled as sampled, through as through
    from servocore.solution import Solution as Solution
    from servocore.solvers.batch import Batch as Batch
    from servocore.solvers.stable_inversion import StableInversion as StableInversion
    from servocore.solvers.dynamic_inversion import DynamicInversion as DynamicInversion
    from servocore.solvers.energy_momentum import EnergyMomentum as EnergyMomentum
    from servocore.solvers.exact_inversion import ExactInversion as ExactInversion
    from servocore.solvers.prepared import PreparedInversion as PreparedInversion, prepare as prepare
    from servocore.solvers.route import Adaptive as Adaptive, Route as Route
    from servocore.solvers.simulate import simulate as simulate
    from servocore.solvers.solve import solve as solve
    from servocore.solvers.sundials import Sundials as Sundials
    from servocore.stepping.forward_dynamics import compile_plant as compile_plant
    from servocore.stepping.rotation_update import RotationUpdate as RotationUpdate
    from servocore.stepping.stepper import Stepper as Stepper
    from servocore.view.page import LivePart as LivePart, live_part as live_part, view as view

    __all__: list[str]

__version__ = "0.3.0"

_FORMER = {
    "BoundaryValue": "servocore.StableInversion",
    "Discretisation": "servocore.Discretization",
    "Drives": "servocore.PositionLoops",
    "PlantWishes": "servocore.PlantOptions",
    "TrajectoryWishes": "servocore.TrajectoryOptions",
    "csv_of": "servocore.path_to_csv",
    "generalise": "servocore.generalize",
    "Effect": "servocore.model.effects.Effect",
    "Effects": "servocore.model.effects.Effects",
    "EffectRow": "servocore.effects.report.EffectRow",
    "EffectsReport": "servocore.effects.report.EffectsReport",
    "Equation": "servocore.dae.Equation",
    "Margin": "servocore.solution.Margin",
    "Plant": "servocore.stepping.forward_dynamics.Plant",
    "PlanReport": "servocore.planning.report.PlanReport",
    "Program": "servocore.stepping.program.Program",
    "Sensitivities": "servocore.planning.sensitivities.Sensitivities",
    "Statistics": "servocore.solution.Statistics",
    "StepReport": "servocore.stepping.program.StepReport",
    "StructureReport": "servocore.analysis.StructureReport",
    "Unknown": "servocore.dae.Unknown",
    "c_compiler": "servocore.numerics.machine_code.c_compiler",
}
"""Names of version 0.2, and the names that replace them: `__getattr__` refuses the former by the latter."""

# A package that is imported for the first time takes the place of the function of its name: so that comes first.
for _room in ("effects", "view"):
    import_module(f"servocore.{_room}")
    del globals()[_room]


@cache  # at the first use of a name: programs need some of them; a command line handles Ctrl-C before it imports any
def _homes() -> dict[str, str]:
    """Return the modules of the public names: those that type checkers import them from, above."""
    with open(__file__, encoding="utf-8") as file:
        source = file.read()
    imports = [each for each in ast.walk(ast.parse(source)) if isinstance(each, ast.ImportFrom)]
    return {alias.asname: str(each.module) for each in imports for alias in each.names if alias.asname}


def __getattr__(name: str) -> object:
    """Import a public name, or a package, at its first use."""
    value: object
    home = __name__ if name.startswith("_") else _homes().get(name, __name__)
    if name == "__all__":
        value = sorted(_homes())
    elif home != __name__:
        value = getattr(import_module(home), name)
    elif name in _FORMER:
        raise AttributeError(f"{__name__}.{name} is {_FORMER[name]} since version 0.3")
    elif name.startswith("_") or find_spec(f"{__name__}.{name}") is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    else:
        value = import_module(f"{__name__}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, those that are still to be imported too."""
    return sorted({*globals(), *_homes()})
