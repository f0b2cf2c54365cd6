"""The variables of an exported inverse model: names, units, bounds and start values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from servocore.errors import InvalidSetting
from servocore.export.units import per_time
from servocore.model.quantity import Quantity
from servocore.model.symbols import Parameter
from servocore.numerics.compiled_calls import Array

Causality = Literal["input", "output", "parameter", "local"]

ORDERS = ("position", "velocity", "acceleration", "jerk", "snap", "crackle", "pop")
"""Names of a path's derivatives of order 0, 1, ...; further ones are called derivative7, ..."""


INTERNAL_STEP = "internal_step"
"""Name of the parameter that divides communication steps."""

_MOST_DISPLAYED = 1e300  # bounds beyond it are none


@dataclass(frozen=True)
class Variable:
    """One variable; its numbers lie at `place` and after in the list of all numbers.

    Attributes
    ----------
    name : str
        Without the index of a component.
    causality : str
        As in FMI.
    unit, description : str
        The unit as FMI spells it, and one line for tool tips.
    place : int
        Of its first number.
    starts : tuple of float
        Start values of its components; empty for what is calculated.
    size : int or None
        Components of a vector; None for a scalar.
    low, high : float
        Bounds.
    nominal : float or None
        Typical magnitude.
    fixed : bool
        Whether a parameter keeps its value from the end of the initialization on.
    setting : bool
        Whether a parameter is none of the model.
    role : str
        What the kernel calls the place of a parameter that it looks for, and of those behind it that belong to it.
    """

    name: str
    causality: Causality
    unit: str
    description: str
    place: int
    starts: tuple[float, ...] = ()
    size: int | None = None
    low: float = -math.inf
    high: float = math.inf
    nominal: float | None = None
    fixed: bool = False
    setting: bool = False
    role: str = ""

    @property
    def scalar_names(self) -> tuple[str, ...]:
        """Names of the components, as FMI 2 has them."""
        return (self.name,) if self.size is None else tuple(f"{self.name}[{k + 1}]" for k in range(self.size))

    @property
    def bounds(self) -> dict[str, float]:
        """The bounds that there are, by the name of FMI's attribute."""
        attributes = {"min": self.low, "max": self.high}
        return {name: value for name, value in attributes.items() if abs(value) < _MOST_DISPLAYED}


@dataclass(frozen=True)
class Choice:
    """A parameter that is one of some names, which are numbered from 1 on.

    Attributes
    ----------
    name, description : str
        As of a `Variable`.
    items : mapping of str to str
        Descriptions by name.
    start : int
        Number of the item that is chosen at first.
    """

    name: str
    description: str
    items: tuple[tuple[str, str], ...]
    start: int = 1

    @property
    def type_name(self) -> str:
        """Name of its type."""
        return "".join(part.capitalize() for part in self.name.split("_"))

    @property
    def listed(self) -> str:
        """Its items in a sentence."""
        names = [f"{k} ({name})" for k, (name, _) in enumerate(self.items, start=1)]
        return " or ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


INPUT_TIME = Choice(
    "input_time",
    "instant of a communication step that its inputs belong to",
    (("start", "its start"), ("end", "its end")),
)
"""What every model with inputs has."""


def order_name(order: int) -> str:
    """Return what a derivative of the path is called."""
    return ORDERS[order] if order < len(ORDERS) else f"derivative{order}"


def path_variables(outputs: Sequence[Quantity], tracked: str, orders: int, home: Array) -> list[Variable]:
    """Return the inputs: the path and its derivatives, order by order.

    Where the scene has a word for what follows the path and all components have one unit, they are vectors
    (``load.position``); otherwise every component has a name of its own (``y.position``).
    """
    count, variables = len(outputs), []
    for order in range(orders):
        starts = [float(value) if order == 0 else 0.0 for value in home]
        what = order_name(order)
        if together(outputs, tracked):
            text = f"{what} wanted of the {tracked}, components {', '.join(quantity.name for quantity in outputs)}"
            unit = per_time(outputs[0].unit, order)
            variables.append(Variable(f"{tracked}.{what}", "input", unit, text, order * count, tuple(starts), count))
            continue
        for k, quantity in enumerate(outputs):
            meant = f" ({quantity.description})" if quantity.description else ""
            text, unit = f"{what} wanted of {quantity.name}{meant}", per_time(quantity.unit, order)
            variables.append(Variable(f"{quantity.name}.{what}", "input", unit, text, order * count + k, (starts[k],)))
    return variables


def output_variables(quantities: Sequence[Quantity], place: int) -> list[Variable]:
    """Return the outputs: the inputs of the mechanical system, and what its model observes."""
    return [
        Variable(
            quantity.name, "output", quantity.unit, quantity.description or quantity.name, place + k,
            low=0.0 if quantity.positive else -math.inf, nominal=quantity.nominal,
        )
        for k, quantity in enumerate(quantities)
    ]  # fmt: skip


