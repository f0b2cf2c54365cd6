"""`Limit`: bounds of a quantity of a scene, and limits by the name of a reported quantity."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, InvalidSetting
from servocore.model.quantity import Quantity
from servocore.model.symbols import Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.numerics.expressions import as_expression
from servocore.numerics.units import behind, in_unit, unit_of

RATE = ".rate"
"""Suffix of the name of a rate of change."""

Expression: TypeAlias = Callable[[ca.SX, Parameters], ca.SX] | Callable[[MechanicalSystem], ca.SX]
"""(gamma (m, orders), parameters) -> an expression of the path, or (system) -> any of q, v, lam, u, p and gamma."""

Bound: TypeAlias = float | str
"""In SI units, or a text with its unit."""

Bounds: TypeAlias = Bound | tuple[Bound | None, Bound | None]
"""The largest magnitude, or the smallest and the largest value; None where there is no bound."""


@dataclass(frozen=True)
class Limit:
    """A quantity that must stay above a bound, below another, or between two.

    Parameters
    ----------
    quantity, unit : str
        The quantity, such as ``distance of the trolley from the slewing axis`` in ``m``.
    bound : float
        The quantity must be larger than this; -inf for no bound.
    reason : str
        Consequence at the bound, as part of a sentence: ``the rope goes slack``. May be empty.
    expression : callable
        (gamma (m, orders), parameters) -> the quantity as a CasADi expression, or (system) -> the same of the system's
        q, v, lam, u, gamma and parameters.
    at_instants_only : bool
        Whether the path may break the limit between the instants of a grid. For limits of the path.
    upper : float
        Upper bound.
    rate : bool
        Whether the limit is one of the expression's rate of change; `unit` is then that of the rate.
    given_in : str
        Unit of values in messages, such as ``deg``; `unit` when empty.
    """

    quantity: str
    unit: str
    bound: float
    reason: str
    expression: Expression
    at_instants_only: bool = False
    upper: float = math.inf
    rate: bool = False
    given_in: str = ""

    def __post_init__(self) -> None:
        if not callable(self.expression):
            raise InvalidSetting(
                f"the limit of {self.quantity} needs a function that returns an expression, not {self.expression!r}"
            )
        if not self.bound < self.upper:
            raise InvalidSetting(
                f"the limit of {self.quantity} must run from a lower to an upper bound, not from {self.bound:g} to"
                f" {self.upper:g} {self.unit}"
            )

    @cached_property  # used several times in every run, and inspecting a signature is slow
    def of_path(self) -> bool:
        """Whether it is a lower bound of an expression of the path alone: such limits are checked first."""
        return _arguments(self.expression) == 2 and self.upper == math.inf and not self.rate

    @property
    def over_run(self) -> RunQuantity | None:
        """What a whole run adds up, if the limit is on that."""
        return self.expression if isinstance(self.expression, RunQuantity) else None

    @property
    def reported(self) -> str:
        """Name of the reported quantity that it bounds, or whose rate; empty if it bounds another expression."""
        return self.expression.name if isinstance(self.expression, Named | RunQuantity) else ""

    def counts_turns(self, system: MechanicalSystem) -> bool:
        """Whether it bounds an angle that is known up to full turns only.

        Parameters
        ----------
        system : MechanicalSystem
            It reports the quantity.

        Returns
        -------
        bool
            False for a rate.
        """
        if self.rate or not isinstance(self.expression, Named):
            return False
        return reported_quantities(system)[self.expression.name].wraps

    def with_unit(self, value: float) -> str:
        """Return a value of the quantity as a text, in the unit in which the limit was given.

        Parameters
        ----------
        value : float
            In `unit`.

        Returns
        -------
        str
            Six digits and the unit.
        """
        size = in_unit(f"1 {self.given_in}", self.unit, self.quantity) if self.given_in else 1.0
        return f"{value / size:.6g}{behind(self.given_in or self.unit)}"

    def on(self, system: MechanicalSystem) -> ca.SX:
        """Return the expression for a system.

        Parameters
        ----------
        system : MechanicalSystem
            A model of the scene.

        Returns
        -------
        casadi.SX, scalar
            The bounded quantity, in the unit of the limit.

        Raises
        ------
        InvalidModel
            If the expression is not a scalar.
        """
        evaluate: Callable[..., ca.SX] = self.expression
        arguments = (system.gamma, system.parameters) if _arguments(self.expression) == 2 else (system,)
        whose = f"{system.name}: the limit of {self.quantity}" if self.quantity else f"{system.name}: a limit"
        expression = as_expression(evaluate(*arguments), whose)
        if expression.shape != (1, 1):
            raise InvalidModel(f"{whose} has shape {expression.shape}, not (1, 1)")
        return expression


def _arguments(function: Callable[..., Any]) -> int:
    """Return the number of required arguments of a function."""
    return sum(parameter.default is parameter.empty for parameter in inspect.signature(function).parameters.values())


@dataclass(frozen=True)
class Named:
    """The expression of a reported quantity."""

    name: str

    def __call__(self, system: MechanicalSystem) -> ca.SX:
        """Return it for a system; raises `InvalidModel` if that has no such quantity."""
        for quantities, expressions in reversed(_groups(system)):
            names = [quantity.name for quantity in quantities]
            if self.name in names:
                return expressions[names.index(self.name)]
        raise InvalidModel(f"{system.name} reports no {self.name}, so that its limit cannot be kept")


@dataclass(frozen=True)
class RunQuantity(Quantity):
    """A quantity of a whole run: the integral of a reported quantity from the start on, or the root of its mean square.

    As the expression of a limit it is what the run integrates.

    Parameters
    ----------
    of : str
        Name of the reported quantity.
    rms : bool
        Whether it is the root of the mean square.
    """

    of: str = ""
    rms: bool = False

    def __call__(self, system: MechanicalSystem) -> ca.SX:
        """Return the integrand for a system; raises `InvalidModel` if that does not report the quantity."""
        found: ca.SX = self.integrand(Named(self.of)(system))
        return found

    def integrand(self, value: Any) -> Any:
        """Return what it integrates, from the reported quantity that it is of."""
        return value**2 if self.rms else value

    def of_sum(self, total: Any, duration: Any) -> Any:
        """Return it from the integral over a duration in s."""
        return np.sqrt(np.maximum(total, 0.0) / duration) if self.rms else total

    def course(self, t: Array, integrands: Array) -> Array:
        """Return it at every instant (..., N) since the first, by Simpson's rule from the integrands there."""
        from scipy.integrate import cumulative_simpson  # noqa: PLC0415 - few runs integrate what they report

        at_start = np.sqrt(integrands[..., :1]) if self.rms else np.zeros((*integrands.shape[:-1], 1))
        # Of instants evenly apart it takes a quarter of the time; their differences are even up to round-off.
        even = t.ndim == 1 < len(t) and np.ptp(np.diff(t)) <= 4.0 * np.spacing(max(abs(t[0]), abs(t[-1])))
        spacing = {"dx": (t[-1] - t[0]) / (len(t) - 1)} if even else {"x": t}
        later = self.of_sum(cumulative_simpson(integrands, **spacing), t[..., 1:] - t[..., :1])
        return np.concatenate([at_start, later], axis=-1)


