"""Exudyn: multibody dynamics in C++, generalized-alpha of index 3, and the trapezoidal rule with index-2 constraints.

It has no servo constraints: a constraint acts along its own gradient there, never along an actuator elsewhere. So the
algebraic part of the projected form is eliminated by hand: the motion of the actuated coordinates, which the path fixes
algebraically for flat scenes, is prescribed to the model on generalized coordinates, and the multipliers of these
constraints are the inputs. The passive coordinates then swing freely, from rest. Mass matrix and forces are user
functions compiled by CasADi. Scenes with internal dynamics do not fix their actuated coordinates algebraically, and
nothing in Exudyn takes a reduced form, which is no mechanism any more: both are listed with this reason.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import make_interp_spline

import servocore as sc
from benchmarks.chart.candidate import OUTPUT_INTERVALS, Answer, Array, Candidate, Prepared, Problem
from benchmarks.peers.base import Effort, Lean, inside
from servocore.model.system import MechanicalSystem

NAME, DISTRIBUTION = "exudyn", "exudyn"

DIVISIONS = (1, 2, 4, 8, 16)  # of each interval of the output grid
METHODS = {
    "generalized-alpha, 0.9": (0.9, False),
    "generalized-alpha, 0.5": (0.5, False),
    "index-2 trapezoidal": (1.0, True),
}


def candidates(problem: Problem, effort: Effort) -> list[Candidate]:
    """List constant steps on the model of generalized coordinates."""
    import exudyn  # noqa: F401, PLC0415

    names = list(problem.scene.models)
    model = "generalized" if "generalized" in names else names[0]
    if sc.analyse(problem.scene).internal_degrees_of_freedom:
        refusal = partial(_refuse, "the path does not fix the actuated coordinates algebraically: internal dynamics")
        return [
            Candidate(problem, NAME, model, formulation, "none", "-", refusal)
            for formulation in ("projected", "reduced")
        ]
    found = [
        Candidate(problem, NAME, model, "projected", f"{method}, actuated coordinates prescribed",
                  f"{division * OUTPUT_INTERVALS} steps", partial(prepare, problem, model, division, *settings))
        for method, settings in inside(list(METHODS.items()), effort.smoke)
        for division in inside(DIVISIONS, effort.smoke)
    ]  # fmt: skip
    refusal = partial(_refuse, "Exudyn solves mechanisms; it has no objects for algebraic equations in general")
    return [*found, Candidate(problem, NAME, model, "reduced", "none", "-", refusal)]


def _refuse(reason: str) -> Prepared:
    raise NotImplementedError(reason)


def prepare(problem: Problem, model: str, division: int, radius: float, index2: bool) -> Prepared:
    """Build the mechanism; the actuated coordinates come from the exact solution, at the instants of the steps."""
    scene, system = problem.scene, problem.scene.model(model)
    steps = division * OUTPUT_INTERVALS
    h = scene.reference.duration / steps
    exact = problem.exact(steps)
    coordinates, factors = actuated(system)
    drives = np.array([exact[system.coordinates.names[k]] for k in coordinates])
    start = np.array([exact[name][0] if name in exact else 0.0 for name in system.coordinates.names])
    mbs = assemble(system, scene, start, coordinates, drives, _rates(problem, system, coordinates, steps), h)
    settings = settings_of(scene.reference.duration, steps, radius, index2)

    def run() -> Array:
        import exudyn  # noqa: PLC0415

        mbs.systemData.SetODE2Coordinates(start, exudyn.ConfigurationType.Initial)
        if not mbs.SolveDynamic(settings, storeSolver=False, showHints=False):
            raise RuntimeError("SolveDynamic failed")
        multipliers = [mbs.GetSensorStoredData(sensor)[::division, 1] for sensor in mbs.variables["sensors"]]
        found: Array = np.array(multipliers) * factors[:, None]
        return found

    def read(found: Array) -> Answer:
        values = found.copy()
        values[:, 0] = [problem.exact(OUTPUT_INTERVALS)[name][0] for name in problem.inputs]  # no multiplier at rest
        return Answer(dict(zip(problem.inputs, values, strict=True)), float("nan"))

    return Prepared(run, read)


def actuated(system: MechanicalSystem) -> tuple[list[int], Array]:
    """Return which coordinate each input acts on, and by what its multiplier is to be multiplied."""
    B = system.input_matrix
    entries = np.asarray(ca.DM(ca.Function("B", [system.p], [B])(system.parameters.values())))
    coordinates = [int(np.flatnonzero(row)[0]) for row in entries]
    return coordinates, np.array([1.0 / row[k] for row, k in zip(entries, coordinates, strict=True)])


def _rates(problem: Problem, system: MechanicalSystem, coordinates: list[int], steps: int) -> Array:
    """Return the velocities of the actuated coordinates at the steps, by splines through eight times as many points."""
    exact, t = problem.exact(8 * steps), problem.grid(8 * steps)
    names = [system.coordinates.names[k] for k in coordinates]
    return np.array([make_interp_spline(t, exact[name], k=7).derivative()(t)[::8] for name in names])


def _at_step(values: Array, h: float, _: Any, t: float, *__: Any) -> float:
    """Return the value of the step at time `t`: Exudyn asks at the ends of its steps only."""
    return float(values[round(t / h)])


def assemble(
    system: MechanicalSystem, scene: sc.Scene, start: Array, coordinates: list[int], drives: Array, rates: Array,
    h: float,
) -> Any:  # fmt: skip
    """Build one object with user functions, and a constraint with a sensor for each actuated coordinate."""
    import exudyn  # noqa: PLC0415
    from exudyn import itemInterface as items  # noqa: N813, PLC0415

    n, p = len(start), system.parameters.values(scene.parameters)
    mass, force = (_user_function(system, p, each) for each in (system.mass, -system.bias))
    mbs = exudyn.SystemContainer().AddSystem()
    node = mbs.AddNode(items.NodeGenericODE2(
        referenceCoordinates=np.zeros(n), initialCoordinates=start, initialCoordinates_t=np.zeros(n),
        numberOfODE2Coordinates=n))  # fmt: skip
    mbs.AddObject(items.ObjectGenericODE2(
        nodeNumbers=[node], massMatrix=np.eye(n), massMatrixUserFunction=lambda *given: mass(*given[3:]),
        forceUserFunction=lambda *given: force(*given[3:])[:, 0]))  # fmt: skip
    ground = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=mbs.AddNode(items.NodePointGround()), coordinate=0))
    sensors = []
    for k, drive, rate in zip(coordinates, drives, rates, strict=True):
        marker = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=k))
        joint = mbs.AddObject(items.ObjectConnectorCoordinate(
            markerNumbers=[ground, marker], offset=drive[0],
            offsetUserFunction=partial(_at_step, drive, h),
            offsetUserFunction_t=partial(_at_step, rate, h)))  # fmt: skip
        sensors.append(mbs.AddSensor(items.SensorObject(
            objectNumber=joint, outputVariableType=exudyn.OutputVariableType.Force, storeInternal=True,
            writeToFile=False)))  # fmt: skip
    mbs.variables["sensors"] = sensors
    mbs.Assemble()
    return mbs


def _user_function(system: MechanicalSystem, p: Array, expression: ca.SX) -> Callable[[Any, Any], Array]:
    function = ca.Function("user", [system.q, system.v, system.p], [ca.densify(expression)], {"cse": True})
    q, v = ca.SX.sym("q", system.q.numel()), ca.SX.sym("v", system.q.numel())
    lean = Lean(ca.Function("user", [q, v], [function(q, v, p)]).expand())
    return lambda position, velocity: lean(position, velocity)[0].copy()


def settings_of(duration: float, steps: int, radius: float, index2: bool) -> Any:
    """Return the settings of a constant step, without output to files."""
    import exudyn  # noqa: PLC0415

    settings = exudyn.SimulationSettings()
    integration = settings.timeIntegration
    integration.endTime, integration.numberOfSteps = duration, steps
    integration.generalizedAlpha.spectralRadius = radius
    integration.newton.relativeTolerance = integration.newton.absoluteTolerance = 1e-12
    if index2:
        integration.generalizedAlpha.useNewmark = integration.generalizedAlpha.useIndex2Constraints = True
    integration.verboseMode = 0
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWritePeriod = duration / steps
    settings.parallel.numberOfThreads = 1
    settings.displayStatistics = settings.displayComputationTime = False
    return settings