def parameter_variables(declared: Sequence[Parameter], values: Array, place: int) -> list[Variable]:
    """Return the parameters with the values that the scene has."""
    return [
        Variable(
            each.name, "parameter", each.unit, each.description or each.name, place + k, (float(value),),
            low=each.lower, high=each.upper, nominal=abs(float(value)) or None, fixed=each.fixed,
        )
        for k, (each, value) in enumerate(zip(declared, values, strict=True))
    ]  # fmt: skip


def internal_step(place: int) -> Variable:
    """Return the parameter that divides communication steps."""
    text = "step of the method; a communication step takes the nearest whole number of them; 0: one"
    return Variable(INTERNAL_STEP, "parameter", "s", text, place, (0.0,), None, 0.0, 3600.0, setting=True, role="STEP")


def start_variables(names: Sequence[tuple[str, int]], units: Sequence[str], place: int) -> list[Variable]:
    """Return the parameters that move the internal states from where they begin by themselves."""
    return [
        Variable(
            f"start.{name.removeprefix('q.')}.{order_name(order)}", "parameter", per_time(unit, order),
            "added to the internal state at its start; 0: it begins at rest", place + k, (0.0,),
            fixed=True, setting=True, role="" if k else "STARTS",
        )
        for k, ((name, order), unit) in enumerate(zip(names, units, strict=True))
    ]  # fmt: skip


def state_variables(names: Sequence[tuple[str, int]], units: Sequence[str], place: int) -> list[Variable]:
    """Return the internal states, each a variable such as ``q.s`` with the order of its derivative."""
    return [
        Variable(
            f"internal.{name.removeprefix('q.')}.{order_name(order)}", "local", per_time(unit, order),
            "state of the internal dynamics", place + k,
        )
        for k, ((name, order), unit) in enumerate(zip(names, units, strict=True))
    ]  # fmt: skip


# Of a feedback -------------------------------------------------------------------------------------------------------


def measured_variables(measured: Sequence[tuple[Quantity, int | None]], place: int) -> list[Variable]:
    """Return the inputs of what is measured; all zero, there is no feedback."""
    variables = []
    for each, size in measured:
        text = f"measured {each.description or each.name}; all zero: no feedback"
        variables.append(
            Variable(f"measured.{each.name}", "input", each.unit, text, place, (0.0,) * (size or 1), size=size)
        )
        place += size or 1
    return variables


def feedback_settings(drives: Sequence[Quantity], distance: float, place: int) -> list[Variable]:
    """Return the parameters of a feedback."""
    share = "share of the feedback in the outputs, where motion is measured"
    far = "farther than this from its path there is no feedback"
    limits = (
        _setting(f"limit.{e.name}", e.unit, f"largest |{e.name}| that the drive gives", (1e9,), 1e-3, 1e9)
        for e in drives
    )
    variables = [
        _setting("feedback", "1", share, (1.0,), 0.0, 1.0, "SHARE"),
        _setting("feedback_distance", "m", far, (distance,), 1e-3, 1e9, "DISTANCE"),
        *playing("LIMITS", limits),
    ]
    return [placed(each, place + k) for k, each in enumerate(variables)]


# Of a plant ----------------------------------------------------------------------------------------------------------


def together(outputs: Sequence[Quantity], tracked: str) -> bool:
    """Whether components of an output are vectors: there is a word for what they belong to, and they have one unit."""
    return bool(tracked) and len(outputs) > 1 and len({quantity.unit for quantity in outputs}) == 1


def motion_variables(outputs: Sequence[Quantity], tracked: str, place: int) -> list[Variable]:
    """Return position and velocity of the servo output as outputs."""
    variables, count = [], len(outputs)
    for order in range(2):
        what, first = order_name(order), place + order * count
        if together(outputs, tracked):
            text = f"{what} of the {tracked}, components {', '.join(quantity.name for quantity in outputs)}"
            unit = per_time(outputs[0].unit, order)
            variables.append(Variable(f"{tracked}.{what}", "output", unit, text, first, size=count))
            continue
        variables += [
            Variable(f"{e.name}.{what}", "output", per_time(e.unit, order), f"{what} of {e.name}", first + k)
            for k, e in enumerate(outputs)
        ]
    return variables


def plant_settings(
    outputs: Sequence[Quantity], tracked: str, home: Array, longest: float, errors: Mapping[str, str]
) -> list[Variable]:
    """Return the parameters of a plant that are none of its model.

    The start is as many derivatives of the servo output, of which `home` (orders, outputs) are the default values; they
    follow each other.
    """
    starts = [(order_name(order), order, tuple(map(float, values))) for order, values in enumerate(home)]
    wrong = "the plant's {} is larger by this fraction of it"
    solver = "longest step of the solver, Runge-Kutta of order four"
    return [
        *playing("ERRORS", (_setting(n, "1", wrong.format(of), (0.0,), -0.9, 10.0) for n, of in errors.items())),
        *(row for each in ("wind", "gust") for row in playing(each.upper(), _pushing(each, outputs, tracked))),
        _setting("gust_start", "s", "time at which the gust begins", (0.0,), -1e9, 1e9, "GUST_START"),
        _setting("gust_duration", "s", "time that the gust lasts", (0.0,), 0.0, 1e9, "GUST_DURATION"),
        _setting(INTERNAL_STEP, "s", solver, (longest,), 1e-6, 1.0, "LONGEST"),
        *(
            row
            for what, order, values in starts
            for row in playing(what.upper(), _starting(f"start.{what}", order, values, outputs, tracked))
        ),
    ]