def run_quantities(quantities: Iterable[Quantity]) -> tuple[RunQuantity, ...]:
    """Return the energy ``NAME.energy`` (J) of every power and ``NAME.rms_torque`` of every torque of a motor."""
    found = []
    for each in quantities:
        name, _, kind = each.name.rpartition(".")
        if (kind, each.unit) == ("power", "W"):
            found.append(RunQuantity(f"{name}.energy", "J", f"integral of {each.name} over the time", of=each.name))
        elif (kind, each.unit) == ("motor_torque", "N.m"):
            about = f"root of the mean square of {each.name} since the start"
            found.append(RunQuantity(f"{name}.rms_torque", "N.m", about, nonnegative=True, of=each.name, rms=True))
    return tuple(found)


def _groups(system: MechanicalSystem) -> list[tuple[Sequence[Quantity], ca.SX | Sequence[ca.SX]]]:
    """Return the reported quantities in groups; of one name the last counts."""
    return [
        (system.coordinates.quantities, system.q),
        (system.outputs, system.output),
        (list(system.observables), list(system.observables.values())),
        (system.inputs, system.u),
    ]


def reported_quantities(system: MechanicalSystem) -> Mapping[str, Quantity]:
    """Return the reported quantities by name: inputs, observables, servo outputs, coordinates."""
    return {quantity.name: quantity for quantities, _ in _groups(system) for quantity in quantities}


