"""`plant_model`: the forward dynamics of a scene, ready to become an FMU: the functions of a `Plant`, as C."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.export import variables as rows
from servocore.export.c_functions import tangent
from servocore.export.inverse_functions import bounds_of
from servocore.export.native_model import Bound, NativeModel, identifier_of
from servocore.export.variables import INPUT_TIME, Choice, Variable
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.numerics.expressions import highest_derivative
from servocore.numerics.machine_code import renamed
from servocore.problem import Problem
from servocore.stepping.forward_dynamics import Plant, compile_plant
from servocore.stepping.observation import compile_margins
from servocore.structure.inversion import inversion

CHOICES = (
    INPUT_TIME,
    Choice(
        "hold",
        "inputs between communication points",
        (("first_order", "linear"), ("zero_order", "constant")),
    ),
    Choice(
        "brakes",
        "brakes hold the plant until an input is not zero",
        (("until_inputs", "until an input is not zero"), ("none", "no brakes")),
    ),
)
_LONGEST = 0.002  # s, of an internal step


@dataclass(frozen=True)
class PlantOptions:
    """Differences of an exported plant from the model of its scene.

    Attributes
    ----------
    errors : mapping of str to str
        Relative errors: a parameter of the plant for each parameter of the model that is larger by this fraction.
    offsets : mapping of str to sequence of str
        Parameters that are added to coordinates at the start: ``{"start.swing": ("swing_in", "swing_out")}``. By
        default each coordinate of a model without constraints has one.
    start : mapping of str to float or str
        Start values of parameters in place of defaults, by the names of FMI 2, and items of choices.
    identifier : str
        Name of libraries and prefix of functions; from the scene's name when empty.
    ranges : mapping of str to (float, float)
        Lowest and highest values of parameters in place of defaults, by their names without components.
    reasons : mapping of str to str
        Meaning of a positive output that reaches zero, by its name, before the name in the sentence:
        ``{"tension": "the rope goes slack: its"}``.
    """

    errors: Mapping[str, str] = field(default_factory=dict)
    offsets: Mapping[str, Sequence[str]] = field(default_factory=dict)
    start: Mapping[str, float | str] = field(default_factory=dict)
    identifier: str = ""
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)


def plant_model(scene: Scene, model: str | None = None, options: PlantOptions | None = None) -> NativeModel:
    """Compile the forward dynamics of a scene for export.

    Parameters
    ----------
    scene : Scene
        With its parameter values; the plant starts at rest at the start of the path.
    model : str, optional
        Model of the scene; when not given the first without constraints, or its smallest.
    options : PlantOptions, optional
        Differences of the plant from the model.

    Raises
    ------
    InvalidModel
        If constraints are redundant, the equations contain the time, or variables have no valid names.
    """
    options = options or PlantOptions()
    model = model or scene.independent_model or scene.default_model
    problem = Problem.of(scene, model)
    # Derivatives of the output, itself included, that determine coordinates and their rates.
    plant, orders = compile_plant(problem.system), max(2, problem.array.reference_order)
    identifier = options.identifier or identifier_of(f"{scene.name}_plant")
    used = _used(problem, plant)
    independent = () if problem.system.lam.numel() else problem.system.coordinates.names
    offsets = options.offsets or {f"start.{coordinate}": (coordinate,) for coordinate in independent}
    limits, margins = _limits(problem, 1)
    start_limits, start_margins = _limits(problem, orders)
    functions = {
        "begin": _begin(problem, f"{identifier}_begin", offsets, orders),
        **_functions(problem, plant, identifier, used, margins),
        "start_margins": renamed(start_margins, f"{identifier}_start_margins"),
    }
    variables = _variables(problem, scene.tracked, used, offsets, options, orders)
    return NativeModel(
        identifier=identifier,
        title=f"{scene.name} plant",
        model=model,
        description=f"Forward dynamics of {scene.name.replace('_', ' ')}: its motion under the inputs"
        f" {', '.join(quantity.name for quantity in problem.system.inputs)}",
        kernel="plant",
        own={
            "state_size": 2 * len(problem.system.coordinates),
            "pushed": len(problem.system.outputs),
            "start_orders": orders,
            "start_limits": start_limits,
            "errors": [problem.system.parameters.names.index(parameter) for parameter in options.errors.values()],
            "offsets": sum(len(offset) for offset in offsets.values()),
            "reasons": [options.reasons.get(each.name, "") for each in used],
        },
        functions=functions,
        variables=variables,
        choices=CHOICES,
        outputs=tuple(used),
        limits=limits,
        depends=np.ones((len(used), len(problem.system.inputs)), dtype=bool),
        duration=scene.reference.duration,
        differentiable=True,
    ).with_starts(options.start)


def _used(problem: Problem, plant: Plant) -> list[Quantity]:
    """Return the channels that are outputs: without accelerations and inputs, with their required signs."""
    system = problem.system
    left = {f"{quantity.name}_ddot" for quantity in system.outputs} | {quantity.name for quantity in system.inputs}
    known = (*system.coordinates.quantities, *system.observables)
    positive = {each.name for each in known if each.positive}
    # A rope cannot push: where its tension in the equations is not positive it is slack, and they are not valid.
    # Quantities of the motion alone, such as an angle from the vertical, may be zero.
    forces = (each for each, expression in system.observables.items() if ca.depends_on(expression, system.lam))
    positive |= {each.name for each in (*forces, *system.reactions) if each.never_negative}
    rates = {f"{each.name}_dot": f"rate of {each.name}" for each in system.coordinates.quantities}
    channels = [channel for channel in plant.channels if channel.name not in left]
    return [
        replace(each, positive=each.name in positive, description=rates.get(each.name, each.description))
        for each in channels
    ]


def _variables(
    problem: Problem,
    tracked: str,
    outputs: Sequence[Quantity],
    offsets: Mapping[str, Sequence[str]],
    options: PlantOptions,
    orders: int,
) -> tuple[Variable, ...]:
    system = problem.system
    variables = [rows.of_quantity(each, "input", (0.0,)) for each in system.inputs]
    variables += rows.path_variables(system.outputs, tracked, 2, None)
    variables += [rows.of_quantity(each, "output") for each in outputs[2 * len(system.outputs) :]]
    variables += rows.parameter_variables(system.parameters.declared, problem.p)
    home = np.zeros((orders, len(system.outputs)))
    home[0] = problem.reference.jet(problem.reference.start_time, 0)[0]
    settings = rows.plant_settings(system.outputs, tracked, home, _LONGEST, options.errors)
    units = {quantity.name: quantity.unit for quantity in system.coordinates.quantities}
    settings += [rows.offset(name, [units[each] for each in of]) for name, of in offsets.items()]
    for setting in settings:
        low, high = options.ranges.get(setting.name, (setting.low, setting.high))
        variables.append(replace(setting, low=low, high=high))
    return rows.placed(variables)


def _limits(problem: Problem, orders: int) -> tuple[tuple[Bound, ...], ca.Function]:
    """Return the limits of the path in its lowest derivatives, and the function (these, p) -> margins."""
    system = problem.system
    orders = min(orders, system.gamma.shape[1])
    highest = {limit: highest_derivative(limit.on(system), system.gamma) for limit in problem.path_limits}
    kept = tuple(limit for limit, order in highest.items() if 0 <= order < orders)
    return tuple(bound for limit in kept for bound in bounds_of(limit)), compile_margins(system, kept, orders - 1)


def _functions(
    problem: Problem, plant: Plant, identifier: str, outputs: Sequence[Quantity], margins: ca.Function
) -> dict[str, ca.Function]:
    """Return the plant's functions and their tangents by name."""
    m, servo = len(problem.system.inputs), len(problem.system.outputs)
    state, d = ca.MX.sym("state", plant.step.numel_in(0)), ca.MX.sym("d", servo)
    u, slope, h = ca.MX.sym("u", m), ca.MX.sym("slope", m), ca.MX.sym("h")
    p = ca.MX.sym("p", problem.system.p.numel())
    places = [[channel.name for channel in plant.channels].index(each.name) for each in outputs]

    def seen(channels: ca.MX) -> list[ca.MX]:
        """Return outputs, and margins of limits."""
        return [ca.densify(channels[places]), margins(channels[:servo], p)]

    signatures: dict[str, tuple[list[ca.MX], list[ca.MX], list[ca.MX]]] = {
        "step": ([state, u, slope, d, p, h], [plant.step(state, u, slope, d, p, h)], [state, u, slope, p]),
        "held_step": ([state, d, p, h], [plant.held_step(state, d, p, h)], [state, p]),
        "observe": ([state, u, d, p], seen(plant.observe(state, u, d, p)), [state, u, p]),
        "held_observe": ([state, d, p], seen(plant.held_observe(state, d, p)), [state, p]),
    }
    functions = {}
    for name, (arguments, results, by) in signatures.items():
        functions[name] = ca.Function(f"{identifier}_{name}", arguments, results)
        functions[f"{name}_tangent"] = tangent(f"{identifier}_{name}_tangent", arguments, results[:1], by)
    return functions


def _begin(problem: Problem, name: str, offsets: Mapping[str, Sequence[str]], orders: int) -> ca.Function:
    """Return (position, velocity, ... of the output, offsets, p) -> state at the start."""
    array, system = problem.array, problem.system
    servo = len(system.outputs)
    motion, p = ca.MX.sym("motion", servo, orders), ca.MX.sym("p", system.p.numel())
    path = ca.horzcat(motion, ca.MX.zeros(servo, 1))[:, : array.reference_order + 1]
    unknowns = inversion(problem.array).function(path, p)[0]
    coordinates = problem.system.coordinates.names
    state = [unknowns[array.position(f"q.{each}", order)] for order in (0, 1) for each in coordinates]
    names = [each for of in offsets.values() for each in of]
    added = ca.MX.sym("offsets", len(names))
    for k, each in enumerate(names):
        if each not in coordinates:
            raise InvalidModel(f"{problem.name} has no coordinate {each}")
        state[coordinates.index(each)] += added[k]
    return ca.Function(name, [motion, added, p], [ca.densify(ca.vertcat(*state))])
