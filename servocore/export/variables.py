"""The variables of an exported inverse model: names, units, bounds and start values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from servocore.export.units import per_time
from servocore.model.quantity import Quantity
from servocore.model.symbols import Parameter
from servocore.numerics.calls import Array

Causality = Literal["input", "output", "parameter", "local"]

ORDERS = ("position", "velocity", "acceleration", "jerk", "snap", "crackle", "pop")
"""Names of a path's derivatives of order 0, 1, ...; further ones are called derivative7, ..."""

INPUT_TIMES = ("start", "end")
"""Values of input_time, from 1 on: the instant of a communication step that its inputs belong to."""

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

    @property
    def scalar_names(self) -> tuple[str, ...]:
        """Names of the components, as FMI 2 has them."""
        return (self.name,) if self.size is None else tuple(f"{self.name}[{k + 1}]" for k in range(self.size))

    @property
    def bounds(self) -> dict[str, float]:
        """The bounds that there are, by the name of FMI's attribute."""
        found = {"min": self.low, "max": self.high}
        return {name: value for name, value in found.items() if abs(value) < _MOST_DISPLAYED}


def order_name(order: int) -> str:
    """Return what a derivative of the path is called."""
    return ORDERS[order] if order < len(ORDERS) else f"derivative{order}"


def path_variables(outputs: Sequence[Quantity], tracked: str, orders: int, home: Array) -> list[Variable]:
    """Return the inputs: the path and its derivatives, order by order.

    Where the scene has a word for what follows the path and all components have one unit, they are vectors
    (``load.position``); otherwise every component has a name of its own (``y.position``).
    """
    count, found = len(outputs), []
    together = bool(tracked) and count > 1 and len({each.unit for each in outputs}) == 1
    for order in range(orders):
        starts = [float(value) if order == 0 else 0.0 for value in home]
        what = order_name(order)
        if together:
            text = f"{what} wanted of the {tracked}, components {', '.join(each.name for each in outputs)}"
            unit = per_time(outputs[0].unit, order)
            found.append(Variable(f"{tracked}.{what}", "input", unit, text, order * count, tuple(starts), count))
            continue
        for k, each in enumerate(outputs):
            meant = f" ({each.description})" if each.description else ""
            text, unit = f"{what} wanted of {each.name}{meant}", per_time(each.unit, order)
            found.append(Variable(f"{each.name}.{what}", "input", unit, text, order * count + k, (starts[k],)))
    return found


def output_variables(quantities: Sequence[Quantity], place: int) -> list[Variable]:
    """Return the outputs: the inputs of the mechanical system, and what its model observes."""
    return [
        Variable(
            each.name, "output", each.unit, each.description or each.name, place + k,
            low=0.0 if each.positive else -math.inf, nominal=each.nominal,
        )
        for k, each in enumerate(quantities)
    ]  # fmt: skip


def parameter_variables(declared: Sequence[Parameter], values: Array, place: int) -> list[Variable]:
    """Return the parameters with the values that the scene has."""
    return [
        Variable(
            each.name, "parameter", each.unit, each.description or each.name, place + k, (float(value),),
            low=each.lower, high=each.upper, nominal=abs(float(value)) or None,
        )
        for k, (each, value) in enumerate(zip(declared, values, strict=True))
    ]  # fmt: skip


def internal_step(place: int) -> Variable:
    """Return the parameter that divides communication steps."""
    text = "step of the method; a communication step takes the nearest whole number of them; 0: one"
    return Variable(INTERNAL_STEP, "parameter", "s", text, place, (0.0,), low=0.0, high=3600.0)


def start_variables(names: Sequence[tuple[str, int]], units: Sequence[str], place: int) -> list[Variable]:
    """Return the parameters that move the internal states from where they begin by themselves."""
    return [
        Variable(
            f"start.{name.removeprefix('q.')}.{order_name(order)}", "parameter", per_time(unit, order),
            "added to the internal state at its start; 0: it begins at rest", place + k, (0.0,), fixed=True,
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