def offset(name: str, units: Sequence[str]) -> Variable:
    """Return what is added to coordinates at the start, a vector if to several."""
    size = len(units) if len(units) > 1 else None
    text = "added at the start, where it rests otherwise"
    return replace(_setting(name, units[0], text, (0.0,) * len(units)), size=size, fixed=True)


def with_item(choice: Choice, start_values: Mapping[str, float | str]) -> Choice:
    """Return a choice that begins with the item that is given by its name; raises `InvalidSetting` if there is none."""
    names, wanted = [name for name, _ in choice.items], start_values.get(choice.name)
    if wanted is None:
        return choice
    if wanted not in names:
        raise InvalidSetting(f"{choice.name} = {wanted!r} is unknown; it may be {', '.join(names)}")
    return replace(choice, start=names.index(str(wanted)) + 1)


def with_starts(variable: Variable, start_values: Mapping[str, float | str]) -> Variable:
    """Return a variable with those start values that are given by the names of its numbers."""
    if not variable.starts:
        return variable
    values = zip(variable.scalar_names, variable.starts, strict=True)
    return replace(variable, starts=tuple(float(start_values.get(name, value)) for name, value in values))


def _pushing(name: str, outputs: Sequence[Quantity], tracked: str) -> list[Variable]:
    text = "constant force" if name == "wind" else "force during the gust"
    if together(outputs, tracked):
        whole = _setting(name, "N", f"{text} on the {tracked}", (0.0,) * len(outputs))
        return [replace(whole, size=len(outputs))]
    return [_setting(f"{name}.{e.name}", "N", f"{text} on {e.name}, N.m for an angle", (0.0,)) for e in outputs]


def _starting(
    name: str, order: int, values: tuple[float, ...], outputs: Sequence[Quantity], tracked: str
) -> list[Variable]:
    what = f"{order_name(order)} at the start"
    if together(outputs, tracked):
        whole = _setting(name, per_time(outputs[0].unit, order), f"{what} of the {tracked}", values)
        return [replace(whole, size=len(values), fixed=True)]
    return [
        replace(_setting(f"{name}.{e.name}", per_time(e.unit, order), f"{what} of {e.name}", (value,)), fixed=True)
        for e, value in zip(outputs, values, strict=True)
    ]


def _setting(
    name: str,
    unit: str,
    text: str,
    starts: tuple[float, ...],
    low: float = -math.inf,
    high: float = math.inf,
    role: str = "",
) -> Variable:
    return Variable(name, "parameter", unit, text, 0, starts, low=low, high=high, setting=True, role=role)


def playing(role: str, variables: Iterable[Variable]) -> list[Variable]:
    """Return variables that follow each other and play a role together, which the first one has."""
    found = list(variables)
    return [replace(found[0], role=role), *found[1:]] if found else []


# Of a trajectory -----------------------------------------------------------------------------------------------------


def path_outputs(outputs: Sequence[Quantity], tracked: str, orders: int) -> list[Variable]:
    """Return a path and its derivatives as outputs, named as the inputs of an inverse model."""
    variables = path_variables(outputs, tracked, orders, np.zeros(len(outputs)))
    return [
        replace(each, causality="output", starts=(), description=each.description.replace(" wanted of", " of"))
        for each in variables
    ]


def line_settings(
    outputs: Sequence[Quantity], tracked: str, ends: Array, times: tuple[float, float, float]
) -> list[Variable]:
    """Return the parameters of a line from rest to rest.

    Its times are when it starts, how long it takes, and its ramp.
    """
    variables, (start_time, duration, ramp) = [], times
    for name, values in zip(("start", "end"), ends, strict=True):
        text = f"{name} of the path"
        if together(outputs, tracked):
            whole = _setting(name, outputs[0].unit, text, tuple(map(float, values)), role=name.upper())
            variables.append(replace(whole, size=len(outputs)))
            continue
        points = (
            _setting(f"{name}.{e.name}", e.unit, f"{text}, {e.name}", (float(value),))
            for e, value in zip(outputs, values, strict=True)
        )
        variables += playing(name.upper(), points)
    rests, usual = "when the motion starts; the path rests before", "0: a quarter of the duration"
    variables += [
        _setting("duration", "s", "time of the motion", (duration,), 1e-3, 1e9, "DURATION"),
        _setting("start_time", "s", rests, (start_time,), -1e9, 1e9, "START_TIME"),
        _setting("ramp", "s", f"time to accelerate, for three-phase; {usual}", (ramp,), 0.0, 1e9, "RAMP"),
    ]
    return [replace(each, fixed=True) for each in variables]


def placed(variable: Variable, place: int) -> Variable:
    """Return a variable with its place."""
    return replace(variable, place=place)