def expression_of(quantity: Quantity) -> Named | RunQuantity:
    """Return the expression of a reported quantity, or the integrand of one of a whole run."""
    return quantity if isinstance(quantity, RunQuantity) else Named(quantity.name)


def quantity_named(system: MechanicalSystem, name: str) -> tuple[Quantity, bool]:
    """Return the reported quantity that a limit names, and whether its rate is meant.

    Raises
    ------
    InvalidSetting
        If no quantity has that name.
    """
    known = dict(reported_quantities(system))
    known |= {each.name: each for each in run_quantities(known.values())}
    of = name if name in known else name.removesuffix(RATE)
    if of not in known or (of != name and isinstance(known[of], RunQuantity)):
        raise InvalidSetting(
            f"{system.name} reports nothing called {name} that could have a limit; there are {', '.join(known)}, and"
            f" the rate of each with {RATE} behind its name"
        )
    return known[of], of != name


def limit_named(system: MechanicalSystem, name: str, bounds: Bounds) -> Limit:
    """Return the limit of a reported quantity, or of its rate.

    Raises
    ------
    InvalidSetting
        If no quantity has that name, or the bounds are invalid.
    """
    quantity, rate = quantity_named(system, name)
    unit = quantity.unit if not rate else f"{quantity.unit}/s"
    what = f"the limit of {name}"
    given = bounds if isinstance(bounds, tuple | list) else [bounds]
    values = [_value(bound, quantity, unit, what) for bound in given]
    if given is bounds:
        if len(values) != 2:
            raise InvalidSetting(f"{what} must be one number or a lower and an upper one, not {bounds!r}")
        lower, upper = values
        lower, upper = (-math.inf if lower is None else lower, math.inf if upper is None else upper)
        if not lower < upper or (lower, upper) == (-math.inf, math.inf):
            raise InvalidSetting(f"{what} must run from a lower to an upper number, not from {given[0]} to {given[1]}")
    else:
        largest = values[0]
        if largest is None or largest <= 0.0:
            raise InvalidSetting(
                f"{what} is {bounds!r}: one number is the largest magnitude and must be positive; for other bounds give"
                f" a lower and an upper one"
            )
        lower, upper = -math.inf if quantity.never_negative and not rate else -largest, largest
    texts = [each for each in given if isinstance(each, str)]
    given_in = next(filter(None, map(unit_of, texts)), "")
    return Limit(name, unit, lower, "", expression_of(quantity), upper=upper, rate=rate, given_in=given_in)


def _value(bound: object, quantity: Quantity, unit: str, what: str) -> float | None:
    """Return a bound of a quantity, or of its rate, as a number in a unit.

    One of an angle that cannot be reached is refused: probably degrees without their unit.
    """
    if bound is None:
        return None
    if isinstance(bound, str):
        number = in_unit(bound, unit, what)
    else:
        try:
            number = math.nan if isinstance(bound, bool) else float(bound)  # type: ignore[arg-type]  # refused below
        except (TypeError, ValueError):
            number = math.nan
    if math.isnan(number):
        raise InvalidSetting(f"{what} must be a number or a text with its unit, such as '2 {unit}', not {bound!r}")
    bare = not isinstance(bound, str) or bound.strip()[-1] in "0123456789."
    most = math.pi if quantity.never_negative else 2.0 * math.pi
    if unit == "rad" and bare and most < abs(number) < math.inf:
        raise InvalidSetting(
            f"{what} is {bound} without a unit: {number:g} rad would be {math.degrees(number):.0f} deg; write"
            f" '{number:g} deg', or '{number:g} rad' if that is meant"
        )
    return number
