"""The variables of exported models: names, units, bounds and start values, in the order of their numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, get_args

import numpy as np

from servocore.model.quantity import Quantity
from servocore.model.symbols import Parameter
from servocore.numerics.compiled_calls import Array
from servocore.numerics.units import behind

Causality = Literal["input", "output", "parameter", "local"]

ORDERS = ("position", "velocity", "acceleration", "jerk", "snap", "crackle", "pop")
"""Names of a path's derivatives of order 0, 1, ...; further ones are called derivative7, ..."""


INTERNAL_STEP = "internal_step"
"""Name of the parameter that divides communication steps."""

_MOST_DISPLAYED = 1e300  # bounds beyond it are none


@dataclass(frozen=True)
class Variable:
    """One variable; its numbers start at `place` in the list of all numbers, see `placed`.

    Attributes
    ----------
    name : str
        Without the index of a component.
    unit, description : str
        The unit as FMI spells it, and one line for tool tips.
    starts : tuple of float
        Start values of its components; empty for calculated variables.
    low, high : float
        Bounds.
    role : str
        Name in the kernel of a parameter besides those of the model, or of a measured input; parameters of one role
        have consecutive places.
    causality : str
        As in FMI.
    size : int or None
        Components of a vector; None for a scalar.
    nominal : float or None
        Typical magnitude.
    fixed : bool
        Whether a parameter is constant after the initialization.
    place : int
        Of its first number.
    """

    name: str
    unit: str
    description: str
    starts: tuple[float, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    role: str = ""
    causality: Causality = "parameter"
    size: int | None = None
    nominal: float | None = None
    fixed: bool = False
    place: int = 0

    @property
    def scalars(self) -> tuple[Variable, ...]:
        """The variable, or one for each component of a vector: as FMI 2 has them, by the name ``load.position[1]``."""
        if self.size is None:
            return (self,)
        return tuple(
            replace(
                self, name=f"{self.name}[{k + 1}]", description=f"{self.description}; component {k + 1}",
                starts=self.starts[k : k + 1], size=None, place=self.place + k,
            )
            for k in range(self.size)
        )  # fmt: skip

    @property
    def places(self) -> range:
        """Places of its numbers."""
        return range(self.place, self.place + (self.size or 1))

    @property
    def unit_behind(self) -> str:
        """The unit as it follows a number in a sentence."""
        return behind(self.unit)

    @property
    def bounds(self) -> dict[str, float]:
        """The finite bounds, by the name of FMI's attribute."""
        attributes = {"min": self.low, "max": self.high}
        return {name: value for name, value in attributes.items() if abs(value) < _MOST_DISPLAYED}

    @property
    def variability(self) -> str:
        """As FMI has it."""
        return ("fixed" if self.fixed else "tunable") if self.causality == "parameter" else "continuous"

    @property
    def range(self) -> str:
        """The finite bounds as a short text."""
        low, high = (self.bounds.get(name) for name in ("min", "max"))
        if low is not None and high is not None:
            return f"{low:g} to {high:g}"
        return f">= {low:g}" if low is not None else f"<= {high:g}" if high is not None else ""


@dataclass(frozen=True)
class Choice:
    """A parameter with named items, numbered from 1.

    Attributes
    ----------
    name, description : str
        As of a `Variable`.
    items : mapping of str to str
        Descriptions by name.
    start : int
        Number of the default item.
    fixed : bool
        Whether it is constant after the initialization.
    """

    name: str
    description: str
    items: tuple[tuple[str, str], ...]
    start: int = 1
    fixed: bool = True
    causality: ClassVar[Causality] = "parameter"

    @property
    def variability(self) -> str:
        """As FMI has it."""
        return "fixed" if self.fixed else "tunable"

    @property
    def type_name(self) -> str:
        """Name of its type."""
        return "".join(part.capitalize() for part in self.name.split("_"))

    @property
    def listed(self) -> str:
        """Its items, in a sentence."""
        names = [f"{k} ({name})" for k, (name, _) in enumerate(self.items, start=1)]
        return " or ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


INPUT_TIME = Choice(
    "input_time",
    "instant of a communication step that its inputs belong to",
    (("start", "its start"), ("end", "its end")),
)
"""A parameter of every model with inputs."""


def order_name(order: int) -> str:
    """Return the name of a derivative of the path."""
    return ORDERS[order] if order < len(ORDERS) else f"derivative{order}"


def per_time(unit: str, order: int) -> str:
    """Return the unit of a derivative by time: ``m`` becomes ``m/s``, ``m/s2``; ``N.m/s`` becomes ``N.m/s2``."""
    if order == 0:
        return unit
    match = re.fullmatch(r"(.*)/s(\d*)", unit)
    if match:
        unit, order = match[1], order + int(match[2] or 1)
    # N/m becomes N/(m.s), in FMI with a negative exponent.
    return f"{unit}{'.' if '/' in unit else '/'}s{order if order > 1 else ''}"


def listed(variables: Iterable[Variable], fmi: int) -> tuple[Variable, ...]:
    """Return variables as a version of FMI has them: the second knows no vectors."""
    return tuple(variables) if fmi == 3 else tuple(scalar for each in variables for scalar in each.scalars)


def placed(variables: Iterable[Variable]) -> tuple[Variable, ...]:
    """Return variables in the order of the kernel, with consecutive places."""
    found, place = [], 0
    for each in sorted(variables, key=lambda each: (get_args(Causality).index(each.causality), each.role != "")):
        found.append(replace(each, place=place))
        place += each.size or 1
    return tuple(found)


def _along(
    outputs: Sequence[Quantity], tracked: str, form: Variable, names: tuple[str, str], texts: tuple[str, str],
    starts: Sequence[float] | Array | None, order: int = 0,
) -> list[Variable]:  # fmt: skip
    """Return a vector variable for the components of the servo output, or a scalar for each.

    If the scene names the tracked body and all components have one unit, they are a vector (``load.position``);
    otherwise every component has its own name (``y.position``).

    Parameters
    ----------
    outputs : sequence of Quantity
        The components.
    tracked : str
        Name of the tracked body; may be empty.
    form : Variable
        Common attributes of the variables; an empty unit is that of the output, or of its derivative.
    names, texts : tuple of str
        Name and description of the vector and of a scalar, the latter with ``{name}`` and perhaps ``{meant}``.
    starts : sequence of float, or None
        Start values of the components, if there are any.
    order : int
        Order of the derivative.
    """
    if tracked and len(outputs) > 1 and len({each.unit for each in outputs}) == 1:
        unit = form.unit or per_time(outputs[0].unit, order)
        values = () if starts is None else tuple(map(float, starts))
        return [replace(form, name=names[0], unit=unit, description=texts[0], starts=values, size=len(outputs))]
    return [
        replace(
            form,
            name=names[1].format(name=each.name),
            unit=form.unit or per_time(each.unit, order),
            description=texts[1].format(name=each.name, meant=f" ({each.description})" if each.description else ""),
            starts=() if starts is None else (float(starts[k]),),
        )
        for k, each in enumerate(outputs)
    ]


def path_variables(outputs: Sequence[Quantity], tracked: str, orders: int, home: Array | None) -> list[Variable]:
    """Return the path and its derivatives, order by order: as inputs, or without a `home` as outputs."""
    form = Variable("", "", "", causality="output" if home is None else "input")
    components, verb, variables = ", ".join(each.name for each in outputs), "" if home is None else "prescribed ", []
    for order in range(orders):
        name, starts = order_name(order), home if home is None or order == 0 else np.zeros(len(outputs))
        texts = f"{verb}{name} of the {tracked}, components {components}", f"{verb}{name} of {{name}}{{meant}}"
        variables += _along(outputs, tracked, form, (f"{tracked}.{name}", f"{{name}}.{name}"), texts, starts, order)
    return variables


def of_quantity(quantity: Quantity, causality: Causality, starts: tuple[float, ...] = ()) -> Variable:
    """Return a quantity as a variable; an output that must be positive has the lower bound zero."""
    low = 0.0 if causality == "output" and quantity.positive else -math.inf
    text = quantity.description or quantity.name
    return Variable(quantity.name, quantity.unit, text, starts, low, causality=causality, nominal=quantity.nominal)


def parameter_variables(declared: Sequence[Parameter], values: Array) -> list[Variable]:
    """Return the parameters with the values of the scene."""
    return [
        Variable(
            each.name, each.unit, each.description or each.name, (float(value),), each.lower, each.upper,
            nominal=abs(float(value)) or None, fixed=each.fixed,
        )
        for each, value in zip(declared, values, strict=True)
    ]  # fmt: skip


def internal_step() -> Variable:
    """Return the parameter that divides communication steps."""
    text = "step of the method; a communication step is divided into the nearest whole number of them; 0: one"
    return Variable(INTERNAL_STEP, "s", text, (0.0,), 0.0, 3600.0, "STEP")


def state_variables(names: Sequence[tuple[str, int]], units: Sequence[str]) -> list[Variable]:
    """Return the offsets of the internal states at the start, and the states, such as ``q.s``."""
    added, variables = "added to the {} at the start of the internal dynamics; 0: they start at rest", []
    for (name, order), unit in zip(names, units, strict=True):
        short, rate = name.removeprefix("q."), per_time(unit, order)
        label, of = f"{short}.{order_name(order)}", f"{order_name(order)} of {short}"
        variables += [
            Variable(f"start.{label}", rate, added.format(of), (0.0,), role="STARTS", fixed=True),
            Variable(f"internal.{label}", rate, f"{of}, of the internal dynamics", causality="local"),
        ]
    return variables


# Of a feedback -------------------------------------------------------------------------------------------------------


def measured_variable(quantity: Quantity, size: int | None) -> Variable:
    """Return the input of a measured value; if all are zero there is no feedback."""
    form = of_quantity(quantity, "input", (0.0,) * (size or 1))
    text = f"measured {form.description}; all zero: no feedback"
    return replace(form, name=f"measured.{form.name}", description=text, role="MEASURED", size=size, nominal=None)


def feedback_settings(drives: Sequence[Quantity], distance: float) -> list[Variable]:
    """Return the parameters of a feedback."""
    share = "share of the feedback in the outputs, where motion is measured"
    far = "largest distance from the path with feedback"
    largest = "largest absolute value of {}"
    return [
        Variable("feedback", "1", share, (1.0,), 0.0, 1.0, "SHARE"),
        Variable("feedback_distance", "m", far, (distance,), 1e-3, 1e9, "DISTANCE"),
        *(Variable(f"limit.{e.name}", e.unit, largest.format(e.name), (1e9,), 1e-3, 1e9, "LIMITS") for e in drives),
    ]


# Of a plant ----------------------------------------------------------------------------------------------------------


def plant_settings(
    outputs: Sequence[Quantity], tracked: str, home: Array, longest: float, errors: Mapping[str, str]
) -> list[Variable]:
    """Return the parameters of a plant besides those of its model.

    The start is given by derivatives of the servo output, with default values `home`, shape (orders, outputs).
    """
    wrong = "relative error of {} in the plant"
    solver = "longest step of the solver, Runge-Kutta of order four"
    settings = [Variable(n, "1", wrong.format(of), (0.0,), -0.9, 10.0, "ERRORS") for n, of in errors.items()]
    for name, text in (("wind", "constant force"), ("gust", "force during the gust")):
        form = Variable("", "N", "", role=name.upper())
        texts = f"{text} on the {tracked}", f"{text} on {{name}}, N.m for an angle"
        settings += _along(outputs, tracked, form, (name, f"{name}.{{name}}"), texts, np.zeros(len(outputs)))
    settings += [
        Variable("gust_start", "s", "start time of the gust", (0.0,), -1e9, 1e9, "GUST_START"),
        Variable("gust_duration", "s", "duration of the gust", (0.0,), 0.0, 1e9, "GUST_DURATION"),
        Variable(INTERNAL_STEP, "s", solver, (longest,), 1e-6, 1.0, "LONGEST"),
    ]
    form = Variable("", "", "", role="MOTION", fixed=True)
    for order, values in enumerate(home):
        name = order_name(order)
        texts = f"{name} of the {tracked} at the start", f"{name} of {{name}} at the start"
        settings += _along(outputs, tracked, form, (f"start.{name}", f"start.{name}.{{name}}"), texts, values, order)
    return settings


def offset(name: str, units: Sequence[str]) -> Variable:
    """Return the offset of coordinates at the start, a vector for several ones."""
    size = len(units) if len(units) > 1 else None
    text = "added to the coordinates at rest at the start"
    return Variable(name, units[0], text, (0.0,) * len(units), role="OFFSETS", size=size, fixed=True)


# Of a trajectory -----------------------------------------------------------------------------------------------------


def line_settings(
    outputs: Sequence[Quantity], tracked: str, ends: Array, times: tuple[float, float, float]
) -> list[Variable]:
    """Return the parameters of a line from rest to rest; its times are start time, duration and ramp in s."""
    variables, (start_time, duration, ramp) = [], times
    for name, values in zip(("start", "end"), ends, strict=True):
        form, text = Variable("", "", "", role=name.upper(), fixed=name == "start"), f"{name} of the path"
        variables += _along(outputs, tracked, form, (name, f"{name}.{{name}}"), (text, f"{text}, {{name}}"), values)
    rests, usual = "start time of the motion; the path is at rest before", "0: a quarter of the duration"
    variables += [
        Variable("duration", "s", "duration of the motion", (duration,), 1e-3, 1e9, "DURATION"),
        Variable("start_time", "s", rests, (start_time,), -1e9, 1e9, "START_TIME"),
        Variable("ramp", "s", f"duration of the acceleration, for three-phase; {usual}", (ramp,), 0.0, 1e9, "RAMP"),
        Variable(
            "trigger", "1", "another value begins a new motion with these settings, from rest", (0.0,), role="TRIGGER"
        ),
    ]
    return variables
