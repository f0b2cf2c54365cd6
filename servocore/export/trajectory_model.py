"""`trajectory_model`: paths with their derivatives, ready to become an FMU: lines by a time law, or a built-in path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from servocore.errors import InvalidReference, InvalidSetting
from servocore.export import variables as rows
from servocore.export.building import require_limits_kept
from servocore.export.native_model import NativeModel, identifier_of
from servocore.export.variables import Choice
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.problem import Problem
from servocore.references.base import Reference, subdivided
from servocore.references.periodic import Periodic
from servocore.references.piecewise import PiecewisePolynomial, hermite
from servocore.references.profiles import DEFAULT_RAMP, TIME_LAWS, PolynomialProfile, ThreePhaseProfile
from servocore.references.rest_to_rest import RestToRest, rest_to_rest
from servocore.solvers.runs import require_derivatives

LAWS = {
    name: f"one polynomial of degree {law.degree}"
    if isinstance(law, PolynomialProfile)
    else "acceleration, cruise, deceleration"
    for name, law in TIME_LAWS.items()
}
"""Time laws by the names of their choices, in the order of their numbers."""

FROM_FILE = "file"
"""The choice of the built-in path."""


_ROWS = 256  # at least, of a path that is no polynomial


@dataclass(frozen=True)
class TrajectoryOptions:
    """Options of an exported trajectory.

    Attributes
    ----------
    path : Reference, optional
        A built-in path, chosen by default, in place of the scene's own.
    profile : str, optional
        One of `LAWS` as default, in place of the path or of the law of the scene's own line.
    start : mapping of str to float
        Start values of parameters in place of defaults, by the names of FMI 2.
    identifier : str
        Name of libraries and prefix of functions; from the scene's name when empty.
    offers_file : bool
        Whether the built-in path is among the choices although there is none: the choice is refused.
    """

    path: Reference | None = None
    profile: str | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    identifier: str = ""
    offers_file: bool = False


def trajectory_model(scene: Scene, model: str | None = None, options: TrajectoryOptions | None = None) -> NativeModel:
    """Compile the time laws for a scene's path, with a built-in path if it is no line by one of them.

    Parameters
    ----------
    scene : Scene
        Its own path gives the start values of the parameters.
    model : str, optional
        Model of the scene, which determines the number of derivatives; its smallest when not given.
    options : TrajectoryOptions, optional
        The path in place of the scene's own.

    Raises
    ------
    InvalidReference
        If the path has other components than the scene, or fewer derivatives than its inputs need, or breaks a limit.
    InvalidSetting
        If there is no such profile.
    """
    options = options or TrajectoryOptions()
    problem = Problem.of(scene, model)
    orders, servo = problem.array.reference_order + 1, problem.system.outputs
    law, begin, ramp = _line(scene.reference)
    baked = options.path if options.path is not None or law else scene.reference
    if baked is not None and baked.dimension != len(servo):
        raise InvalidReference(f"the path has {baked.dimension} components, {scene.name} has {len(servo)}")
    if options.path is not None:
        scene.with_reference(options.path)  # which refuses units that are implausible for the scene
    path = baked or scene.reference
    require_derivatives(replace(problem, reference=path), orders - 1, "the inputs need")
    require_limits_kept(replace(scene, reference=path), model)
    identifier = options.identifier or identifier_of(f"{scene.name}_trajectory")
    profile = options.profile or (law if baked is None else FROM_FILE)
    ends = scene.reference.jet([scene.reference.start_time, scene.reference.end_time], 0)[:, 0]
    times = begin, scene.reference.duration, ramp if law == profile else 0.0
    played = rows.path_variables(servo, scene.tracked, orders, None)
    variables = rows.placed([*played, *rows.line_settings(servo, scene.tracked, ends, times)])
    items = LAWS | ({FROM_FILE: "the built-in path"} if baked is not None or options.offers_file else {})
    if profile not in items:
        raise InvalidSetting(f"there is no profile {profile!r}; there are {', '.join(items)}")
    number, meaning = 1 + list(items).index(profile), "time law along the line, or a path"
    start_time = min(0.0, path.start_time)  # a run starts at zero unless the path starts earlier
    outputs = [Quantity(each.name, each.unit, each.description) for each in rows.listed(played, 2)]
    return NativeModel(
        identifier=identifier,
        title=f"{scene.name} trajectory",
        model="",
        description=f"Path for {scene.name.replace('_', ' ')} with its derivatives: a line from rest to rest, or a path"
        " of one's own",
        kernel="trajectory",
        own={
            "components": len(servo),
            "orders": orders,
            "law_names": [*LAWS, FROM_FILE],
            "ramped": 1 + list(LAWS).index("three-phase"),
            "path": None if baked is None else _polynomial(baked, orders),
            "period": baked.period if isinstance(baked, Periodic) else 0.0,
        },
        functions={
            f"law_{k}": _law(name, f"{identifier}_law_{k}", len(servo), orders) for k, name in enumerate(LAWS, start=1)
        },
        variables=variables,
        choices=(Choice("profile", meaning, tuple(items.items()), number, fixed=False),),
        outputs=tuple(outputs),
        depends=np.zeros((len(outputs), 0), dtype=bool),
        timed=True,
        start_time=start_time,
        duration=path.end_time - start_time,
    ).with_starts(options.start)


def _line(path: Reference) -> tuple[str, float, float]:
    """Return law, start time and ramp (0: the default) of a line; the law is empty for a path by none of `LAWS`."""
    if isinstance(path, RestToRest):
        for name, law in TIME_LAWS.items():
            if isinstance(law, ThreePhaseProfile) and isinstance(path.profile, ThreePhaseProfile):
                return name, path.start_time, path.profile.ramp or 0.0
            if path.profile == law:
                return name, path.start_time, 0.0
    return "", 0.0, 0.0


# Laws ----------------------------------------------------------------------------------------------------------------


def _law(name: str, function_name: str, m: int, orders: int) -> ca.Function:
    """Return (start, end, start time, end time, ramp, time) -> the path, order by order.

    It is the formula of the library's path, operation by operation: estimates of derivatives from positions amplify
    round-off by 1/h^4.
    """
    first, last, time = ca.SX.sym("start", m), ca.SX.sym("end", m), ca.SX.sym("time")
    begin, end, ramp = ca.SX.sym("start_time"), ca.SX.sym("end_time"), ca.SX.sym("ramp")
    law, span, order = TIME_LAWS[name], end - begin, orders - 1
    if isinstance(law, ThreePhaseProfile):
        numbers = law.numbers_with(ca.if_else(ramp > 0, ramp, DEFAULT_RAMP * span), span, order)
    else:
        numbers = law.numbers(span, order)
    ends = [each for point in (first, last, last - first) for each in ca.vertsplit(point)]
    line = rest_to_rest([0.0] * m, [1.0] * m, 1.0, law).formula
    path = line.jet(time, [*ends, begin, end, *numbers], order)
    return ca.Function(function_name, [first, last, begin, end, ramp, time], [ca.vertcat(*path)], {"cse": True})


# Paths ---------------------------------------------------------------------------------------------------------------


def _polynomial(path: Reference, orders: int) -> PiecewisePolynomial:
    """Return a path, or one period of it, as piecewise polynomial, interpolated at many instants if it is none."""
    order = max(4, orders - 1)
    if isinstance(path, PiecewisePolynomial):
        return path
    if isinstance(path, Periodic):
        path = replace(path, end_time=path.start_time + path.period)
    ends = path.stretches
    parts = -(-_ROWS // (len(ends) - 1))
    t = subdivided(ends, parts)
    return hermite(t, path.jet(t, min(order, path.max_order)))[0]
